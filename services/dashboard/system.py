"""How the processes do: speeds, lag, queues, losses, CPU and memory, who is there, and what happened."""

from collections.abc import Iterator
from dataclasses import dataclass

import rerun as rr

from protocol.messages import Status
from services.dashboard.canvas import Canvas, Due, Lines, colours, page, plain
from services.dashboard.colours import GREEN, GREY, SKY, VERMILLION, WHITE, YELLOW, Colour, of_index
from services.dashboard.roster import MOST_ACTORS, MOST_OTHERS, Member, News, Roster

DRAW_SECS = 1.0
SLOW_SECS = 5.0
"""CPU and memory"""
THIN_SECS = 2.0
"""Time between rows of the file."""
REPEAT_SECS = 60.0
"""States that still hold are said again so often, since viewers that join late get a limited past."""
MOST_NEWS_PER_DRAW = 20
LONGEST_WAIT = 60
"""characters of what a member waits for"""
MEMBER_STATES = {"alive": GREEN, "silent": YELLOW, "lost": VERMILLION, "left": GREY}
TROUBLES = {"lost": VERMILLION, "duplicated": SKY, "refused": YELLOW}
SHOWN = ("actors", "encoder_learner", "policy_learner", "coordinator", "dashboard", "launcher", "recorder")
"""services with a colour of their own"""


@dataclass
class _Load:
    queue_depth: int = 0
    cores: float = 0.0
    memory_mb: float = 0.0

    def add(self, member: Member, status: Status, now_secs: float) -> None:
        self.queue_depth += status.queue_depth
        self.cores += member.cpu_secs.per_sec(now_secs) or 0.0
        self.memory_mb += status.metrics.get("rss_mb", 0.0)


class SystemPanel:
    """Under /system, /members, /status/members and /events."""

    def __init__(self, roster: Roster) -> None:
        self._roster = roster
        self._lines = Lines()
        self._due, self._thin, self._slow = Due(DRAW_SECS), Due(THIN_SECS), Due(SLOW_SECS)
        self._repeat = Due(REPEAT_SECS)
        self._states: dict[str, str] = {}

    def begin(self, canvas: Canvas) -> None:
        """Name the lines, and say the states that hold."""
        self._lines.begin(canvas)
        self._lines.name(canvas, "/system/steps_per_sec_all", "all actors", WHITE, 2.0)
        for name, colour in TROUBLES.items():
            self._lines.name(canvas, f"/system/{name}", name, colour)
        for label, state in self._states.items():
            _configure(canvas, label)
            canvas.log(f"/members/{label}", rr.StateChange(state=state))

    def draw(self, canvas: Canvas, now_secs: float) -> None:
        """Log what happened at once, and the rest each second."""
        for _ in range(min(len(self._roster.news), MOST_NEWS_PER_DRAW)):
            _tell(canvas, self._roster.news.popleft())
        if not self._due(now_secs):
            return
        self._draw_states(canvas, now_secs, again=self._repeat(now_secs))
        thin = self._thin(now_secs)
        self._draw_speeds(canvas, now_secs, thin=thin)
        self._draw_loads(canvas, now_secs, thin=thin, slow=self._slow(now_secs))
        for name, total in troubles(self._roster).items():
            self._lines.add(canvas, f"/system/{name}", total, thin=thin)
        canvas.log("/status/members", page(members_table(self._roster, now_secs)), thin=thin)

    def _draw_states(self, canvas: Canvas, now_secs: float, *, again: bool) -> None:
        states = {member.label: member.state(now_secs) for member in self._roster}
        for label, state in states.items():
            if again or self._states.get(label) != state:
                if label not in self._states:
                    _configure(canvas, label)
                canvas.log(f"/members/{label}", rr.StateChange(state=state))
        self._states |= states

    def _draw_speeds(self, canvas: Canvas, now_secs: float, *, thin: bool) -> None:
        """Each actor's, 0 when it is lost, and the sum."""
        speeds = {m.label: _speed(m, now_secs) for m in self._roster if m.service == "actor"}
        for label, speed in speeds.items():
            path, colour = f"/system/steps_per_sec/{label}", of_index(int(label[1:]))
            self._add(canvas, path, label, colour, speed, thin=thin)
        known = [speed for speed in speeds.values() if speed is not None]
        if known:
            self._lines.add(canvas, "/system/steps_per_sec_all", sum(known), thin=thin)

    def _draw_loads(self, canvas: Canvas, now_secs: float, *, thin: bool, slow: bool) -> None:
        """Queues, CPU and memory: of each service, and of all actors together."""
        loads: dict[str, _Load] = {}
        for member in self._roster:
            if member.status is not None and member.lost_secs is None:
                who = "actors" if member.service == "actor" else member.label
                loads.setdefault(who, _Load()).add(member, member.status, now_secs)
        for who, load in loads.items():
            colour = _colour(who)
            self._add(canvas, f"/system/queue_depth/{who}", who, colour, load.queue_depth, thin=thin)
            if slow:
                self._add(canvas, f"/system/cpu/{who}", who, colour, load.cores)
                self._add(canvas, f"/system/rss_mb/{who}", who, colour, load.memory_mb)

    def _add(
        self, canvas: Canvas, path: str, name: str, colour: Colour, value: float | None, *, thin: bool = True
    ) -> None:
        self._lines.name(canvas, path, name, colour)
        self._lines.add(canvas, path, value, thin=thin)


