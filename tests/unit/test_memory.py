"""What the memory holds, and which pairs it draws: streams stay apart, images stay bytes."""

import tracemalloc

import numpy as np
import pytest

from babble.memory import ExperienceMemory, bytes_per_step
from babble.observations import Layout

EYES = {"joints": (2,), "eyes": (2, 4, 5, 3), "touch": (3,)}


def vectors(size):
    """A memory of one sense, a vector."""
    return ExperienceMemory({"sense": (size,)})


def extend(memory, source, observation, episode):
    """Add flat observations (T, E, n)."""
    memory.extend(source, memory.layout.pack(np.asarray(observation, np.float32)), np.asarray(episode))


def seen(rng, steps, columns):
    """Flat observations of EYES."""
    observation = rng.standard_normal((steps, columns, 125)).astype(np.float32)
    observation[:, :, 2:122] = rng.integers(0, 256, (steps, columns, 120))
    return observation


def lived(rng, steps, columns, source_number):
    """Observations that name their source, column, episode and time, with episodes of random length."""
    episode = (rng.random((steps, columns)) < 0.1).cumsum(axis=0)
    time = np.broadcast_to(np.arange(steps)[:, None], (steps, columns))
    column = np.broadcast_to(np.arange(columns), (steps, columns))
    source = np.full((steps, columns), source_number)
    return np.stack([source, column, episode, time], axis=2).astype(np.float32), episode


def test_pairs_lie_within_the_window_of_one_episode_of_one_stream():
    rng = np.random.default_rng(0)
    memory = vectors(4)
    for number, source in enumerate(("a", "b")):
        observation, episode = lived(rng, 90, 3, number)
        for part in range(0, 90, 30):
            extend(memory, source, observation[part : part + 30], episode[part : part + 30])
    assert memory.steps == 2 * 90 * 3
    anchor, positive = memory.sample_pairs(rng, 20_000, 5)
    np.testing.assert_array_equal(anchor[:, :3], positive[:, :3])
    offset = positive[:, 3] - anchor[:, 3]
    assert set(offset) == {1, 2, 3, 4, 5}
    border = (anchor[:, 3] < 30) & (positive[:, 3] >= 30)
    assert border.any(), "a stream goes on from one segment to the next"
    assert {tuple(row) for row in np.unique(anchor[:, :2], axis=0)} == {
        (s, c) for s in (0, 1) for c in (0, 1, 2)
    }


def test_offsets_are_uniform_and_anchors_without_room_are_not_used():
    memory = vectors(1)
    time = np.arange(12, dtype=np.float32).reshape(12, 1, 1)
    extend(memory, "a", time, np.zeros((12, 1)))
    anchor, positive = memory.sample_pairs(np.random.default_rng(0), 40_000, 8)
    offset = (positive - anchor).ravel().astype(int)
    shares = np.bincount(offset, minlength=9)[1:] / len(offset)
    np.testing.assert_allclose(shares, 1 / 8, atol=0.01)
    for k in (1, 8):
        starts = anchor.ravel()[offset == k]
        np.testing.assert_allclose(np.bincount(starts.astype(int)) / len(starts), 1 / (12 - k), atol=0.02)


def test_an_episode_number_used_again_later_is_another_episode():
    memory = vectors(1)
    observation = np.arange(6, dtype=np.float32).reshape(6, 1, 1)
    extend(memory, "a", observation, np.array([0, 0, 1, 1, 0, 0]).reshape(6, 1))
    anchor, positive = memory.sample_pairs(np.random.default_rng(0), 200, 5)
    assert {(a, p) for a, p in zip(anchor.ravel(), positive.ravel(), strict=True)} == {(0, 1), (2, 3), (4, 5)}


