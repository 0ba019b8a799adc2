"""The data set of a run's states, `<run>/states/`: what its files are called, and how to read it.

docs/recording.md has the columns, their units and what is guaranteed. pandas, polars and DuckDB read the
folder in one line; what is here reads it in the order of the steps and in little memory.
"""

import json
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

STATES = "states"
"""The data set's folder, in the run's."""
METADATA_KEY = b"babble"
"""Of a file's schema: a JSON object with run, scenario, seed, every_steps, state_names and blocks."""
EVALUATE = "evaluate"
"""The phase in which the body is not exploring but examined."""
_KEYS = ("term", "step", "actor", "column")


class RecordingError(ValueError):
    """There is no recording, or it cannot be read; one sentence."""


@dataclass(frozen=True)
class Audit:
    """What a recording holds, and whether it is whole."""

    rows: int
    duplicates: int
    """rows of an (actor, column, step) that another row has already"""
    gaps: int
    """rows that are missing between two of the same actor, column and term"""
    rows_by_phase: Mapping[str, int]
    actors: tuple[str, ...]
    """lives, sorted"""


@dataclass(frozen=True)
class _Part:
    path: Path
    phase: str
    rows: int


@dataclass
class _Stay:
    """One life in one term: its part of the rows in the files' order, and its steps."""

    begin: int
    end: int
    low: int
    high: int
    offset: int = 0
    """steps of the term before its first one"""


