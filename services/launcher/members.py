"""What the launcher has heard of a run, for people to see (pure: messages and times are given)."""

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from protocol.latest import LatestPhase
from protocol.messages import Phase, PhaseAnnounced, Progress, Status
from services.runtime.phases import phase_words
from services.runtime.settings import GoalSettings, RunSettings
from services.runtime.speed import Speed

SHOW_LOST_SECS = 10.0
"""A member that went is shown as lost for so long."""
SHOW_MISHAP_SECS = 30.0
"""What the launcher deals with itself, such as a process that died, is shown as an error for so long."""
RETURN_SECS = 3.0
"""Once the own link is up again, members have so long to come back before they are lost."""
ERROR_SECS = 10.0
"""What goes wrong in one process is told so often at most; the newest is always to be seen."""
DOUBT_SECS = 0.3
"""The tokens of all members go a moment before the own link is known to be lost."""
ROUTER, RECORDER = "router", "recorder"
MOST_LAST_WORDS = 256
MOST_NEWS = 100
MOST_EVENTS = 16
"""So many of the last events can be seen again."""
SILENT_SECS = 10.0
"""Who has no token (the router, and what speaks late of itself) has gone after so long without a word."""
UNHEARD_SECS = 2.0
"""A block of which no learner has said anything so long after a phase began waits for one."""
UNEASY_SECS = 5.0
"""A member that has said nothing for so long is worth a look."""


@dataclass
class Member:
    """A process of the run."""

    life: str
    service: str
    has_token: bool = False
    """its token was seen, so that it is known at once when it goes; the router has none"""
    lost_secs: float | None = None
    """when it went, None while it is alive"""
    went_in_order: bool = False
    """it went after the run was done, as it should"""
    status: Status | None = None
    speed: Speed = field(default_factory=Speed)
    """environment steps"""
    heard_secs: float | None = None
    """when its status was last heard; None before the first"""
    cpu: Speed = field(default_factory=Speed)
    """CPU milliseconds"""


@dataclass
class Tally:
    """What did not go as it should on the wire, summed over all lives that were heard of."""

    lost: int = 0
    duplicated: int = 0
    refused: int = 0
    resent: int = 0
    cut_off: int = 0
    """clients that the router shut out because they did too much"""

    def add(self, status: Status) -> None:
        """Add the totals of one life."""
        if status.service == ROUTER:
            # What it finds to be garbage is refused, and counted, by those who are meant to read it.
            self.cut_off += status.totals.get("cut_off", 0)
            return
        self.lost += status.lost
        self.duplicated += status.duplicated
        self.refused += sum(status.refused.values())
        self.resent += status.totals.get("resent", 0)


@dataclass(frozen=True, kw_only=True)
class BlockWork:
    """How far a block is in the current phase."""

    block: str
    progress: Progress | None
    """None before the first word of it"""
    left_secs: float | None
    """None while there is too little to tell"""
    learner: str
    """the life that spoke of it last; empty before the first word"""
    waits: bool
    """it is not finished, and nobody is there who works on it"""
    worker: str = "learner"
    """who should be"""