def test_noise_about_nothing_is_not_blown_up():
    memory = ExperienceMemory({"still": (3,), "moving": (1,)})
    rng = np.random.default_rng(0)
    observation = np.concatenate(
        [1e-17 * rng.standard_normal((50, 2, 3)), rng.normal(size=(50, 2, 1))], axis=2
    )
    extend(memory, "a", observation, np.zeros((50, 2)))
    scale = memory.scaling()[1]
    np.testing.assert_array_equal(scale[:3], 1.0)
    assert scale[3] == pytest.approx(1.0, abs=0.2)
    assert scale[3] != 1.0


def test_nothing_to_pair_is_said():
    memory = vectors(2)
    with pytest.raises(ValueError, match="empty"):
        memory.sample_pairs(np.random.default_rng(0), 2, 3)
    extend(memory, "a", np.zeros((1, 4, 2)), np.zeros((1, 4)))
    with pytest.raises(ValueError, match="no episode in the experience memory has two steps"):
        memory.sample_pairs(np.random.default_rng(0), 2, 3)


def test_scaling_is_the_mean_and_one_scale_for_all_numbers_of_a_sense():
    memory, rng = vectors(3), np.random.default_rng(0)
    values = rng.standard_normal((4000, 2, 3)) * [3.0, 0.0, 4.0] + [1.0, 2.0, 3.0]
    extend(memory, "a", values[:1000], np.zeros((1000, 2)))
    extend(memory, "b", values[1000:], np.zeros((3000, 2)))
    mean, scale = memory.scaling()
    np.testing.assert_allclose(mean, [1, 2, 3], atol=0.15)
    np.testing.assert_allclose(scale, np.sqrt(25 / 3), rtol=0.02)
    assert len(set(scale)) == 1


def test_each_sense_comes_in_with_the_same_variance():
    memory, rng = ExperienceMemory(EYES), np.random.default_rng(0)
    observation = seen(rng, 400, 3)
    observation[:, :, :2] = 1e-3 * observation[:, :, :2] + 5
    observation[:, :, 122:] *= 1e4
    extend(memory, "a", observation[:150], np.zeros((150, 3)))
    extend(memory, "a", observation[150:], np.zeros((250, 3)))
    mean, scale = memory.scaling()
    flat = observation.reshape(-1, 125)
    np.testing.assert_allclose(mean, flat.mean(axis=0, dtype=np.float64), rtol=1e-5)
    standardised = (flat - mean) / scale
    for place in memory.layout.slices.values():
        assert np.square(standardised[:, place]).mean() == pytest.approx(1, rel=1e-4)
        assert len(set(scale[place])) == 1


@pytest.mark.parametrize("value", [7.0, 0.1, 9.81, 0.0])
def test_a_sense_that_never_changed_is_scaled_by_one(value):
    memory = ExperienceMemory({"still": (2,), "moving": (2,)})
    observation = np.full((50, 3, 4), value)
    observation[:, :, 2:] += np.random.default_rng(0).standard_normal((50, 3, 2))
    extend(memory, "a", observation, np.zeros((50, 3)))
    scale = memory.scaling()[1]
    assert scale[:2].tolist() == [1, 1]
    assert 0.5 < scale[2] < 1.5


def test_images_are_held_as_bytes_and_drawn_as_the_observations_they_were():
    memory, rng = ExperienceMemory(EYES), np.random.default_rng(0)
    observation = seen(rng, 60, 2)
    observation[:, :, 0] = np.arange(60)[:, None]
    observation[:, :, 1] = np.arange(2)
    for part in range(0, 60, 20):
        extend(memory, "a", observation[part : part + 20], np.zeros((20, 2)))
    anchor, positive = memory.sample_pairs(rng, 500, 3)
    assert anchor.dtype == positive.dtype == np.float32
    for drawn in (anchor, positive):
        np.testing.assert_array_equal(drawn, observation[drawn[:, 0].astype(int), drawn[:, 1].astype(int)])


