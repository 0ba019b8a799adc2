"""The texts that people see, as lines of styled pieces for a width (pure)."""

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from services.launcher.members import BlockWork, Member, Picture, phase_words

Line = tuple[tuple[str, str], ...]
"""Pieces of (text, style of rich); nothing is told by the style alone."""

Row = Mapping[str, object]
"""A line of `scores.jsonl`."""

COLUMNS = (
    ("separation", "separation", 10),
    ("z_min", "z_min", 5),
    ("z_goal", "z_goal", 6),
    ("switch_success", "switch", 6),
    ("crossing", "crossing", 8),
    ("landmarks", "landmark", 8),
    ("external_reward", "reward", 8),
)
"""Of a row: field, head and width. Of several landmarks the least is shown."""
TABLE_WIDTH = 60
LEFT_OUT = ("z_goal", "switch_success", "separation")
"""Where all would be wider than that: what success is not asked of, one after the other."""
MOST_ACTORS = 8
MOST_ROWS = 8
MOST_ERRORS = 3
LONGEST_BAR = 30


@dataclass(frozen=True, kw_only=True)
class Signs:
    """The characters of bars and marks."""

    full: str = "█"
    empty: str = "░"
    dash: str = "·"


ASCII = Signs(full="#", empty="-", dash="-")
"""Where the terminal's encoding has no others."""


def frame(picture: Picture, now_secs: float, width: int, signs: Signs | None = None) -> list[Line]:
    """The live view; no line is wider than `width`."""
    signs = signs or Signs()
    rows = [_headline(picture, now_secs, width, signs), *_phase(picture, now_secs, width, signs)]
    rows += [(), *_members(picture, now_secs, width, signs)]
    if picture.scores:
        rows += [(), *(((text, ""),) for text in score_table(picture.scores, newest=MOST_ROWS))]
    if picture.errors:
        rows.append(())
        for error in list(picture.errors.values())[-MOST_ERRORS:]:
            rows += [((text, "red"),) for text in _wrapped(f"! {error}", width, most=3)]
    rows += [(), *(((picture.folder[i : i + width], "dim"),) for i in range(0, len(picture.folder), width))]
    return [_clipped(row, width) for row in rows]


def progress_line(picture: Picture, now_secs: float) -> str:
    """The state in one line, for where there is no terminal."""
    if picture.announced is None:
        return "waiting for the coordinator"
    parts = [f"{phase_words(picture.announced)}: {_work_words(work)}" for work in picture.work(now_secs)]
    parts = parts or [": ".join([phase_words(picture.announced), *picture.waiting()[:1]])]
    if rate := _total_rate(picture, now_secs):
        parts.append(f"{rate:,.0f} steps/s")
    return "; ".join(parts)


def score_words(row: Row) -> str:
    """One line of scores as a sentence."""
    shown = [
        f"{head} {_number(row[name])}" for name, head, _ in COLUMNS if isinstance(row.get(name), int | float)
    ]
    shown += [f"{name} {_number(share)}" for name, share in _landmarks(row).items()]
    return (
        f"scores of {row['block']}, iteration {row['iteration']}, {row['policy']} policy: {', '.join(shown)}"
    )


def score_table(rows: Sequence[Row], *, newest: int | None = None) -> list[str]:
    """All scores in lines of at most 60 characters, block by block; or only the newest."""
    shown = rows if newest is None else rows[-newest:]
    columns = _columns(shown)
    blocks = list(dict.fromkeys(str(row["block"]) for row in shown))
    lines = ["  ".join([f"{'iter':>4}", f"{'policy':<7}", *(f"{head:>{size}}" for _, head, size in columns)])]
    for block in blocks:
        lines += [f"{block[: TABLE_WIDTH - 1]}:"] if len(blocks) > 1 else []
        lines += [_score_line(row, columns) for row in shown if row["block"] == block]
    return lines


def best_words(best: Mapping[str, Row]) -> list[str]:
    """Which iteration is kept, and why."""
    return [f"best of {block}: {row['reason']}" for block, row in best.items()]


def cpu_table(cpu_secs: Mapping[str, float]) -> list[str]:
    """CPU seconds by process and in sum."""
    rows = [*cpu_secs.items(), ("all", sum(cpu_secs.values()))]
    longest = max(len(name) for name, _ in rows)
    return [f"{name:<{longest}}  {secs:7.1f} s" for name, secs in rows]


