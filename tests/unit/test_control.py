"""The control trains as GROUND does: it succeeds on a good encoder, and must fail on an untrained one."""

from dataclasses import replace

import numpy as np
import pytest

from babble.breakdowns import Breakdowns, UnstableError
from babble.control import ground, train_on_untrained_encoder, transition, walk
from babble.noise import make_noise
from babble.policy.act import EncoderModel, PolicyModel
from babble.policy.goals import GoalClock
from babble.policy.ppo import GoalPPO
from babble.scores import score, walk_legs
from babble.worlds import Step, World, make
from babble.worlds.batch import Floats, PointWorld
from tests.unit.analytic_run import encoder, policy

COLUMNS = 16
SETTINGS = {"steps": 64, "minibatch": 256}
ROLLOUT = COLUMNS * SETTINGS["steps"]


@pytest.fixture
def world() -> World:
    """A batch of cuboids."""
    return make("Cuboid", {}, COLUMNS, [1])


def z_min(encoder_model: EncoderModel, policy_model: PolicyModel) -> float:
    """Of a fresh evaluation with mean actions."""
    fresh = make("Cuboid", {}, 32, [2])
    legs = walk_legs(fresh, encoder_model, policy_model, np.random.default_rng(3), legs=3, leg_steps=60)
    return score(legs, fresh.diameter)["z_min"]


def train(seed: int, rollouts: int) -> tuple[EncoderModel, PolicyModel]:
    """The control with a small budget."""
    noise = make_noise("ou", scale=0.6, columns=COLUMNS, size=3, rng=np.random.default_rng(0))
    world, steps = make("Cuboid", {}, COLUMNS, [1]), rollouts * ROLLOUT
    return train_on_untrained_encoder(
        world, 2, noise=noise, walk_steps=2_000, train_steps=steps, seed=seed, **SETTINGS
    )


def test_the_same_training_succeeds_on_a_good_encoder_and_fails_on_an_untrained_one(world: World) -> None:
    learned = EncoderModel(encoder((1.0, 0.6, 0.3)))
    rng = np.random.default_rng(0)
    ppo = GoalPPO(2, 3, columns=COLUMNS, **SETTINGS)
    trained = ground(world, learned, ppo, GoalClock(COLUMNS, 2, 100, rng), rng, 8 * ROLLOUT)
    assert z_min(learned, trained) >= 0.9
    assert z_min(*train(seed=0, rollouts=8)) < 0.75


def test_a_seed_decides_everything(world: World) -> None:
    points = world.uniform_points(32, np.random.default_rng(0))
    goals = np.eye(2, dtype=np.float32)[np.arange(32) % 2]
    latents, actions = [], []
    for seed in (1, 1, 2):
        one, other = train(seed, rollouts=1)
        latents.append(one.latent(points))
        actions.append(other.distribution(latents[0], goals)[0])
    for found in (latents, actions):
        np.testing.assert_array_equal(found[0], found[1])
        assert not np.allclose(found[0], found[2])


def test_a_walk_has_the_asked_steps_and_sets_a_scaling(world: World) -> None:
    noise = make_noise("ou", scale=0.6, columns=COLUMNS, size=3, rng=np.random.default_rng(0))
    memory = walk(world, noise, 33 * COLUMNS - 5)
    mean, scale = memory.scaling()
    assert memory.steps == 33 * COLUMNS
    assert ((scale > 0) & (scale < 1)).all()
    assert mean.shape == scale.shape == (3,)


def test_training_is_whole_rollouts_rounded_up(world: World) -> None:
    rng = np.random.default_rng(0)
    ppo = GoalPPO(2, 3, columns=COLUMNS, steps=8, epochs=1, minibatch=64)
    held = EncoderModel(encoder((1.0, 0.6, 0.3)))
    ground(world, held, ppo, GoalClock(COLUMNS, 2, 100, rng), rng, 2 * 8 * COLUMNS + 1)
    assert ppo.updates == 3


def test_a_new_goal_truncates_under_the_old_one_and_moves_nobody(world: World) -> None:
    rng = np.random.default_rng(0)
    clock = GoalClock(COLUMNS, 2, 1, rng)
    before = clock.goal
    held, pusher = EncoderModel(encoder((1.0, 0.6, 0.3))), PolicyModel(policy((1.0, 1.0, 1.0)))
    row, observation = transition(
        world, world.reset("random"), held, pusher, clock, rng, Breakdowns(world.id)
    )
    assert row is not None
    assert row["truncated"].all()
    assert not row["terminated"].any()
    np.testing.assert_array_equal(row["goal"], before)
    np.testing.assert_array_equal(observation, world.posture())
    np.testing.assert_array_equal(row["next_latent"], held.latent(observation))


class Fragile(PointWorld):
    """A cuboid whose simulation breaks down in column 0 at every so many steps."""

    every = 7
    _steps = 0

    @classmethod
    def of(cls, world: World) -> "Fragile":
        """The same world, with the weakness."""
        assert isinstance(world, PointWorld)
        return cls("Fragile", world.body, speed=world.speed, columns=world.columns, rng=world.rng)

    def step(self, action: Floats) -> Step:
        """As in the cuboid, but for NaN where it breaks down."""
        step = super().step(action)
        self._steps += 1
        failed = np.zeros(self.columns, np.bool_)
        failed[0] = self._steps % self.every == 0
        observation = np.where(failed[:, None], np.float32(np.nan), step.observation)
        return replace(step, observation=observation, failed=failed)


def test_a_walk_goes_on_in_a_new_episode_where_the_simulation_broke_down(world: World) -> None:
    noise = make_noise("ou", scale=0.6, columns=COLUMNS, size=3, rng=np.random.default_rng(0))
    memory = walk(Fragile.of(world), noise, 28 * COLUMNS)
    episodes = memory.state()["episode/walk"]
    assert memory.steps == 28 * COLUMNS
    assert np.flatnonzero(np.diff(episodes[:, 0])).tolist() == [6, 13, 20]
    assert not episodes[:, 1:].any()


def test_training_drops_the_rollouts_in_which_the_simulation_broke_down(world: World) -> None:
    rng, held = np.random.default_rng(0), EncoderModel(encoder((1.0, 0.6, 0.3)))
    fragile = Fragile.of(world)
    clock = GoalClock(COLUMNS, 2, 100, rng)
    ground(fragile, held, GoalPPO(2, 3, columns=COLUMNS, steps=5, epochs=1, minibatch=16), clock, rng, 1)
    with pytest.raises(UnstableError, match="Fragile broke down 20 times in a row"):
        ground(fragile, held, GoalPPO(2, 3, columns=COLUMNS, steps=8, minibatch=16), clock, rng, 1)
