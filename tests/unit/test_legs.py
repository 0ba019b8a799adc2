"""A walk from vertex to vertex: what is traced, what a breakdown leaves, what an episode's end does."""

from typing import Any

import numpy as np
import pytest

from babble.breakdowns import Breakdowns, UnstableError
from babble.legs import Walk, Walker, walk_blocks
from tests.simulated.episodic import EpisodicWorld
from tests.unit.actor_doubles import Half, Push

LEGS, LEG_STEPS, COLUMNS = 3, 6, 4


def walk_of(world: EpisodicWorld, **options: Any) -> Walk:
    walker = Walker(Half(), Push(0, actuators=1), np.arange(2), np.arange(1))
    return Walk(world, {"body": walker}, np.random.default_rng(1), LEGS, LEG_STEPS, **options)


def world_of(**parameters: Any) -> EpisodicWorld:
    return EpisodicWorld(COLUMNS, np.random.default_rng(0), **parameters)


def test_a_trace_has_every_posture_and_the_latent_that_each_step_was_taken_at() -> None:
    walk = walk_of(world_of(), traced=True)
    assert not walk.advance(LEGS * LEG_STEPS - 1)
    with pytest.raises(RuntimeError, match="once the walk is done"):
        walk.legs()
    assert walk.advance(1)
    posture, latent = np.stack(walk.path.posture), np.stack(walk.path.latent["body"])
    assert (posture.shape, latent.shape) == ((19, COLUMNS, 1), (18, COLUMNS, 2))
    np.testing.assert_allclose(latent[:, :, 0], 0.5 + 0.4 * posture[:-1, :, 0], atol=1e-6)
    np.testing.assert_array_equal(posture[0], walk.legs()["body"].start_posture)
    np.testing.assert_array_equal(posture[LEG_STEPS::LEG_STEPS], walk.legs()["body"].posture)


class OnASide(EpisodicWorld):
    """Lies on its back to the right of the middle, on its belly to the left."""

    def side(self) -> np.ndarray:
        return np.sign(self.posture()[:, 0])


def test_legs_say_which_side_the_body_lay_on_at_their_end() -> None:
    assert walk_blocks(world_of(), *walkers())["body"].side is None
    world = OnASide(COLUMNS, np.random.default_rng(0))
    legs = walk_blocks(world, *walkers())["body"]
    assert legs.side is not None
    np.testing.assert_array_equal(legs.side, np.sign(legs.posture[:, :, 0]))


def walkers() -> tuple[dict[str, Walker], np.random.Generator, int, int]:
    walker = Walker(Half(), Push(0, actuators=1), np.arange(2), np.arange(1))
    return {"body": walker}, np.random.default_rng(1), LEGS, LEG_STEPS


def test_a_walk_that_is_done_does_not_step_any_more() -> None:
    world = world_of()
    walk = walk_of(world)
    assert walk.advance(1000)
    assert walk.advance(1000)
    assert world.steps == walk.steps == LEGS * LEG_STEPS


def test_of_an_attempt_that_broke_down_nothing_is_left() -> None:
    world, breakdowns = world_of(fails_every=25), Breakdowns("Episodic")
    world.steps = 18  # seven steps before the breakdown
    walk = walk_of(world, traced=True, breakdowns=breakdowns)
    while not walk.advance(1):
        pass
    assert walk.steps == 7 + LEGS * LEG_STEPS
    assert (breakdowns.episodes, breakdowns.segments) == (1, 1)
    assert "episodes lost: 1" in breakdowns.sentence
    assert len(walk.path.posture) == 1 + LEGS * LEG_STEPS
    assert np.isfinite(walk.path.posture).all()
    assert np.isfinite(walk.legs()["body"].latent).all()


def test_a_world_that_always_breaks_down_is_given_up() -> None:
    walker = Walker(Half(), Push(0, actuators=1), np.arange(2), np.arange(1))
    with pytest.raises(UnstableError, match="Episodic broke down 20 times in a row"):
        walk_blocks(world_of(fails_every=4), {"body": walker}, np.random.default_rng(0), LEGS, LEG_STEPS)


def test_a_column_whose_episode_ends_goes_on_from_the_start_towards_the_same_vertex() -> None:
    world = world_of(limit_steps=4)
    walk = walk_of(world)
    walk.advance(LEGS * LEG_STEPS)
    legs = walk.legs()["body"]
    towards = 1.0 - 2.0 * legs.goal
    ends = [0.2, 0.4, 0.2]  # steps since the episode began: 6 = 4 + 2, 12 = 8 + 4, 18 = 16 + 2
    np.testing.assert_allclose(legs.posture[:, :, 0], np.array(ends)[:, None] * towards, atol=1e-6)
