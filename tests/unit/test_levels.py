"""A level of the tree as a world: latents of the limbs in, goals of the limbs out."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from babble.blocks import BlockError, BlockSpec, BlockTree
from babble.legs import Seen, Walk, Walker, Witness
from babble.levels import BlockModels, LevelWorld, stage_of
from babble.limbs import goal_of
from babble.policy.goals import RandomGoals
from babble.worlds import make
from babble.worlds.batch import Step
from tests.simulated.episodic import EpisodicWorld

COLUMNS = 4
LEAVES = [
    BlockSpec("x", 2, observes=(0,), drives=(0,)),
    BlockSpec("y", 2, observes=(1,), drives=(1,)),
    BlockSpec("z", 2, observes=(2,), drives=(2,)),
]
TWO_LEVELS = BlockTree([*LEAVES, BlockSpec("body", 2, children=("x", "y", "z"))], 3, 3)
THREE_LEVELS = BlockTree(
    [*LEAVES, BlockSpec("plane", 2, children=("x", "y")), BlockSpec("body", 2, children=("z", "plane"))], 3, 3
)


class Place:
    """An encoder of one number: z_0 tells where it is, from -1 to 1; counts how often it is asked."""

    latent_dim = 2

    def __init__(self) -> None:
        self.asked = 0

    def latent(self, observation: np.ndarray) -> np.ndarray:
        self.asked += 1
        first = (observation[:, :1] + 1) / 2
        return np.concatenate([first, 1 - first], axis=1).astype(np.float32)


class Towards:
    """A policy that goes up for goal 0 and down for goal 1, in all its actions or goals."""

    def __init__(self, actions: int) -> None:
        self.actions = actions
        self.asked = 0

    def act(self, z: Any, g: Any, rng: Any, mode: str = "sampled") -> tuple[np.ndarray, np.ndarray]:
        self.asked += 1
        sign = g[:, :1] - g[:, 1:]
        action = np.tile(np.concatenate([sign, -sign], axis=1), self.actions)[:, : self.actions]
        return action.astype(np.float32), np.zeros(len(z), np.float32)


def models_of(**actions: int) -> dict[str, BlockModels]:
    return {block: BlockModels(Place(), Towards(count)) for block, count in actions.items()}  # type: ignore[arg-type]


def leaves() -> dict[str, BlockModels]:
    return models_of(x=1, y=1, z=1)


def box() -> Any:
    return make("Cuboid", {"half_sizes": [1.0, 1.0, 1.0], "speed": 0.02}, COLUMNS, 0)


def up(columns: int = COLUMNS, limbs: int = 3) -> np.ndarray:
    """An action that aims all limbs at their goal 0."""
    return np.tile(np.array([1, -1], np.float32), (columns, limbs))


def test_limbs_go_where_the_action_sends_them_for_as_long_as_it_is_held() -> None:
    stage = stage_of(box(), TWO_LEVELS, 1, leaves(), decision_steps=(1, 10))
    stage.world.reset()
    action = up()
    action[:, 2:4] = [-0.3, 0.1]
    step = stage.world.step(action)
    assert stage.env_steps_per_step == 10
    np.testing.assert_allclose(stage.world.posture(), [[0.2, -0.2, 0.2]] * COLUMNS, atol=1e-6)
    expected = [0.6, 0.4, 0.4, 0.6, 0.6, 0.4]
    np.testing.assert_allclose(step.observation, [expected] * COLUMNS, atol=1e-6)


def test_a_step_may_be_shorter_than_what_an_action_is_held_for() -> None:
    stage = stage_of(box(), TWO_LEVELS, 1, leaves(), decision_steps=(1, 10), steps_per_action=1)
    stage.world.reset()
    stage.world.step(up())
    np.testing.assert_allclose(stage.world.posture(), [[0.02, 0.02, 0.02]] * COLUMNS, atol=1e-6)


def test_blocks_of_the_middle_decide_anew_only_after_their_own_steps() -> None:
    models = {**leaves(), **models_of(plane=4)}
    stage = stage_of(box(), THREE_LEVELS, 2, models, decision_steps=(1, 5, 20))
    assert list(stage.observed) == ["body"]
    stage.world.reset()
    action = up(limbs=2)
    action[:, 2:] = [-1, 1]
    stage.world.step(action)
    # The plane's policy answers its goal 1 with [-1, 1] for both children.
    np.testing.assert_allclose(stage.world.posture(), [[-0.4, -0.4, 0.4]] * COLUMNS, atol=1e-6)
    assert models["plane"].policy.asked == 20 / 5  # type: ignore[attr-defined]
    assert models["x"].policy.asked == 20  # type: ignore[attr-defined]


def test_no_observation_is_encoded_twice() -> None:
    models = leaves()
    stage = stage_of(box(), TWO_LEVELS, 1, models, decision_steps=(1, 10))
    stage.world.reset()
    for _ in range(3):
        stage.world.step(up())
    assert models["x"].encoder.asked == 1 + 30  # type: ignore[attr-defined]


def test_the_state_of_a_level_is_that_of_its_body() -> None:
    body = box()
    stage = stage_of(body, TWO_LEVELS, 1, leaves(), decision_steps=(1, 10))
    stage.world.reset()
    stage.world.step(up())
    np.testing.assert_array_equal(stage.world.state(), body.state())
    assert np.abs(body.state()).min() > 0
    assert stage.world.state_names == ("position/x", "position/y", "position/z")


def test_what_is_not_below_the_blocks_at_work_stays_idle() -> None:
    tree = BlockTree([*LEAVES, BlockSpec("plane", 2, children=("x", "y"))], 3, 3)
    stage = stage_of(box(), tree, 1, leaves(), decision_steps=(1, 10))
    stage.world.reset()
    stage.world.step(up(limbs=2))
    np.testing.assert_allclose(stage.world.posture(), [[0.2, 0.2, 0.0]] * COLUMNS, atol=1e-6)


def test_a_level_goes_on_from_where_the_body_is() -> None:
    world = box()
    world.reset()
    observation = world.step(np.full((COLUMNS, 3), 1, np.float32)).observation
    raised = stage_of(world, TWO_LEVELS, 1, leaves(), decision_steps=(1, 10)).world
    assert isinstance(raised, LevelWorld)
    latents = raised.resume(observation)
    np.testing.assert_allclose(latents[:, 0], 0.51)
    np.testing.assert_allclose(raised.posture(), 0.02)
    np.testing.assert_array_equal(raised.body_observation, observation)


def test_people_see_the_body_at_each_environment_step_with_all_blocks_that_act() -> None:
    class Watching(Witness):
        looking = True

        def __init__(self) -> None:
            self.seen: list[tuple[float, Mapping[str, Seen | None]]] = []

        def see(self, observation: np.ndarray, seen: Mapping[str, Seen | None]) -> None:
            self.seen.append((float(observation[0, 0]), dict(seen)))

    witness = Watching()
    stage = stage_of(box(), TWO_LEVELS, 1, leaves(), decision_steps=(1, 10), witness=witness)
    latent, goal = np.zeros((COLUMNS, 2), np.float32), np.ones((COLUMNS, 2), np.float32)
    observation = stage.world.reset()
    stage.witness.see(observation, {"body": (latent, goal)})
    stage.world.step(up())
    assert [place for place, _ in witness.seen] == pytest.approx([0.02 * k for k in range(10)])
    last = witness.seen[-1][1]
    assert set(last) == {"body", "x", "y", "z"}
    assert last["x"] is not None
    assert last["x"][0][0, 0] == pytest.approx((0.18 + 1) / 2)
    np.testing.assert_array_equal(last["x"][1], [[1, 0]] * COLUMNS)
    assert last["body"] is not None
    assert last["body"][1] is goal


def test_an_episode_that_ends_within_a_step_ends_the_step_of_its_column() -> None:
    tree = BlockTree([BlockSpec("leaf", 2), BlockSpec("top", 2, children=("leaf",))], 1, 1)
    world = EpisodicWorld(3, np.random.default_rng(0), limit_steps=4)
    stage = stage_of(world, tree, 1, models_of(leaf=1), decision_steps=(1, 6))
    stage.world.reset()
    step = stage.world.step(up(3, 1))
    assert step.truncated.all()
    assert isinstance(step, Step)
    begun = stage.world.restart(step.truncated)
    assert begun.shape == (3, 2)
    assert not stage.world.step(up(3, 1)[:, :2]).terminated.any()


class OnASide(EpisodicWorld):
    """Lies on its back to the right of the middle, on its belly to the left."""

    def side(self) -> np.ndarray:
        return np.sign(self.posture()[:, 0])


@pytest.mark.parametrize("ends_after", [0, 4])
def test_the_side_is_that_at_the_end_of_the_step_or_of_its_episode(ends_after: int) -> None:
    tree = BlockTree([BlockSpec("leaf", 2), BlockSpec("top", 2, children=("leaf",))], 1, 1)
    world = OnASide(3, np.random.default_rng(0), limit_steps=ends_after)
    stage = stage_of(world, tree, 1, models_of(leaf=1), decision_steps=(1, 4))
    stage.world.reset()
    stage.world.step(up(3, 1))
    np.testing.assert_array_equal(stage.world.side(), [1, 1, 1])
    if ends_after:
        world.restart(np.ones(3, np.bool_))
        np.testing.assert_array_equal(world.side(), [0, 0, 0])
        np.testing.assert_array_equal(stage.world.side(), [1, 1, 1], "what it was before the restart")


def test_a_walk_over_a_level_takes_the_whole_tree_to_its_vertices() -> None:
    stage = stage_of(box(), TWO_LEVELS, 1, leaves(), decision_steps=(1, 10))

    class Mean:
        latent_dim = 2

        def latent(self, observation: np.ndarray) -> np.ndarray:
            first = observation[:, ::2].mean(axis=1, keepdims=True)
            return np.concatenate([first, 1 - first], axis=1).astype(np.float32)

    walker = Walker(Mean(), Towards(6), stage.observed["body"], stage.driven["body"])
    walk = Walk(stage.world, {"body": walker}, np.random.default_rng(1), 4, 15)
    assert walk.advance(60)
    legs = walk.legs()["body"]
    at_goal = np.take_along_axis(legs.latent, legs.goal[:, :, None].astype(int), axis=2)
    assert (at_goal > 0.99).all()
    assert (np.abs(legs.posture) > 0.99).all()


def test_a_missing_model_below_is_named() -> None:
    models = leaves()
    del models["y"]
    with pytest.raises(BlockError, match="block 'y' has no models to act with below body"):
        stage_of(box(), TWO_LEVELS, 1, models, decision_steps=(1, 10))


@pytest.mark.parametrize("bad", [np.zeros((COLUMNS, 5), np.float32), np.full((COLUMNS, 6), np.nan)])
def test_actions_of_another_shape_or_without_a_number_are_refused(bad: np.ndarray) -> None:
    stage = stage_of(box(), TWO_LEVELS, 1, leaves(), decision_steps=(1, 10))
    stage.world.reset()
    with pytest.raises(ValueError, match=r"finite numbers of shape \(4, 6\)"):
        stage.world.step(bad)


def test_goals_of_an_action_are_vertices_or_points_near_them() -> None:
    action = np.array([[0.2, 0.9, -3.0], [5.0, 4.0, 4.5]], np.float32)
    np.testing.assert_array_equal(goal_of(action, "one-hot"), [[0, 1, 0], [1, 0, 0]])
    soft = goal_of(action, "softmax")
    np.testing.assert_allclose(soft.sum(axis=1), 1, rtol=1e-6)
    np.testing.assert_array_equal(soft.argmax(axis=1), [1, 0])
    assert 0.8 < soft[1, 0] < 0.99


def test_random_goals_are_one_hot_held_for_their_steps_and_unsynchronised() -> None:
    steps, columns = 600, 8
    goals = RandomGoals(
        [2, 3], columns, np.random.default_rng(0), least_steps=20, most_steps=100, env_steps=5
    )
    drawn = np.stack([goals.sample() for _ in range(steps)])
    first, second = drawn[..., :2], drawn[..., 2:]
    for part in (first, second):
        np.testing.assert_array_equal(part.sum(axis=2), 1)
        assert part.mean(axis=(0, 1)) == pytest.approx(1 / part.shape[2], abs=0.12)
    changes = (np.diff(second.argmax(axis=2), axis=0) != 0)[:, 0]
    apart = np.diff(np.flatnonzero(changes)) * 5
    assert apart.min() >= 20
    both = (np.diff(first.argmax(axis=2), axis=0) != 0) & (np.diff(second.argmax(axis=2), axis=0) != 0)
    assert both.mean() < 0.03, "children change at times of their own"
