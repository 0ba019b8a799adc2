"""What the panels make of what they hear: latents, measures, members, scores, words."""

import math
from pathlib import Path

import numpy as np
import pytest

from protocol.messages import ALL_BLOCKS, Phase, Score, Status
from services.dashboard.colours import of_index
from services.dashboard.latent_book import CLOUD_POINTS, CLOUD_SECS, STALE_SECS, LatentBook
from services.dashboard.learning import LearningPanel, scores_table
from services.dashboard.ledger import MOST_LIVES, Ledger
from services.dashboard.measures import latent_entropy, usage_entropy, vertex_usage
from services.dashboard.pens import grouped
from services.dashboard.phase import duration_words, phase_states
from services.dashboard.roster import FORGET_SECS, MOST_ACTORS, RETURN_SECS, Roster
from services.dashboard.system import members_table, troubles
from services.runtime.phases import phase_words
from tests.unit.dashboard_feed import RUN, announced, view_of

LATENT = np.array([[0.7, 0.2, 0.1], [0.1, 0.1, 0.8]], np.float32)
GOAL = np.array([[1, 0, 0], [0, 1, 0]], np.float32)


def status_of(life: str, service: str = "actor", **fields: object) -> Status:
    header = {"run": RUN, "term": 1, "block": ALL_BLOCKS, "life": life, "seq": 0, "service": service}
    return Status.model_validate({**header, **fields})


def score_of(block: str, iteration: int, **fields: object) -> Score:
    numbers = dict.fromkeys(("separation", "separation_worst", "z_min", "z_goal", "switch_success"), 0.5)
    row = {
        "run": RUN,
        "block": block,
        "iteration": iteration,
        "phase": Phase.GROUND,
        "policy": "mean",
        "steps": 9,
    }
    return Score.model_validate({**row, **numbers, **fields})


def test_distances_are_those_of_equation_12() -> None:
    book = LatentBook("hand", 3)
    book.hear("a0", view_of("actor-1", "hand", {"latent": LATENT, "goal": GOAL}), now_secs=0.0)
    (newest,) = book.acting(0.0)
    expected = [0.3**2 + 0.2**2 + 0.1**2, 0.1**2 + 0.9**2 + 0.8**2]
    assert newest.distances == pytest.approx(expected)


def test_rows_that_are_no_numbers_are_left_out() -> None:
    book = LatentBook("hand", 3)
    broken = LATENT.copy()
    broken[0, 1] = np.nan
    trail = np.array([[1, 0, 0], [np.inf, 0, 0], [0, 1, 0]], np.float32)
    book.hear("a0", view_of("actor-1", "hand", {"latent": broken, "goal": GOAL, "trail": trail}), 0.0)
    (newest,) = book.acting(0.0)
    assert newest.latent.tolist() == LATENT[1:].tolist()
    assert newest.goal is not None
    assert newest.goal.tolist() == GOAL[1:].tolist()
    assert len(newest.trail) == 2
    book.hear("a1", view_of("actor-2", "hand", {"latent": broken[:1]}), 0.0)
    assert [actor.label for actor in book.acting(0.0)] == ["a0"]


def test_latents_of_another_dimension_are_refused_in_one_sentence() -> None:
    book = LatentBook("hand", 4)
    with pytest.raises(
        ValueError, match="actor-1 sent latents of 3 numbers of block 'hand', which has 4 vert"
    ):
        book.hear("a0", view_of("actor-1", "hand", {"latent": LATENT}), 0.0)
    assert not book.changes


def test_an_actor_that_stopped_acting_is_no_longer_drawn() -> None:
    book = LatentBook("hand", 3)
    for label, secs in (("a10", 0.0), ("a2", 3.0)):
        book.hear(label, view_of("actor-1", "hand", {"latent": LATENT}), secs)
    assert [newest.label for newest in book.acting(3.0)] == ["a2", "a10"]
    assert [newest.label for newest in book.acting(STALE_SECS + 1)] == ["a2"]


def test_the_cloud_is_bounded_and_filled_at_its_own_pace() -> None:
    book = LatentBook("hand", 3)
    many = np.tile(LATENT, (50, 1))
    sizes = []
    for tick in range(400):
        book.hear("a0", view_of("actor-1", "hand", {"latent": many}), tick / 10)
        sizes.append(len(book.cloud))
    assert sizes[-1] == CLOUD_POINTS
    assert sizes[100] < CLOUD_POINTS, (
        f"a thousand latents a second must not renew it in less than {CLOUD_SECS} s"
    )


