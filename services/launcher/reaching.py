"""Which run a command means, and where it is reached: by its folder, or by its name at a router."""

import argparse
import os
from dataclasses import dataclass
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from protocol.messages import Name
from services.launcher.run_folder import RUNS, RunFolder, RunFolderError, running
from services.runtime.credentials import CREDENTIAL_VARIABLE, add_credential_option
from services.runtime.errors import UserError
from services.runtime.process import ENDPOINT_VARIABLE, RUN_VARIABLE


class NotRunning(UserError):
    """There is no run to reach."""


@dataclass(frozen=True, kw_only=True)
class Reach:
    """A run, and the way to it."""

    run: str
    folder: RunFolder | None
    """None where only its name is known here"""
    connect: str | None
    """the router's address that was given; None if the folder must know it"""

    def endpoint(self) -> str:
        """The router's address, now: of a run that `babble up` resumes it changes. Raises `NotRunning`."""
        if self.connect is not None:
            return self.connect
        assert self.folder is not None, "a name without an address is refused before"
        shown = self.folder.shown
        if self.folder.in_use():
            return self.folder.endpoint()
        raise NotRunning(
            f"the run {shown} is not going on here; go on with `babble up --resume {shown}`, "
            "or say with --connect where it does"
        )

    def credential(self, given: Path | None) -> Path | None:
        """The file to show there, of the one that was given on the command line or by the environment.

        Whoever exports one for other runs has no use for it where `babble up` of this machine is on tcp/.
        """
        exported = os.environ.get(CREDENTIAL_VARIABLE)
        if self.connect is None and str(given) == exported and self.endpoint().startswith("tcp/"):
            return None
        return given


def add_reaching(parser: argparse.ArgumentParser) -> None:
    """The arguments that say which run it is, where it is, and who asks."""
    parser.add_argument(
        "run",
        nargs="?",
        metavar="RUN",
        help=f"folder of a run, or its name, in {RUNS}/ or at --connect "
        f"(default: the one that goes on in {RUNS}/, else ${RUN_VARIABLE})",
    )
    parser.add_argument(
        "--connect",
        metavar="ADDRESS",
        help="address of the run's router, if `babble up` of this machine does not have it "
        f"(default: ${ENDPOINT_VARIABLE})",
    )
    add_credential_option(parser)


def reach(run: str | None, connect: str | None) -> Reach:
    """The run that is meant. Raises `NotRunning` or `RunFolderError` where there is none."""
    if run is None and connect is None and (found := running()):
        return Reach(run=found[-1].run, folder=found[-1], connect=None)
    run = run or os.environ.get(RUN_VARIABLE) or None
    elsewhere = connect or os.environ.get(ENDPOINT_VARIABLE) or None
    if run is None:
        raise NotRunning(
            f"no run is going on in {RUNS}/; start one with `babble up SCENARIO`, or name its folder"
            if elsewhere is None
            else f"a router may have several runs; name the one at {elsewhere} too, as RUN or {RUN_VARIABLE}"
        )
    folder = _folder(run, elsewhere)
    if folder is None:
        return Reach(run=_name(run), folder=None, connect=elsewhere)
    # Whoever exports an address for other runs still means the router of the folder's own launcher.
    own = connect is None and folder.in_use()
    return Reach(run=folder.run, folder=folder, connect=None if own else elsewhere)


def _folder(run: str, elsewhere: str | None) -> RunFolder | None:
    """The run's folder if it is here. Raises `RunFolderError` if it must be.

    With an address, a bare name is that of a run there, whatever is called so here.
    """
    if elsewhere is None or os.path.isfile(Path(os.path.expanduser(run)) / "run.json"):
        return RunFolder.find(run)
    return None


def _name(run: str) -> str:
    try:
        return TypeAdapter(Name).validate_python(run)
    except ValidationError:
        raise RunFolderError(f"{run!r} is neither a run's folder nor a run's name") from None