def test_the_memory_takes_what_it_says_and_no_more_when_it_is_used(monkeypatch):
    monkeypatch.setattr("babble.memory.AT_ONCE", 1 << 18)
    layout = Layout({"joints": (4,), "eyes": (2, 24, 24, 3)})
    image = np.random.default_rng(0).integers(0, 256, (20, 8, layout.parts["image"]), np.uint8)
    parts = {"observation": np.zeros((20, 8, 4), np.float32), "image": image}
    tracemalloc.start()
    memory = ExperienceMemory(layout.senses)
    for _ in range(64):
        memory.extend("a", parts, np.zeros((20, 8), np.int32))
    collected, _ = tracemalloc.get_traced_memory()
    memory.sample_pairs(np.random.default_rng(0), 8, 5)
    settled, _ = tracemalloc.get_traced_memory()
    tracemalloc.reset_peak()
    memory.scaling()
    _, scaled = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    said = memory.steps * bytes_per_step(layout)
    assert said == 64 * 160 * (4 * 4 + 3456 + 4)
    assert max(collected, settled) < 1.05 * said
    assert scaled < 1.3 * said


def test_a_restored_memory_draws_the_same_pairs():
    rng = np.random.default_rng(0)
    memory = vectors(4)
    for source in ("life/1", "life-2"):
        for _ in range(2):
            extend(memory, source, *lived(rng, 20, 2, 0))
    copy = vectors(4)
    extend(copy, "other", np.ones((3, 1, 4)), np.zeros((3, 1)))
    copy.restore(memory.state())
    assert copy.steps == memory.steps
    drawn = [held.sample_pairs(np.random.default_rng(1), 64, 4) for held in (memory, copy)]
    np.testing.assert_array_equal(drawn[0], drawn[1])
    memory.clear()
    assert (memory.steps, copy.steps) == (0, 160)


def test_experience_with_images_is_restored_and_goes_on():
    rng, memory = np.random.default_rng(0), ExperienceMemory(EYES)
    observation = seen(rng, 40, 2)
    extend(memory, "a/0", observation[:15], np.zeros((15, 2)))
    extend(memory, "b", observation[20:], np.zeros((20, 2)))
    copy = ExperienceMemory(EYES)
    copy.restore({name: array.copy() for name, array in memory.state().items()})
    for held in (memory, copy):
        extend(held, "a/0", observation[15:20], np.zeros((5, 2)))
    drawn = [held.sample_pairs(np.random.default_rng(1), 64, 4) for held in (memory, copy)]
    np.testing.assert_array_equal(drawn[0], drawn[1])
    assert memory.state()["image/a/0"].shape == (20, 2, 120)


def test_experience_that_does_not_fit_is_refused():
    memory = ExperienceMemory(EYES)
    fitting = memory.layout.pack(seen(np.random.default_rng(0), 2, 3))
    memory.extend("a", fitting, np.zeros((2, 3)))
    fewer = {part: array[:, :2] for part, array in fitting.items()}
    not_a_number = fitting | {"observation": np.full((2, 3, 5), np.nan, np.float32)}
    for source, parts, episode, words in (
        ("a", fewer, np.zeros((2, 2)), "a sent 3 columns before and now 2"),
        ("b", {"observation": fitting["observation"]}, np.zeros((2, 3)), "of b: these senses are packed as"),
        ("b", fitting | {"image": fitting["image"][..., :7]}, np.zeros((2, 3)), "image of 120, got .* of 7"),
        ("b", fitting | {"image": fitting["image"] * 1.0}, np.zeros((2, 3)), "images are uint8, got float64"),
        ("b", fitting, np.zeros((2, 2)), r"must be \(T, E, n\)"),
        ("b", fitting, np.zeros(6), r"must be \(T, E, n\)"),
        ("b", not_a_number, np.zeros((2, 3)), "b sent observations that are not finite"),
    ):
        with pytest.raises(ValueError, match=words):
            memory.extend(source, parts, episode)
    assert memory.steps == 6


def test_the_memory_keeps_what_it_was_given_when_the_frame_is_reused():
    memory = vectors(1)
    frame = np.zeros((2, 1, 1), np.float32)
    memory.extend("a", {"observation": frame}, np.zeros((2, 1)))
    frame += 1
    assert memory.scaling()[0] == 0
