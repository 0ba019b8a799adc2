"""What the launcher has heard of a run, for people to see (pure: messages and times are given)."""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from protocol.latest import LatestPhase
from protocol.messages import Phase, PhaseAnnounced, Progress, Status

RATE_SECS = 5.0
"""Speeds are over so many of the last seconds, as far as they are known."""
SHOW_LOST_SECS = 10.0
"""A member that went is shown as lost for so long."""
RETURN_SECS = 3.0
"""Once the own link is up again, members have so long to come back before they are lost."""
ERROR_SECS = 10.0
"""What goes wrong in one process is told so often at most; the newest is always to be seen."""
DOUBT_SECS = 0.3
"""The tokens of all members go a moment before the own link is known to be lost."""
MOST_NEWS = 100


class Speed:
    """How fast a total grows."""

    def __init__(self) -> None:
        self._heard: deque[tuple[float, int]] = deque(maxlen=64)

    def hear(self, now_secs: float, total: int) -> None:
        """A total; one that is smaller than before is a new count."""
        if self._heard and total < self._heard[-1][1]:
            self._heard.clear()
        self._heard.append((now_secs, total))

    def per_sec(self, now_secs: float) -> float | None:
        """The mean of the last `RATE_SECS`; None while there is too little to tell."""
        recent = [(secs, total) for secs, total in self._heard if secs >= now_secs - RATE_SECS]
        if len(recent) < 2 or recent[-1][0] <= recent[0][0]:
            return None
        return (recent[-1][1] - recent[0][1]) / (recent[-1][0] - recent[0][0])


@dataclass
class Member:
    """A process of the run."""

    life: str
    service: str
    lost_secs: float | None = None
    """when it went, None while it is alive"""
    went_in_order: bool = False
    """it went after the run was done, as it should"""
    status: Status | None = None
    speed: Speed = field(default_factory=Speed)
    """environment steps"""


@dataclass(frozen=True, kw_only=True)
class BlockWork:
    """How far a block is in the current phase."""

    progress: Progress
    left_secs: float | None
    """None while there is too little to tell"""


