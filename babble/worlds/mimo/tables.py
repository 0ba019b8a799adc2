"""Reading tables of figures: files laid over one another, values checked, errors that name file and key."""

import math
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

Keys = tuple[str, ...]
Origins = dict[Keys, str]
"""Which source each key, given with the tables around it, came from."""
Vector = tuple[float, float, float]


class FiguresError(ValueError):
    """A table of figures that makes no body; the text is one sentence for a person."""


def read_toml(path: Path) -> dict[str, Any]:
    """The file's content. Raises `FiguresError` when it is missing or no TOML."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise FiguresError(f"the table of figures {path} cannot be read: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise FiguresError(f"the table of figures {path} is no TOML: {error}") from None


def lay_over(
    base: dict[str, Any], edits: Mapping[str, Any], source: str, origins: Origins, at: Keys = ()
) -> None:
    """Put `edits` over `base`, table by table; `origins` learns which source each key came from."""
    for key, value in edits.items():
        path = (*at, key)
        if key in base and isinstance(base[key], dict) != isinstance(value, Mapping):
            kind = "a table" if isinstance(base[key], dict) else "a value"
            raise FiguresError(f"{source}: {'.'.join(path)} must be {kind}, got {value!r}")
        origins[path] = source
        if isinstance(value, Mapping):
            lay_over(base.setdefault(key, {}), value, source, origins, path)
        else:
            base[key] = value


class Table:
    """One table being read. What is asked for is checked; `close` complains of keys nobody asked for.

    `side`: on which side of the body the entry is now read; `mirrored`: the entry is written for the other
    side. Keys that the entry states for its side (`left = {...}`) are taken as they are.
    """

    def __init__(self, values: Mapping[str, Any], origins: Origins, path: Keys = ()) -> None:
        self._values = dict(values)
        self._paths = {key: (*path, key) for key in values}
        self._origins = origins
        self._path = path
        self._asked: set[str] = set()
        self._literal: set[str] = set()
        self.side = ""
        self.mirrored = False

    def __contains__(self, key: str) -> bool:
        return key in self._values

    def error(self, key: str, complaint: str) -> FiguresError:
        """The sentence: file, key, what is wrong with it."""
        path = self._paths.get(key, (*self._path, key) if key else self._path)
        known = (path[:end] for end in range(len(path), 0, -1))
        source = next((self._origins[part] for part in known if part in self._origins), "the figures")
        return FiguresError(f"{source}: {'.'.join(path)} {complaint}")

    def on_side(self, side: str, mirrored: bool) -> "Table":
        """The same entry as it reads for one side of the body ('' for the middle)."""
        table = Table({k: v for k, v in self._values.items() if k not in ("left", "right")}, self._origins)
        table._path, table._paths = self._path, {key: self._paths[key] for key in table._values}
        table.side, table.mirrored = side, mirrored
        if side:
            for own in ("left", "right"):
                self.table(own)  # both must be tables, whichever side is read
            for key, value in self._values.get(side, {}).items():
                table._values[key] = value
                table._paths[key] = (*self._path, side, key)
                table._literal.add(key)
        elif {"left", "right"} & self._values.keys():
            raise self.error("", "has no sides, so it cannot have a 'left' or a 'right' exception")
        return table

    def over(self, *defaults: "Table") -> "Table":
        """This entry with what it does not say taken from `defaults`, the later the stronger."""
        table = Table({}, self._origins, self._path)
        table.side, table.mirrored = self.side, self.mirrored
        for layer in (*defaults, self):
            table._values.update(layer._values)
            table._paths.update(layer._paths)
            table._literal -= layer._values.keys()
            table._literal |= layer._literal
        return table

    def _get(self, key: str, default: Any) -> Any:
        self._asked.add(key)
        if key in self._values:
            return self._values[key]
        if default is None:
            raise self.error(key, "is missing")
        return default

    def number(self, key: str, default: float | None = None, *, least: float = -math.inf) -> float:
        """A finite number, not below `least`."""
        value = self._get(key, default)
        if not _is_number(value) or value < least:
            bound = "" if least == -math.inf else f" of at least {least:g}"
            raise self.error(key, f"must be a number{bound}, got {value!r}")
        return float(value)

    def positive(self, key: str, default: float | None = None) -> float:
        """A finite number above 0."""
        value = self.number(key, default)
        if value <= 0:
            raise self.error(key, f"must be above 0, got {value:g}")
        return value

    def numbers(self, key: str, count: int, default: tuple[float, ...] | None = None) -> tuple[float, ...]:
        """Exactly `count` finite numbers."""
        value = self._get(key, default)
        listed = isinstance(value, list | tuple) and len(value) == count and all(map(_is_number, value))
        if not listed:
            raise self.error(key, f"must be {count} numbers, got {value!r}")
        return tuple(float(number) for number in value)

    def ordered(self, key: str, default: tuple[float, float] | None = None) -> tuple[float, float]:
        """Two numbers, the first the smaller one."""
        low, high = self.numbers(key, 2, default)
        if low >= high:
            raise self.error(key, f"must be two numbers, the smaller first, got [{low:g}, {high:g}]")
        return low, high

    def place(self, key: str, default: Vector | None = None) -> Vector:
        """A point or displacement; mirrored in the body's middle plane (y changes sign)."""
        x, y, z = self.numbers(key, 3, default)
        return (x, 0.0 - y, z) if self._mirrors(key) else (x, y, z)

    def turning(self, key: str, default: Vector | None = None) -> Vector:
        """An axis or angles of rotation; the mirror image turns the other way about x and z."""
        x, y, z = self.numbers(key, 3, default)
        return (0.0 - x, y, 0.0 - z) if self._mirrors(key) else (x, y, z)

    def _mirrors(self, key: str) -> bool:
        return self.mirrored and key not in self._literal

    def text(self, key: str, default: str | None = None, *, among: tuple[str, ...] = ()) -> str:
        """A text, one of `among` where that is given."""
        value = self._get(key, default)
        if not isinstance(value, str) or (among and value not in among):
            wanted = f"one of {', '.join(among)}" if among else "a text"
            raise self.error(key, f"must be {wanted}, got {value!r}")
        return value

    def texts(self, key: str, default: tuple[str, ...] | None = None) -> tuple[str, ...]:
        """A list of texts."""
        value = self._get(key, default)
        if not isinstance(value, list | tuple) or not all(isinstance(text, str) for text in value):
            raise self.error(key, f"must be a list of names, got {value!r}")
        return tuple(value)

    def nested(self, key: str) -> tuple[tuple[str, ...], ...]:
        """A list of lists of texts."""
        value = self._get(key, ())
        if not isinstance(value, list | tuple) or not all(isinstance(inner, list | tuple) for inner in value):
            raise self.error(key, f"must be a list of lists of names, got {value!r}")
        return tuple(tuple(str(text) for text in inner) for inner in value)

    def flag(self, key: str, default: bool | None = None) -> bool:
        """true or false."""
        value = self._get(key, default)
        if not isinstance(value, bool):
            raise self.error(key, f"must be true or false, got {value!r}")
        return value

    def table(self, key: str) -> "Table":
        """The table of that name; an empty one when there is none."""
        value = self._get(key, {})
        if not isinstance(value, dict):
            raise self.error(key, f"must be a table, got {value!r}")
        table = Table(value, self._origins, self._paths.get(key, (*self._path, key)))
        table.side, table.mirrored = self.side, self.mirrored
        return table

    def tables(self) -> Iterator[tuple[str, "Table"]]:
        """Every entry that nobody asked for yet, all of which must be tables."""
        for key in [key for key in self._values if key not in self._asked]:
            yield key, self.table(key)

    @property
    def keys(self) -> list[str]:
        """The keys, in the order in which they were written."""
        return list(self._values)

    def close(self) -> None:
        """Raises `FiguresError` for a key that nobody asked for."""
        for key in self._values:
            if key not in self._asked:
                raise self.error(key, f"is not known there; known are {', '.join(sorted(self._asked))}")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
