"""Who is in the run and how each does, with short names that last: a0, a1, encoder_learner... (pure)."""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

from protocol.keys import SERVICES
from protocol.messages import Status
from services.dashboard.ledger import Ledger
from services.runtime.speed import RATE_SECS, Speed

MOST_ACTORS, MOST_OTHERS = 64, 16
"""So many are shown. What others count is counted, and nothing else of them is kept."""
MOST_NEWS = 256
SILENT_SECS = 5.0
"""A member that is there but has said nothing for so long is silent."""
SILENT_STATUSES = 3
"""It may miss so many of its words before, where these are seldom."""
DOUBT_SECS = 0.5
"""The tokens of all members go a moment before the own link is known to be lost."""
RETURN_SECS = 3.0
"""Once the own link is up again, members have so long to come back before they are lost."""
FORGET_SECS = 60.0
"""A lost member is shown for so long, or until another takes its short name."""
ERROR_SECS = 10.0
"""What goes wrong in one process is told so often at most."""


@dataclass
class Member:
    """A process of the run."""

    life: str
    service: str
    label: str
    heard_secs: float
    """when it last said how it is, or appeared"""
    silent_secs: float
    """it is silent after so long"""
    env_steps: Speed
    cpu_secs: Speed
    seen: bool = False
    """its token was there"""
    gone_secs: float | None = None
    """when its token went; None while it is there"""
    lost_secs: float | None = None
    """when it was taken for lost"""
    left: bool = False
    """it went in order, after the run was done"""
    status: Status | None = None

    def state(self, now_secs: float) -> str:
        """alive, silent, lost or left."""
        if self.lost_secs is not None:
            return "left" if self.left else "lost"
        return "silent" if now_secs - self.heard_secs > self.silent_secs else "alive"


@dataclass(frozen=True)
class News:
    """Something that happened, as one sentence."""

    text: str
    bad: bool = False


