"""Following a run until it is done: connect, listen, show, until the coordinator or the folder says so."""

import threading
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from services.launcher.address import launcher_credential
from services.launcher.display import Display
from services.launcher.interrupts import Interrupts
from services.launcher.listening import Listener
from services.launcher.members import Picture
from services.launcher.reaching import NotRunning, Reach
from services.launcher.status_command import ANSWER_SECS, ask
from services.runtime.bus import Wakeup
from services.runtime.errors import BusError, RefusedError, UserError
from services.runtime.process import new_life
from services.runtime.zenoh_bus import ZenohBus

POLL_SECS = 0.1
CONNECT_SECS = 5.0
"""One attempt; what is in the way is told after it."""
AGAIN_SECS = 2.0
"""Between two attempts."""
SCORES_SECS = 0.5
FOLDER_SECS = 2.0
"""Who hears nothing looks so often whether the folder says that the run is done."""
ALONE_SECS = 15.0
"""A coordinator that is not there for so long is told of, once."""
CLOSE_SECS = 1.0

Row = Mapping[str, Any]


class Follower:
    """One person's look at one run; nobody in it knows that somebody looks."""

    def __init__(self, asked: Reach, credential: Path | None, display: Display) -> None:
        """Raises `UserError` if the run is not to be reached, or not with this credential."""
        launcher_credential(asked.endpoint(), asked.credential(credential))
        folder = asked.folder
        self.picture = Picture(asked.run, folder.shown if folder else "", time.monotonic())
        self.picture.opening = "waiting for the coordinator"
        self.picture.linked = False
        if folder is not None:
            self.picture.know(folder.settings())
        self.best: dict[str, Row] = {}
        """Block -> the iteration that is kept, where the coordinator has told it."""
        self._asked, self._credential, self._folder = asked, credential, folder
        self._display = display
        self._wakeup = Wakeup()
        self._listener = Listener(self.picture, self._wakeup)
        self._leaving = threading.Event()
        self._bus: ZenohBus | None = None
        self._met = False
        """The connection was made, and the picture knows; from then on the bus tells how the link is."""
        self._endpoint = self._trouble = ""
        self._refused: RefusedError | None = None
        self._described: dict[str, Any] = {}
        self._scores_at_secs = self._folder_at_secs = float("-inf")
        self._scores_size = -1
        self._alone_secs: float | None = None
        self._told_alone = False

    def follow(self, interrupts: Interrupts) -> bool:
        """Show the run until it is done (True) or a signal comes (False).

        Raises `RefusedError` where no waiting helps, such as another authority's certificate.
        """
        self._begin()
        try:
            with self._display:
                while not (interrupts.numbers or self.picture.done or self._completed()):
                    if self._refused is not None:
                        raise self._refused
                    self._wakeup.wait(POLL_SECS)
                    self._look(time.monotonic())
                if not interrupts.numbers:
                    self._look_last()
        finally:
            self._close()
        return not interrupts.numbers

    def _look(self, now_secs: float) -> None:
        self._listener.hear(now_secs)
        self._note_connection(now_secs)
        self._note_absence(now_secs)
        self._take_scores(now_secs)
        self._display.show(self.picture, now_secs)

    def _look_last(self) -> None:
        """The scores as they are in the end."""
        if self._folder is None and self._bus is not None:
            self._describe(self._bus)
        self._scores_at_secs = float("-inf")
        self._look(time.monotonic())

    def _begin(self) -> None:
        self._bus, self._met = None, False
        threading.Thread(target=self._connect, name="connect", daemon=True).start()

    def _connect(self) -> None:
        """On a thread of its own, so that nobody waits for it; again and again until it is done."""
        while not self._leaving.is_set():
            try:
                endpoint = self._endpoint = self._asked.endpoint()
                credential = launcher_credential(endpoint, self._asked.credential(self._credential))
                bus = ZenohBus(endpoint, new_life("launcher"), self._wakeup, CONNECT_SECS, credential)
                self._listener.connect(bus)
            except RefusedError as error:
                self._refused = error
                return
            except UserError as error:
                self._trouble = str(error)
                self._leaving.wait(AGAIN_SECS)
                continue
            self._trouble, self._bus = "", bus
            if self._folder is None:
                self._describe(bus)
            return

    def _describe(self, bus: ZenohBus) -> None:
        try:
            self._described = ask(bus, self.picture.run, ANSWER_SECS)
        except (NotRunning, BusError):
            return  # what was heard has to do

    def _note_connection(self, now_secs: float) -> None:
        if self._bus is not None and not self._met:
            self._met = True
            self.picture.errors.pop("router", None)
            if self.picture.members():
                self.picture.link(True, now_secs)
            self.picture.linked = True
        elif self._trouble:
            self.picture.note_error("router", f"{self._trouble}; trying again", now_secs)
        elif self._bus is not None and not self.picture.linked and self._has_moved():
            threading.Thread(target=self._bus.close, name="close", daemon=True).start()
            self._begin()

    def _has_moved(self) -> bool:
        """True if the run goes on at another address, as one that is resumed does."""
        if self._asked.connect is not None:
            return False
        try:
            return self._asked.endpoint() != self._endpoint
        except UserError:
            return False  # it does not go on yet

    def _note_absence(self, now_secs: float) -> None:
        run, known = self.picture.run, self.picture.members("coordinator")
        if self._bus is None or not self.picture.linked:
            self._alone_secs = None
        elif any(member.lost_secs is None for member in known):
            self._alone_secs, self._told_alone = None, False
        elif self._alone_secs is None:
            self._alone_secs = now_secs
        elif now_secs > self._alone_secs + ALONE_SECS and not self._told_alone:
            self._told_alone = True
            away = f"no coordinator of {run} has been there for {ALONE_SECS:.0f} s"
            why = "is that the run's name?" if self.picture.announced is None else "the run goes on with it"
            self.picture.tell(f"{away}; waiting for one ({why})", now_secs)

    def _completed(self) -> bool:
        """The folder's word, where the coordinator may have said it while nobody listened."""
        now_secs = time.monotonic()
        hearing = self._bus is not None and self.picture.linked and self._alone_secs is None
        if self._folder is None or hearing or now_secs < self._folder_at_secs + FOLDER_SECS:
            return False
        self._folder_at_secs = now_secs
        return self._folder.completed()

    def _take_scores(self, now_secs: float) -> None:
        if now_secs < self._scores_at_secs + SCORES_SECS:
            return
        self._scores_at_secs = now_secs
        if self._folder is None:
            self._merge_scores()
        elif (size := self._folder.scores_size()) != self._scores_size:
            self._scores_size = size
            self.picture.scores = self._folder.scores()

    def _merge_scores(self) -> None:
        """The coordinator told the older ones when it was asked, the learner tells the new ones."""
        told, self._described = self._described, {}
        self.best |= {row["block"]: row for row in told.get("best", ())}
        statuses = [member.status for member in self.picture.members() if member.status is not None]
        heard = [score.model_dump(mode="json") for status in statuses for score in status.scores]
        self.picture.scores = _merged([*self.picture.scores, *told.get("scores", ()), *heard])

    def _close(self) -> None:
        """Leave, without waiting long for a router that is stuck."""
        self._leaving.set()
        if self._bus is not None:
            closer = threading.Thread(target=self._bus.close, name="close", daemon=True)
            closer.start()
            closer.join(CLOSE_SECS)


def _merged(rows: Iterable[Row]) -> list[Row]:
    """Each score once, by iteration."""
    each = {(row["block"], row["iteration"], row["policy"]): row for row in rows}
    return sorted(each.values(), key=lambda row: int(row["iteration"]))
