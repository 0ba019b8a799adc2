"""Hi-Composer (thesis 3.5) in one process: levels one after the other, what is below frozen, crashes."""

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from protocol.messages import Phase, Segment
from services.runtime.models import model_path
from services.runtime.settings import RunSettings, parse
from tests.simulated.conftest import TINY
from tests.simulated.harness import Simulation

Simulate = Callable[..., Simulation]
LEAVES = ("x", "yz")
TREE = {
    **TINY,
    "block": [
        {"name": "x", "observes": ["x"], "drives": ["x"]},
        {"name": "yz", "observes": ["y", "z"], "drives": ["y", "z"], "latent_dim": 3},
        {"name": "body", "children": ["x", "yz"]},
    ],
    "level": [
        {},
        {
            "decision_steps": 5,
            "segment_steps": 8,
            "phases": {"babble_steps": 320, "ground_steps": 480, "walk_steps": 160, "practise_steps": 240},
            "babbling": {"subgoal_steps": [5, 20]},
        },
    ],
}
ACTS = (Phase.GROUND, Phase.PRACTISE)


@pytest.fixture
def tree() -> RunSettings:
    return parse(TREE, origin="the tiny tree")


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Simulation:
    """A whole run of two actors, for the tests that only look at it."""
    settings = parse({**TREE, "view": {"latents_per_sec": 50}}, origin="the tiny tree")
    simulation = Simulation(settings, tmp_path_factory.mktemp("finished"))
    simulation.start_all(actors=2)
    simulation.until_all_ended()
    return simulation


def scores_of(run_dir: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (run_dir / "scores.jsonl").read_text().splitlines()]


def of_block(simulation: Simulation, block: str, *phases: Phase) -> list[Segment]:
    return [segment for segment in simulation.segments(*phases) if segment.block == block]


def level_is(simulation: Simulation, level: int, *phases: str) -> Callable[[], bool]:
    """True once the coordinator has announced such a phase of this level."""

    def announced() -> bool:
        path = simulation.run_dir / "events.jsonl"
        lines = path.read_text().splitlines() if path.exists() else []
        return any(f"level {level}" in line and any(phase in line for phase in phases) for line in lines)

    return announced


def test_the_levels_of_a_tree_learn_one_after_the_other(finished: Simulation) -> None:
    rows = [(s["block"], s["iteration"]) for s in scores_of(finished.run_dir) if s["policy"] == "mean"]
    assert sorted(rows[:4]) == [("x", 0), ("x", 1), ("yz", 0), ("yz", 1)]
    assert rows[4:] == [("body", 0), ("body", 1)]
    walked = of_block(finished, "body", Phase.BABBLE)
    assert walked[0].arrays["observation"].shape == (8, 2, 5), "the latents of x and yz (eq. 14)"
    latents = np.concatenate([s.arrays["observation"] for s in walked])
    np.testing.assert_allclose(latents[..., :2].sum(axis=-1), 1, atol=1e-5)
    np.testing.assert_allclose(latents[..., 2:].sum(axis=-1), 1, atol=1e-5)
    acted = of_block(finished, "body", *ACTS)
    assert {s.arrays["action"].shape for s in acted} == {(8, 2, 5)}, "the goals of x and yz (eq. 15)"


def test_budgets_are_environment_steps_at_every_level(finished: Simulation) -> None:
    rows = sum(s.steps * s.columns for s in of_block(finished, "body", Phase.GROUND))
    assert rows * 5 >= 480
    assert rows * 5 < 480 + 2 * 8 * 4 * 5, "at most a rollout more than was asked for"
    assert sum(s.steps * s.columns for s in of_block(finished, "body", Phase.BABBLE)) >= 320


def test_below_the_level_that_learns_all_is_frozen_at_its_best(finished: Simulation) -> None:
    best = json.loads((finished.run_dir / "best.json").read_text())
    for block in LEAVES:
        for kind in ("encoder", "policy"):
            kept = model_path(finished.run_dir, block, kind, best[block][f"{kind}_version"]).read_bytes()
            files = (finished.run_dir / "models" / block).glob(f"{kind}-*.onnx")
            newest = max(files, key=lambda path: int(path.stem.split("-")[1]))
            same = hashlib.sha256(newest.read_bytes()).hexdigest() == hashlib.sha256(kept).hexdigest()
            assert same, f"what of {block} acts below the body is its best {kind}"


