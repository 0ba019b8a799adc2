"""Segments as rows: which columns the data set has, and what stands in them (pure)."""

import json
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from babble.policy.goals import reward
from babble.recording import METADATA_KEY
from protocol.messages import Segment
from services.recorder.config import BlockColumns, RecorderConfig

NAMES = pa.dictionary(pa.int32(), pa.string())
MOST = {"term": 2**31 - 1, "level": 2**7 - 1, "iteration": 2**15 - 1, "columns": 2**15}
"""What the data set's columns have room for; no run has more."""
Floats = NDArray[np.float32]


def schema_of(config: RecorderConfig) -> pa.Schema:
    """The columns of every file of a run, and under the key `babble` what they are of."""
    places = [
        ("step", pa.int64()),
        ("column", pa.int16()),
        ("actor", NAMES),
        ("term", pa.int32()),
        ("level", pa.int8()),
        ("iteration", pa.int16()),
        ("episode", pa.int32()),
    ]
    numbers = ["external_reward"] if config.rewarded else []
    for block in config.blocks:
        numbers += [
            f"{part}/{block.name}/{k}" for part in ("latent", "goal") for k in range(block.latent_dim)
        ]
        numbers.append(f"reward/{block.name}")
    numbers += config.state_names
    about = {
        "run": config.run,
        "scenario": config.scenario,
        "seed": config.seed,
        "every_steps": config.every_steps,
        "state_names": config.state_names,
        "blocks": {block.name: block.latent_dim for block in config.blocks},
    }
    fields = [*places, *((name, pa.float32()) for name in numbers)]
    return pa.schema(fields, metadata={METADATA_KEY: json.dumps(about)})


def check(segment: Segment, config: RecorderConfig) -> None:
    """Raises ValueError for a segment whose arrays are not those of the run's world and blocks.

    Also for one whose numbers fit into no column: it lies in the spool, so it would end every restart too.
    """
    for what, most in MOST.items():
        if getattr(segment, what) > most:
            raise ValueError(f"its {what} is {getattr(segment, what):,}, more than {most:,}")
    states, wanted = segment.arrays["state"].shape[-1], len(config.state_names)
    if states != wanted:
        raise ValueError(f"its states have {states} components, and those of the world {wanted}")
    if ("external_reward" in segment.arrays) != config.rewarded:
        found = "one, and the world has no task" if not config.rewarded else "none, and the world has a task"
        raise ValueError(f"of external rewards it has {found}")
    dims = {f"latent/{block.name}": block.latent_dim for block in config.blocks}
    for name, array in segment.arrays.items():
        if name.startswith("latent/") and dims.get(name) != array.shape[-1]:
            there = f"{dims[name]} vertices" if name in dims else "no place in the run's tree"
            raise ValueError(f"{name} has {array.shape[-1]} components, and the block has {there}")


def table_of(segments: Sequence[Segment], config: RecorderConfig, schema: pa.Schema) -> pa.Table:
    """The rows of some segments, in their order; within one by column, then step, as they compress best."""
    columns = [*_places(segments, config.every_steps)]
    if config.rewarded:
        columns.append(_flat(segments, "external_reward"))
    for block in config.blocks:
        columns += _of_block(segments, block)
    size = len(config.state_names)
    states = np.concatenate([_rows_of(s, "state").reshape(-1, size) for s in segments])
    columns.extend(np.ascontiguousarray(states.T))
    return pa.Table.from_arrays([_array(column) for column in columns], schema=schema)


def _places(segments: Sequence[Segment], every_steps: int) -> Iterator[Any]:
    rows = [segment.steps * segment.columns for segment in segments]
    yield np.concatenate(
        [
            np.tile(s.first_step + every_steps * np.arange(s.steps, dtype=np.int64), s.columns)
            for s in segments
        ]
    )
    yield np.concatenate([np.repeat(np.arange(s.columns, dtype=np.int16), s.steps) for s in segments])
    lives = list(dict.fromkeys(segment.life for segment in segments))
    indices = np.repeat(np.array([lives.index(segment.life) for segment in segments], np.int32), rows)
    yield pa.DictionaryArray.from_arrays(indices, lives)
    yield np.repeat(np.array([segment.term for segment in segments], np.int32), rows)
    yield np.repeat(np.array([segment.level for segment in segments], np.int8), rows)
    yield np.repeat(np.array([segment.iteration for segment in segments], np.int16), rows)
    yield _flat(segments, "episode")


def _of_block(segments: Sequence[Segment], block: BlockColumns) -> Iterator[Any]:
    """Latent, goal and reward of each row; null where the block acted without."""
    acted = [f"latent/{block.name}" in segment.arrays for segment in segments]
    if not any(acted):
        yield from (pa.nulls(_rows(segments), pa.float32()) for _ in range(2 * block.latent_dim + 1))
        return
    missing = np.repeat([not known for known in acted], [s.steps * s.columns for s in segments])
    latent, goal = (_stacked(segments, f"{part}/{block.name}", block) for part in ("latent", "goal"))
    rewards = reward(latent, goal, block.reward, block.sparse_radius)
    for column in (*latent.T, *goal.T, rewards):
        yield _array(column, missing) if missing.any() else column


def _stacked(segments: Sequence[Segment], name: str, block: BlockColumns) -> Floats:
    """(rows, d), zero where a segment lacks it."""
    return np.concatenate(
        [
            _rows_of(s, name).reshape(-1, block.latent_dim)
            if name in s.arrays
            else np.zeros((s.steps * s.columns, block.latent_dim), np.float32)
            for s in segments
        ]
    )


def _flat(segments: Sequence[Segment], name: str) -> NDArray[Any]:
    return np.concatenate([_rows_of(segment, name).ravel() for segment in segments])


def _rows_of(segment: Segment, name: str) -> NDArray[Any]:
    """(E, T, ...) of an array (T, E, ...)."""
    return segment.arrays[name].swapaxes(0, 1)


def _rows(segments: Sequence[Segment]) -> int:
    return sum(segment.steps * segment.columns for segment in segments)


def _array(column: Any, missing: NDArray[np.bool_] | None = None) -> pa.Array:
    """An array of Arrow over the numbers themselves; null where they are missing.

    Not by `pa.array`: where pandas is installed, the first call of that imports it, which takes seconds.
    """
    if isinstance(column, pa.Array):
        return column
    numbers = np.ascontiguousarray(column)
    present = None if missing is None else pa.py_buffer(np.packbits(~missing, bitorder="little"))
    return pa.Array.from_buffers(
        pa.from_numpy_dtype(numbers.dtype), len(numbers), [present, pa.py_buffer(numbers)]
    )
