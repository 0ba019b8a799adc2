"""What the bus says of a run, taken into a picture of it."""

import logging

from protocol import keys
from protocol.gate import Gate
from protocol.messages import Message, PhaseAnnounced, Status
from services.launcher.members import Picture
from services.runtime.bus import Bus, Frame, Inbox, Link, Membership, Question, Wakeup

log = logging.getLogger(__name__)


class Listener:
    """Keeps a picture up to date from the phase, the status of all, and who is there."""

    def __init__(self, picture: Picture, wakeup: Wakeup) -> None:
        self._picture = picture
        self._inbox = Inbox(wakeup, max_frames=keys.DELIVERY["status"].keep)
        self._gate = Gate(picture.run, {"status", "phase"})

    def connect(self, bus: Bus) -> None:
        """Listen here from now on. Raises `BusError`."""
        run = self._picture.run
        bus.watch_link(self._inbox)
        bus.subscribe("phase", keys.phase(run), self._inbox)
        bus.subscribe("status", keys.status(run, "*", "*"), self._inbox)
        bus.watch(keys.alive(run, "*", "*"), self._inbox)

    def hear(self, now_secs: float) -> None:
        """Take what has come."""
        for arrival in self._inbox.take_all():
            match arrival:
                case Frame(key=key, data=data):
                    self._hear_message(self._gate.admit(key, data), now_secs)
                case Membership(key=key, present=True):
                    self._picture.appeared(*keys.member(key), now_secs)
                case Membership(key=key):
                    self._picture.vanished(keys.member(key)[1], now_secs)
                case Link(up=up):
                    self._picture.link(up, now_secs)
                case Question():
                    log.error("a question came to the launcher, which answers none")
        self._picture.settle(now_secs)

    def _hear_message(self, message: Message | None, now_secs: float) -> None:
        match message:
            case PhaseAnnounced():
                self._picture.hear_phase(message, now_secs)
            case Status():
                self._picture.hear_status(message, now_secs)
