"""SPEC.md says what the code does: each kind, key, delivery row, field, default, array and reason."""

import re
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import pytest
from pydantic_core import PydanticUndefined

import protocol
from protocol import arrays, codec, keys, messages
from protocol.contents import (
    MODEL_ARRAYS,
    RECORDED_ARRAYS,
    RECORDED_OF_BLOCK,
    SEGMENT_ARRAYS,
    VIEW_ARRAYS,
    Rules,
)
from protocol.keys import DELIVERY
from protocol.messages import MESSAGES, Frozen, Header, ModelFloor, Phase, Progress, Score
from protocol.refusal import Reason

TEXT = (Path(protocol.__file__).parent / "SPEC.md").read_text(encoding="utf-8")


def section(title: str) -> str:
    """The text under a heading, up to the next heading."""
    found = re.search(rf"^#+ {re.escape(title)}$(.*?)(?=^#|\Z)", TEXT, re.M | re.S)
    assert found, f"SPEC.md has no heading {title!r}"
    return found[1]


def rows(text: str, first_column: str) -> list[list[str]]:
    """The rows of the table whose first column is headed so, without backticks around single values."""
    table = re.search(rf"^\| {re.escape(first_column)} \|.*?\n\|[-|]+\n((?:\|.*\n?)*)", text, re.M)
    assert table, f"no table headed {first_column!r}"
    return [
        [cell.strip().replace("\\|", "|") for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
        for line in table[1].splitlines()
    ]


def default_of(field: Any) -> str:
    """A default as SPEC.md writes it."""
    if field.is_required():
        return "required"
    value = field.default if field.default is not PydanticUndefined else field.default_factory()
    return f'"{value}"' if isinstance(value, str) else repr(value)


def choices(annotation: Any) -> set[str]:
    """The texts of a Literal, however deep."""
    if get_origin(annotation) is Literal:
        return set(get_args(annotation))
    return {choice for inner in get_args(annotation) for choice in choices(inner)}


TABLES = [
    ("Fields of every header", "field", Header),
    *((kind, "field", message) for kind, message in MESSAGES.items()),
    ("phase", "field of a floor", ModelFloor),
    ("phase", "field of a frozen", Frozen),
    ("status", "field of a progress", Progress),
    ("status", "field of a score", Score),
]


@pytest.mark.parametrize(("title", "heading", "model"), TABLES, ids=[f"{t}-{h}" for t, h, _ in TABLES])
def test_every_field_and_default_is_there_and_no_other(title, heading, model):
    inherited = set(Header.model_fields) if model is not Header and issubclass(model, Header) else set()
    expected = {
        f"`{name}`": default_of(field)
        for name, field in model.model_fields.items()
        if name not in inherited | {"arrays"}
    }
    table = rows(section(title), heading)
    assert {row[0]: row[2] for row in table} == expected
    for name, type_text, *_ in table:
        wanted = choices(model.model_fields[name.strip("`")].annotation)
        if wanted:
            assert set(re.findall(r"`(\w+)`", type_text)) == wanted, name


def test_every_key_is_there():
    sample = {
        "segment": keys.segment("<run>", "<consumer>", "<block>", "<life>"),
        "ack": keys.ack("<run>", "<to>", "<consumer>"),
        "model": keys.model("<run>", "<model>", "<block>"),
        "phase": keys.phase("<run>"),
        "settings": keys.settings("<run>"),
        "status": keys.status("<run>", "<service>", "<life>"),
        "view": keys.view("<run>", "<view>", "<life>"),
        "command": keys.command("<run>", "<service>"),
        "reply": keys.command("<run>", "<service>"),
    }
    assert set(sample) == set(MESSAGES)
    table = rows(section("2. Keys and delivery"), "kind")
    assert {row[0]: row[1] for row in table} == {kind: f"`{key}`" for kind, key in sample.items()}
    assert all(len(row) == 4 and all(row) for row in table), "each has a sender and receivers"
    assert f"`{keys.alive('<run>', '<service>', '<life>')}`" in TEXT


def test_every_row_of_the_delivery_table_is_there():
    promised = re.search(r"^\| kind \| promise.*?(?=\n\n)", TEXT, re.M | re.S)
    found = {row[0]: row[1:] for row in rows(promised[0] + "\n", "kind")}
    assert found == {
        kind: [row.promise, row.priority, row.on_full, row.link, str(row.keep)]
        for kind, row in DELIVERY.items()
    }
    for row in DELIVERY.values():
        assert f"- **{row.promise}**:" in TEXT


def array_rows(rules: Rules) -> list[list[str]]:
    """The rules as rows: array, dtype, shape, presence."""
    return [
        [f"`{name}`", f"`{rule.dtype}`", rule.text, "required" if rule.required else "optional"]
        for name, rule in rules.items()
    ]


def test_every_array_is_there_and_no_other():
    segment_rows = [
        [phase, *row[1:5]] for row in rows(section("segment"), "phase") for phase in row[0].split(", ")
    ]
    expected = [[str(phase), *row] for phase, rules in SEGMENT_ARRAYS.items() for row in array_rows(rules)]
    assert sorted(segment_rows) == sorted(expected)
    recorded = [row[:4] for row in rows(section("segment"), "recorded")]
    of_block = [[f"`{what}/<block>`", "`<f4`", "(T, E, d)", "optional"] for what in RECORDED_OF_BLOCK]
    assert recorded == array_rows(RECORDED_ARRAYS) + of_block
    view_rows = [row[:5] for row in rows(section("view"), "view")]
    assert view_rows == [[what, *row] for what, rules in VIEW_ARRAYS.items() for row in array_rows(rules)]
    assert [row[:4] for row in rows(section("model"), "array")] == array_rows(MODEL_ARRAYS)
    assert {kind for kind, message in MESSAGES.items() if message.carries_arrays} == {
        "segment",
        "model",
        "view",
    }


def test_every_reason_is_there():
    table = rows(section("5. What a receiver does with a bad frame"), "reason")
    assert sorted(row[0] for row in table) == sorted(f"`{reason}`" for reason in Reason)


def test_limits_and_lists_are_those_of_the_code():
    flat = " ".join(TEXT.split())
    assert f"{keys.MAX_FRAME_BYTES:,} bytes" in flat
    assert f"at most {messages.MAX_ENTRIES} entries" in flat
    assert f"at most {codec.MAX_NODES:,} values" in flat
    assert f"at most {arrays.MAX_DIMENSIONS} sizes" in flat
    assert (
        f"at most {arrays.MAX_ARRAYS} arrays, each of a name of at most {arrays.MAX_NAME_CHARS} char" in flat
    )
    assert f"text of at most {messages.MAX_REPLY_CHARS:,} characters" in flat
    assert f"text of at most {messages.MAX_CONFIG_CHARS:,} characters" in flat
    assert codec.MAX_TEXT_BYTES == 1 << 20
    assert "a text at most 1 MiB" in flat
    for dtype in arrays.DTYPES:
        assert f"`{dtype}`" in section("1. A frame")
    phases = rows(section("Types of fields"), "type")
    assert next(row[1] for row in phases if row[0] == "phase") == "one of " + " ".join(
        f"`{p}`" for p in Phase
    )


def test_the_number_and_its_history_are_there():
    assert f"Protocol number **{protocol.PROTOCOL}**" in TEXT
    history = [int(row[0]) for row in rows(section("7. Versions"), "number")]
    assert history == list(range(1, protocol.PROTOCOL + 1))
