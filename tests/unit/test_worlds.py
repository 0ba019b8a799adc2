import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env as gymnasium_check
from stable_baselines3.common.env_checker import check_env as sb3_check

from babble.worlds import WORLDS, WorldError, make
from babble.worlds.geometry import CuboidBody, DumbbellBody, EllipsoidBody
from babble.worlds.shapes import Cuboid, Dumbbell, Ellipsoid

SHAPES = ("Cuboid", "Ellipsoid", "Dumbbell")
BODIES = [
    CuboidBody((1.0, 0.6, 0.3)),
    EllipsoidBody((1.0, 0.6, 0.3)),
    EllipsoidBody((1.0, 1.0, 0.05)),
    DumbbellBody(0.9, 0.5, 0.15),
]


@pytest.mark.parametrize("body", BODIES, ids=str)
@pytest.mark.parametrize("reach", [0.05, 1.0, 30.0])
def test_a_wall_puts_a_point_at_the_nearest_place_inside(body, reach):
    """No point of the body is nearer than the one found, however far outside the point was."""
    rng = np.random.default_rng(0)
    points = body.uniform(200, rng) + rng.standard_normal((200, 3)) * reach
    found = body.nearest(points)
    distance = np.linalg.norm(points - found, axis=1)
    for some in np.split(body.uniform(20_000, rng), 20):
        others = np.linalg.norm(points[:, None] - some[None], axis=2)
        assert (distance[:, None] <= others + 1e-9).all()
    np.testing.assert_allclose(body.nearest(found), found, atol=1e-9)


def test_points_inside_stay():
    for body in BODIES:
        inside = body.uniform(1000, np.random.default_rng(1))
        np.testing.assert_array_equal(body.nearest(inside), inside)


def test_the_ellipsoids_wall_is_the_foot_of_the_normal_not_a_radial_scaling():
    axes = np.array([1.0, 0.6, 0.3])
    rng = np.random.default_rng(2)
    points = rng.standard_normal((500, 3)) * 2
    points = points[((points / axes) ** 2).sum(axis=1) > 1.01]
    found = EllipsoidBody((1.0, 0.6, 0.3)).nearest(points)
    np.testing.assert_allclose(((found / axes) ** 2).sum(axis=1), 1, atol=1e-9)
    normal = found / axes**2
    np.testing.assert_allclose(np.cross(normal, points - found), 0, atol=1e-8)
    assert ((normal * (points - found)).sum(axis=1) > 0).all()


def test_a_tilted_push_slides_along_the_ellipsoid_to_near_its_pole():
    world = make("Ellipsoid", {}, 1, 0)
    world.reset()
    for _ in range(200):
        world.step(np.array([[1.0, 0.3, 0.3]], dtype=np.float32))
    assert world.posture()[0, 0] > 0.95


def test_the_bridge_is_the_only_way_across():
    world = make("Dumbbell", {}, 2, 0)
    world.reset()
    ahead = np.array([[1.0, 0.0, 0.0], [1.0, 1.0, 0.0]], dtype=np.float32)
    for _ in range(60):
        world.step(ahead)
    for _ in range(60):
        world.step(-ahead)
    through, stuck = world.posture()[:, 0]
    assert through < -1.3
    assert stuck > 0


@pytest.mark.parametrize(
    ("id", "parameters", "diameter"),
    [
        ("Cuboid", {}, 2.408319),
        ("Ellipsoid", {}, 2.0),
        ("Dumbbell", {}, 2.8),
        ("Cuboid", {"half_sizes": [3, 4, 12]}, 26.0),
        ("Ellipsoid", {"semi_axes": (1, 2.5, 1)}, 5.0),
    ],
)
def test_the_diameter_is_the_greatest_distance_in_the_body(id, parameters, diameter):
    world = make(id, parameters, 4, 0)
    assert world.diameter == pytest.approx(diameter, abs=1e-5)
    points = world.uniform_points(2000, np.random.default_rng(0))
    widest = np.linalg.norm(points[:, None] - points[None], axis=2).max()
    assert 0.85 * diameter < widest <= diameter + 1e-6


