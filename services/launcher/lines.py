"""The words and tables that people see, in a terminal or not (pure)."""

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from services.launcher.learning import learning_words
from services.launcher.members import RECORDER, BlockWork, Picture, by_learner
from services.runtime.phases import phase_words

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

MOST_BLOCKS = 4
"""Of one learner; where it has more, a line tells of them together."""


@dataclass(frozen=True, kw_only=True)
class Signs:
    """The characters of bars and marks."""

    full: str = "█"
    empty: str = "░"
    dash: str = "·"


ASCII = Signs(full="#", empty="-", dash="-")
"""Where the terminal's encoding has no others."""


def progress_line(picture: Picture, now_secs: float) -> str:
    """The state in one line, for where there is no terminal."""
    if not picture.linked:
        return "waiting for the router"
    if picture.announced is None:
        return "waiting for the coordinator"
    told = _works_words(picture.work(now_secs)) or picture.waiting()[:1]
    parts = [": ".join([phase_words(picture.announced), *told[:1]]), *told[1:]]
    if rate := total_rate(picture, now_secs):
        parts.append(f"{rate:,.0f} steps/s")
    if learned := learning_words(picture):
        parts.append(learned)
    if rows := picture.recorded().get("rows"):
        parts.append(f"{rows:,} rows recorded")
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
    lines = [_heads(columns)]
    for block in blocks:
        lines += [f"{block[: TABLE_WIDTH - 1]}:"] if len(blocks) > 1 else []
        lines += [_score_line(row, columns) for row in shown if row["block"] == block]
    return lines


def block_table(rows: Sequence[Row], *, most: int | None = None) -> list[str]:
    """A line per block, of its newest row and by mean actions if there is one; so many lines at most.

    Blocks come with the least z_min first, so that what is left out is better than what is shown.
    """
    newest: dict[str, Row] = {}
    for row in rows:
        block, last = str(row["block"]), newest.get(str(row["block"]))
        if last is None or last["policy"] != "mean" or row["policy"] == "mean":
            newest[block] = row
    shown = sorted(newest.values(), key=lambda row: float(str(row["z_min"])))
    columns, longest = _columns(shown), max(map(len, ["block", *newest]))
    lines = [f"{'block':<{longest}}  {_heads(columns)}"]
    lines += [f"{row['block']!s:<{longest}}  {_score_line(row, columns)}" for row in shown]
    return shortened(lines, most)


def shortened(lines: Sequence[str], most: int | None) -> list[str]:
    """The first lines; the last of so many says how many there are besides."""
    if most is None or len(lines) <= most:
        return list(lines)
    return [*lines[: max(0, most - 1)], f"and {len(lines) - max(0, most - 1)} more"][:most]


def brief(rows: Sequence[Row], best: Mapping[str, Row], newest: int) -> list[Row]:
    """Of each block the rows of so many of its newest iterations, and of the one that is kept."""
    blocks = dict.fromkeys(str(row["block"]) for row in rows)
    wanted = set[tuple[str, object]]()
    for block in blocks:
        iterations = sorted({int(str(row["iteration"])) for row in rows if row["block"] == block})
        wanted |= {(block, iteration) for iteration in iterations[-newest:]}
    wanted |= {(block, row["iteration"]) for block, row in best.items()}
    return [row for row in rows if (str(row["block"]), row["iteration"]) in wanted]


def has_many_blocks(rows: Sequence[Row]) -> bool:
    """True where a table of each block's iterations would fill a screen."""
    return len({str(row["block"]) for row in rows}) > MOST_BLOCKS + 2


def kept_table(rows: Sequence[Row], best: Mapping[str, Row]) -> list[str]:
    """A line per block: the iteration that is kept, or the newest of blocks that keep none yet."""
    kept = [row for row in rows if row["iteration"] == best.get(str(row["block"]), row)["iteration"]]
    return block_table(kept)


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


def _works_words(works: Sequence[BlockWork]) -> list[str]:
    """What works, learner by learner where there are several; then who waits for one."""
    groups = by_learner(work for work in works if not work.waits)
    words = [
        f"{life}: {_group_words(group)}" if len(groups) > 1 else _group_words(group)
        for life, group in groups.items()
    ]
    waiting = [work.block for work in works if work.waits]
    worker = next((work.worker for work in works if work.waits), "")
    if waiting:
        shown = [
            *waiting[:MOST_BLOCKS],
            *([f"{len(waiting) - MOST_BLOCKS} more"] * (len(waiting) > MOST_BLOCKS)),
        ]
        words.append(f"waiting for a {worker}: {', '.join(shown)}")
    return words


def _group_words(group: Sequence[BlockWork]) -> str:
    """Each block of a learner, or where they are many what is done of all of them, and the slowest."""
    if len(group) <= MOST_BLOCKS:
        return ", ".join(f"{work.block} {amount_words(work)}" for work in group)
    told = [work.progress for work in group if work.progress is not None]
    done, wanted = sum(each.done for each in told), sum(each.wanted for each in told)
    slowest = min(told, key=lambda each: each.done / max(1, each.wanted))
    return (
        f"{len(told)} blocks {done:,} of {wanted:,} {slowest.unit}, least of {slowest.block} "
        f"{slowest.done:,} of {slowest.wanted:,}"
    )


def amount_words(work: BlockWork) -> str:
    """How far a block is, and how long it still takes, or that it waits."""
    progress = work.progress
    words = [] if progress is None else [f"{progress.done:,} of {progress.wanted:,} {progress.unit}"]
    if work.waits:
        words.append(f"waiting for {'the' if work.worker == RECORDER else 'its'} {work.worker}")
    elif work.left_secs is not None and progress is not None and not progress.finished:
        words.append(f"{clock_words(work.left_secs)} left")
    return ", ".join(words)


def total_rate(picture: Picture, now_secs: float) -> float:
    """Environment steps per second of all actors that are there."""
    alive = [member for member in picture.members("actor") if member.lost_secs is None]
    return sum(member.speed.per_sec(now_secs) or 0.0 for member in alive)


def _columns(rows: Sequence[Row]) -> list[tuple[str, str, int]]:
    """What the rows have, and there is room for."""
    columns = [column for column in COLUMNS if any(_measure(row, column[0]) is not None for row in rows)]
    for least in LEFT_OUT:
        if len("iter  sampled") + sum(2 + size for _, _, size in columns) > TABLE_WIDTH:
            columns = [column for column in columns if column[0] != least]
    return columns


def _heads(columns: Iterable[tuple[str, str, int]]) -> str:
    return "  ".join([f"{'iter':>4}", f"{'policy':<7}", *(f"{head:>{size}}" for _, head, size in columns)])


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


def wrapped(text: str, width: int, *, most: int) -> list[str]:
    """A sentence on so many lines at most."""
    return textwrap.wrap(text, width, max_lines=most, placeholder=" ...", subsequent_indent="  ")


def packed(words: Iterable[str], width: int, signs: Signs) -> list[str]:
    """As many on a line as there is room for, none broken."""
    lines: list[str] = []
    for word in words:
        longer = f"{lines[-1]} {signs.dash} {word}" if lines else ""
        if lines and len(longer) <= width:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines


def clipped(line: Line, width: int) -> Line:
    """The line, no wider than that."""
    pieces: list[tuple[str, str]] = []
    for text, style in line:
        pieces.append((text[:width], style))
        width = max(0, width - len(text))
    return tuple(pieces)
