"""Arrays on the wire: [dtype, shape, bytes], little-endian numbers in C order, never objects."""

from collections.abc import Mapping
from math import prod

import numpy as np
from numpy.typing import NDArray

from protocol.keys import MAX_FRAME_BYTES
from protocol.refusal import Reason, Refused, shown

DTYPES = {name: np.dtype(name) for name in ("<f2", "<f4", "<f8", "<i4", "<i8", "|i1", "|u1")}
"""The array types that travel."""
MAX_DIMENSIONS = 6
MAX_ARRAYS = 240
MAX_NAME_CHARS = 80


def pack(arrays: Mapping[str, NDArray[np.generic]]) -> dict[str, list[object]]:
    """What MessagePack is given for the arrays of a message; copies only what is not contiguous.

    Raises `Refused` for whatever `restore` would not take back.
    """
    if len(arrays) > MAX_ARRAYS:
        raise Refused(Reason.BAD_ARRAY, f"{len(arrays)} arrays are more than a frame's {MAX_ARRAYS}")
    return {_name(name): _pack(name, array) for name, array in arrays.items()}


def restore(packed: object) -> dict[str, NDArray[np.generic]]:
    """The arrays of a frame, read-only. Raises `Refused`, never anything else."""
    if not isinstance(packed, dict) or len(packed) > MAX_ARRAYS:
        raise Refused(Reason.BAD_ARRAY, f"arrays must be a map of at most {MAX_ARRAYS}, not {shown(packed)}")
    return {_name(name): _restore(name, value) for name, value in packed.items()}


def _name(name: object) -> str:
    if not isinstance(name, str) or not 0 < len(name) <= MAX_NAME_CHARS:
        raise Refused(
            Reason.BAD_ARRAY,
            f"an array's name must be a text of 1 to {MAX_NAME_CHARS} characters, not {shown(name)}",
        )
    return name


def _pack(name: str, array: NDArray[np.generic]) -> list[object]:
    dtype = array.dtype.str
    shape = list(array.shape)
    _check_type(name, dtype)
    _check_shape(name, shape)
    return [dtype, shape, np.ascontiguousarray(array).reshape(-1).view(np.uint8).data]


def _restore(name: str, packed: object) -> NDArray[np.generic]:
    if not isinstance(packed, list) or len(packed) != 3:
        raise Refused(
            Reason.BAD_ARRAY, f"array {shown(name)} must be [dtype, shape, bytes], not {shown(packed)}"
        )
    dtype, shape, data = packed
    known = _check_type(name, dtype)
    expected = prod(_check_shape(name, shape)) * known.itemsize
    if type(data) is not bytes or len(data) != expected:
        raise Refused(
            Reason.BAD_ARRAY,
            f"array {shown(name)} of {dtype} {shape} must have {expected} bytes, not {shown(data)}",
        )
    return np.ndarray(shape, known, data)


def _check_type(name: str, dtype: object) -> "np.dtype[np.generic]":
    known = DTYPES.get(dtype) if isinstance(dtype, str) else None
    if known is None:
        raise Refused(
            Reason.BAD_ARRAY, f"array {shown(name)} has dtype {shown(dtype)}; allowed: {sorted(DTYPES)}"
        )
    return known


def _check_shape(name: str, shape: object) -> list[int]:
    if type(shape) is list and len(shape) <= MAX_DIMENSIONS:
        for size in shape:
            if type(size) is not int or not 0 < size <= MAX_FRAME_BYTES:
                break
        else:
            return shape
    raise Refused(
        Reason.BAD_ARRAY,
        f"array {shown(name)} has the shape {shown(shape)}; allowed: {MAX_DIMENSIONS} sizes, each 1 or more",
    )
