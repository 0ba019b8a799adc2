"""The flow of goals through a tree of blocks: its picture, its lanes, and the tabs of a run that has one."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb

from protocol.messages import Phase, View
from services.dashboard.colours import DIM, of_index
from services.dashboard.goals import tree_bounds
from services.dashboard.learning import tree_scores_table
from services.dashboard.phase import phase_states
from services.dashboard.tree import Tree
from tests.unit.dashboard_feed import announced, settings_of, view_of
from tests.unit.dashboard_reading import documents, parts_of, rows_of, scalars, states, verified
from tests.unit.dashboard_stage import Stage
from tests.unit.dashboard_trees import BODY, FINGERS, HAND, TreeActor, tree_settings
from tests.unit.test_dashboard_blueprint import page_of, views
from tests.unit.test_dashboard_panels import score_of, status_of

HAND_AT_1 = {"thumb": 1, "index": 0, "middle": 1, "ring": 1, "little": 1}
"""What the hand lets its fingers aim at when it aims at its vertex 1."""


@pytest.fixture
def stage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Stage]:
    """A run of a hand and its fingers, with one actor."""
    rr.set_strict_mode(True)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    folder = tmp_path / "run"
    folder.mkdir()
    played = Stage(folder, tree_settings(HAND), actors=1)
    played.start()
    played.everybody_joins()
    yield played
    played.end()


def views_of(stage: Stage, goals: Mapping[str, int], near: float) -> list[View]:
    """What the actor shows: all these blocks, with d = 2, so near their goals."""
    shown = []
    for name, goal in goals.items():
        latent = np.full(2, 1 - near, np.float32)
        latent[goal] = near
        arrays = {"latent": latent[None], "goal": np.eye(2, dtype=np.float32)[[goal]]}
        trail = np.stack([1 - latent, latent])
        shown.append(view_of(stage.feed.actors[0][0].life, name, {**arrays, "trail": trail}))
    return shown


def last(stage: Stage, entity: str) -> dict[str, list[object]]:
    """The newest row of a part of the picture."""
    rows = [
        row for row in rows_of(parts_of(stage.run_dir), f"/goals/tree/{entity}") if row.run_secs is not None
    ]
    return rows[-1].values


def aims(stage: Stage, name: str, number: int) -> list[str]:
    return states(parts_of(stage.run_dir), f"/goals/aim/{number:02}/{name}")


def test_what_the_hand_lets_its_fingers_aim_at_is_seen_and_so_is_how_they_follow(stage: Stage) -> None:
    stage.say(views_of(stage, {"hand": 0, **dict.fromkeys(FINGERS, 0)}, near=0.95))
    stage.poll()
    for near in (0.1, 0.9):
        stage.say(views_of(stage, {"hand": 1, **HAND_AT_1}, near=near))
        stage.poll(2.5)
    stage.end()
    assert aims(stage, "hand", 0) == ["g0", "g1"]
    for number, (finger, goal) in enumerate(HAND_AT_1.items(), 1):
        assert aims(stage, finger, number) == (["g0", "g1"] if goal else ["g0"])
        shares = scalars(parts_of(stage.run_dir), f"/goals/near/{finger}")
        assert shares == [pytest.approx(share) for share in (0.95, 0.1, 0.9)]
    colours = [of_index(goal) for goal in HAND_AT_1.values()]
    assert last(stage, "edges")["LineStrips2D:colors"] == colours, (
        "a line has the colour of the goal it brings"
    )
    assert last(stage, "rings")["LineStrips2D:colors"] == [*colours, of_index(1)]
    assert "index  g0  0.90" in last(stage, "names")["Points2D:labels"]
    radii = np.array(last(stage, "discs")["Points2D:radii"])
    full = np.array(rows_of(parts_of(stage.run_dir), "/goals/tree/discs")[1].values["Points2D:radii"])
    assert (radii / full) ** 2 == pytest.approx(0.9 / 0.95), "the area of a disc is z_goal"
    way = np.array(last(stage, "ways")["LineStrips2D:strips"][0])
    assert way[1, 1] < way[0, 1], "y points down: the way rises as the finger comes nearer"
    assert last(stage, "actor")["Points2D:labels"] == ["of a0"]


def test_blocks_that_do_not_act_are_grey_and_so_are_lines_that_carry_no_goal(stage: Stage) -> None:
    stage.say(views_of(stage, {"thumb": 1}, near=0.5))
    stage.poll()
    stage.end()
    rings = last(stage, "rings")["LineStrips2D:colors"]
    assert rings == [of_index(1), *[DIM] * 5]
    assert last(stage, "edges")["LineStrips2D:colors"] == [DIM] * 5, "the goal is not the hand's"
    told = set(last(stage, "names")["Points2D:labels"])
    assert told == {"thumb  g1  0.50", "index", "middle", "ring", "little", "hand"}
    assert aims(stage, "hand", 0) == ["idle"]
    assert not scalars(parts_of(stage.run_dir), "/goals/near/hand")


def test_when_nobody_acts_any_more_all_is_grey_again(stage: Stage) -> None:
    stage.say(views_of(stage, {"hand": 1, **HAND_AT_1}, near=0.5))
    stage.poll()
    stage.poll(10.0)
    stage.end()
    assert set(last(stage, "rings")["LineStrips2D:colors"]) == {DIM}
    assert not last(stage, "actor")["Points2D:labels"]
    assert aims(stage, "thumb", 1) == ["g1", "idle"]


def test_a_tree_of_two_levels_is_recorded(stage: Stage, tmp_path: Path) -> None:
    actor = TreeActor(stage.settings)
    stage.feed.actors[0][0].life = actor.life
    for term, level in enumerate((0, 1), 1):
        stage.say(announced(Phase.GROUND, term).model_copy(update={"level": level}))
        for _ in range(20):
            stage.say(actor.views(level))
            stage.poll()
    stage.end()
    paths = parts_of(stage.run_dir)
    assert verified(paths[0], tmp_path / "home")
    assert states(paths, "/state/phase") == ["ground", "ground, level 1"]
    for block in (*FINGERS, "hand"):
        assert rows_of(paths, f"/latent/{block}/now"), "each block has its simplex under its own name"
        assert scalars(paths, f"/measures/{block}/goal_distance/mean")
    edges = [row for row in rows_of(paths, "/goals/tree/edges") if row.run_secs is None]
    assert [len(row.values["LineStrips2D:strips"]) for row in edges] == [5]
    hand = last(stage, "names")["Points2D:labels"]
    assert any(str(label).startswith("hand  g") for label in hand)
    assert "a0→g" in documents(paths, "/status/summary")[-1]


def test_runs_without_a_tree_have_nothing_of_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    stage = Stage(tmp_path, settings_of(2, 3))
    stage.start()
    stage.everybody_joins()
    stage.play(1.0, Phase.GROUND, 1)
    stage.end()
    assert not [row for row in rows_of(parts_of(tmp_path)) if "goals" in row.entity]


@pytest.mark.parametrize("children", [HAND, BODY])
def test_blocks_stand_apart_by_level_and_parents_amid_their_children(
    children: Mapping[str, Sequence[str]],
) -> None:
    settings = tree_settings(children)
    tree = Tree(settings)
    places = tree.places()
    assert len({tuple(place) for place in places.values()}) == len(settings.block)
    for parent, below in children.items():
        assert places[parent][1] == pytest.approx(np.mean([places[child][1] for child in below]))
        assert all(places[parent][0] + tree.reach < places[child][0] for child in below), "room for its text"
    (left, right), (top, bottom) = tree_bounds(tree)
    assert all(left < x and x + tree.reach < right and top < y < bottom for x, y in places.values())
    assert max(right - left, bottom - top) < 2 * min(right - left, bottom - top), "it fits a page"


def test_a_tree_has_a_tab_for_goals_one_for_each_family_and_one_for_each_level() -> None:
    page = page_of(tree_settings(BODY))
    assert [tab.name for tab in page.contents] == [
        "Overview",
        "Goals",
        "Latent",
        "Body",
        "Learning",
        "System",
    ]
    latent, learning = page.contents[2], page.contents[4]
    assert isinstance(latent, rrb.Tabs)
    assert [tab.name for tab in latent.contents] == [
        "body",
        "left_arm",
        "right_arm",
        "left_hand",
        "right_hand",
    ]
    origins = [str(view.origin) for view in views(latent)]
    for block in tree_settings(BODY).block:
        assert f"/latent/{block.name}" in origins
        assert origins.count(f"/status/reading/{block.name}") == 1, "each has one page of its own"
    assert [tab.name for tab in learning.contents] == [f"Level {level}" for level in range(4)]
    hands = learning.contents[1]
    assert [tab.name for tab in hands.contents] == ["together", "left_hand", "right_hand"]


def test_a_block_beside_the_tree_keeps_a_tab() -> None:
    settings = tree_settings({**HAND, "stump": []})
    latent = page_of(settings).contents[2]
    assert [tab.name for tab in latent.contents] == ["hand", "stump"]


def test_the_newest_scores_are_grouped_by_level() -> None:
    scores = [score_of("thumb", 0), score_of("thumb", 1, z_goal=0.75), score_of("hand", 0)]
    lines = tree_scores_table(scores, (FINGERS, ("hand",))).splitlines()
    assert [line.split("|")[1:3] for line in lines[2:]] == [[" 1 ", " hand "], [" 0 ", " thumb "]]
    assert "0.750" in lines[3]
    assert "first evaluation" in tree_scores_table([], (FINGERS, ("hand",)))


def test_measures_of_several_learners_of_one_kind_are_all_shown(stage: Stage) -> None:
    for life, block in (("encoder_learner-a", "thumb"), ("encoder_learner-b", "index")):
        stage.join("encoder_learner", life)
        stage.say(
            status_of(life, "encoder_learner", totals={"updates": 7}, metrics={f"{block}/encoder/loss": 1.5})
        )
    stage.poll()
    stage.end()
    for block in ("thumb", "index"):
        assert scalars(parts_of(stage.run_dir), f"/learning/{block}/encoder/loss") == [1.5]


def test_the_phase_bar_tells_levels_apart() -> None:
    states_of_two = phase_states(3, levels=2)
    assert {"babble", "babble, level 1", "walk 3, level 1"} <= set(states_of_two)
    assert states_of_two["babble"] == states_of_two["babble, level 1"]
