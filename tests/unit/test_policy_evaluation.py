"""The policy learner's evaluation: landmarks and rewards in the scores, also after a restart."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from babble.landmarks import Landmark
from babble.parts import Part
from protocol.messages import Phase, Segment
from services.policy_learner.config import PolicyWorkConfig, work_config
from services.policy_learner.evaluation import Evaluation
from services.runtime.settings import parse
from tests.unit.trees import tree_on

COLUMNS, LEGS = 4, 3


@pytest.fixture
def config() -> PolicyWorkConfig:
    settings = parse(
        {"scenario": "x", "evaluation": {"columns": COLUMNS, "legs": LEGS, "leg_steps": 5}}, origin="x"
    )
    tree = tree_on(settings, 1, 1)
    landmarks = (Landmark("shut", ((0,),), 0.8, 1.0), Landmark("open", ((0,),), -1.0, -0.8))
    return work_config(
        settings,
        tree,
        "body",
        0,
        run="r",
        posture_size=1,
        part=Part(np.arange(1), 2.0, None, landmarks),
    )


def evaluation_of(config: PolicyWorkConfig) -> Evaluation:
    return Evaluation(config, iteration=2, phase=Phase.PRACTISE, versions=(1, 7))


def legs(columns: int = 2, *, policy: str = "mean", first: int = 0, **changes: Any) -> Segment:
    """Goal 0 leads to -1 with a reward of 0.5, goal 1 to +1 with -1; `first` is where the columns begin."""
    goal = (np.arange(LEGS)[:, None] + first + np.zeros((LEGS, columns), np.int32)).astype(np.int32) % 2
    arrays: dict[str, Any] = {
        "posture": (2.0 * goal - 1)[:, :, None].astype(np.float32),
        "latent": np.eye(2, dtype=np.float32)[goal],
        "goal": goal,
        "external_reward": np.where(goal == 0, 0.5, -1.0).astype(np.float32),
    }
    arrays = {name: array for name, array in {**arrays, **changes}.items() if array is not None}
    return Segment(
        run="r", term=1, block="body", life="actor-1", seq=0, consumer="policy_learner",
        fingerprint="0" * 16, phase=Phase.EVALUATE, encoder_version=1, policy_version=7, policy=policy,
        steps=LEGS * 5, columns=columns, first_step=0, arrays=arrays,
    )  # fmt: skip


def test_scores_have_landmarks_with_their_vertices_and_the_tasks_reward(config: PolicyWorkConfig) -> None:
    evaluation = evaluation_of(config)
    assert evaluation.take(legs())
    assert evaluation.take(legs())
    (found,) = evaluation.scores
    assert found.landmarks == {"shut": 1.0, "open": 1.0}
    assert found.landmark_vertices == {"shut": 1, "open": 0}
    assert found.external_reward_by_vertex == [0.5, -1.0]
    assert found.external_reward == -0.25, "the two legs after the first, one to each vertex"
    assert (found.iteration, found.policy, found.policy_version) == (2, "mean", 7)


def test_an_evaluation_restarted_in_the_middle_finds_the_same(config: PolicyWorkConfig) -> None:
    straight = evaluation_of(config)
    straight.take(legs())
    restarted = Evaluation.restored(config, straight.state())
    for evaluation in (straight, restarted):
        evaluation.take(legs(first=1))
    assert straight.scores == restarted.scores
    assert straight.scores[0].external_reward_by_vertex == [0.5, -1.0]


def test_legs_without_the_reward_are_scored_without_it(config: PolicyWorkConfig) -> None:
    evaluation = evaluation_of(config)
    evaluation.take(legs())
    evaluation.take(legs(external_reward=None))
    assert evaluation.scores[0].external_reward is None
    assert evaluation.scores[0].z_min == 1.0


@pytest.mark.parametrize("reward", [np.full((LEGS, 2), np.nan, np.float32), np.zeros((LEGS, 3), np.float32)])
def test_rewards_that_are_no_numbers_are_refused(config: PolicyWorkConfig, reward: np.ndarray) -> None:
    with pytest.raises(ValueError, match="external_reward must be finite numbers of shape"):
        evaluation_of(config).take(legs(external_reward=reward))


def test_where_sides_count_each_leg_says_which_it_ended_on(config: PolicyWorkConfig) -> None:
    config = replace(config, part=Part(np.arange(1), 2.0, None, (), turns=True))
    straight = evaluation_of(config)
    straight.take(legs(side=np.array([[1, 1], [1, 1], [-0.9, -0.4]], np.float32)))
    restarted = Evaluation.restored(config, straight.state())
    for evaluation in (straight, restarted):
        evaluation.take(legs(side=np.array([[1, 1], [1, -1], [1, 0.6]], np.float32)))
        assert evaluation.scores[0].crossing == 0.5, "one rolled to the front, one back, one to a flank"
