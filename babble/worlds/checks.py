"""Checks of what people write into scenarios; each refusal is one sentence that names the parameter."""

import math
from collections.abc import Iterable, Mapping, Sequence


def check_number(name: str, value: object, *, least: float, most: float) -> float:
    """The value as a float. Raises ValueError unless it is a number from `least` to `most`."""
    if isinstance(value, int | float) and not isinstance(value, bool) and least <= value <= most:
        return float(value)
    raise ValueError(f"{name} must be a number from {least:g} to {most:g}, got {shown(value)}")


def check_count(name: str, value: object, *, least: int, most: int) -> None:
    """Raises ValueError unless `value` is a whole number from `least` to `most`."""
    if not isinstance(value, int) or isinstance(value, bool) or not least <= value <= most:
        raise ValueError(f"{name} must be a whole number from {least} to {most}, got {shown(value)}")


def check_flag(name: str, value: object) -> None:
    """Raises ValueError unless `value` is true or false."""
    if not isinstance(value, bool):
        raise ValueError(f"{name} must be true or false, got {shown(value)}")


def check_choice(name: str, value: object, choices: Iterable[str]) -> None:
    """Raises ValueError unless `value` is one of the choices."""
    known = tuple(choices)
    if not isinstance(value, str) or value not in known:
        raise ValueError(f"{name} must be one of {', '.join(known)}; got {shown(value)}")


def check_texts(name: str, value: object) -> None:
    """Raises ValueError unless `value` is a list of texts."""
    listed = isinstance(value, Sequence) and not isinstance(value, str)
    if not listed or not all(isinstance(text, str) for text in value):  # type: ignore[attr-defined]
        raise ValueError(f"{name} must be a list of texts, got {shown(value)}")


def check_table(name: str, value: object, known: Iterable[str] | None = None) -> None:
    """Raises ValueError unless `value` is a table, of the `known` keys if they are given."""
    if not isinstance(value, Mapping):
        raise ValueError(f"{name} must be a table, got {shown(value)}")
    if known is not None and (unknown := sorted(set(value) - set(known))):
        raise ValueError(f"{name} has no option {unknown[0]!r}; there are {', '.join(known)}")


def shown(value: object) -> str:
    """A value as it may stand in a sentence: never long."""
    if isinstance(value, int) and abs(value) > 10**15:
        return f"an integer of {int(math.log10(abs(value))) + 1} digits"
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
