"""The drawing of the phases follows the table."""

import re
from pathlib import Path

from services.coordinator.diagram import REDRAW, mermaid, page, table
from services.coordinator.table import DUTY, NEXT, Phase

PAGE = Path(__file__).parents[2] / "docs" / "phases.md"


def test_the_committed_page_is_the_one_drawn_from_the_table() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), f"the table changed; draw it anew with: {REDRAW}"


def test_the_diagram_shows_every_legal_move_and_no_other() -> None:
    drawn = set(re.findall(r"^    (\w+) --> (\w+)", mermaid(), re.MULTILINE))
    assert drawn == {(phase.value, to.value) for phase, moves in NEXT.items() for to in moves}


def test_every_phase_has_a_row_and_a_duty_and_what_is_otherwise_in_an_open_loop_is_beside_it() -> None:
    rows = [line.strip("| ").split(" | ") for line in table().splitlines()[2:]]
    assert [name for name, *_ in rows if "open loop" not in name] == [phase.value for phase in Phase]
    assert set(DUTY) == set(NEXT) == set(Phase)
    babble = next(index for index, (name, *_) in enumerate(rows) if name == "babble")
    assert [row[0] for row in rows[babble : babble + 2]] == ["babble", "babble (open loop)"]
    assert [row[2] for row in rows[babble : babble + 2]] == ["encoder_learner", "recorder"]
