import io

import numpy as np
import pytest
import torch

from babble.policy.goals import one_hot, reward
from babble.policy.ppo import GoalPPO

T, M, D, A = 24, 4, 2, 3
DISCOUNT, LAMBDA = 0.9, 0.8


def make_ppo(seed=0, **settings):
    return GoalPPO(
        D,
        A,
        **{
            "hidden": (16,),
            "steps": T,
            "columns": M,
            "minibatch": 32,
            "discount": DISCOUNT,
            "gae_lambda": LAMBDA,
            "seed": seed,
            **settings,
        },
    )


def make_rollout(seed=0, ends=()):
    """Random experience; `ends` lists (kind, t, column), and the goal changes after each."""
    rng = np.random.default_rng(seed)
    path = rng.dirichlet(np.ones(D), (T + 1, M)).astype(np.float32)
    flags = {kind: np.zeros((T, M), np.uint8) for kind in ("truncated", "terminated")}
    aim = np.zeros((T, M), int)
    for kind, t, column in ends:
        flags[kind][t, column] = 1
        aim[t + 1 :, column] = 1 - aim[t, column]
    return {
        "latent": path[:-1],
        "next_latent": path[1:],
        "goal": one_hot(aim, D),
        "action": rng.standard_normal((T, M, A)).astype(np.float32),
        "log_prob": rng.normal(-4, 0.3, (T, M)).astype(np.float32),
        **flags,
    }


def advantages_by_hand(rollout, value, rewards):
    """Generalised advantage estimation (Schulman et al. 2016), one column and one step at a time."""
    found = np.zeros((T, M))
    for column in range(M):
        trace = 0.0
        for t in reversed(range(T)):
            z, z_next, goal = (rollout[name][t, column] for name in ("latent", "next_latent", "goal"))
            after = 0.0 if rollout["terminated"][t, column] else float(value(z_next, goal))
            if rollout["terminated"][t, column] or rollout["truncated"][t, column]:
                trace = 0.0
            error = rewards[t, column] + DISCOUNT * after - float(value(z, goal))
            trace = error + DISCOUNT * LAMBDA * trace
            found[t, column] = trace
    return found


def learnt_from(ppo, rollout):
    """The advantages (T, M) that SB3 trained on."""
    ppo.update(rollout)
    return ppo._ppo.rollout_buffer.advantages.reshape(M, T).T


@pytest.mark.parametrize(
    "ends",
    [
        [],
        [("truncated", 5, 0), ("truncated", 6, 0), ("truncated", 10, 2)],
        [("truncated", T - 1, 1)],
        [("terminated", 7, 3), ("terminated", T - 1, 0)],
        [("truncated", 7, 3), ("terminated", 7, 3)],
        [("truncated", 3, 0), ("terminated", 9, 0), ("truncated", T - 1, 2), ("terminated", 0, 1)],
    ],
    ids=["none", "truncated", "truncated at the end", "terminated", "both at once", "all"],
)
def test_advantages_are_those_of_a_plain_loop(ends):
    ppo, rollout = make_ppo(), make_rollout(ends=ends)
    rewards = reward(rollout["next_latent"], rollout["goal"])
    expected = advantages_by_hand(rollout, make_ppo().value, rewards)
    np.testing.assert_allclose(learnt_from(ppo, rollout), expected, atol=1e-5)


def test_a_goal_switch_is_bootstrapped_with_the_old_goals_value():
    """With this critic the two goals' values lie far apart, so that the wrong one would show."""
    ppo = make_ppo()
    with torch.no_grad():
        ppo._ppo.policy.mlp_extractor.value_net[0].weight[:, D:] = torch.tensor([3.0, -3.0])
        ppo._ppo.policy.value_net.weight.fill_(1.0)
    rollout = make_rollout(ends=[("truncated", 10, 0)])
    z, old, new = rollout["next_latent"][10, 0], rollout["goal"][10, 0], rollout["goal"][11, 0]
    assert abs(float(ppo.value(z, old) - ppo.value(z, new))) > 5
    now = float(ppo.value(rollout["latent"][10, 0], old))
    expected = float(reward(z, old)) + DISCOUNT * float(ppo.value(z, old)) - now
    assert learnt_from(ppo, rollout)[10, 0] == pytest.approx(expected, abs=1e-4)