class Roster:
    """The members of a run, as they were last heard; `settle` it each second."""

    def __init__(self, status_secs: float = 1.0) -> None:
        """`status_secs` is the time between two words of a member."""
        self.ledger = Ledger()
        """what all have counted, also those that are not shown or gone"""
        self.news: deque[News] = deque(maxlen=MOST_NEWS)
        """whoever shows it takes it out"""
        self.errors: dict[str, str] = {}
        """short name -> the newest of what went wrong there, of members that are there; the newest last"""
        self.linked = True
        self.not_shown = 0
        """words of members beyond the bounds, or of no known service"""
        self.done = False
        """True once the run is done, and leaving is in order"""
        self._members: dict[str, Member] = {}
        self._silent_secs = max(SILENT_SECS, SILENT_STATUSES * status_secs)
        self._rate_secs = max(RATE_SECS, SILENT_STATUSES * status_secs)
        self._linked_secs = float("-inf")
        self._said_secs: dict[str, float] = {}

    def __iter__(self) -> Iterator[Member]:
        ranked = sorted(self._members.values(), key=lambda m: (m.service == "actor", len(m.label), m.label))
        return iter(ranked)

    def of(self, service: str) -> list[Member]:
        """The members of a service that are there."""
        return [m for m in self if m.service == service and m.lost_secs is None]

    def appeared(self, service: str, life: str, now_secs: float) -> None:
        """A member's token is there."""
        member = self._meet(service, life, now_secs)
        if member is None:
            return
        if not member.seen:
            self.news.append(News(f"{member.label} is there ({life})"))
        elif member.lost_secs is not None:
            self.news.append(News(f"{member.label} is back ({life})"))
        member.gone_secs, member.lost_secs, member.seen = None, None, True

    def vanished(self, life: str, now_secs: float) -> None:
        """A member's token is gone: it is lost, unless it was this process's own link."""
        member = self._members.get(life)
        if member is not None and member.gone_secs is None:
            member.gone_secs = now_secs

    def link(self, up: bool, now_secs: float) -> None:
        """This process's own link to the router went or came back."""
        if up != self.linked:
            text = "the router is back" if up else "the dashboard's link to the router is lost"
            self.news.append(News(text, bad=not up))
        self.linked = up
        self._linked_secs = now_secs if up else float("inf")

    def hear(self, status: Status, now_secs: float) -> None:
        """Take a member's word on how it is."""
        self.ledger.hear(status)
        member = self._meet(status.service, status.life, now_secs)
        if member is None:
            return
        member.status, member.heard_secs = status, now_secs
        if "env_steps" in status.totals:
            member.env_steps.hear(now_secs, status.totals["env_steps"])
        if "cpu_secs" in status.metrics:
            member.cpu_secs.hear(now_secs, status.metrics["cpu_secs"])
        if status.last_error:
            self.note_error(member.label, status.last_error, now_secs)

    def note_error(self, label: str, sentence: str, now_secs: float) -> None:
        """Something went wrong; the same is told once, and of one process only now and then."""
        if self.errors.get(label) == sentence:
            return
        self.errors.pop(label, None)
        self.errors[label] = sentence
        if now_secs >= self._said_secs.get(label, float("-inf")) + ERROR_SECS:
            self._said_secs[label] = now_secs
            self.news.append(News(f"{label}: {sentence}", bad=True))

    def meet_actor(self, life: str, now_secs: float) -> str | None:
        """The short name of an actor that shows something; None if there are too many members."""
        member = self._meet("actor", life, now_secs)
        return None if member is None else member.label

    def settle(self, now_secs: float) -> None:
        """Decide which of the vanished members are lost, and forget old ones."""
        for member in list(self._members.values()):
            if member.lost_secs is not None or not member.seen:
                last_secs = member.heard_secs if member.lost_secs is None else member.lost_secs
                if now_secs - last_secs > FORGET_SECS:
                    self._forget(member)
            elif member.gone_secs is not None and now_secs >= self._sure_secs(member.gone_secs):
                self._lose(member, now_secs)

    def _sure_secs(self, gone_secs: float) -> float:
        """From when on a member whose token went at this time is lost: it may have been the own link."""
        return max(self._linked_secs + RETURN_SECS, gone_secs + DOUBT_SECS)

    def _lose(self, member: Member, now_secs: float) -> None:
        member.lost_secs, member.left = now_secs, self.done
        self.errors.pop(member.label, None)
        text = f"{member.label} {'has left' if self.done else 'is lost'} ({member.life})"
        self.news.append(News(text, bad=not self.done))

    def _meet(self, service: str, life: str, now_secs: float) -> Member | None:
        member = self._members.get(life)
        if member is not None:
            return member
        if service not in SERVICES or not self._has_room(service == "actor"):
            self.not_shown += 1
            return None
        label, rate_secs = self._free_label(service), self._rate_secs
        self._members[life] = Member(
            life, service, label, now_secs, self._silent_secs, Speed(rate_secs), Speed(rate_secs)
        )
        return self._members[life]

    def _free_label(self, service: str) -> str:
        """The first of a0, a1... (or learner, learner-2...) that nobody has who is there."""
        taken = {member.label: member for member in self._members.values()}
        for number in range(MOST_ACTORS + MOST_OTHERS):
            label = f"a{number}" if service == "actor" else service + (f"-{number + 1}" if number else "")
            if label not in taken:
                return label
            if taken[label].lost_secs is not None:
                self._forget(taken[label])
                return label
        raise AssertionError("there are more short names than members")

    def _has_room(self, actor: bool) -> bool:
        """Room for one more actor or other member, if need be that of the one that was lost first."""
        alike = [member for member in self._members.values() if (member.service == "actor") is actor]
        if len(alike) < (MOST_ACTORS if actor else MOST_OTHERS):
            return True
        lost = [member for member in alike if member.lost_secs is not None]
        if lost:
            self._forget(min(lost, key=lambda member: member.lost_secs or 0.0))
        return bool(lost)

    def _forget(self, member: Member) -> None:
        self.errors.pop(member.label, None)
        del self._members[member.life]
