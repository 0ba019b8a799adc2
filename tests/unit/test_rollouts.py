"""Columns become rollouts in order; experience of a too old policy is dropped and counted."""

import numpy as np
import pytest

from services.policy_learner.rollouts import RolloutHand


def segment(mark: int, columns: int = 2, steps: int = 3) -> dict[str, np.ndarray]:
    latent = np.full((steps, columns, 2), mark, np.float32)
    latent[:, :, 1] = np.arange(columns)
    return {"latent": latent, "log_prob": np.full((steps, columns), mark, np.float32)}


def test_a_rollout_takes_whole_columns_in_their_order() -> None:
    hand = RolloutHand(rollout_columns=3, max_policy_lag=2)
    hand.add(segment(1), policy_version=5)
    assert hand.rollout() is None
    hand.add(segment(2), policy_version=6)
    taken = hand.rollout()
    assert taken is not None
    rollout, versions = taken
    assert rollout["latent"].shape == (3, 3, 2)
    assert rollout["latent"][0, :, 0].tolist() == [1, 1, 2]
    assert rollout["latent"][0, :, 1].tolist() == [0, 1, 0]
    assert versions == [5, 5, 6]
    assert hand.columns == 1, "the fourth column waits for the next rollout"


@pytest.mark.parametrize(("lag", "kept"), [(2, 2), (3, 0)])
def test_only_experience_older_than_the_limit_is_dropped(lag: int, kept: int) -> None:
    hand = RolloutHand(rollout_columns=2, max_policy_lag=2)
    hand.add(segment(1), policy_version=4)
    hand.drop_older_than(4 + lag)
    assert hand.columns == kept
    assert hand.too_old == 2 - kept


def test_what_is_in_hand_survives_a_checkpoint() -> None:
    hand = RolloutHand(rollout_columns=2, max_policy_lag=2)
    hand.add(segment(7), policy_version=4)
    restored = RolloutHand(rollout_columns=2, max_policy_lag=2)
    restored.restore(hand.state())
    one, other = hand.rollout(), restored.rollout()
    assert one is not None
    assert other is not None
    assert one[1] == other[1]
    np.testing.assert_array_equal(one[0]["latent"], other[0]["latent"])
