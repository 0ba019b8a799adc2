"""What an observation is made of: the senses of a body, flattened and concatenated, packed for storing.

A sense whose shape has four dimensions, (eyes, height, width, 3), is a set of images: whole numbers from
0 to 255, which fit into bytes. Every other sense is a vector of float32.
"""

from collections.abc import Mapping, Sequence
from math import prod

import numpy as np
from numpy.typing import NDArray

Senses = Mapping[str, tuple[int, ...]]
"""The shape of each sense, in the order in which they make up the observation."""
Floats = NDArray[np.float32]
Parts = Mapping[str, NDArray[np.generic]]
"""A packed observation."""

VECTORS, IMAGES = "observation", "image"
"""The parts of a packed observation, by the names under which they travel (protocol/SPEC.md)."""
IMAGE_DIMENSIONS = 4


class Layout:
    """Where each sense lies in an observation (..., n), and how that is packed and unpacked.

    Raises ValueError for senses that make up no observation.
    """

    def __init__(self, senses: Senses) -> None:
        if not senses or not all(shape and min(shape) > 0 for shape in senses.values()):
            raise ValueError(f"an observation needs senses of one number or more, got {dict(senses)}")
        self.senses = dict(senses)
        self.images = {name: shape for name, shape in senses.items() if len(shape) == IMAGE_DIMENSIONS}
        self.slices: dict[str, slice] = {}
        """By sense: where it lies in the observation."""
        self.places: dict[str, tuple[str, slice]] = {}
        """By sense: in which part it is packed, and where there."""
        self.parts: dict[str, int] = {}
        """How many numbers each part of a packed observation holds; a part that holds none is left out."""
        self.size = 0
        """n"""
        for name, shape in senses.items():
            part, size = IMAGES if name in self.images else VECTORS, prod(shape)
            start = self.parts.get(part, 0)
            self.slices[name] = slice(self.size, self.size + size)
            self.places[name] = part, slice(start, start + size)
            self.size += size
            self.parts[part] = start + size

    @property
    def packed_bytes(self) -> int:
        """The memory that one packed observation takes."""
        return self.parts.get(IMAGES, 0) + 4 * self.parts.get(VECTORS, 0)

    def pack(self, observation: Floats) -> dict[str, NDArray[np.generic]]:
        """Of (..., n): the vectors as "observation", (..., v) float32, the images as "image", (..., b) uint8.

        A part that would hold nothing is left out. Raises ValueError for another size than n, and for
        images that are not whole numbers from 0 to 255.
        """
        if observation.shape[-1:] != (self.size,):
            raise ValueError(f"an observation has {self.size} numbers here, got shape {observation.shape}")
        packed: dict[str, NDArray[np.generic]] = {}
        for part in self.parts:
            pieces = [
                observation[..., self.slices[name]] for name in self.senses if self.places[name][0] == part
            ]
            numbers = pieces[0] if len(pieces) == 1 else np.concatenate(pieces, axis=-1)
            packed[part] = _as_bytes(numbers) if part == IMAGES else np.asarray(numbers, np.float32)
        return packed

    def unpack(self, parts: Parts) -> Floats:
        """The observations (..., n) that were packed. Raises ValueError for parts that `pack` never makes."""
        self.check(parts)
        if not self.images:
            return np.asarray(parts[VECTORS], np.float32)
        observation = np.empty((*parts[IMAGES].shape[:-1], self.size), np.float32)
        for name, (part, place) in self.places.items():
            observation[..., self.slices[name]] = parts[part][..., place]
        return observation

    def check(self, parts: Parts) -> None:
        """Raises ValueError unless these are the parts of this layout, with their sizes, bytes for images."""
        found = {part: array.shape[-1] if array.ndim else 0 for part, array in parts.items()}
        if found != self.parts:
            raise ValueError(f"these senses are packed as {_shown(self.parts)}, got {_shown(found)}")
        if IMAGES in parts and parts[IMAGES].dtype != np.uint8:
            raise ValueError(f"packed images are uint8, got {parts[IMAGES].dtype}")


def part_of(senses: Senses, indices: Sequence[int] | NDArray[np.intp]) -> dict[str, tuple[int, ...]]:
    """The senses of a block that observes these indices of the observation, in the order of the indices.

    Of a vector it may have any numbers in any order, which then are a vector of that length; images it has
    whole or not at all. Raises ValueError for part of an image, and where two senses are mixed.
    """
    layout = Layout(senses)
    given = np.asarray(indices, dtype=np.intp)
    if not given.size or given.min() < 0 or given.max() >= layout.size:
        raise ValueError(f"a block observes some of 0 to {layout.size - 1}, got {_brief(given)}")
    stops = [place.stop for place in layout.slices.values()]
    owners = np.searchsorted(stops, given, side="right")
    found: dict[str, tuple[int, ...]] = {}
    for group in np.split(np.arange(given.size), np.flatnonzero(np.diff(owners)) + 1):
        name = list(senses)[owners[group[0]]]
        place, shape = layout.slices[name], senses[name]
        whole = np.array_equal(given[group], np.arange(place.start, place.stop))
        if name in found:
            raise ValueError(f"a block must observe its senses one after the other, but {name!r} comes twice")
        if name in layout.images and not whole:
            raise ValueError(
                f"a block observes images whole: list all of {place.start} to {place.stop - 1} "
                f"in order for {name!r}, or none"
            )
        found[name] = shape if whole else (len(group),)
    return found


def _as_bytes(numbers: Floats) -> NDArray[np.uint8]:
    with np.errstate(invalid="ignore"):
        packed = numbers.astype(np.uint8)
    if not np.array_equal(packed, numbers):
        raise ValueError("images must hold whole numbers from 0 to 255")
    return packed


def _shown(sizes: Mapping[str, int]) -> str:
    return ", ".join(f"{part} of {size}" for part, size in sizes.items()) or "nothing"


def _brief(indices: NDArray[np.intp]) -> str:
    return f"{indices.min()} to {indices.max()}" if indices.size else "none"