class Picture:
    """A run as it was last heard."""

    def __init__(self, run: str, folder: str, began_secs: float) -> None:
        self.run = run
        self.folder = folder
        self.began_secs = began_secs
        self.goals: GoalSettings | None = None
        """How reaching goals is rewarded; None if that is not known here."""
        self.worker = "learner"
        """Who works on blocks: "recorder" where nothing is learned."""
        self.opening = "starting the processes"
        """What goes on before the coordinator's first word."""
        self.dashboard = ""
        """Where a browser finds the dashboard; empty if there is none."""
        self.news: deque[str] = deque(maxlen=MOST_NEWS)
        """What happened, one sentence each; whoever shows it takes it out."""
        self.events: deque[tuple[float, str]] = deque(maxlen=MOST_EVENTS)
        """The last of what happened, with its time."""
        self.errors: dict[str, str] = {}
        """Process -> the newest of what went wrong there; the newest last."""
        self.scores: Sequence[Mapping[str, object]] = ()
        self.linked = True
        self._members: dict[str, Member] = {}
        self._latest = LatestPhase()
        self._term_secs = float("-inf")
        self._told: dict[str, tuple[int, str, Progress]] = {}
        """By block: the newest term in which somebody worked on it, who last spoke of that, and what."""
        self._speeds: dict[str, Speed] = {}
        self._gone: dict[str, float] = {}
        """Tokens that went while it was open whether it was the link or the member."""
        self._linked_secs = float("-inf")
        self._said_secs: dict[str, float] = {}
        self._mishaps: dict[str, float] = {}
        self._of_the_gone = Tally()
        self._last_words: dict[str, Status] = {}
        """Of those forgotten, the oldest first: one may be back (stopped and continued), and counts once."""

    @property
    def announced(self) -> PhaseAnnounced | None:
        """What the coordinator last said; None before its first word."""
        return self._latest.current

    @property
    def done(self) -> bool:
        """True once the coordinator has said that the run is done."""
        return self.announced is not None and self.announced.phase is Phase.DONE

    def know(self, settings: RunSettings) -> None:
        """Take what the run's settings say."""
        self.goals = settings.goals
        self.worker = RECORDER if settings.phases.open_loop else "learner"

    def hear_phase(self, announced: PhaseAnnounced, now_secs: float) -> None:
        """Take the coordinator's word."""
        before = self.announced
        if self._latest.admit(announced) and (before is None or announced.term > before.term):
            self._speeds.clear()
            self._term_secs = now_secs
            self.tell(phase_words(announced), now_secs)

    def hear_status(self, status: Status, now_secs: float) -> None:
        """Take a member's status."""
        member = self._members.setdefault(status.life, Member(status.life, status.service))
        self._last_words.pop(status.life, None)
        member.status, member.heard_secs = status, now_secs
        if not member.has_token:
            member.lost_secs = None
        member.cpu.hear(now_secs, round(1000 * status.metrics.get("cpu_secs", 0.0)))
        if "env_steps" in status.totals:
            member.speed.hear(now_secs, status.totals["env_steps"])
        if status.service == RECORDER and status.progress:
            self.worker = RECORDER
        for progress in status.progress:
            if status.term >= self._told.get(progress.block, (0,))[0]:
                self._told[progress.block] = status.term, status.life, progress
            if self.announced is not None and status.term == self.announced.term:
                self._speeds.setdefault(progress.block, Speed()).hear(now_secs, progress.done)
        if status.last_error:
            self.note_error(status.life, f"{status.life}: {status.last_error}", now_secs)

    def tell(self, sentence: str, now_secs: float) -> None:
        """Something happened."""
        self.news.append(sentence)
        self.events.append((now_secs, sentence))

    def note_error(self, where: str, sentence: str, now_secs: float) -> None:
        """Something went wrong; it is news once, and of one process only now and then."""
        if self.errors.get(where) == sentence:
            return
        self.errors.pop(where, None)
        self.errors[where] = sentence
        if now_secs >= self._said_secs.get(where, float("-inf")) + ERROR_SECS:
            self._said_secs[where] = now_secs
            self.tell(sentence, now_secs)

    def note_mishap(self, sentence: str, now_secs: float) -> None:
        """Something went wrong and is being dealt with; it is news, and to be seen for a while."""
        self.note_error(sentence, sentence, now_secs)
        self._mishaps[sentence] = now_secs

    def appeared(self, service: str, life: str, now_secs: float) -> None:
        """A member is there."""
        self._gone.pop(life, None)
        member = self._members.setdefault(life, Member(life, service))
        if member.lost_secs is not None:
            self.tell(f"{life} is back", now_secs)
        elif not member.has_token:
            self.tell(f"{life} is there", now_secs)
        member.has_token, member.lost_secs = True, None

    def vanished(self, life: str, now_secs: float) -> None:
        """A member's token is gone: it is lost, unless it was this process's own link."""
        member = self._members.get(life)
        if member is not None and member.lost_secs is None:
            self._gone.setdefault(life, now_secs)

    def link(self, up: bool, now_secs: float) -> None:
        """This process's own link to the router went or came back."""
        if up != self.linked:
            self.tell("the router is back" if up else "the link to the router is lost", now_secs)
        self.linked = up
        self._linked_secs = now_secs if up else float("inf")

    def settle(self, now_secs: float) -> None:
        """Call it now and then: decides which of the vanished members are lost, and forgets what is old."""
        if now_secs >= self._linked_secs + RETURN_SECS:
            for life in [life for life, secs in self._gone.items() if now_secs >= secs + DOUBT_SECS]:
                self._members[life].lost_secs = self._gone.pop(life)
                self._members[life].went_in_order = self.done
                self.tell(f"{life} {'has left' if self.done else 'is lost'}", now_secs)
            self._settle_silent(now_secs)
        for sentence in [s for s, secs in self._mishaps.items() if now_secs > secs + SHOW_MISHAP_SECS]:
            del self._mishaps[sentence]
            self.errors.pop(sentence, None)
        old = [
            m.life for m in self._members.values() if now_secs - (m.lost_secs or now_secs) > SHOW_LOST_SECS
        ]
        for life in old:
            if (status := self._members.pop(life).status) is not None:
                self._last_words[life] = status
            self.errors.pop(life, None)
        while len(self._last_words) > MOST_LAST_WORDS:
            self._of_the_gone.add(self._last_words.pop(next(iter(self._last_words))))

    def _settle_silent(self, now_secs: float) -> None:
        for member in self._members.values():
            if member.has_token or member.heard_secs is None or member.lost_secs is not None:
                continue
            if now_secs > member.heard_secs + SILENT_SECS:
                member.lost_secs = now_secs

    def members(self, service: str | None = None) -> list[Member]:
        """Those alive and those lost lately, of one service or of all."""
        return [m for _, m in sorted(self._members.items()) if service is None or m.service == service]

    def work(self, now_secs: float) -> list[BlockWork]:
        """How far the blocks are in the current phase, those that wait for their learner first."""
        if self.announced is None:
            return []
        term, blocks = self.announced.term, dict.fromkeys((*self.announced.blocks, *self._told))
        told = {block: self._told[block][1:] for block in blocks if self._told.get(block, (0,))[0] == term}
        late = now_secs >= self._term_secs + UNHEARD_SECS
        unheard = [block for block in self.announced.blocks if late and block not in told]
        works = [self._work(life, progress, now_secs) for life, progress in told.values()]
        works += [
            BlockWork(block=block, progress=None, left_secs=None, learner="", waits=True, worker=self.worker)
            for block in unheard
        ]
        return sorted(works, key=lambda work: not work.waits)

    def waiting(self) -> list[str]:
        """What is waited for, the coordinator's sentence first."""
        ranked = sorted(self.members(), key=lambda member: member.service != "coordinator")
        said = [m.status.waiting_for for m in ranked if m.status is not None and m.lost_secs is None]
        return list(dict.fromkeys(sentence for sentence in said if sentence))

    def tally(self) -> Tally:
        """Lost, duplicated, refused and resent, over all lives that were heard of."""
        tally = replace(self._of_the_gone)
        heard = [member.status for member in self._members.values() if member.status is not None]
        for status in (*self._last_words.values(), *heard):
            tally.add(status)
        return tally

    def cpu_secs(self) -> dict[str, float]:
        """Life -> CPU seconds, as last heard of it; those of the longest gone are forgotten."""
        heard = [member.status for member in self._members.values() if member.status is not None]
        said = {status.life: status for status in (*self._last_words.values(), *heard)}
        return {life: s.metrics["cpu_secs"] for life, s in sorted(said.items()) if "cpu_secs" in s.metrics}

    def recorded(self) -> Mapping[str, int]:
        """The totals that the recorder told last: rows, files, bytes, gaps; empty without a recorder."""
        told = [member for member in self.members(RECORDER) if member.status is not None]
        newest = max(told, key=lambda member: member.heard_secs or 0.0, default=None)
        return {} if newest is None or newest.status is None else newest.status.totals

    def measured(self) -> dict[str, dict[str, float]]:
        """Block -> the newest of what the learners measure, by names such as "policy/loss"."""
        blocks: dict[str, dict[str, float]] = {}
        for status in self._of_learners():
            for name, value in status.metrics.items():
                block, _, measure = name.partition("/")
                if measure:
                    blocks.setdefault(block, {})[measure] = value
        return blocks

    def versions(self) -> dict[str, int]:
        """The newest models, by "encoder/<block>" and "policy/<block>"."""
        newest: dict[str, int] = {}
        for status in self._of_learners():
            for name, version in status.versions.items():
                newest[name] = max(version, newest.get(name, 0))
        return newest

    def _of_learners(self) -> list[Status]:
        heard = (member.status for member in self.members() if member.service.endswith("_learner"))
        return [status for status in heard if status is not None]

    def _work(self, life: str, progress: Progress, now_secs: float) -> BlockWork:
        per_sec = self._speeds.setdefault(progress.block, Speed()).per_sec(now_secs)
        left = max(0, progress.wanted - progress.done)
        member = self._members.get(life)
        there = member is not None and member.lost_secs is None
        return BlockWork(
            block=progress.block,
            progress=progress,
            left_secs=left / per_sec if per_sec else None,
            learner=life,
            waits=not (there or progress.finished),
            worker=self.worker,
        )


