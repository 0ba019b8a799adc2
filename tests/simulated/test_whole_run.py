"""A whole run in one process: it ends by itself, repeats bit for bit, and shares the work."""

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from services.runtime.settings import BlockSettings, RunSettings
from tests.simulated.harness import Simulation

Simulate = Callable[..., Simulation]


def scores_of(run_dir: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (run_dir / "scores.jsonl").read_text().splitlines()]


def models_of(run_dir: Path) -> dict[str, str]:
    """The digest of each model file."""
    return {
        str(path.relative_to(run_dir)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted((run_dir / "models").rglob("*.onnx"))
    }


def test_a_run_goes_through_all_phases_and_everyone_ends(tiny: RunSettings, simulate: Simulate) -> None:
    simulation = simulate(tiny)
    simulation.start_all(actors=2)
    simulation.until_all_ended()
    assert sorted(simulation.ended) == [
        "actor-0", "actor-1", "coordinator-0", "encoder_learner-0", "policy_learner-0",
    ]  # fmt: skip
    assert [(s["iteration"], s["phase"], s["policy"]) for s in scores_of(simulation.run_dir)] == [
        (0, "ground", "mean"),
        (0, "ground", "sampled"),
        (1, "practise", "mean"),
        (1, "practise", "sampled"),
    ]
    assert (simulation.run_dir / "best.json").exists()


def test_a_seeded_run_repeats_bit_for_bit(tiny: RunSettings, simulate: Simulate) -> None:
    outcomes = []
    for seed in (3, 3, 4):
        simulation = simulate(tiny.model_copy(update={"seed": seed}))
        simulation.start_all(actors=2)
        simulation.until_all_ended()
        outcomes.append((models_of(simulation.run_dir), scores_of(simulation.run_dir)))
    assert len(outcomes[0][0]) == 4, "two encoders and two policies are kept"
    assert outcomes[0] == outcomes[1]
    assert outcomes[0][0] != outcomes[2][0], "another seed is another run"


def test_all_actors_contribute_in_every_phase_that_collects(tiny: RunSettings, simulate: Simulate) -> None:
    simulation = simulate(tiny)
    simulation.start_all(actors=3)
    simulation.until_all_ended()
    for learner in ("encoder_learner", "policy_learner"):
        contributors = {life for life, *_ in simulation.book(learner)["ledger"]["streams"]}
        assert contributors == {"actor-0", "actor-1", "actor-2"}


def test_two_blocks_of_one_level_learn_at_once_from_the_same_actors(
    tiny: RunSettings, simulate: Simulate
) -> None:
    blocks = [
        BlockSettings(name="along", observes=[0], drives=[0]),
        BlockSettings(name="across", observes=[1, 2], drives=[1, 2], latent_dim=3),
    ]
    simulation = simulate(tiny.model_copy(update={"block": blocks}))
    simulation.start_all(actors=2)
    simulation.until_all_ended()
    by_block = {(s["block"], s["iteration"], s["policy"]) for s in scores_of(simulation.run_dir)}
    assert by_block == {
        (block, iteration, policy)
        for block in ("along", "across")
        for iteration in (0, 1)
        for policy in ("mean", "sampled")
    }
