"""The live view: sizes, contents, what goes first in small ones, and that colour tells nothing alone."""

import pytest

from protocol.messages import ALL_BLOCKS, Status
from services.launcher.frame import facts, frame
from services.launcher.lines import ASCII, progress_line
from services.launcher.members import Picture
from tests.unit.launcher_picture import RUN, crowd, practising, sharing, texts


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
    for needed in ("encoder_learner", "lost", "body  ", "0.988", "! policy_learner-0a1b2c3d: "):
        assert needed in shown


def test_speeds_are_per_actor_and_in_sum_and_time_is_left() -> None:
    shown = "\n".join(texts(frame(practising(), 2.0, 100)))
    assert shown.count(" 12,345 ") == 3
    assert "3 actors together                   37,035" in shown
    assert "0:48 left" in shown


def test_the_bar_is_as_full_as_the_work_is_done() -> None:
    bar = next(text for text in texts(frame(practising(), 2.0, 120)) if text.startswith("body"))
    assert (bar.count("█"), bar.count("░")) == (3, 27)


def test_a_terminal_without_unicode_gets_ascii() -> None:
    assert "\n".join(texts(frame(practising(), 2.0, 80, signs=ASCII))).isascii()


def test_before_the_first_word_it_says_that_it_starts() -> None:
    seen = Picture(RUN, "runs/x", 0.0)
    assert "starting the processes" in "\n".join(texts(frame(seen, 1.0, 60)))
    assert progress_line(seen, 1.0) == "waiting for the coordinator"


@pytest.mark.parametrize("lost", [False, True])
def test_several_learners_are_told_apart_with_the_progress_of_each_block(lost: bool) -> None:
    seen = sharing(lost=lost)
    for shown in (texts(frame(seen, 2.5, 100)), texts(facts(seen, 2.5, 100))):
        heads = [shown.index(f"policy_learner-{who}") for who in ("arm", "leg")]
        arm, leg = (shown[head + 1] for head in heads)
        assert arm.startswith("arm0")
        assert arm.endswith("50 of 100 steps")
        assert leg.startswith("leg0")
        assert leg.endswith("50 of 100 steps, waiting for its learner" if lost else "50 of 100 steps")
        assert (heads[1] < heads[0]) == lost, "what waits comes first"


def test_one_learner_needs_no_name_over_its_blocks() -> None:
    shown = texts(frame(practising(), 2.0, 100))
    assert "policy_learner-0a1b2c3d" not in shown


def row_of(life: str, shown: list[str]) -> list[str]:
    return next(text for text in shown if text.startswith(life)).split()


def test_a_member_is_shown_with_its_last_word_speed_queue_and_cost() -> None:
    seen = practising()
    shown = texts(frame(seen, 4.5, 100))
    assert row_of("actor-00000000", shown) == ["actor-00000000", "2.5", "s", "12,345", "2", "50", "%", "98"]
    assert row_of("encoder_learner", shown)[1:3] == ["not", "yet"]


def test_what_is_learned_is_told_in_numbers() -> None:
    shown = "\n".join(texts(frame(practising(), 2.0, 100)))
    for needed in ("encoder v3", "policy v14", "policy lag 0.5, at most 2", "InfoNCE 2.35", "alignment 0.25"):
        assert needed in shown
    for needed in ("reward -0.25", "distance to goal 0.5", "PPO loss 0.0123", "KL 0.011", "entropy 1.42"):
        assert needed in shown


def test_losses_events_and_the_dashboard_are_told() -> None:
    seen = practising()
    shown = texts(frame(seen, 2.0, 100))
    assert "1 lost · 0 duplicated · 0 refused · 3 sent again" in shown
    assert shown[0].split()[-2:] == ["http://127.0.0.1:9090", "0:02"]
    assert texts(frame(seen, 2.0, 80))[1] == "http://127.0.0.1:9090", "there is no room beside the name"
    assert any(text.endswith("0:00  actor-00000002 is there") for text in shown)
    seen.dashboard = ""
    assert not any("http" in text for text in texts(frame(seen, 2.0, 100)))


@pytest.mark.parametrize("height", [1, 5, 12, 23, 29, 60])
@pytest.mark.parametrize("actors", [0, 2, 8, 40])
def test_the_live_view_fits_the_height(height: int, actors: int) -> None:
    shown = texts(frame(practising(actors), 2.0, 80, height))
    assert len(shown) <= height
    assert shown[0].startswith("Babble")