@pytest.mark.parametrize("id", SHAPES)
def test_uniform_points_fill_the_body_evenly(id):
    points = make(id, {}, 1, 0).uniform_points(20_000, np.random.default_rng(3))
    assert points.shape == (20_000, 3)
    assert np.abs(points.mean(axis=0)).max() < 0.02
    share = (np.abs(points[:, 0]) < 0.5).mean()
    expected = {"Cuboid": 0.5, "Ellipsoid": 0.5 * (1.5 - 0.125), "Dumbbell": 0.0791}[id]
    assert share == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize("shape", [Cuboid, Ellipsoid, Dumbbell])
def test_the_environment_passes_both_checkers(shape):
    gymnasium_check(shape(), skip_render_check=True)
    sb3_check(shape())


@pytest.mark.parametrize("id", SHAPES)
def test_the_registered_environment_moves_as_the_batch_does(id):
    env = gymnasium.make(WORLDS[id].gymnasium_id, disable_env_checker=True)
    world = make(id, {}, 5, 0)
    seen, _ = env.reset(seed=0)
    together = world.reset()
    rng = np.random.default_rng(4)
    for _ in range(60):
        np.testing.assert_array_equal(together, np.tile(seen, (5, 1)))
        assert env.observation_space.contains(seen)
        action = rng.uniform(-1.5, 1.5, 3).astype(np.float32)
        seen, reward, terminated, truncated, _ = env.step(action)
        step = world.step(np.tile(action, (5, 1)))
        together = step.observation
        assert (reward, terminated, truncated) == (0.0, False, False)
        assert not step.terminated.any()
        assert not step.truncated.any()
        assert not step.external_reward.any()


def test_actions_are_bounded_by_the_speed():
    world = make("Cuboid", {"speed": 0.1}, 2, 0)
    world.reset()
    world.step(np.array([[9.0, -9.0, 0.5], [0, 0, 0]], dtype=np.float32))
    np.testing.assert_allclose(world.posture(), [[0.1, -0.1, 0.05], [0, 0, 0]], atol=1e-7)


def test_random_starts_differ_and_follow_the_seed():
    first, again, other = (make("Dumbbell", {}, 8, seed).reset("random") for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()
    assert len(np.unique(first, axis=0)) == 8
    env = Cuboid()
    one, _ = env.reset(seed=3, options={"start": "random"})
    two, _ = env.reset(seed=3, options={"start": "random"})
    np.testing.assert_array_equal(one, two)
    assert one.any()
    assert not env.reset()[0].any()


@pytest.mark.parametrize(
    ("id", "parameters", "words"),
    [
        ("Sphere", {}, "there is no world 'Sphere'; the worlds are Cuboid, Ellipsoid, Dumbbell"),
        ("Cuboid", {"size": 1}, "Cuboid has no parameter 'size'; its parameters are half_sizes, speed"),
        ("Cuboid", {"half_sizes": [1, 2]}, "half_sizes must be three positive numbers"),
        ("Cuboid", {"half_sizes": [1, -2, 1]}, "half_sizes must be a positive number, got -2"),
        ("Ellipsoid", {"semi_axes": "abc"}, "semi_axes must be three positive numbers"),
        ("Ellipsoid", {"speed": float("nan")}, "speed must be a positive number"),
        ("Cuboid", {"speed": True}, "speed must be a positive number"),
        ("Dumbbell", {"bridge_radius": 0.6}, "bridge_radius < lobe_radius < lobe_centre"),
    ],
)
def test_a_world_that_cannot_be_is_refused_in_one_sentence(id, parameters, words):
    with pytest.raises(WorldError) as caught:
        make(id, parameters, 1, 0)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("action", [np.zeros((3, 3)), np.full((2, 3), np.nan), np.zeros((2, 2))])
def test_a_wrong_action_moves_nothing(action):
    world = make("Cuboid", {}, 2, 0)
    before = world.reset("random")
    with pytest.raises(ValueError, match=r"finite numbers of shape \(2, 3\)"):
        world.step(action.astype(np.float32))
    np.testing.assert_array_equal(world.posture(), before)


def test_defaults_are_listed_for_people():
    assert WORLDS["Dumbbell"].defaults == {
        "lobe_centre": 0.9,
        "lobe_radius": 0.5,
        "bridge_radius": 0.15,
        "speed": 0.08,
    }