class Recording:
    """The files that are there now; a run that goes on adds others."""

    def __init__(self, parts: Sequence[_Part], about: Mapping[str, Any]) -> None:
        self._parts = tuple(parts)
        self.rows = sum(part.rows for part in parts)
        self.state_names: tuple[str, ...] = tuple(about["state_names"])
        self.every_steps = int(about["every_steps"])
        self.phases: tuple[str, ...] = tuple(dict.fromkeys(part.phase for part in parts))
        """those that have rows, in the order in which they were first written"""

    @classmethod
    def open(cls, run_folder: Path) -> "Recording":
        """The recording of a run. Raises `RecordingError`."""
        folder = run_folder / STATES
        paths = sorted(folder.glob("phase=*/part-*.parquet"), key=lambda path: path.name)
        if not paths:
            raise RecordingError(
                f"{run_folder} has no recorded states; set recording.every_steps = 1 in the scenario"
            )
        found = [_opened(path) for path in paths]
        about = found[0][1]
        for part, other in found:
            if other != about:
                raise RecordingError(
                    f"{part.path} is not of the recording of {paths[0]}; keep each run in a folder of its own"
                )
        return cls([part for part, _ in found], about)

    def states(
        self, *, most_rows: int | None = None, phases: Collection[str] | None = None
    ) -> NDArray[np.float32]:
        """(N, s) the states in the order of (term, step in it, actor, column), or the first `most_rows`.

        `phases` None: all but "evaluate". In memory is one copy, besides a row group and 60 bytes a row.
        Raises `RecordingError` for a file that cannot be read, ValueError for `most_rows` below 0.
        """
        if most_rows is not None and most_rows < 0:
            raise ValueError(f"most_rows must be at least 0, got {most_rows}")
        parts = self._of(phases)
        order = self._order(parts)
        place = np.empty(len(order), np.int64)
        place[order] = np.arange(len(order))
        rows = len(order) if most_rows is None else min(most_rows, len(order))
        states = np.empty((rows, len(self.state_names)), np.float32)
        begin = 0
        for group in _groups(parts, self.state_names):
            to = place[begin : begin + group.num_rows]
            begin += group.num_rows
            wanted = to < len(states)
            if not wanted.any():
                continue
            block = np.empty((group.num_rows, states.shape[1]), np.float32)
            for k, column in enumerate(group.columns):
                block[:, k] = column.to_numpy()
            states[to[wanted]] = block if wanted.all() else block[wanted]
        return states

    def table(self, columns: Sequence[str], *, phases: Collection[str] | None = None) -> Any:
        """A `pyarrow.Table` of some columns, "phase" perhaps among them, in the order of `states`.

        Raises `RecordingError` for a column that there is not, or a file that cannot be read.
        """
        import pyarrow as pa

        parts = self._of(phases)
        stored = [name for name in columns if name != "phase"]
        tables = list(_groups(parts, stored))
        table = (
            pa.concat_tables(tables).unify_dictionaries()
            if tables
            else pa.table({name: [] for name in stored})
        )
        if "phase" in columns:
            phases_of = np.repeat([part.phase for part in parts], [part.rows for part in parts])
            table = table.append_column("phase", pa.array(phases_of, pa.string()))
        return table.select(list(columns)).take(self._order(parts))

    def audit(self) -> Audit:
        """Count rows, and what is double or missing, over all phases. Raises `RecordingError`."""
        keys = self._keys(self._parts)
        term, step, actor, column = (keys[name] for name in _KEYS)
        order = np.lexsort((step, column, actor))
        same = (np.diff(actor[order]) == 0) & (np.diff(column[order]) == 0)
        ahead = np.diff(step[order])
        inside = same & (np.diff(term[order]) == 0) & (ahead > 0)
        rows = Counter[str]()
        for part in self._parts:
            rows[part.phase] += part.rows
        return Audit(
            rows=self.rows,
            duplicates=int(np.count_nonzero(same & (ahead == 0))),
            gaps=int((ahead[inside] // self.every_steps - 1).sum()),
            rows_by_phase=dict(rows),
            actors=tuple(keys["lives"]),
        )

    def _of(self, phases: Collection[str] | None) -> list[_Part]:
        return [p for p in self._parts if (p.phase != EVALUATE if phases is None else p.phase in phases)]

    def _order(self, parts: Sequence[_Part]) -> NDArray[np.int64]:
        """(N,) the rows as the files have them, in their order of (term, step in it, actor, column)."""
        keys = self._keys(parts)
        keys["step"] = _steps_in_term(keys["term"], keys["actor"], keys["step"], self.every_steps)
        return np.lexsort([keys[name] for name in reversed(_KEYS)])

    def _keys(self, parts: Sequence[_Part]) -> dict[str, Any]:
        """Each row's place (N,), the actors as numbers in the order of their lives, and the lives."""
        found: dict[str, list[NDArray[Any]]] = {name: [] for name in _KEYS}
        numbers: dict[str, int] = {}
        for group in _groups(parts, _KEYS):
            for name in _KEYS:
                values = group.column(name)
                if name != "actor":
                    found[name].append(values.to_numpy())
                    continue
                for chunk in values.chunks:
                    own = [numbers.setdefault(life, len(numbers)) for life in chunk.dictionary.to_pylist()]
                    found[name].append(np.asarray(own, np.int32)[chunk.indices.to_numpy()])
        keys: dict[str, Any] = {name: _joined(arrays) for name, arrays in found.items()}
        lives = sorted(numbers)
        rank = np.empty(len(lives), np.int32)
        rank[[numbers[life] for life in lives]] = np.arange(len(lives))
        keys["actor"] = rank[keys["actor"].astype(np.int32)]
        return keys | {"lives": lives}


def _joined(arrays: Sequence[NDArray[Any]]) -> NDArray[Any]:
    return np.concatenate(arrays) if arrays else np.empty(0, np.int64)


def _steps_in_term(
    term: NDArray[Any], actor: NDArray[Any], step: NDArray[np.int64], every_steps: int
) -> NDArray[np.int64]:
    """(N,) each row's step, counted from the beginning of its term, of rows in the files' order.

    A life counts from its own first step in the term. But one that is new there goes on after those that
    ended there before it came: of a run that is resumed, the rows before come first.
    """
    if not len(step):
        return step
    edges = np.flatnonzero((np.diff(term) != 0) | (np.diff(actor) != 0)) + 1
    begins = np.concatenate([[0], edges])
    lows, highs = np.minimum.reduceat(step, begins), np.maximum.reduceat(step, begins)
    of_run = list(zip(term[begins].tolist(), actor[begins].tolist(), strict=True))
    terms: dict[int, dict[int, _Stay]] = {}
    for number, ((at, life), low, high) in enumerate(zip(of_run, lows.tolist(), highs.tolist(), strict=True)):
        stay = terms.setdefault(at, {}).setdefault(life, _Stay(number, number, low, high))
        stay.end, stay.low, stay.high = number, min(stay.low, low), max(stay.high, high)
    first = {life: min(at for at, stays in terms.items() if life in stays) for _, life in set(of_run)}
    last = {life: max(at for at, stays in terms.items() if life in stays) for _, life in set(of_run)}
    for at, stays in terms.items():
        ended = [stay for life, stay in stays.items() if last[life] == at]
        for stay in (stay for life, stay in stays.items() if first[life] == at):
            before = [other for other in ended if other.end < stay.begin]
            lengths = (other.offset + other.high - other.low + every_steps for other in before)
            stay.offset = max(lengths, default=0)
    shifts = np.array([terms[at][life].offset - terms[at][life].low for at, life in of_run], np.int64)
    return step + np.repeat(shifts, np.diff([*begins, len(step)]))


def _opened(path: Path) -> tuple[_Part, Mapping[str, Any]]:
    """A file, and what its metadata says. Raises `RecordingError`."""
    import pyarrow.parquet as pq

    try:
        metadata = pq.read_metadata(path)
    except (OSError, ValueError) as error:
        raise _unreadable(path, error) from None
    try:
        about: dict[str, Any] = json.loads(metadata.metadata[METADATA_KEY])
        int(about["every_steps"]), tuple(about["state_names"])
    except (KeyError, TypeError, ValueError):
        raise RecordingError(
            f"{path} was not written by Babble's recorder; take it out of the folder"
        ) from None
    return _Part(path, path.parent.name.partition("=")[2], metadata.num_rows), about


def _groups(parts: Sequence[_Part], columns: Sequence[str]) -> Iterator[Any]:
    """The row groups of all files, one after the other, as tables. Raises `RecordingError`."""
    import pyarrow.parquet as pq

    for part in parts:
        try:
            with pq.ParquetFile(part.path) as file:
                missing = sorted(set(columns) - set(file.schema_arrow.names))
                if missing:
                    raise RecordingError(f"the recording has no column {missing[0]!r}; see docs/recording.md")
                for number in range(file.num_row_groups):
                    yield file.read_row_group(number, columns=list(columns)).select(list(columns))
        except (OSError, ValueError) as error:
            raise error if isinstance(error, RecordingError) else _unreadable(part.path, error) from None


def _unreadable(path: Path, error: Exception) -> RecordingError:
    why = str(error).splitlines()[0] if str(error) else type(error).__name__
    return RecordingError(f"{path} cannot be read ({why}); restore it from a backup, or record anew")
