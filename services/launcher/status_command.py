"""`babble status`: asks the coordinator of a run how it goes."""

import argparse
import json
from collections.abc import Mapping
from typing import Any

from pydantic import TypeAdapter, ValidationError

from protocol import keys
from protocol.codec import Refused, decode, encode
from protocol.messages import ALL_BLOCKS, Command, Name, Reply
from services.launcher.lines import best_words, score_table
from services.launcher.run_folder import RUNS, RunFolder, RunFolderError, running
from services.runtime.bus import Wakeup
from services.runtime.errors import UserError
from services.runtime.process import new_life

SERVICE = "coordinator"
CONNECT_SECS = 3.0
ANSWER_SECS = 3.0


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
    name, endpoint = _whom_to_ask(arguments.run, arguments.connect)
    print("\n".join(status_lines(ask(name, endpoint))))
    return 0


def ask(run: str, endpoint: str) -> dict[str, Any]:
    """What the coordinator says of the run.

    Raises `NotRunning` if it is silent, `BusError` without a router.
    """
    from services.runtime.zenoh_bus import ZenohBus

    life = new_life("launcher")
    command = Command(run=run, term=0, block=ALL_BLOCKS, life=life, seq=0, id=life, name="describe")
    bus = ZenohBus(endpoint, life, Wakeup(), CONNECT_SECS)
    try:
        answer = bus.ask(keys.command(run, SERVICE), encode(command), ANSWER_SECS)
    finally:
        bus.close()
    if not answer:
        raise NotRunning(
            f"the coordinator of {run} did not answer at {endpoint} within {ANSWER_SECS:.0f} s; "
            "it may be starting again, so try once more, or look into its log"
        )
    return _described(answer)


def status_lines(told: Mapping[str, Any]) -> list[str]:
    """The coordinator's description for a person."""
    phase = str(told["phase"]).upper() + (f" after {told['evaluates'].upper()}" if told["evaluates"] else "")
    rounds = f", iteration {told['iteration']} of {told['iterations']}" if told["iteration"] else ""
    lines = [f"run {told['run']}: {phase}{rounds}, term {told['term']}"]
    lines += [told["waiting"]] if told["waiting"] else []
    lines += ["", *(_member(member) for member in told["members"])]
    lines += [f"and {told['unlisted']:,} more"] if told["unlisted"] else []
    if told["scores"]:
        best = {row["block"]: row for row in told["best"]}
        lines += ["", *score_table(told["scores"]), *best_words(best)]
    return lines


def _whom_to_ask(run: str | None, endpoint: str | None) -> tuple[str, str]:
    if endpoint is not None:
        return _run_name(run), endpoint
    if run is not None:
        folder = RunFolder.find(run)
        if not folder.in_use():
            raise NotRunning(
                f"the run {folder.shown} is not going on; go on with `babble up --resume {folder.shown}`"
            )
        return folder.run, folder.endpoint()
    found = running()
    if not found:
        raise NotRunning(
            f"no run is going on in {RUNS}/; start one with `babble up SCENARIO`, or name its folder"
        )
    return found[-1].run, found[-1].endpoint()


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
