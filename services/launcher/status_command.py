"""`babble status`: asks the coordinator of a run how it goes, and listens to its members for a moment."""

import argparse
import json
import shutil
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from protocol import keys
from protocol.codec import Refused, decode, encode
from protocol.messages import ALL_BLOCKS, Command, Reply
from services.launcher.address import launcher_credential
from services.launcher.frame import facts
from services.launcher.lines import ASCII, Signs, best_words, brief, has_many_blocks, kept_table, score_table
from services.launcher.listening import Listener
from services.launcher.members import Picture
from services.launcher.reaching import NotRunning, add_reaching, reach
from services.launcher.run_folder import RunFolder
from services.runtime.bus import Bus, Wakeup
from services.runtime.process import new_life

SERVICE = "coordinator"
CONNECT_SECS = 3.0
ANSWER_SECS = 3.0
LISTEN_SECS = 2.5
"""Members speak each second; speeds need two words of each."""
MOST_COLUMNS = 100
MOST_EVENTS = 5
MOST_ITERATIONS = 4
"""Of each block; the one that is kept is shown besides."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `babble status`."""
    add_reaching(parser)


def run(arguments: argparse.Namespace) -> int:
    """Print how the run goes; returns 0. Raises `UserError` if there is none or it does not answer."""
    asked = reach(arguments.run, arguments.connect)
    folder = asked.folder
    if folder is not None and not folder.in_use():
        _refuse_completed(folder)
    told, picture = look(asked.run, asked.endpoint(), asked.credential(arguments.credential))
    if folder is not None:
        picture.know(folder.settings())
    lines = status_lines(
        told,
        dashboard=folder.dashboard() if folder else "",
        facts=_plain_facts(picture) if _heard(picture) else (),
        events=folder.events(MOST_EVENTS) if folder else (),
    )
    print("\n".join(lines))
    return 0


def look(run: str, endpoint: str, credential: Path | None = None) -> tuple[dict[str, Any], Picture]:
    """What the coordinator says of the run, and what its members said within a moment.

    Raises `NotRunning` if the coordinator is silent, `BusError` without a router, `CredentialError` if the
    router would not let this process in.
    """
    shown = launcher_credential(endpoint, credential)
    from services.runtime.zenoh_bus import ZenohBus

    wakeup = Wakeup()
    bus = ZenohBus(endpoint, new_life("launcher"), wakeup, CONNECT_SECS, shown)
    try:
        picture = Picture(run, "", time.monotonic())
        listener = Listener(picture, wakeup)
        listener.connect(bus)
        until_secs = time.monotonic() + LISTEN_SECS
        told = ask(bus, run, ANSWER_SECS)
        while (left_secs := until_secs - time.monotonic()) > 0:
            wakeup.wait(left_secs)
            listener.hear(time.monotonic())
    finally:
        bus.close()
    return told, picture


def ask(bus: Bus, run: str, within_secs: float) -> dict[str, Any]:
    """The coordinator's description of a run. Raises `NotRunning` if it gives none in time."""
    life = new_life("launcher")
    command = Command(run=run, term=0, block=ALL_BLOCKS, life=life, seq=0, id=life, name="describe")
    answer = bus.ask(keys.command(run, SERVICE), encode(command), within_secs)
    if not answer:
        raise NotRunning(
            f"the coordinator of {run} did not answer within {within_secs:.0f} s; check the run's name, try "
            "once more in case it is starting again, or look into its log"
        )
    return _described(answer)


def status_lines(
    told: Mapping[str, Any],
    *,
    dashboard: str = "",
    facts: Sequence[str] = (),
    events: Iterable[Mapping[str, object]] = (),
) -> list[str]:
    """The coordinator's description for a person, with what was heard and seen besides.

    `facts` are those of the members (see `frame.facts`); without them the coordinator's word on members is
    told. `events` are rows of `events.jsonl`.
    """
    phase = str(told["phase"]).upper() + (f" after {told['evaluates'].upper()}" if told["evaluates"] else "")
    rounds = f", iteration {told['iteration']} of {told['iterations']}" if told["iteration"] else ""
    level = f", level {told['level']}" if told.get("level") else ""
    lines = [f"run {told['run']}: {phase}{rounds}{level}, term {told['term']}"]
    lines += [f"dashboard {dashboard}"] if dashboard else []
    lines += [told["waiting"]] if told["waiting"] else []
    lines += facts or ["", *(_member(member) for member in told["members"])]
    lines += [f"and {told['unlisted']:,} more"] if told["unlisted"] and not facts else []
    if told["scores"]:
        best, rows = {row["block"]: row for row in told["best"]}, told["scores"]
        few = [*score_table(brief(rows, best, MOST_ITERATIONS)), *best_words(best)]
        lines += ["", *(kept_table(rows, best) if has_many_blocks(rows) else few)]
    happened = [words for event in events if (words := _happened(event))]
    return lines + (["", *happened] if happened else [])


def _heard(picture: Picture) -> bool:
    return any(member.status is not None for member in picture.members())


def _plain_facts(picture: Picture) -> list[str]:
    width = min(MOST_COLUMNS, shutil.get_terminal_size().columns)
    signs = Signs() if "utf" in (sys.stdout.encoding or "").lower() else ASCII
    rows = facts(picture, time.monotonic(), width, signs)
    return ["".join(text for text, _ in row).rstrip() for row in rows]


def _happened(event: Mapping[str, object]) -> str:
    """A milestone with its local time of day; empty if it is damaged."""
    try:
        moment = datetime.fromisoformat(str(event["time"])).astimezone()
        return f"{moment:%H:%M:%S}  {event['text']}"
    except (KeyError, ValueError, OverflowError):
        return ""


def _refuse_completed(folder: RunFolder) -> None:
    """Raise `NotRunning` for a run that is over."""
    if folder.completed():
        raise NotRunning(
            f"the run {folder.shown} is completed; read {folder.shown}/report.md"
            + (f", or see it again with `babble view {folder.shown}`" if folder.recorded() else "")
        )


def _described(answer: bytes) -> dict[str, Any]:
    try:
        reply = decode(answer)
        if isinstance(reply, Reply) and reply.ok:
            return dict(json.loads(reply.text))
        reason = reply.text if isinstance(reply, Reply) else f"it sent a {reply.kind}"
    except (Refused, ValueError) as error:
        reason = str(error)
    raise NotRunning(f"the coordinator gave no description of the run: {reason}")


def _member(member: Mapping[str, Any]) -> str:
    words = f"{member['life']:<26}"
    versions = ", ".join(f"{name} v{version}" for name, version in member.get("versions", {}).items())
    if steps := member.get("totals", {}).get("env_steps"):
        words += f" {steps:,} steps;"
    parts = [part for part in (versions, member.get("waiting_for"), member.get("last_error")) if part]
    return f"{words} {'; '.join(parts)}".rstrip(" ;")