def test_entropies_and_usage() -> None:
    corners, middle = np.eye(3, dtype=np.float32), np.full((2, 3), 1 / 3, np.float32)
    assert latent_entropy(corners) == pytest.approx(0.0, abs=1e-6)
    assert latent_entropy(middle) == pytest.approx(1.0)
    assert math.isnan(latent_entropy(corners[:0]))
    assert vertex_usage(corners[[0, 0, 2, 2]]).tolist() == [0.5, 0.0, 0.5]
    assert usage_entropy(vertex_usage(corners)) == pytest.approx(1.0)
    assert usage_entropy(vertex_usage(corners[:1])) == 0.0


def test_names_of_actors_that_are_close_together_share_one_place() -> None:
    positions = np.array([[0, 0], [1, 0], [0.01, 0], [0.02, 0], [0, 0.01], [0, 0.02]], np.float32)
    heads, texts = grouped(positions, [f"a{i}" for i in range(6)], near=0.1)
    assert (heads, texts) == ([0, 1], ["a0 a2 a3 +2", "a1"])
    assert grouped(positions, [f"a{i}" for i in range(6)], near=0.0)[0] == list(range(6))


def test_short_names_last_and_are_given_anew() -> None:
    roster = Roster()
    for life in ("actor-x", "actor-y"):
        roster.appeared("actor", life, 0.0)
    roster.appeared("policy_learner", "policy_learner-x", 0.0)
    assert [member.label for member in roster] == ["policy_learner", "a0", "a1"]
    roster.vanished("actor-x", 10.0)
    roster.settle(10.1)
    assert [m.state(10.1) for m in roster] == ["silent", "silent", "silent"], "it may have been the own link"
    roster.settle(11.0)
    assert [m.label for m in roster if m.state(11.0) == "lost"] == ["a0"]
    assert roster.meet_actor("actor-z", 12.0) == "a0"
    assert [m.life for m in roster.of("actor")] == ["actor-z", "actor-y"]


def test_a_lost_link_is_not_lost_members() -> None:
    roster = Roster()
    roster.appeared("actor", "actor-x", 0.0)
    roster.vanished("actor-x", 1.0)
    roster.link(False, 1.2)
    roster.settle(60.0)
    assert roster.of("actor")
    roster.link(True, 60.0)
    roster.appeared("actor", "actor-x", 60.5)
    roster.settle(60.0 + RETURN_SECS + 1)
    assert roster.of("actor")
    assert [news.text for news in roster.news if news.bad] == ["the dashboard's link to the router is lost"]


def test_steps_of_actors_that_are_gone_still_count() -> None:
    roster = Roster()
    roster.appeared("actor", "actor-x", 0.0)
    roster.hear(status_of("actor-x", totals={"env_steps": 500}), 0.0)
    roster.vanished("actor-x", 1.0)
    roster.settle(2.0)
    roster.hear(status_of("actor-y", totals={"env_steps": 70}), 3.0)
    assert roster.ledger["env_steps"] == 570
    roster.settle(2.0 + FORGET_SECS + 1)
    assert roster.ledger["env_steps"] == 570
    assert "actor-x" not in [member.life for member in roster]
    roster.appeared("actor", "actor-x", 70.0)
    assert roster.ledger["env_steps"] == 570
    roster.hear(status_of("actor-x", totals={"env_steps": 600}), 71.0)
    assert roster.ledger["env_steps"] == 670, "one that was only away counts once"


def test_what_was_lost_stays_counted_after_its_member_is_forgotten() -> None:
    roster = Roster()
    roster.appeared("actor", "actor-x", 0.0)
    roster.hear(status_of("actor-x", lost=4, refused={"stale": 2}), 0.0)
    roster.vanished("actor-x", 1.0)
    for secs in (2.0, 2.0 + FORGET_SECS + 1):
        roster.settle(secs)
    assert not list(roster)
    assert troubles(roster) == {"lost": 4, "duplicated": 0, "refused": 2}


def test_counts_go_on_from_those_of_an_earlier_dashboard(tmp_path: Path) -> None:
    path, first = tmp_path / "counts.json", Ledger()
    for index in range(MOST_LIVES + 10):
        first.hear(status_of(f"actor-{index}", totals={"env_steps": 10}, lost=1))
    first.write(path)
    second = Ledger()
    second.read(path)
    assert second["env_steps"] == 10 * (MOST_LIVES + 10)
    second.hear(status_of("actor-500", totals={"env_steps": 15}))
    second.hear(status_of("actor-new", totals={"env_steps": 100}))
    assert second["env_steps"] == 10 * (MOST_LIVES + 10) + 5 + 100
    assert second["lost"] == MOST_LIVES + 10
    assert [entry.name for entry in tmp_path.iterdir()] == ["counts.json"]