@pytest.mark.parametrize(("width", "height"), [(80, 23), (100, 29)])
@pytest.mark.parametrize("actors", [2, 8])
def test_in_common_terminals_nothing_that_matters_is_missing(width: int, height: int, actors: int) -> None:
    shown = "\n".join(texts(frame(practising(actors), 2.0, width, height)))
    for needed in ("PRACTISE 2 of 4", "body ", "waiting for policy_learner", "http://127.0.0.1:9090"):
        assert needed in shown
    for needed in (
        "! policy_learner",
        "encoder_learner-0a1b2c3d",
        "actors together",
        "reward -0.25",
        "1 lost",
    ):
        assert needed in shown
    assert "z_min" in shown
    assert "0.988" in shown


def test_small_terminals_show_the_newest_scores_and_events() -> None:
    seen = practising()
    for number in range(20):
        seen.note_error(f"actor-{number}", f"failure {number}", 100.0 * number)
    seen.errors.clear()
    shown = texts(frame(seen, 2000.0, 80, 23))
    assert any(text.endswith("failure 19") for text in shown)
    assert any(text.split()[:2] == ["8", "sampled"] for text in shown)


def test_actors_that_there_is_no_room_for_are_counted() -> None:
    shown = texts(frame(practising(40), 2.0, 80))
    assert "and 32 more" in shown
    shown = texts(frame(practising(8), 2.0, 80, 23))
    left_out = next(int(text.split()[1]) for text in shown if text.startswith("and "))
    assert left_out + sum(text.startswith("actor-") for text in shown) == 8


def test_the_facts_for_status_have_no_gaps_in_what_they_tell() -> None:
    shown = "\n".join(texts(facts(practising(), 2.0, 100)))
    for needed in ("! policy_learner", "policy v14", "actor-00000002", "1 lost"):
        assert needed in shown


def test_lives_of_other_hosts_are_told_apart_in_narrow_terminals_too() -> None:
    seen = practising(0)
    host = "a_label_of_24_characters"
    for index in range(2):
        seen.appeared("actor", f"actor-{host}-{index:08x}", 0.0)
    for width, name in ((100, f"actor-{host}-00000001"), (60, "actor-a_label_o~00000001")):
        lines = texts(frame(seen, 2.0, width))
        assert sum(line.startswith(name) for line in lines) == 1
        assert max(map(len, lines)) <= width


def test_who_was_cut_off_is_counted_beside_what_was_lost() -> None:
    seen = practising()
    assert not any("cut off" in line for line in texts(frame(seen, 2.0, 80)))
    said = Status(
        run=RUN,
        block=ALL_BLOCKS,
        seq=0,
        term=7,
        life="router-1a2b3c4d",
        service="router",
        totals={"cut_off": 1},
    )
    seen.hear_status(said, 2.0)
    assert any(line.endswith("1 cut off by the router") for line in texts(frame(seen, 2.0, 80)))


@pytest.mark.parametrize(("width", "height"), [(80, 23), (120, 40), (80, None)])
def test_many_blocks_leave_room_for_all_else(width: int, height: int | None) -> None:
    shown = texts(frame(crowd(), 2.0, width, height))
    assert len(shown) <= (height or 99)
    bars = [text for text in shown if "steps" in text and "%" not in text and "/s" not in text]
    assert bars[0].startswith("18 blocks ")
    assert "860 of 1,800 steps" in bars[0]
    assert bars[1].startswith("part_2 "), "the slowest comes next"
    assert len(bars) == 4
    for needed in ("policy_learner-0a1b2c3d", "0 lost", "GROUND"):
        assert needed in "\n".join(shown)


def test_of_many_blocks_the_weakest_are_shown_by_name_and_the_others_counted() -> None:
    shown = texts(frame(crowd(), 2.0, 80, 23))
    learning = shown.index(next(text for text in shown if "reward" in text))
    assert shown[learning + 1].split()[:3] == ["part_17", "-", "-1.7"]
    scores = shown.index(next(text for text in shown if "z_min" in text))
    assert shown[scores + 1].split()[:3] == ["part_7", "1", "mean"]
    left_out = [int(text.split()[1]) for text in shown if text.startswith("and ")]
    listed = [text for text in shown[learning:] if text.startswith("part_")]
    assert len(listed) + sum(left_out) == 2 * 18


def test_status_shows_every_block() -> None:
    shown = texts(facts(crowd(), 2.0, 80))
    bars = [text for text in shown if text.startswith("part_") and "steps" in text]
    assert len(bars) == 18