def test_people_see_the_limbs_of_a_level_too(finished: Simulation) -> None:
    seen = [view for view in finished.views(Phase.GROUND) if view.term == level_1_term(finished)]
    newest = {view.block: view for view in seen}
    assert set(newest) == {"body", *LEAVES}
    assert "posture" in newest["body"].arrays
    assert "posture" not in newest["x"].arrays, "the body is shown once, not once per limb"
    assert newest["yz"].arrays["goal"].shape == (2, 3)


def level_1_term(simulation: Simulation) -> int:
    return of_block(simulation, "body", Phase.GROUND)[0].term


def test_a_seeded_tree_repeats_bit_for_bit_seen_or_not(
    tree: RunSettings, finished: Simulation, simulate: Simulate
) -> None:
    again = simulate(tree)
    again.start_all(actors=2)
    again.until_all_ended()
    assert scores_of(again.run_dir) == scores_of(finished.run_dir)


@pytest.mark.parametrize(
    ("victim", "phase"),
    [
        ("coordinator", "babble"),
        ("encoder_learner", "practise"),
        ("policy_learner", "ground"),
        ("actor", "ground"),
    ],
)
def test_a_crash_in_the_middle_of_level_1_trains_nothing_of_level_0_again(
    tree: RunSettings, simulate: Simulate, victim: str, phase: str
) -> None:
    simulation = simulate(tree)
    simulation.start_all(actors=1)
    simulation.until(level_is(simulation, 1, phase))
    trained = len(of_block(simulation, "x", *ACTS))
    best = {block: json.loads((simulation.run_dir / "best.json").read_text())[block] for block in LEAVES}
    for _ in range(5):
        simulation.round()
    simulation.crash(f"{victim}-0")
    for _ in range(20):
        simulation.round()
    simulation.start(victim, f"{victim}-1")
    simulation.until_all_ended()
    assert len(of_block(simulation, "x", *ACTS)) == trained
    rows = [(s["block"], s["iteration"]) for s in scores_of(simulation.run_dir) if s["policy"] == "mean"]
    assert sorted(rows) == [(block, k) for block in ("body", "x", "yz") for k in (0, 1)]
    after = json.loads((simulation.run_dir / "best.json").read_text())
    assert {block: after[block] for block in LEAVES} == best, "what is frozen stays what it is"
    if victim == "actor":
        # It joined late, and acted with the models of level 0 that were trained before its time.
        assert {s.life for s in of_block(simulation, "body", Phase.PRACTISE)} == {"actor-1"}


def test_three_levels_of_several_parents_whose_children_stand_on_different_levels(
    simulate: Simulate,
) -> None:
    settings = parse(
        {
            **TREE,
            "block": [
                *({"name": axis, "observes": [axis], "drives": [axis]} for axis in "xyz"),
                {"name": "left", "children": ["x"], "latent_dim": 3},
                {"name": "right", "children": ["y"]},
                {"name": "body", "children": ["z", "left", "right"]},
            ],
            "level": [
                {},
                {"decision_steps": 5, "segment_steps": 8},
                {"decision_steps": 10, "segment_steps": 8},
            ],
        },
        origin="three levels",
    )
    simulation = simulate(settings)
    simulation.start_all(actors=1)
    simulation.until_all_ended()
    rows = [s["block"] for s in scores_of(simulation.run_dir) if s["policy"] == "mean"]
    assert sorted(rows[6:10]) == ["left", "left", "right", "right"]
    assert rows[10:] == ["body", "body"]
    for block in ("left", "right"):
        for segment in of_block(simulation, block, *ACTS):
            assert segment.arrays["action"].shape == (8, 2, 2)
            goes_on = segment.arrays["latent"][1:] == segment.arrays["next_latent"][:-1]
            assert goes_on.all(), "one chain of latents, for the cuboid has no episodes"
    walked = of_block(simulation, "body", Phase.BABBLE)[0].arrays["observation"]
    assert walked.shape == (8, 2, 2 + 3 + 2)
    for part in np.split(walked, [2, 5], axis=-1):
        np.testing.assert_allclose(part.sum(axis=-1), 1, atol=1e-5)