def by_learner(works: Iterable[BlockWork]) -> dict[str, list[BlockWork]]:
    """The works by the life that spoke of them last, in the order in which they are given."""
    groups: dict[str, list[BlockWork]] = {}
    for work in works:
        groups.setdefault(work.learner, []).append(work)
    return groups


def slowest(works: Sequence[BlockWork], most: int) -> list[BlockWork]:
    """So many of those of which the least is done; what waits for its learner comes first."""
    return sorted(works, key=lambda work: (not work.waits, _share(work)))[:most]


def together(works: Sequence[BlockWork]) -> BlockWork:
    """All of a learner's blocks as if they were one."""
    told = [work.progress for work in works if work.progress is not None]
    done, wanted = sum(each.done for each in told), sum(each.wanted for each in told)
    left = [work.left_secs for work in works if work.progress is None or not work.progress.finished]
    known = [secs for secs in left if secs is not None]
    finished = all(work.progress is not None and work.progress.finished for work in works)
    return BlockWork(
        block=f"{len(works)} blocks",
        progress=told[0].model_copy(update={"done": done, "wanted": wanted, "finished": finished})
        if told
        else None,
        left_secs=max(known) if known and len(known) == len(left) else None,
        learner=works[0].learner,
        waits=all(work.waits for work in works),
        worker=works[0].worker,
    )


def _share(work: BlockWork) -> float:
    return 0.0 if work.progress is None else work.progress.done / max(1, work.progress.wanted)
