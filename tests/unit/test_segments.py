import numpy as np
import pytest

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