def clock_words(secs: float) -> str:
    """A duration: 0:42, 12:05, 1:02:03."""
    minutes, seconds = divmod(round(max(0.0, secs)), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{seconds:02}" if hours else f"{minutes}:{seconds:02}"


def _headline(picture: Picture, now_secs: float, width: int, signs: Signs) -> Line:
    time = clock_words(now_secs - picture.began_secs)
    title = f"Babble {signs.dash} {picture.run}"[: max(0, width - len(time) - 1)]
    return (title, "bold"), (" " * max(1, width - len(title) - len(time)), ""), (time, "")


def _phase(picture: Picture, now_secs: float, width: int, signs: Signs) -> list[Line]:
    if picture.announced is None:
        return [(("starting the processes", "bold cyan"),)]
    rows: list[Line] = [((phase_words(picture.announced), "bold cyan"),)]
    works = picture.work(now_secs)
    longest = max((len(work.progress.block) for work in works), default=0)
    for work in works:
        rows += _bar(work, longest, width, signs)
    if not picture.linked:
        rows.append((("the link to the router is lost; it comes back by itself", "yellow"),))
    for sentence in picture.waiting()[:3]:
        rows += [((text, "yellow"),) for text in _wrapped(sentence, width, most=2)]
    return rows


def _bar(work: BlockWork, longest: int, width: int, signs: Signs) -> list[Line]:
    progress = work.progress
    share = 1.0 if progress.wanted == 0 else min(1.0, progress.done / progress.wanted)
    words = _amount(work)
    size = min(LONGEST_BAR, width - longest - len(words) - 4)
    name = f"{progress.block:<{longest}}  "
    if size < 6:
        return [((name, ""), (words, ""))]
    full = round(size * share)
    return [
        ((name, ""), (signs.full * full, "green"), (signs.empty * (size - full), "dim"), (f"  {words}", ""))
    ]


def _work_words(work: BlockWork) -> str:
    return f"{work.progress.block} {_amount(work)}"


def _amount(work: BlockWork) -> str:
    progress = work.progress
    words = f"{progress.done:,} of {progress.wanted:,} {progress.unit}"
    if progress.finished or work.left_secs is None:
        return words
    return f"{words}, {clock_words(work.left_secs)} left"


def _members(picture: Picture, now_secs: float, width: int, signs: Signs) -> list[Line]:
    actors = picture.members("actor")
    others = [member for member in picture.members() if member.service != "actor"]
    rows: list[Line] = []
    if others:
        rows += [
            ((text, ""),) for text in _packed((f"{m.service} {_state(m)}" for m in others), width, signs)
        ]
    for member in actors[:MOST_ACTORS]:
        rows.append(_actor(member, now_secs))
    if len(actors) > MOST_ACTORS:
        rows.append(((f"and {len(actors) - MOST_ACTORS} more actors", ""),))
    alive = sum(member.lost_secs is None for member in actors)
    if alive > 1 and (rate := _total_rate(picture, now_secs)):
        rows.append(((f"{f'{alive} actors together':<22}{rate:>9,.0f} steps/s", "bold"),))
    return rows or [(("nobody is there yet", "yellow"),)]


def _actor(member: Member, now_secs: float) -> Line:
    if member.lost_secs is not None:
        return ((f"{member.life:<22}", ""), (f"{_state(member):>9}", "" if member.went_in_order else "red"))
    rate = member.speed.per_sec(now_secs)
    words = f"{rate:>9,.0f} steps/s" if rate else f"{'alive':>9}"
    return ((f"{member.life:<22}", ""), (words, "green"))


def _state(member: Member) -> str:
    if member.lost_secs is None:
        return "alive"
    return "left" if member.went_in_order else "lost"


def _total_rate(picture: Picture, now_secs: float) -> float:
    alive = [member for member in picture.members("actor") if member.lost_secs is None]
    return sum(member.speed.per_sec(now_secs) or 0.0 for member in alive)


def _columns(rows: Sequence[Row]) -> list[tuple[str, str, int]]:
    """What the rows have, and there is room for."""
    columns = [column for column in COLUMNS if any(_measure(row, column[0]) is not None for row in rows)]
    for least in LEFT_OUT:
        if len("iter  sampled") + sum(2 + size for _, _, size in columns) > TABLE_WIDTH:
            columns = [column for column in columns if column[0] != least]
    return columns


def _score_line(row: Row, columns: Iterable[tuple[str, str, int]]) -> str:
    cells = [f"{_number(_measure(row, name), size):>{size}}" for name, _, size in columns]
    return "  ".join([f"{row['iteration']:>4}", f"{row['policy']!s:<7}", *cells])


def _measure(row: Row, name: str) -> object:
    return min(_landmarks(row).values(), default=None) if name == "landmarks" else row.get(name)


def _landmarks(row: Row) -> Mapping[str, float]:
    shares = row.get("landmarks")
    return shares if isinstance(shares, Mapping) else {}


def _number(value: object, size: int = 8) -> str:
    """With three digits after the point, as far as there is room."""
    if not isinstance(value, int | float):
        return "-"
    texts = (f"{value:.{digits}f}" for digits in (3, 2, 1, 0))
    return next((text for text in texts if len(text) <= size), f"{value:.0e}")


def _wrapped(text: str, width: int, *, most: int) -> list[str]:
    return textwrap.wrap(text, width, max_lines=most, placeholder=" ...", subsequent_indent="  ")


def _packed(words: Iterable[str], width: int, signs: Signs) -> list[str]:
    """As many on a line as there is room for, none broken."""
    lines: list[str] = []
    for word in words:
        longer = f"{lines[-1]} {signs.dash} {word}" if lines else ""
        if lines and len(longer) <= width:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines


def _clipped(line: Line, width: int) -> Line:
    pieces: list[tuple[str, str]] = []
    for text, style in line:
        pieces.append((text[:width], style))
        width = max(0, width - len(text))
    return tuple(pieces)
