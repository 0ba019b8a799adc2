"""The task's own reward beside the goal's: what the policy is trained on, and what is refused."""

from typing import Any

import numpy as np
import pytest

from babble.policy.goals import reward, weighted
from protocol.messages import Phase
from services.policy_learner.work import PolicyWork
from tests.unit.test_learner_works import announce, new_policy_work, segment, settings_of
from tests.unit.test_ppo import M, T, advantages_by_hand, learnt_from, make_ppo, make_rollout


def test_both_rewards_are_weighted_and_added() -> None:
    goal, external = np.array([-1.0, -0.5], np.float32), np.array([2.0, -2.0], np.float32)
    np.testing.assert_allclose(weighted(goal, external, 0.5, 3.0), [5.5, -6.25])
    np.testing.assert_array_equal(weighted(goal, None, 1.0, 0.0), goal)


def rewarded() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(5)
    return {**make_rollout(), "external_reward": rng.normal(size=(T, M)).astype(np.float32)}


@pytest.mark.parametrize(("goal_weight", "external_weight"), [(1.0, 2.0), (0.0, 1.0), (0.5, -0.25)])
def test_the_weights_reach_the_advantages(goal_weight: float, external_weight: float) -> None:
    ppo = make_ppo(goal_weight=goal_weight, external_weight=external_weight)
    rollout = rewarded()
    goals = reward(rollout["next_latent"], rollout["goal"])
    rewards = goal_weight * goals + external_weight * rollout["external_reward"]
    expected = advantages_by_hand(rollout, make_ppo().value, rewards)
    np.testing.assert_allclose(learnt_from(ppo, rollout), expected, atol=1e-5)


def test_the_metrics_tell_the_reward_that_was_trained_on_and_the_tasks_own() -> None:
    rollout = rewarded()
    found = make_ppo(goal_weight=0.0, external_weight=2.0).update(rollout)
    assert found["external_reward_mean"] == pytest.approx(rollout["external_reward"].mean(), rel=1e-5)
    assert found["reward_mean"] == pytest.approx(2 * rollout["external_reward"].mean(), rel=1e-5)


def test_without_a_weight_the_reward_is_not_looked_at() -> None:
    rollout = make_rollout()
    plain = make_ppo().update(rollout)
    assert plain == make_ppo().update({**rollout, "external_reward": np.full((T, M), np.nan)})


@pytest.mark.parametrize("wrong", [None, np.full((T, M), np.inf, np.float32), np.zeros((T, M + 1))])
def test_a_rollout_without_the_reward_that_has_a_weight_is_refused(wrong: np.ndarray | None) -> None:
    rollout = make_rollout() if wrong is None else {**make_rollout(), "external_reward": wrong}
    with pytest.raises(ValueError, match="external_reward"):
        make_ppo(external_weight=1.0).update(rollout)


def grounded(weight: float) -> PolicyWork:
    work = new_policy_work(settings_of(goals={"external_weight": weight}))
    work.begin(announce(Phase.GROUND, 3, encoder=1))
    return work


def with_reward(taken: Any, value: float = 1.0) -> Any:
    reward = np.full((taken.steps, taken.columns), value, np.float32)
    return taken.model_copy(update={"arrays": {**taken.arrays, "external_reward": reward}})


def test_a_segment_without_the_reward_is_refused_where_it_has_a_weight_and_only_there() -> None:
    plain = segment(Phase.GROUND, 0, np.random.default_rng(1))
    assert grounded(0.0).take(plain)
    assert grounded(0.0).take(with_reward(plain)), "what it does not need does no harm"
    assert grounded(0.5).take(with_reward(plain))
    with pytest.raises(ValueError, match=r"it has no external_reward, .* a weight of 0\.5"):
        grounded(0.5).take(plain)
    with pytest.raises(ValueError, match="external_reward must be finite"):
        grounded(0.5).take(with_reward(plain, np.nan))


def test_columns_with_their_rewards_survive_a_restart() -> None:
    straight = grounded(1.0)
    straight.take(with_reward(segment(Phase.GROUND, 0, np.random.default_rng(1)), 0.25))
    restarted = new_policy_work(settings_of(goals={"external_weight": 1.0}))
    restarted.restore(straight.state())
    for work in (straight, restarted):
        assert work.advance()
    assert straight.metrics() == restarted.metrics()
    assert straight.metrics()["body/policy/external_reward_mean"] == 0.25
