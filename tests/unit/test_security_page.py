"""docs/security.md says what the code does: the tables of rights and denials, the limits, the times."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from services.launcher.authority import AUTHORITY_DAYS, CREDENTIAL_DAYS
from services.router.access import RIGHTS, Rights
from services.router.bans import FIRST_SECS, LONGEST_SECS
from services.router.conduct import GARBAGE_SECS, WINDOW_SECS
from services.router.config import BOUNDS, Limits
from services.runtime.credentials import WARN_DAYS
from services.runtime.transport import ACCEPT_TIMEOUT_MS, MAX_PENDING, MAX_SESSIONS
from tests.processes.test_access import DENIED

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "security.md").read_text(encoding="utf-8")
SAID = " ".join(PAGE.split())
TESTS = ROOT / "tests"


def table_below(heading: str) -> Iterator[list[str]]:
    """The cells of each row of the first table below a heading, without its head."""
    assert f"\n## {heading}\n" in PAGE
    section = PAGE.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]
    table = section[section.index("\n|") + 1 :].partition("\n\n")[0]
    for row in table.splitlines()[2:]:
        yield [cell.strip() for cell in row.split("|")[1:-1]]


def quoted(cell: str) -> list[str]:
    """What stands in backticks."""
    return re.findall(r"`([^`]*)`", cell)


def test_the_table_of_rights_is_that_of_the_router() -> None:
    written = {
        quoted(row[0])[0]: tuple(set(quoted(cell)) for cell in row[1:]) for row in table_below("Rights")
    }
    assert written == {role: cells_of(rights) for role, rights in RIGHTS.items()}


def cells_of(rights: Rights) -> tuple[set[str], ...]:
    """What the row of a role holds: heard, said, announced and watched, asked and answered."""
    return (
        {*rights.hears, *rights.hears_newest},
        {*rights.says, *rights.retains},
        {*rights.announces, *rights.watches},
        {*rights.asks, *rights.answers},
    )


def test_the_kinds_that_are_kept_for_later_comers_are_named() -> None:
    kept = {key for rights in RIGHTS.values() for key in rights.retains}
    (sentence,) = re.findall(r"Kept for those who come later are ([^.]*)\.", SAID)
    assert set(quoted(sentence)) == kept


def test_each_act_that_is_tried_and_denied_is_in_the_table() -> None:
    """Each row: who, does, the keys; all of them are cases of one test."""
    written = {
        (quoted(who)[0], does, key)
        for who, does, keys in table_below("What is tried")
        for key in quoted(keys)
    }
    tried = {
        (act.who, act.does + (f" as a {act.calls_itself}" if act.calls_itself != "client" else ""), act.key)
        for act in DENIED
    }
    assert written == tried


def test_each_test_that_is_named_exists() -> None:
    """A file is named, and then functions in it."""
    named = [word for word in quoted(SAID) if word.startswith("test_")]
    functions: set[str] = set()
    for word in named:
        if word.endswith(".py"):
            (path,) = TESTS.rglob(word)
            functions = {f.name for f in ast.parse(path.read_text()).body if isinstance(f, ast.FunctionDef)}
        else:
            assert word in functions, f"there is no {word} in the file that is named before it"
    assert len(named) > 30


def test_the_limits_are_those_of_the_router() -> None:
    written = {
        quoted(option)[0]: number.split()[0].replace(",", "") for _, number, option in table_below("Limits")
    }
    assert written == {bound.option: f"{getattr(Limits, name):g}" for name, bound in BOUNDS.items()}


def test_times_and_numbers_in_the_text() -> None:
    for words in (
        f"the authority for {AUTHORITY_DAYS // 365} years, credentials for {CREDENTIAL_DAYS} days",
        f"in the last {WARN_DAYS} days",
        f"over {WINDOW_SECS:.0f} s",
        f"in {GARBAGE_SECS:.0f} s",
        f"for {FIRST_SECS:.0f} s, each further time for twice as long",
        f"at most {LONGEST_SECS / 3600:.0f} hour",
        f"{MAX_PENDING:,} connections at a time",
        f"{MAX_SESSIONS:,} connections in all",
        f"within {ACCEPT_TIMEOUT_MS / 1000:.0f} s",
    ):
        assert words in SAID, words
