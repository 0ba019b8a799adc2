"""A run's settings as its coordinator announces them, for a process that has only the run's name."""

from protocol import keys
from protocol.gate import Gate
from protocol.messages import SettingsAnnounced
from services.runtime.bus import Bus, Frame, Inbox, Wakeup
from services.runtime.clock import Clock
from services.runtime.errors import UserError
from services.runtime.settings import RunSettings, parse_announced

MOST_NAMED = 5
"""So many of the runs that there are instead are named."""
LONGEST_WAIT_SECS = 0.25


class UnknownRunError(UserError):
    """Nobody announces a run of this name at this router."""


class AnnouncedSettings:
    """Hears the settings of a run, for the first time and whenever they are announced again."""

    def __init__(self, bus: Bus, run: str, clock: Clock, wakeup: Wakeup) -> None:
        self._run, self._clock, self._wakeup = run, clock, wakeup
        self._inbox = Inbox(wakeup, max_frames=keys.DELIVERY["settings"].keep)
        self._gate = Gate(run, {"settings"})
        self._taken: SettingsAnnounced | None = None
        self._newest: SettingsAnnounced | None = None
        self._others: set[str] = set()
        bus.subscribe("settings", keys.settings("*"), self._inbox)

    def wait(self, endpoint: str, within_secs: float) -> RunSettings:
        """The settings, once they have come from the router at `endpoint`.

        Raises `UnknownRunError` after the deadline, `SettingsError` if they cannot be used here.
        """
        deadline_secs = self._clock.now_secs() + within_secs
        self._hear()
        while self._newest is None:
            left_secs = deadline_secs - self._clock.now_secs()
            if left_secs <= 0:
                raise UnknownRunError(self._missed(endpoint))
            self._wakeup.wait(min(left_secs, LONGEST_WAIT_SECS))
            self._hear()
        self._taken = self._newest
        return parse_announced(self._taken.config, origin=f"the settings of run {self._run!r}")

    def replaced(self) -> bool:
        """True once other settings, or another run of the same name, were announced than `wait` returned."""
        self._hear()
        return _gist(self._newest) != _gist(self._taken)

    def _hear(self) -> None:
        for arrival in self._inbox.take_all():
            if not isinstance(arrival, Frame):
                continue
            run = arrival.key.split("/")[1]
            if run != self._run:
                self._others = {*sorted(self._others)[:MOST_NAMED], run}
                continue
            message = self._gate.admit(arrival.key, arrival.data)
            if isinstance(message, SettingsAnnounced):
                self._newest = message

    def _missed(self, endpoint: str) -> str:
        if self._gate.last_refusal:
            return f"the settings of run {self._run!r} at {endpoint} are refused: {self._gate.last_refusal}"
        there = ", ".join(map(repr, sorted(self._others)[:MOST_NAMED]))
        instead = f" (there is {there})" if there else ""
        return (
            f"no run {self._run!r} is announced at {endpoint}{instead}: check --run (the run's name, see "
            "`babble status` there), or the coordinator is not up yet"
        )


def _gist(announced: SettingsAnnounced | None) -> tuple[str, int] | None:
    return None if announced is None else (announced.config, announced.began_ms)