def test_columns_are_separate_segments():
    """What happens in one column changes nothing in another's advantages."""
    rollout, other = make_rollout(), make_rollout()
    other["next_latent"] = other["next_latent"].copy()
    other["next_latent"][:, 2] = [1.0, 0.0]
    one, two = learnt_from(make_ppo(), rollout), learnt_from(make_ppo(), other)
    changed = (np.abs(one - two) > 1e-6).any(axis=0)
    assert changed.tolist() == [False, False, True, False]


@pytest.mark.parametrize("form", ["squared", "dense", "sparse"])
def test_the_reward_form_reaches_the_advantages(form):
    ppo, rollout = make_ppo(reward_form=form, sparse_radius=0.5), make_rollout()
    rewards = reward(rollout["next_latent"], rollout["goal"], form, 0.5)
    expected = advantages_by_hand(rollout, make_ppo().value, rewards)
    found = learnt_from(ppo, rollout)
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_ratios_are_taken_to_the_policy_that_acted():
    """Log probabilities of a policy far from the present one must show in the KL and the clipping."""
    near, rollout = make_ppo(epochs=1, minibatch=T * M), make_rollout()
    mean, log_std = near.distribution(rollout["latent"].reshape(-1, D), rollout["goal"].reshape(-1, D))
    noise = (rollout["action"].reshape(-1, A) - mean) / np.exp(log_std)
    log_prob = -(0.5 * noise**2 + log_std + 0.5 * np.log(2 * np.pi)).sum(axis=1).reshape(T, M)
    same = near.update({**rollout, "log_prob": log_prob.astype(np.float32)})
    assert same["approx_kl"] == pytest.approx(0, abs=1e-6)
    assert same["clip_fraction"] == 0
    far = make_ppo(epochs=1, minibatch=T * M).update(
        {**rollout, "log_prob": (log_prob - 1).astype(np.float32)}
    )
    assert far["approx_kl"] == pytest.approx(np.e - 2, abs=1e-3)
    assert far["clip_fraction"] == 1


def bandit_rollout(ppo, rng):
    """One-step tasks: the first action component moves z towards vertex 1."""
    z, aim = np.full((T, M, D), 0.5, np.float32), rng.integers(0, D, (T, M))
    goal = one_hot(aim, D)
    mean, log_std = ppo.distribution(z.reshape(-1, D), goal.reshape(-1, D))
    noise = rng.standard_normal(mean.shape).astype(np.float32)
    action = (mean + np.exp(log_std) * noise).reshape(T, M, A)
    log_prob = -(0.5 * noise**2 + log_std + 0.5 * np.log(2 * np.pi)).sum(axis=1).reshape(T, M)
    first = 1 / (1 + np.exp(-2 * action[..., 0]))
    return {
        "latent": z,
        "next_latent": np.stack([1 - first, first], axis=2).astype(np.float32),
        "goal": goal,
        "action": action,
        "log_prob": log_prob.astype(np.float32),
        "truncated": np.zeros((T, M), np.uint8),
        "terminated": np.ones((T, M), np.uint8),
    }


def test_updates_make_the_policy_reach_its_goals():
    ppo, rng = make_ppo(learning_rate=1e-2), np.random.default_rng(0)
    rewards = [ppo.update(bandit_rollout(ppo, rng))["reward_mean"] for _ in range(25)]
    assert rewards[0] < -0.4
    assert np.mean(rewards[-5:]) > -0.2
    mean, _ = ppo.distribution(np.full((2, 2), 0.5, np.float32), one_hot([0, 1], 2))
    assert mean[0, 0] < -0.5 < 0.5 < mean[1, 0]


def test_the_metrics_say_what_happened():
    rollout = make_rollout()
    metrics = make_ppo(log_std=-1.0, learning_rate=1e-5).update(rollout)
    assert set(metrics) == {
        "loss",
        "policy_loss",
        "value_loss",
        "approx_kl",
        "clip_fraction",
        "explained_variance",
        "std",
        "entropy",
        "reward_mean",
    }
    expected = reward(rollout["next_latent"], rollout["goal"]).mean()
    assert metrics["reward_mean"] == pytest.approx(expected)
    assert metrics["std"] == pytest.approx(np.exp(-1), rel=1e-3)
    assert metrics["entropy"] == pytest.approx(A * (0.5 * np.log(2 * np.pi * np.e) - 1), rel=1e-3)


