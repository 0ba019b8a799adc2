"""The conditions of the coverage study (thesis 4.5): one switch each, and the run still goes to its end."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from babble.policy.act import EncoderModel
from protocol.messages import Phase
from services.runtime.settings import RunSettings, parse
from tests.simulated.conftest import TINY
from tests.simulated.harness import Simulation

Simulate = Callable[..., Simulation]

TWO_FITS: dict[str, Any] = TINY["encoder"]  # type: ignore[assignment]
C2 = {"encoder": TWO_FITS | {"contrastive": False, "blend": 0.5}}
C3 = {"encoder": TWO_FITS | {"output": "linear"}}
C4 = {"goals": {"kind": "random", "period_steps": 10, "walk_steps_per_goal": 10}}


def settings_of(change: dict[str, Any]) -> RunSettings:
    return parse({**TINY, **change}, origin="test")


def finished(simulate: Simulate, change: dict[str, Any]) -> Simulation:
    simulation = simulate(settings_of(change))
    simulation.start_all(actors=2)
    simulation.until_all_ended()
    rows = [json.loads(line) for line in (simulation.run_dir / "scores.jsonl").read_text().splitlines()]
    assert [(row["iteration"], row["policy"]) for row in rows] == [
        (0, "mean"), (0, "sampled"), (1, "mean"), (1, "sampled"),
    ]  # fmt: skip
    return simulation


def encoders(run_dir: Path) -> list[bytes]:
    return [path.read_bytes() for path in sorted((run_dir / "models" / "body").glob("encoder-*.onnx"))]


def latents(onnx: bytes) -> np.ndarray:
    points = np.random.default_rng(5).uniform(-1, 1, (200, 3)).astype(np.float32)
    return EncoderModel(onnx).latent(points)


def test_without_contrastive_learning_the_encoder_stays_as_it_was_at_first(simulate: Simulate) -> None:
    simulation = finished(simulate, C2)
    first, second = encoders(simulation.run_dir)
    assert first == second, "REFINE publishes a version, of the same weights"
    totals = simulation.statuses("encoder_learner-0")[-1][1].totals
    assert totals["body/encoder_updates"] == 0
    learned, _ = encoders(finished(simulate, {}).run_dir)
    assert np.abs(latents(first) - latents(learned)).max() > 0.01
    spread = latents(first)
    np.testing.assert_allclose(spread.sum(axis=1), 1, atol=1e-5)
    other = encoders(finished(simulate, C2 | {"seed": 9}).run_dir)[0]
    assert np.abs(latents(other) - spread).max() > 0.01, "its weights are random, of the run's seed"


def test_without_the_simplex_latents_are_any_numbers_everywhere(simulate: Simulate) -> None:
    simulation = finished(simulate, C3)
    assert all((np.abs(latents(onnx).sum(axis=1) - 1) > 0.05).any() for onnx in encoders(simulation.run_dir))
    for segment in simulation.segments(Phase.PRACTISE):
        if segment.consumer == "policy_learner":
            assert (np.abs(segment.arrays["latent"].sum(axis=-1) - 1) > 1e-3).any()


@pytest.mark.parametrize("phase", [Phase.GROUND, Phase.PRACTISE])
def test_without_one_hot_goals_policies_learn_from_points_inside_the_simplex(
    simulate: Simulate, phase: Phase
) -> None:
    simulation = finished(simulate, C4)
    goals = [s.arrays["goal"] for s in simulation.segments(phase) if s.consumer == "policy_learner"]
    assert goals
    points = np.concatenate([goal.reshape(-1, 2) for goal in goals])
    np.testing.assert_allclose(points.sum(axis=1), 1, atol=1e-5)
    assert ((points > 0) & (points < 1)).all()
    assert len(np.unique(points[:, 0])) > 10
    measured = [s for s in simulation.segments(Phase.EVALUATE) if s.consumer == "policy_learner"]
    assert all(np.isin(s.arrays["goal"], (0, 1)).all() for s in measured), "vertices, by their indices"


@pytest.mark.parametrize(("exponent", "least", "most"), [(0.0, -0.3, 0.3), (2.0, 0.6, 1.0)])
def test_a_run_babbles_in_colour(simulate: Simulate, exponent: float, least: float, most: float) -> None:
    table = {"kind": "coloured", "scale": 0.1, "block_steps": 64, "exponents": [exponent, exponent]}
    simulation = finished(simulate, {"babbling": table})
    moves = [np.diff(s.arrays["observation"], axis=0) for s in simulation.segments(Phase.BABBLE)]
    before, after = (
        np.concatenate([move[part].ravel() for move in moves]) for part in (slice(-1), slice(1, None))
    )
    assert least < np.corrcoef(before, after)[0, 1] < most, "how alike two moves are that follow each other"
