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


def test_the_levels_of_a_tree_learn_one_after_the_other(tree: RunSettings, simulate: Simulate) -> None:
    simulation = simulate(tree)
    simulation.start_all(actors=2)
    simulation.until_all_ended()
    rows = [(s["block"], s["iteration"]) for s in scores_of(simulation.run_dir) if s["policy"] == "mean"]
    assert sorted(rows[:4]) == [("x", 0), ("x", 1), ("yz", 0), ("yz", 1)]
    assert rows[4:] == [("body", 0), ("body", 1)]
    walked = of_block(simulation, "body", Phase.BABBLE)
    assert walked[0].arrays["observation"].shape == (8, 2, 5), "the latents of x and yz (eq. 14)"
    latents = np.concatenate([s.arrays["observation"] for s in walked])
    np.testing.assert_allclose(latents[..., :2].sum(axis=-1), 1, atol=1e-5)
    np.testing.assert_allclose(latents[..., 2:].sum(axis=-1), 1, atol=1e-5)
    acted = of_block(simulation, "body", *ACTS)
    assert {s.arrays["action"].shape for s in acted} == {(8, 2, 5)}, "the goals of x and yz (eq. 15)"


def test_budgets_are_environment_steps_at_every_level(tree: RunSettings, simulate: Simulate) -> None:
    simulation = simulate(tree)
    simulation.start_all(actors=1)
    simulation.until_all_ended()
    rows = sum(s.steps * s.columns for s in of_block(simulation, "body", Phase.GROUND))
    assert rows * 5 >= 480
    assert rows * 5 < 480 + 2 * 8 * 4 * 5, "at most a rollout more than was asked for"
    assert sum(s.steps * s.columns for s in of_block(simulation, "body", Phase.BABBLE)) >= 320


def test_below_the_level_that_learns_all_is_frozen_at_its_best(tree: RunSettings, simulate: Simulate) -> None:
    simulation = simulate(tree)
    simulation.start_all(actors=2)
    simulation.until(level_is(simulation, 1, "babble"))
    best = json.loads((simulation.run_dir / "best.json").read_text())
    versions = {block: dict(best[block]) for block in LEAVES}
    simulation.until_all_ended()
    assert {
        b: v for b, v in json.loads((simulation.run_dir / "best.json").read_text()).items() if b != "body"
    } == versions
    for block in LEAVES:
        for kind in ("encoder", "policy"):
            kept = model_path(simulation.run_dir, block, kind, best[block][f"{kind}_version"]).read_bytes()
            files = (simulation.run_dir / "models" / block).glob(f"{kind}-*.onnx")
            newest = max(files, key=lambda path: int(path.stem.split("-")[1]))
            same = hashlib.sha256(newest.read_bytes()).hexdigest() == hashlib.sha256(kept).hexdigest()
            assert same, f"what of {block} acts below the body is its best {kind}"


@pytest.mark.parametrize("victim", ["coordinator", "encoder_learner", "policy_learner", "actor"])
@pytest.mark.parametrize("phase", ["babble", "ground", "practise"])
def test_a_crash_in_the_middle_of_level_1_trains_nothing_of_level_0_again(
    tree: RunSettings, simulate: Simulate, victim: str, phase: str
) -> None:
    simulation = simulate(tree)
    simulation.start_all(actors=1)
    simulation.until(level_is(simulation, 1, phase))
    trained = len(of_block(simulation, "x", *ACTS))
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


def test_an_actor_that_joins_at_level_1_gets_what_it_needs_of_level_0(
    tree: RunSettings, simulate: Simulate
) -> None:
    simulation = simulate(tree)
    simulation.start_all(actors=1)
    simulation.until(level_is(simulation, 1, "ground"))
    simulation.crash("actor-0")
    simulation.start("actor", "actor-late", 1)
    simulation.until_all_ended()
    assert {s.life for s in of_block(simulation, "body", Phase.PRACTISE)} == {"actor-late"}


def test_a_seeded_tree_repeats_bit_for_bit(tree: RunSettings, simulate: Simulate) -> None:
    outcomes = []
    for _ in range(2):
        simulation = simulate(tree)
        simulation.start_all(actors=2)
        simulation.until_all_ended()
        outcomes.append(scores_of(simulation.run_dir))
    assert outcomes[0] == outcomes[1]


def test_people_see_the_limbs_of_a_level_too(tree: RunSettings, simulate: Simulate) -> None:
    simulation = simulate(
        tree.model_copy(update={"view": tree.view.model_copy(update={"latents_per_sec": 50})})
    )
    simulation.start_all(actors=1)
    simulation.until(level_is(simulation, 1, "ground"))
    simulation.until_all_ended()
    term = next(s.term for s in of_block(simulation, "body", Phase.GROUND))
    seen = {view.block: view for view in simulation.views(Phase.GROUND) if view.term == term}
    assert set(seen) == {"body", *LEAVES}
    assert "posture" in seen["body"].arrays
    assert "posture" not in seen["x"].arrays, "the body is shown once, not once per limb"
    assert seen["yz"].arrays["goal"].shape == (2, 3)