class Picture:
    """A run as it was last heard."""

    def __init__(self, run: str, folder: str, began_secs: float) -> None:
        self.run = run
        self.folder = folder
        self.began_secs = began_secs
        self.news: deque[str] = deque(maxlen=MOST_NEWS)
        """What happened, one sentence each; whoever shows it takes it out."""
        self.errors: dict[str, str] = {}
        """Process -> the newest of what went wrong there; the newest last."""
        self.scores: Sequence[Mapping[str, object]] = ()
        self.linked = True
        self._members: dict[str, Member] = {}
        self._latest = LatestPhase()
        self._speeds: dict[str, Speed] = {}
        self._gone: dict[str, float] = {}
        """Tokens that went while it was open whether it was the link or the member."""
        self._linked_secs = float("-inf")
        self._said_secs: dict[str, float] = {}

    @property
    def announced(self) -> PhaseAnnounced | None:
        """What the coordinator last said; None before its first word."""
        return self._latest.current

    @property
    def done(self) -> bool:
        """True once the coordinator has said that the run is done."""
        return self.announced is not None and self.announced.phase is Phase.DONE

    def hear_phase(self, announced: PhaseAnnounced) -> None:
        """Take the coordinator's word."""
        before = self.announced
        if self._latest.admit(announced) and (before is None or announced.term > before.term):
            self._speeds.clear()
            self.news.append(phase_words(announced))

    def hear_status(self, status: Status, now_secs: float) -> None:
        """Take a member's status."""
        member = self._members.setdefault(status.life, Member(status.life, status.service))
        member.status = status
        if "env_steps" in status.totals:
            member.speed.hear(now_secs, status.totals["env_steps"])
        if self.announced is not None and status.term == self.announced.term:
            for progress in status.progress:
                self._speeds.setdefault(progress.block, Speed()).hear(now_secs, progress.done)
        if status.last_error:
            self.note_error(status.life, f"{status.life}: {status.last_error}", now_secs)

    def note_error(self, where: str, sentence: str, now_secs: float) -> None:
        """Something went wrong; it is news once, and of one process only now and then."""
        if self.errors.get(where) == sentence:
            return
        self.errors.pop(where, None)
        self.errors[where] = sentence
        if now_secs >= self._said_secs.get(where, float("-inf")) + ERROR_SECS:
            self._said_secs[where] = now_secs
            self.news.append(sentence)

    def appeared(self, service: str, life: str) -> None:
        """A member is there."""
        self._gone.pop(life, None)
        member = self._members.get(life)
        if member is None:
            self._members[life] = Member(life, service)
            self.news.append(f"{life} is there")
        elif member.lost_secs is not None:
            member.lost_secs = None
            self.news.append(f"{life} is back")

    def vanished(self, life: str, now_secs: float) -> None:
        """A member's token is gone: it is lost, unless it was this process's own link."""
        member = self._members.get(life)
        if member is not None and member.lost_secs is None:
            self._gone.setdefault(life, now_secs)

    def link(self, up: bool, now_secs: float) -> None:
        """This process's own link to the router went or came back."""
        if up != self.linked:
            self.news.append("the router is back" if up else "the link to the router is lost")
        self.linked = up
        self._linked_secs = now_secs if up else float("inf")

    def settle(self, now_secs: float) -> None:
        """Call it now and then: decides which of the vanished members are lost, and forgets old ones."""
        if now_secs >= self._linked_secs + RETURN_SECS:
            for life in [life for life, secs in self._gone.items() if now_secs >= secs + DOUBT_SECS]:
                self._members[life].lost_secs = self._gone.pop(life)
                self._members[life].went_in_order = self.done
                self.news.append(f"{life} {'has left' if self.done else 'is lost'}")
        old = [
            m.life for m in self._members.values() if now_secs - (m.lost_secs or now_secs) > SHOW_LOST_SECS
        ]
        for life in old:
            del self._members[life]
            self.errors.pop(life, None)

    def members(self, service: str | None = None) -> list[Member]:
        """Those alive and those lost lately, of one service or of all."""
        return [m for _, m in sorted(self._members.items()) if service is None or m.service == service]

    def work(self, now_secs: float) -> list[BlockWork]:
        """How far the blocks are in the current phase."""
        if self.announced is None:
            return []
        found: dict[str, Progress] = {}
        for member in self.members():
            if member.status is not None and member.status.term == self.announced.term:
                found |= {progress.block: progress for progress in member.status.progress}
        return [self._work(progress, now_secs) for progress in found.values()]

    def waiting(self) -> list[str]:
        """What is waited for, the coordinator's sentence first."""
        ranked = sorted(self.members(), key=lambda member: member.service != "coordinator")
        said = [m.status.waiting_for for m in ranked if m.status is not None and m.lost_secs is None]
        return list(dict.fromkeys(sentence for sentence in said if sentence))

    def _work(self, progress: Progress, now_secs: float) -> BlockWork:
        per_sec = self._speeds.setdefault(progress.block, Speed()).per_sec(now_secs)
        left = max(0, progress.wanted - progress.done)
        return BlockWork(progress=progress, left_secs=left / per_sec if per_sec else None)


def phase_words(announced: PhaseAnnounced) -> str:
    """The phase for a person: "PRACTISE 2 of 4", "EVALUATE after GROUND"."""
    name = announced.phase.upper()
    if announced.phase is Phase.EVALUATE and announced.evaluates is not None:
        name += f" after {announced.evaluates.upper()}"
    if announced.iteration > 0 and announced.phase is not Phase.DONE:
        name += f" {announced.iteration} of {announced.iterations}"
    return name + (f", level {announced.level}" if announced.level > 0 else "")
