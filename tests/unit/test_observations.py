"""How observations are packed and unpacked, and what a block with a slice of them senses."""

import numpy as np
import pytest

from babble.observations import Layout, part_of

SENSES = {"joints": (3,), "eyes": (2, 4, 5, 3), "touch": (2, 2), "wide": (1, 2, 2, 3)}
SIZE = 3 + 120 + 4 + 12


def observed(*leading):
    """Observations (..., n) of SENSES."""
    rng = np.random.default_rng(0)
    observation = rng.standard_normal((*leading, SIZE)).astype(np.float32)
    for place in (slice(3, 123), slice(127, 139)):
        observation[..., place] = rng.integers(0, 256, observation[..., place].shape)
    return observation


def test_each_sense_lies_after_the_one_before():
    layout = Layout(SENSES)
    assert layout.size == SIZE
    assert {name: (s.start, s.stop) for name, s in layout.slices.items()} == {
        "joints": (0, 3),
        "eyes": (3, 123),
        "touch": (123, 127),
        "wide": (127, 139),
    }


@pytest.mark.parametrize("leading", [(), (6,), (4, 6)])
def test_what_was_packed_is_unpacked(leading):
    layout, observation = Layout(SENSES), observed(*leading)
    packed = layout.pack(observation)
    assert {part: (a.shape, a.dtype.str) for part, a in packed.items()} == {
        "observation": ((*leading, 7), "<f4"),
        "image": ((*leading, 132), "|u1"),
    }
    assert sum(a.nbytes for a in packed.values()) == layout.packed_bytes * int(np.prod(leading))
    unpacked = layout.unpack(packed)
    assert unpacked.dtype == np.float32
    np.testing.assert_array_equal(unpacked, observation)


@pytest.mark.parametrize(
    ("senses", "part"), [({"joints": (3,), "touch": (2,)}, "observation"), ({"eyes": (1, 2, 2, 3)}, "image")]
)
def test_a_part_that_would_hold_nothing_is_left_out(senses, part):
    layout = Layout(senses)
    observation = np.arange(4 * layout.size, dtype=np.float32).reshape(4, -1)
    packed = layout.pack(observation)
    assert list(packed) == [part]
    np.testing.assert_array_equal(layout.unpack(packed), observation)


@pytest.mark.parametrize("value", [-1.0, 256.0, 0.5, np.nan, np.inf])
def test_images_that_are_no_bytes_are_refused_rather_than_wrapped(value):
    observation = observed(2)
    observation[1, 50] = value
    with pytest.raises(ValueError, match="whole numbers from 0 to 255"):
        Layout(SENSES).pack(observation)


def test_observations_and_parts_of_other_senses_are_refused():
    layout = Layout(SENSES)
    with pytest.raises(ValueError, match=r"has 139 numbers here, got shape \(2, 138\)"):
        layout.pack(np.zeros((2, 138), np.float32))
    packed = layout.pack(observed(2))
    for wrong in (
        {"observation": packed["observation"]},
        packed | {"image": packed["image"][:, 1:]},
        packed | {"surprise": packed["image"]},
    ):
        with pytest.raises(ValueError, match="packed as observation of 7, image of 132, got"):
            layout.unpack(wrong)


@pytest.mark.parametrize("senses", [{}, {"joints": ()}, {"joints": (0,)}, {"eyes": (2, 0, 4, 3)}])
def test_senses_of_nothing_are_refused(senses):
    with pytest.raises(ValueError, match="senses of one number or more"):
        Layout(senses)


@pytest.mark.parametrize(
    ("indices", "expected"),
    [
        (range(SIZE), SENSES),
        ([2, 0], {"joints": (2,)}),
        ([124], {"touch": (1,)}),
        ([1, *range(3, 123)], {"joints": (1,), "eyes": (2, 4, 5, 3)}),
        ([*range(123, 127), 0, 1, 2], {"touch": (2, 2), "joints": (3,)}),
        (range(127, 139), {"wide": (1, 2, 2, 3)}),
    ],
)
def test_a_block_senses_what_it_observes(indices, expected):
    part = part_of(SENSES, list(indices))
    assert part == expected
    assert list(part) == list(expected)
    observation = observed(5)[:, list(indices)]
    np.testing.assert_array_equal(Layout(part).unpack(Layout(part).pack(observation)), observation)


@pytest.mark.parametrize(
    ("indices", "words"),
    [
        (range(3, 100), "images whole: list all of 3 to 122 in order for 'eyes'"),
        (range(122, 2, -1), "images whole"),
        ([0, 124, 1], "one after the other, but 'joints' comes twice"),
        ([*range(3, 123), 3], "images whole"),
        ([], "some of 0 to 138, got none"),
        ([0, 139], "some of 0 to 138, got 0 to 139"),
    ],
)
def test_a_block_that_mixes_senses_or_cuts_images_is_refused(indices, words):
    with pytest.raises(ValueError, match=words):
        part_of(SENSES, list(indices))
