"""What people see: widths, contents, and that nothing depends on colour."""

import io
from collections.abc import Sequence

import pytest

from protocol.messages import ALL_BLOCKS, Phase, PhaseAnnounced, Progress, Status
from services.launcher.display import LiveDisplay, PlainDisplay, display_for
from services.launcher.lines import ASCII, Line, clock_words, cpu_table, frame, progress_line, score_table
from services.launcher.members import Picture

RUN = "a-scenario-with-quite-a-long-nam-20260101-120000-4294967295"


def row(
    iteration: int, policy: str = "mean", crossing: float | None = 0.5, block: str = "body"
) -> dict[str, object]:
    numbers = {"separation": 0.98765, "z_min": 0.5, "z_goal": 0.75, "switch_success": 1.0}
    return {"block": block, "iteration": iteration, "policy": policy, "crossing": crossing, **numbers}


def practising(actors: int = 3) -> Picture:
    seen = Picture(RUN, f"/a/long/way/to/somewhere/on/this/disk/{RUN}", 0.0)
    common = {"run": RUN, "block": ALL_BLOCKS, "seq": 0, "term": 7}
    seen.hear_phase(
        PhaseAnnounced(**common, life="c-1", phase=Phase.PRACTISE, iteration=2, iterations=4, blocks={})
    )
    waiting = "waiting for policy_learner: 1,228,800 of 12,288,000 steps of a-block-with-a-long-name"
    for service in ("coordinator", "encoder_learner", "policy_learner"):
        seen.appeared(service, f"{service}-0a1b2c3d")
    seen.hear_status(
        Status(**common, life="coordinator-0a1b2c3d", service="coordinator", waiting_for=waiting), 1.0
    )
    for index in range(actors):
        life = f"actor-{index:08x}"
        seen.appeared("actor", life)
        for now in (1.0, 2.0):
            totals = {"env_steps": round(12_345 * now)}
            seen.hear_status(Status(**common, life=life, service="actor", totals=totals), now)
    for now, done in ((1.0, 1_000_000), (2.0, 1_228_800)):
        progress = [
            Progress(block=block, done=done, wanted=12_288_000, unit="steps")
            for block in ("body", "a-block-with-a-long-name-of-its-own")
        ]
        said = Status(
            **common,
            life="policy_learner-0a1b2c3d",
            service="policy_learner",
            progress=progress,
            last_error="x" * 300,
        )
        seen.hear_status(said, now)
    seen.scores = [row(i, policy) for i in range(9) for policy in ("mean", "sampled")]
    return seen


def texts(lines: Sequence[Line]) -> list[str]:
    return ["".join(text for text, _ in line) for line in lines]


@pytest.mark.parametrize("width", [20, 40, 60, 120])
@pytest.mark.parametrize("actors", [0, 1, 3, 40])
def test_no_line_of_the_live_view_is_wider_than_the_terminal(width: int, actors: int) -> None:
    assert max(map(len, texts(frame(practising(actors), 2.0, width)))) <= width


def test_the_live_view_tells_all_that_matters_at_width_60() -> None:
    seen = practising()
    seen.vanished("actor-00000001", 1.0)
    seen.settle(2.0)
    shown = "\n".join(texts(frame(seen, 75.0, 60)))
    for needed in ("PRACTISE 2 of 4", "1:15", "1,228,800 of 12,288,000 steps", "waiting for policy_learner"):
        assert needed in shown
    for needed in ("encoder_learner alive", "lost", "body  ", "0.988", "! policy_learner-0a1b2c3d: "):
        assert needed in shown


def test_speeds_are_per_actor_and_in_sum_and_time_is_left() -> None:
    shown = "\n".join(texts(frame(practising(), 2.0, 100)))
    assert shown.count("12,345 steps/s") == 3
    assert "3 actors together        37,035 steps/s" in shown
    assert "0:48 left" in shown