COUNTED = '{"names": ["env_steps", "lost", "duplicated", "refused"], '
BROKEN_COUNTS = [
    "",
    "[]",
    '{"names": ["env_steps"]}',
    COUNTED + '"older": [0, 0, 0, 0], "lives": {"actor-1": [9]}}',
    COUNTED + '"older": [-9, 0, 0, 0], "lives": {}}',
]


@pytest.mark.parametrize("text", BROKEN_COUNTS)
def test_counts_that_cannot_be_read_begin_anew(tmp_path: Path, text: str) -> None:
    path, ledger = tmp_path / "counts.json", Ledger()
    path.write_text(text)
    ledger.read(path)
    assert ledger["env_steps"] == 0
    ledger.hear(status_of("actor-1", totals={"env_steps": 3}))
    assert ledger["env_steps"] == 3


def test_more_members_than_can_be_shown_are_counted() -> None:
    roster = Roster()
    for index in range(MOST_ACTORS + 3):
        roster.hear(status_of(f"actor-{index}", totals={"env_steps": 10}), 0.0)
    assert len(list(roster)) == MOST_ACTORS
    assert roster.not_shown == 3
    assert "more than are shown: 64 actors" in members_table(roster, 0.0)
    assert roster.ledger["env_steps"] == 10 * (MOST_ACTORS + 3), "the steps of all count"
    for service in ("coordinator", "policy_learner"):
        roster.appeared(service, f"{service}-1", 0.0)
    assert [m.label for m in roster][:2] == ["coordinator", "policy_learner"], "actors leave room for others"
    roster.hear(status_of("thing-1", "thing"), 0.0)
    assert "thing" not in [m.label for m in roster]


def test_members_that_speak_seldom_are_not_silent_and_have_a_speed() -> None:
    roster = Roster(status_secs=8.0)
    for turn in range(3):
        roster.hear(status_of("actor-x", totals={"env_steps": 800 * turn}), 8.0 * turn)
    (member,) = roster
    assert member.state(23.0) == "alive"
    assert member.env_steps.per_sec(23.0) == pytest.approx(100.0)
    assert member.state(16.0 + 25.0) == "silent"


def test_the_newest_error_comes_last_and_goes_with_its_member() -> None:
    roster = Roster()
    for turn, life in enumerate(("actor-x", "actor-y", "actor-x")):
        roster.hear(status_of(life, last_error=f"trouble {turn}"), float(turn))
    assert list(roster.errors.items()) == [("a1", "trouble 1"), ("a0", "trouble 2")]
    roster.settle(2.0 + FORGET_SECS + 1)
    assert roster.errors == {}


def test_the_table_says_how_each_member_does() -> None:
    roster = Roster()
    roster.hear(
        status_of("actor-x", queue_depth=3, lost=2, refused={"stale": 5}, waiting_for="a | grant"), 0.0
    )
    roster.appeared("encoder_learner", "encoder_learner-x", 0.0)
    table = members_table(roster, 4.0)
    assert "| a0 | alive | 4 s ago |  | 3 | 2 | 5 |" in table
    assert "a / grant" in table
    assert "has said nothing yet" in table
    assert troubles(roster) == {"lost": 2, "duplicated": 0, "refused": 5}


def test_scores_are_kept_once_and_shown_the_newest_first() -> None:
    panel = LearningPanel(["hand"])
    assert "first evaluation" in scores_table(panel.scores)
    rows = [score_of("hand", 0), score_of("hand", 1, phase=Phase.PRACTISE, z_min=0.912), score_of("foot", 0)]
    for _ in range(2):
        panel.hear_status(status_of("policy_learner-x", "policy_learner", scores=rows))
    assert [(row.block, row.iteration) for row in panel.scores] == [("hand", 0), ("hand", 1)]
    lines = scores_table(panel.scores).splitlines()
    assert lines[2].startswith("| hand | practise 1 | mean |")
    assert "0.912" in lines[2]


def test_phases_in_words_and_in_the_bar() -> None:
    assert phase_words(announced(Phase.PRACTISE, 7, iteration=2)) == "PRACTISE 2 of 4"
    assert phase_words(announced(Phase.DONE, 9, iteration=4)) == "DONE"
    assert phase_words(None) == "Waiting for the coordinator"
    assert {"babble", "walk 1", "practise 3", "done"} <= set(phase_states(3))
    assert "walk 4" not in phase_states(3)
    assert len(phase_states(10_000)) == len(Phase)
    assert [duration_words(secs) for secs in (8.2, 200, 9000)] == ["8 s", "3 min", "2.5 h"]


def test_colours_come_round_again() -> None:
    assert of_index(0) == of_index(8) != of_index(1)