def members_table(roster: Roster, now_secs: float) -> str:
    """All members as a table in Markdown, the learners first."""
    rows = [
        "| member | state | heard | steps/s | queue | lost | refused | CPU | MB | versions | waits for |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for member in roster:
        state, ago = member.state(now_secs), f"{max(0.0, now_secs - member.heard_secs):.0f} s ago"
        cells = [f"{member.label}", state, ago, *_words(member, now_secs)]
        rows.append("| " + " | ".join(_cell(cell) for cell in cells) + " |")
    if roster.not_shown:
        rows += ["", f"There are more than are shown: {MOST_ACTORS} actors and {MOST_OTHERS} others."]
    return "\n".join(rows)


def troubles(roster: Roster) -> dict[str, int]:
    """Frames lost, duplicated and refused, by all members together, those that are gone too."""
    return {name: roster.ledger[name] for name in TROUBLES}


def _words(member: Member, now_secs: float) -> Iterator[str]:
    status = member.status
    if status is None:
        yield from [""] * 7
        yield "has said nothing yet"
        return
    yield _number(member.env_steps.per_sec(now_secs), ",.0f")
    yield f"{status.queue_depth:,}"
    yield f"{status.lost:,}"
    yield f"{sum(status.refused.values()):,}"
    yield _number(member.cpu_secs.per_sec(now_secs), ".2f")
    yield _number(status.metrics.get("rss_mb"), ",.0f")
    yield " ".join(f"{name.split('/')[0][0]}{version}" for name, version in list(status.versions.items())[:4])
    yield status.waiting_for[:LONGEST_WAIT]


def _number(value: float | None, form: str) -> str:
    return "" if value is None else format(value, form)


def _cell(text: str) -> str:
    return text.replace("|", "/").replace("\n", " ")


def _speed(member: Member, now_secs: float) -> float | None:
    if member.lost_secs is not None:
        return 0.0
    return member.env_steps.per_sec(now_secs)


def _colour(who: str) -> Colour:
    """Of a service, or of the actors together."""
    return of_index(SHOWN.index(who)) if who in SHOWN else WHITE


def _configure(canvas: Canvas, label: str) -> None:
    config = rr.StateConfiguration(values=list(MEMBER_STATES), colors=colours(list(MEMBER_STATES.values())))
    canvas.log(f"/members/{label}", config, static=True)


def _tell(canvas: Canvas, news: News) -> None:
    level = rr.TextLogLevel.WARN if news.bad else rr.TextLogLevel.INFO
    canvas.log("/events", rr.TextLog(plain(news.text), level=level))
