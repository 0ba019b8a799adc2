import numpy as np
import pytest

from babble.memory import ExperienceMemory
from babble.segments import SegmentBuilder


def step(i, columns=2):
    return {"observation": np.full((columns, 3), i, np.float32), "episode": np.zeros(columns, np.int32)}


def test_every_so_many_steps_make_a_segment_in_order():
    builder = SegmentBuilder(4, 2)
    finished = [builder.add(**step(i)) for i in range(10)]
    assert [i for i, segment in enumerate(finished) if segment] == [3, 7]
    assert finished[7]["observation"].shape == (4, 2, 3)
    assert finished[7]["observation"][:, 0, 0].tolist() == [4, 5, 6, 7]
    assert finished[3]["observation"][:, 0, 0].tolist() == [0, 1, 2, 3]
    assert finished[3]["episode"].dtype == np.int32
    assert len(builder) == 2


def test_a_segment_keeps_what_it_was_given_when_the_caller_reuses_its_array():
    builder = SegmentBuilder(2, 1)
    array = np.zeros((1, 1))
    builder.add(x=array)
    array += 1
    assert builder.add(x=array)["x"].ravel().tolist() == [0, 1]


def test_discarding_starts_afresh():
    builder = SegmentBuilder(2, 2)
    builder.add(**step(0))
    builder.discard()
    assert builder.add(**step(1)) is None
    assert builder.add(**step(2))["observation"][:, 0, 0].tolist() == [1, 2]


@pytest.mark.parametrize(
    "wrong",
    [
        {"observation": np.zeros((2, 3), np.float32)},
        {**step(0), "extra": np.zeros(2)},
        {"observation": np.zeros((2, 4), np.float32), "episode": np.zeros(2, np.int32)},
        {"observation": np.zeros((2, 3)), "episode": np.zeros(2, np.int32)},
        step(0, columns=3),
    ],
    ids=["missing", "extra", "size", "dtype", "columns"],
)
def test_a_step_that_does_not_fit_is_refused_and_changes_nothing(wrong):
    builder = SegmentBuilder(2, 2)
    builder.add(**step(0))
    with pytest.raises(ValueError, match="does not fit a segment of"):
        builder.add(**wrong)
    assert builder.add(**step(1))["observation"][:, 0, 0].tolist() == [0, 1]


def test_the_first_step_must_have_the_columns():
    with pytest.raises(ValueError, match="observation must have 2 columns"):
        SegmentBuilder(2, 2).add(**step(0, columns=3))


def lived(rng, steps, columns, source_number):
    """Observations that name their source, column, episode and time, with episodes of random length."""
    episode = (rng.random((steps, columns)) < 0.1).cumsum(axis=0)
    time = np.broadcast_to(np.arange(steps)[:, None], (steps, columns))
    column = np.broadcast_to(np.arange(columns), (steps, columns))
    source = np.full((steps, columns), source_number)
    return np.stack([source, column, episode, time], axis=2).astype(np.float32), episode


def test_pairs_lie_within_the_window_of_one_episode_of_one_stream():
    rng = np.random.default_rng(0)
    memory = ExperienceMemory()
    for number, source in enumerate(("a", "b")):
        observation, episode = lived(rng, 90, 3, number)
        for part in range(0, 90, 30):
            memory.extend(source, observation[part : part + 30], episode[part : part + 30])
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
    memory = ExperienceMemory()
    time = np.arange(12, dtype=np.float32).reshape(12, 1, 1)
    memory.extend("a", time, np.zeros((12, 1)))
    anchor, positive = memory.sample_pairs(np.random.default_rng(0), 40_000, 8)
    offset = (positive - anchor).ravel().astype(int)
    shares = np.bincount(offset, minlength=9)[1:] / len(offset)
    np.testing.assert_allclose(shares, 1 / 8, atol=0.01)
    for k in (1, 8):
        starts = anchor.ravel()[offset == k]
        np.testing.assert_allclose(np.bincount(starts.astype(int)) / len(starts), 1 / (12 - k), atol=0.02)