def test_an_update_prints_nothing(capfd):
    make_ppo().update(make_rollout())
    assert capfd.readouterr() == ("", "")


def parameters(ppo):
    return torch.cat([p.detach().flatten() for p in ppo._ppo.policy.parameters()])


def test_the_seed_decides_all_and_no_global_generator_is_touched():
    torch.manual_seed(3)
    np.random.seed(3)
    before = torch.get_rng_state(), np.random.get_state()[1].copy()
    runs = [make_ppo(seed) for seed in (1, 1, 2)]
    for ppo in runs:
        ppo.update(make_rollout())
    assert torch.equal(torch.get_rng_state(), before[0])
    np.testing.assert_array_equal(np.random.get_state()[1], before[1])
    assert torch.equal(parameters(runs[0]), parameters(runs[1]))
    assert not torch.equal(parameters(runs[0]), parameters(runs[2]))


def test_a_restored_policy_goes_on_bit_for_bit():
    ppo = make_ppo()
    ppo.update(make_rollout(0))
    file = io.BytesIO()
    torch.save(ppo.state(), file)
    file.seek(0)
    other = make_ppo(seed=7)
    other.restore(torch.load(file, weights_only=True))
    assert other.updates == 1
    assert ppo.update(make_rollout(1)) == other.update(make_rollout(1))
    assert torch.equal(parameters(ppo), parameters(other))


def test_a_state_does_not_change_as_training_goes_on():
    ppo = make_ppo()
    ppo.update(make_rollout(0))
    state, before = ppo.state(), parameters(ppo)
    ppo.update(make_rollout(1))
    ppo.restore(state)
    assert torch.equal(parameters(ppo), before)


def test_a_fresh_optimiser_keeps_the_weights_and_forgets_the_moments():
    used, plain = make_ppo(), make_ppo()
    for ppo in (used, plain):
        ppo.update(make_rollout(0))
    before = parameters(used)
    used.reset_optimiser()
    assert torch.equal(parameters(used), before)
    for ppo in (used, plain):
        ppo.update(make_rollout(1))
    assert not torch.equal(parameters(used), parameters(plain))


def test_the_learning_rate_is_the_one_given_also_after_a_reset():
    moved = []
    for rate in (1e-4, 1e-3):
        ppo = make_ppo(learning_rate=rate, epochs=1, minibatch=T * M)
        ppo.reset_optimiser()
        before = parameters(ppo)
        ppo.update(make_rollout())
        moved.append((parameters(ppo) - before).abs().max().item())
    assert moved == pytest.approx([1e-4, 1e-3], rel=0.02)


def test_frames_that_may_not_be_written_to_are_read():
    rollout = make_rollout()
    for array in rollout.values():
        array.flags.writeable = False
    ppo = make_ppo()
    before = parameters(ppo)
    ppo.update(rollout)
    assert not torch.equal(parameters(ppo), before)


@pytest.mark.parametrize(
    ("name", "wrong", "words"),
    [
        ("log_prob", None, "the rollout has no log_prob"),
        ("goal", np.zeros((T, M, D + 1)), r"goal must be finite numbers of shape \(24, 4, 2\)"),
        ("action", np.full((T, M, A), np.inf), "action must be finite"),
        ("truncated", np.zeros((T + 1, M)), r"truncated must be .* \(24, 4\), got shape \(25, 4\)"),
    ],
)
def test_a_rollout_that_does_not_fit_changes_nothing(name, wrong, words):
    ppo, rollout = make_ppo(), make_rollout()
    before = parameters(ppo)
    if wrong is None:
        del rollout[name]
    else:
        rollout[name] = wrong
    with pytest.raises(ValueError, match=words):
        ppo.update(rollout)
    assert torch.equal(parameters(ppo), before)
    assert ppo.updates == 0


def test_an_unknown_setting_is_refused():
    with pytest.raises(TypeError, match="learning_speed"):
        GoalPPO(2, 3, learning_speed=1)
