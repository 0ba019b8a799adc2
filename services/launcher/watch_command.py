"""`babble watch`: follow a run until it is done, wherever it goes on, and write its report if asked to."""

import argparse
import os
import signal
import sys
from contextlib import nullcontext

from services.launcher.conclusion import (
    left_out_by,
    print_rows,
    print_scores,
    say_how_to_see_it,
    write_and_say,
)
from services.launcher.display import display_for
from services.launcher.following import Follower
from services.launcher.interrupts import Interrupts
from services.launcher.members import Picture
from services.launcher.reaching import add_reaching, reach
from services.launcher.recorded import counts_words
from services.launcher.records import Records
from services.launcher.run_folder import RunFolder
from services.launcher.timeline import timeline_of
from services.runtime.errors import UserError

DASHBOARD_VARIABLE = "BABBLE_DASHBOARD_URL"
"""The environment variable with the dashboard's address, where only who starts the containers knows it."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `babble watch`."""
    add_reaching(parser)
    parser.add_argument(
        "--report", action="store_true", help="write the report into the run's folder when it is done"
    )


def run(arguments: argparse.Namespace) -> int:
    """Follow the run; returns 0 when it is done, 128 and the signal's number if one came before.

    Raises `UserError` if there is nothing to follow.
    """
    asked = reach(arguments.run, arguments.connect)
    folder: RunFolder | None = asked.folder
    if arguments.report and folder is None:
        raise UserError(
            "--report writes into the run's folder, and only its name is known here; give the folder as RUN"
        )
    with Interrupts() as interrupts:
        follower = None
        if folder is None or not folder.completed():
            follower = Follower(asked, arguments.credential, display_for(sys.stdout))
            print(
                f"run        {folder.shown if folder else asked.run}\nrouter     {asked.endpoint()}",
                flush=True,
            )
            if dashboard := os.environ.get(DASHBOARD_VARIABLE):
                print(f"dashboard  {dashboard}", flush=True)
            if not follower.follow(interrupts):
                print("no longer watching; the run goes on", flush=True)
                return 128 + interrupts.numbers[0]
        else:
            print(f"the run {folder.shown} is completed already:\n")
        if folder is None:
            assert follower is not None, "only a folder says that a run is over"
            print_rows(follower.picture.scores, follower.best, "the run's scores.jsonl")
            if words := counts_words(follower.picture.recorded()):
                print(f"recorded: {words}, in the run's folder")
            return 0
        leaving = left_out_by(signal.SIGINT, signal.SIGTERM, folder=folder)
        with leaving if arguments.report else nullcontext():
            _conclude(folder, follower.picture if follower else None, report=arguments.report)
    return 0


def _conclude(folder: RunFolder, picture: Picture | None, *, report: bool) -> None:
    """Scores, and the report if it is wanted and not there yet. Raises `UserError`."""
    print_scores(folder)
    if not report or _is_reported(folder):
        say_how_to_see_it(folder)
    elif folder.in_use():
        print("`babble up` looks after this run and writes its report", flush=True)
    else:
        if not folder.result():
            secs = timeline_of(Records(folder.path / "events.jsonl")).end_secs
            used = {life: round(used, 2) for life, used in picture.cpu_secs().items()} if picture else {}
            folder.finish({"scores_secs": round(secs, 2), "cpu_secs": used})
        print("\nwriting the report (Ctrl-C leaves it out)", flush=True)
        write_and_say(folder, rollouts=True)


def _is_reported(folder: RunFolder) -> bool:
    """True if there is a report of the run since it was completed."""
    try:
        finished, written = (folder.path / name for name in ("result.json", "report.md"))
        return written.stat().st_mtime_ns >= finished.stat().st_mtime_ns
    except OSError:
        return False