def test_an_episode_number_used_again_later_is_another_episode():
    memory = ExperienceMemory()
    observation = np.arange(6, dtype=np.float32).reshape(6, 1, 1)
    memory.extend("a", observation, np.array([0, 0, 1, 1, 0, 0]).reshape(6, 1))
    anchor, positive = memory.sample_pairs(np.random.default_rng(0), 200, 5)
    assert {(a, p) for a, p in zip(anchor.ravel(), positive.ravel(), strict=True)} == {(0, 1), (2, 3), (4, 5)}


def test_nothing_to_pair_is_said():
    memory = ExperienceMemory()
    with pytest.raises(ValueError, match="empty"):
        memory.sample_pairs(np.random.default_rng(0), 2, 3)
    memory.extend("a", np.zeros((1, 4, 2)), np.zeros((1, 4)))
    with pytest.raises(ValueError, match="no episode in the experience memory has two steps"):
        memory.sample_pairs(np.random.default_rng(0), 2, 3)


def test_scaling_is_the_mean_and_one_scale_for_all():
    memory = ExperienceMemory()
    rng = np.random.default_rng(0)
    values = rng.standard_normal((4000, 2, 3)) * [3.0, 0.0, 4.0] + [1.0, 2.0, 3.0]
    memory.extend("a", values[:1000], np.zeros((1000, 2)))
    memory.extend("b", values[1000:], np.zeros((3000, 2)))
    mean, scale = memory.scaling()
    np.testing.assert_allclose(mean, [1, 2, 3], atol=0.15)
    assert scale == pytest.approx(np.sqrt(25 / 3), rel=0.02)


def test_a_body_that_never_moved_is_scaled_by_one():
    memory = ExperienceMemory()
    memory.extend("a", np.full((5, 1, 2), 7.0), np.zeros((5, 1)))
    assert memory.scaling()[1] == 1.0


def test_a_restored_memory_draws_the_same_pairs():
    rng = np.random.default_rng(0)
    memory = ExperienceMemory()
    for source in ("life/1", "life-2"):
        for _ in range(2):
            memory.extend(source, *lived(rng, 20, 2, 0))
    copy = ExperienceMemory()
    copy.extend("other", np.ones((3, 1, 9)), np.zeros((3, 1)))
    copy.restore(memory.state())
    assert copy.steps == memory.steps
    drawn = [held.sample_pairs(np.random.default_rng(1), 64, 4) for held in (memory, copy)]
    np.testing.assert_array_equal(drawn[0], drawn[1])
    memory.clear()
    assert (memory.steps, copy.steps) == (0, 160)


def test_experience_that_does_not_fit_is_refused():
    memory = ExperienceMemory()
    memory.extend("a", np.zeros((2, 3, 4)), np.zeros((2, 3)))
    for source, observation, episode, words in (
        ("a", np.zeros((2, 2, 4)), np.zeros((2, 2)), r"a sent \(columns, size\) \(3, 4\) before"),
        ("b", np.zeros((2, 3, 5)), np.zeros((2, 3)), "size 4 are held, b sent 5"),
        ("b", np.zeros((2, 3, 4)), np.zeros((2, 2)), r"must be \(T, E, n\)"),
        ("b", np.full((2, 3, 4), np.nan), np.zeros((2, 3)), "b sent observations that are not finite"),
    ):
        with pytest.raises(ValueError, match=words):
            memory.extend(source, observation, episode)
    assert memory.steps == 6


def test_the_memory_keeps_what_it_was_given_when_the_frame_is_reused():
    memory = ExperienceMemory()
    frame = np.zeros((2, 1, 1), np.float32)
    memory.extend("a", frame, np.zeros((2, 1)))
    frame += 1
    assert memory.scaling()[0] == 0
