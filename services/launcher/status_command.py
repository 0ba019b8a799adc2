"""`babble status`: asks the coordinator of a run how it goes, and listens to its members for a moment."""

import argparse
import json
import shutil
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from typing import Any

from pydantic import TypeAdapter, ValidationError

from protocol import keys
from protocol.codec import Refused, decode, encode
from protocol.messages import ALL_BLOCKS, Command, Name, Reply
from services.launcher.frame import facts
from services.launcher.lines import ASCII, Signs, best_words, brief, score_table
from services.launcher.listening import Listener
from services.launcher.members import Picture
from services.launcher.run_folder import RUNS, RunFolder, RunFolderError, running
from services.runtime.bus import Wakeup
from services.runtime.errors import UserError
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


class NotRunning(UserError):
    """There is no run to ask."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `babble status`."""
    parser.add_argument(
        "run",
        nargs="?",
        metavar="RUN",
        help=f"folder or name of a run (default: the one that goes on in {RUNS}/)",
    )
    parser.add_argument(
        "--connect",
        metavar="ADDRESS",
        help="the router's address, for a run of another machine; RUN is its name",
    )


def run(arguments: argparse.Namespace) -> int:
    """Print how the run goes; returns 0. Raises `UserError` if there is none or it does not answer."""
    name, endpoint, folder = _whom_to_ask(arguments.run, arguments.connect)
    told, picture = look(name, endpoint)
    if folder is not None:
        picture.goals = folder.settings().goals
    lines = status_lines(
        told,
        dashboard=folder.dashboard() if folder else "",
        facts=_plain_facts(picture) if _heard(picture) else (),
        events=folder.events(MOST_EVENTS) if folder else (),
    )
    print("\n".join(lines))
    return 0


def look(run: str, endpoint: str) -> tuple[dict[str, Any], Picture]:
    """What the coordinator says of the run, and what its members said within a moment.

    Raises `NotRunning` if the coordinator is silent, `BusError` without a router.
    """
    from services.runtime.zenoh_bus import ZenohBus

    life = new_life("launcher")
    command = Command(run=run, term=0, block=ALL_BLOCKS, life=life, seq=0, id=life, name="describe")
    wakeup = Wakeup()
    bus = ZenohBus(endpoint, life, wakeup, CONNECT_SECS)
    try:
        picture = Picture(run, "", time.monotonic())
        listener = Listener(picture, wakeup)
        listener.connect(bus)
        until_secs = time.monotonic() + LISTEN_SECS
        answer = bus.ask(keys.command(run, SERVICE), encode(command), ANSWER_SECS)
        while answer and (left_secs := until_secs - time.monotonic()) > 0:
            wakeup.wait(left_secs)
            listener.hear(time.monotonic())
    finally:
        bus.close()
    if not answer:
        raise NotRunning(
            f"the coordinator of {run} did not answer at {endpoint} within {ANSWER_SECS:.0f} s; "
            "it may be starting again, so try once more, or look into its log"
        )
    return _described(answer), picture


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
    lines = [f"run {told['run']}: {phase}{rounds}, term {told['term']}"]
    lines += [f"dashboard {dashboard}"] if dashboard else []
    lines += [told["waiting"]] if told["waiting"] else []
    lines += facts or ["", *(_member(member) for member in told["members"])]
    lines += [f"and {told['unlisted']:,} more"] if told["unlisted"] and not facts else []
    if told["scores"]:
        best = {row["block"]: row for row in told["best"]}
        lines += ["", *score_table(brief(told["scores"], best, MOST_ITERATIONS)), *best_words(best)]
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


def _whom_to_ask(run: str | None, endpoint: str | None) -> tuple[str, str, RunFolder | None]:
    """The run's name, its router's address, and its folder if it is a run of this machine."""
    if endpoint is not None:
        return _run_name(run), endpoint, None
    if run is not None:
        folder = RunFolder.find(run)
        if not folder.in_use():
            if folder.result():
                raise NotRunning(
                    f"the run {folder.shown} is completed; read {folder.shown}/report.md"
                    + (f", or see it again with `babble view {folder.shown}`" if folder.recorded() else "")
                )
            raise NotRunning(
                f"the run {folder.shown} is not going on; go on with `babble up --resume {folder.shown}`"
            )
        return folder.run, folder.endpoint(), folder
    found = running()
    if not found:
        raise NotRunning(
            f"no run is going on in {RUNS}/; start one with `babble up SCENARIO`, or name its folder"
        )
    return found[-1].run, found[-1].endpoint(), found[-1]


def _run_name(run: str | None) -> str:
    if run is None:
        raise NotRunning("--connect needs the name of the run too: babble status RUN --connect ADDRESS")
    try:
        return RunFolder.find(run).run
    except RunFolderError:
        try:
            return TypeAdapter(Name).validate_python(run)
        except ValidationError:
            raise NotRunning(f"{run!r} is neither a run's folder nor a run's name") from None


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
