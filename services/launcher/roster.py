"""The table of a run's members: when each was last heard, how fast it is, what it holds and costs (pure)."""

from collections.abc import Sequence

from services.launcher.lines import Line, total_rate
from services.launcher.members import UNEASY_SECS, Member, Picture

COLUMNS = (("heard", 9), ("steps/s", 9), ("queue", 6), ("cpu", 6), ("MB", 6))
"""Heads and widths; where a terminal is narrow, the last ones are left out."""
LIFE_WIDTH = 24
"""What a life gets before the columns do; where there is room, it gets all it needs."""
CUT = "~"
LEAST_LIFE_WIDTH = 8
MOST_ACTORS = 8


def roster(picture: Picture, now_secs: float, width: int, most: int | None = None) -> list[Line]:
    """The table in at most so many lines: services first, then actors, then what these do together."""
    columns = _columns(width)
    actors = picture.members("actor")
    members = [member for member in picture.members() if member.service != "actor"] + actors
    longest = max((len(member.life) for member in members), default=0)
    life_width = min(max(LIFE_WIDTH, longest), width - sum(size for _, size in columns))
    together = _together(actors, columns, life_width, total_rate(picture, now_secs))
    room = len(members) + 2 if most is None else most - 1 - len(together)
    shown = min(len(members) - max(0, len(actors) - MOST_ACTORS), room)
    if shown < len(members):
        shown = max(0, min(shown, room - 1))
    left_out = len(members) - shown
    head = "".join(f"{name:>{size}}" for name, size in columns)
    rows: list[Line] = [((f"{'member':<{life_width}}{head}", "bold"),)]
    rows += [_row(member, columns, life_width, now_secs) for member in members[:shown]]
    rows += [((f"and {left_out} more", ""),)] if left_out else []
    return (rows + together)[:most]


def _columns(width: int) -> Sequence[tuple[str, int]]:
    room = width - LIFE_WIDTH
    columns = list(COLUMNS)
    while len(columns) > 1 and sum(size for _, size in columns) > room:
        columns.pop()
    if sum(size for _, size in columns) > width - LEAST_LIFE_WIDTH:
        columns.pop()
    return columns


def _row(member: Member, columns: Sequence[tuple[str, int]], life_width: int, now_secs: float) -> Line:
    cells = "".join(f"{_cell(member, name, now_secs):>{size}}" for name, size in columns)
    return ((f"{_name(member.life, life_width):<{life_width}}", ""), (cells, _style(member, now_secs)))


def _name(life: str, width: int) -> str:
    """The life, or its begin and its end: in between is what many of one host have in common."""
    if len(life) <= width:
        return life
    head, _, tail = life.rpartition("-")
    room = width - len(tail) - len(CUT)
    return f"{head[:room]}{CUT}{tail}" if room > 0 else life[:width]


def _cell(member: Member, name: str, now_secs: float) -> str:
    if name == "heard":
        return _heard(member, now_secs)
    status = member.status
    if status is None or member.lost_secs is not None:
        return "-"
    match name:
        case "steps/s":
            rate = member.speed.per_sec(now_secs)
            return "-" if rate is None else f"{rate:,.0f}"
        case "queue":
            return f"{status.queue_depth:,}"
        case "cpu":
            milliseconds = member.cpu.per_sec(now_secs)
            return "-" if milliseconds is None else f"{milliseconds / 10:.0f} %"
    return f"{status.metrics.get('rss_mb', 0.0):,.0f}"


def _heard(member: Member, now_secs: float) -> str:
    if member.lost_secs is not None:
        return "left" if member.went_in_order else "lost"
    if member.heard_secs is None:
        return "not yet"
    return f"{max(0.0, now_secs - member.heard_secs):.1f} s"


def _style(member: Member, now_secs: float) -> str:
    if member.lost_secs is not None:
        return "" if member.went_in_order else "red"
    quiet = member.heard_secs is None or now_secs - member.heard_secs > UNEASY_SECS
    return "yellow" if quiet else "green"


def _together(
    actors: Sequence[Member], columns: Sequence[tuple[str, int]], life_width: int, rate: float
) -> list[Line]:
    alive = sum(member.lost_secs is None for member in actors)
    if alive < 2 or not rate or len(columns) < 2:
        return []
    words = f"{alive} actors together"[:life_width]
    return [((f"{words:<{life_width}}{'':>{columns[0][1]}}{rate:>{columns[1][1]},.0f}", "bold"),)]