def test_the_bar_is_as_full_as_the_work_is_done() -> None:
    bar = next(text for text in texts(frame(practising(), 2.0, 120)) if text.startswith("body"))
    assert (bar.count("█"), bar.count("░")) == (3, 27)


def test_a_terminal_without_unicode_gets_ascii() -> None:
    assert "\n".join(texts(frame(practising(), 2.0, 80, ASCII))).isascii()


def test_before_the_first_word_it_says_that_it_starts() -> None:
    seen = Picture(RUN, "runs/x", 0.0)
    assert "starting the processes" in "\n".join(texts(frame(seen, 1.0, 60)))
    assert progress_line(seen, 1.0) == "waiting for the coordinator"


def test_the_score_table_fits_60_and_names_blocks_only_if_there_are_several() -> None:
    table = score_table([row(0), row(1, "sampled")])
    assert table[0].split() == ["iter", "policy", "separation", "z_min", "z_goal", "switch", "crossing"]
    assert table[2].split() == ["1", "sampled", "0.988", "0.500", "0.750", "1.000", "0.500"]
    assert max(map(len, table)) <= 60
    assert "crossing" not in score_table([row(0, crossing=None)])[0]
    assert score_table([row(0, block="arm"), row(0, block="leg")])[1::2] == ["arm:", "leg:"]
    assert len(score_table([row(i) for i in range(9)], newest=4)) == 5


@pytest.mark.parametrize("crossing", [None, 0.5])
@pytest.mark.parametrize("landmarks", [{}, {"open": 1.0, "closed": 0.5}])
@pytest.mark.parametrize("reward", [None, 0.25, -1234.5678, 3e30])
def test_whatever_the_rows_have_the_score_table_is_never_wider_than_60(
    crossing: float | None, landmarks: dict[str, float], reward: float | None
) -> None:
    rows = [
        {**row(999, "sampled", crossing, block), "landmarks": landmarks, "external_reward": reward}
        for block in ("arm", "b" * 64)
    ]
    table = score_table(rows)
    assert max(map(len, table)) <= 60
    asked = ["z_min", *(["crossing"] if crossing else []), *(["landmark"] if landmarks else ["separation"])]
    assert set(asked) <= set(table[0].split()), "what success is asked of is always shown"


def test_durations_and_cpu() -> None:
    assert [clock_words(secs) for secs in (-1, 42.4, 725, 3723)] == ["0:00", "0:42", "12:05", "1:02:03"]
    assert cpu_table({"router": 1.0, "actor-0": 2.25}) == [
        "router       1.0 s",
        "actor-0      2.2 s",
        "all          3.2 s",
    ]


def test_plain_lines_come_on_changes_and_every_ten_seconds() -> None:
    out = io.StringIO()
    seen = practising()
    seen.news.clear()
    seen.scores = []
    with PlainDisplay(out) as display:
        for tenth in range(250):
            if tenth == 30:
                seen.news.append("actor-9 is there")
            if tenth == 40:
                seen.scores = [row(0)]
            display.show(seen, tenth / 10)
    lines = out.getvalue().splitlines()
    assert [line.split(" s  ")[0].strip() for line in lines] == ["3.0", "4.0", "10.0", "20.0"]
    assert lines[0].endswith("actor-9 is there")
    assert "iteration 0, mean policy: separation 0.988" in lines[1]
    assert "PRACTISE 2 of 4: body 1,228,800 of 12,288,000 steps" in lines[2]


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(
    ("out", "term", "kind"),
    [
        (io.StringIO(), "xterm-256color", PlainDisplay),
        (_Terminal(), "dumb", PlainDisplay),
        (_Terminal(), "xterm-256color", LiveDisplay),
    ],
)
def test_only_a_terminal_that_can_redraw_gets_the_live_view(
    out: io.StringIO, term: str, kind: type, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TERM", term)
    assert isinstance(display_for(out), kind)
