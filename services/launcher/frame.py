"""The view of a run for a terminal of any size; a small one shows the most important (pure)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from services.launcher.learning import encoder_words, learning_table, model_words, policy_words
from services.launcher.lines import (
    MOST_BLOCKS,
    Line,
    Signs,
    amount_words,
    block_table,
    clipped,
    clock_words,
    packed,
    score_table,
    shortened,
    wrapped,
)
from services.launcher.members import BlockWork, Picture, by_learner, slowest, together
from services.launcher.recorded import counts_words
from services.launcher.roster import roster
from services.runtime.phases import phase_words

MOST_ROWS = 8
"""Of the table of scores."""
MOST_ERRORS = 3
MOST_EVENTS = 8
MOST_TOLD = 2
"""Blocks whose learning is told in sentences; of more there is a table."""
LONGEST_BAR = 30
LEAST_BAR = 6
LAST_IMPORTANT = 5
"""The rank of the last section that is shown whole before any gap."""


@dataclass(frozen=True, kw_only=True)
class Section:
    """Lines that belong together."""

    rank: int
    """the smaller, the more important"""
    wanted: int
    """lines it has"""
    least: int
    """lines it gets before any section gets more than that"""
    fit: Callable[[int], Sequence[Line]]
    """so many of its lines, the most important ones"""


def frame(
    picture: Picture, now_secs: float, width: int, height: int | None = None, signs: Signs | None = None
) -> list[Line]:
    """The live view; no line is wider than `width`, and there are no more than `height`."""
    signs = signs or Signs()
    sections = [
        section
        for section in (
            _headline(picture, now_secs, width, signs),
            _phase(picture, now_secs, width, signs),
            _errors(picture, width),
            _learning(picture, width, signs),
            _recorded(picture),
            _members(picture, now_secs, width),
            _wire(picture, width, signs),
            _scores(picture),
            _events(picture, width),
            _folder(picture, width),
        )
        if section.wanted
    ]
    rows: list[Line] = []
    for section, (count, gap) in zip(sections, _shared(sections, height), strict=True):
        rows += [()] if gap else []
        rows += section.fit(count) if count else []
    return [clipped(row, width) for row in rows]


def facts(picture: Picture, now_secs: float, width: int, signs: Signs | None = None) -> list[Line]:
    """What works, goes wrong and is learned, who is there and how the wire does, of any height."""
    signs = signs or Signs()
    rows: list[Line] = []
    for section in (
        _section(1, _works(picture, now_secs, width, signs), 0),
        _errors(picture, width),
        _learning(picture, width, signs),
        _recorded(picture),
        _members(picture, now_secs, width),
        _wire(picture, width, signs),
    ):
        if section.wanted:
            rows += [(), *section.fit(section.wanted)]
    return [clipped(row, width) for row in rows]


def _shared(sections: Sequence[Section], height: int | None) -> list[tuple[int, bool]]:
    """How many lines each section gets, and whether an empty one comes before it.

    First what each needs at least, the most important first; then whatever else the important ones have,
    then the gaps, then the rest.
    """
    room = height if height is not None else sum(section.wanted + 1 for section in sections)
    order = sorted(range(len(sections)), key=lambda i: sections[i].rank)
    counts, gaps = [0] * len(sections), [False] * len(sections)
    for i in order:
        counts[i] = min(sections[i].least, sections[i].wanted, room)
        room -= counts[i]
    for important in (True, False):
        for i in order:
            if (sections[i].rank <= LAST_IMPORTANT) == important:
                more = min(sections[i].wanted - counts[i], room)
                counts[i] += more
                room -= more
        for i in range(1, len(sections) if important else 0):
            gaps[i] = room > 0 and counts[i] > 0
            room -= gaps[i]
    return list(zip(counts, gaps, strict=True))


def _section(rank: int, rows: Sequence[Line], least: int) -> Section:
    """A section whose first lines are the most important."""
    return Section(rank=rank, wanted=len(rows), least=least, fit=lambda count: rows[:count])


def _headline(picture: Picture, now_secs: float, width: int, signs: Signs) -> Section:
    time = clock_words(now_secs - picture.began_secs)
    title = f"Babble {signs.dash} {picture.run}"
    apart = bool(picture.dashboard) and len(title) + len(picture.dashboard) + len(time) + 4 > width
    if picture.dashboard and not apart:
        time = f"{picture.dashboard}  {time}"
    title = title[: max(0, width - len(time) - 1)]
    gap = " " * max(1, width - len(title) - len(time))
    rows: list[Line] = [((title, "bold"), (gap, ""), (time, ""))]
    rows += [((picture.dashboard, ""),)] if apart else []
    return _section(0, rows, len(rows))


def _phase(picture: Picture, now_secs: float, width: int, signs: Signs) -> Section:
    if picture.announced is None:
        return _section(1, [((picture.opening, "bold cyan"),)], 1)
    rows: list[Line] = [((phase_words(picture.announced), "bold cyan"),)]
    rows += _works(picture, now_secs, width, signs, most=MOST_BLOCKS)
    if not picture.linked:
        rows.append((("the link to the router is lost; it comes back by itself", "yellow"),))
    for sentence in picture.waiting()[:3]:
        rows += [((text, "yellow"),) for text in wrapped(sentence, width, most=2)]
    return _section(1, rows, 4)


def _works(
    picture: Picture, now_secs: float, width: int, signs: Signs, most: int | None = None
) -> list[Line]:
    """A bar for each block at work, learner by learner where there are several.

    Where a learner has more than `most`: one for all together, then one for each of the slowest.
    """
    groups = by_learner(picture.work(now_secs))
    if most is not None:
        groups = {
            life: [together(group), *slowest(group, most - 1)] if len(group) > most + 1 else group
            for life, group in groups.items()
        }
    longest = max((len(work.block) for group in groups.values() for work in group), default=0)
    rows: list[Line] = []
    for life, group in groups.items():
        rows += [((life or f"no {group[0].worker} yet", ""),)] if len(groups) > 1 else []
        rows += [_bar(work, longest, width, signs) for work in group]
    return rows


def _bar(work: BlockWork, longest: int, width: int, signs: Signs) -> Line:
    progress, words = work.progress, amount_words(work)
    style = "yellow" if work.waits else ""
    size = min(LONGEST_BAR, width - longest - len(words) - 4)
    name = f"{work.block:<{longest}}  "
    if size < LEAST_BAR or progress is None:
        return (name, ""), (words, style)
    full = round(size * (1.0 if progress.wanted == 0 else min(1.0, progress.done / progress.wanted)))
    return (
        (name, ""),
        (signs.full * full, "green"),
        (signs.empty * (size - full), "dim"),
        (f"  {words}", style),
    )


def _errors(picture: Picture, width: int) -> Section:
    rows: list[Line] = []
    for error in list(picture.errors.values())[-MOST_ERRORS:]:
        rows += [((text, "red"),) for text in wrapped(f"! {error}", width, most=3)]
    return _section(2, rows, 2)


def _learning(picture: Picture, width: int, signs: Signs) -> Section:
    measured = picture.measured()
    if len(measured) > MOST_TOLD:
        table = learning_table(picture, width)
        return Section(rank=4, wanted=len(table), least=4, fit=lambda count: _plain(shortened(table, count)))
    rows: list[Line] = []
    for block, values in measured.items():
        rows.append(((f"{block}: ", "bold"), (model_words(picture, block), "")))
        for words in (encoder_words(values), policy_words(values, picture.goals)):
            rows += [((f"  {text}", ""),) for text in packed(words, width - 2, signs)]
    return _section(4, rows, 3)


def _recorded(picture: Picture) -> Section:
    words = counts_words(picture.recorded())
    return _section(4, [(("recorded: ", "bold"), (words, ""))] if words else [], 1)


def _plain(texts: Sequence[str]) -> list[Line]:
    return [((text, ""),) for text in texts]


def _members(picture: Picture, now_secs: float, width: int) -> Section:
    members = picture.members()
    if not members:
        return _section(3, [(("nobody is there yet", "yellow"),)], 1)
    whole = roster(picture, now_secs, width)
    return Section(
        rank=3, wanted=len(whole), least=8, fit=lambda count: roster(picture, now_secs, width, most=count)
    )


def _wire(picture: Picture, width: int, signs: Signs) -> Section:
    tally = picture.tally()
    counts = ((tally.lost, "lost"), (tally.duplicated, "duplicated"), (tally.refused, "refused"))
    words = [f"{count:,} {what}" for count, what in (*counts, (tally.resent, "sent again"))]
    words += [f"{tally.cut_off:,} cut off by the router"] if tally.cut_off else []
    style = "yellow" if tally.lost or tally.refused or tally.cut_off else ""
    return _section(5, [((text, style),) for text in packed(words, width, signs)], 1)


def _scores(picture: Picture) -> Section:
    """The newest of the only block at work; of several the newest of each."""
    at_work = picture.announced.blocks if picture.announced else {}
    scores = [row for row in picture.scores if row["block"] in at_work] or picture.scores
    if len({row["block"] for row in scores}) > 1:
        table = block_table(scores)
        return Section(
            rank=6, wanted=len(table), least=4, fit=lambda count: _plain(block_table(scores, most=count))
        )
    rows = min(len(scores), MOST_ROWS)
    wanted = len(score_table(scores, newest=rows)) if rows else 0
    return Section(
        rank=6,
        wanted=wanted,
        least=3,
        fit=lambda count: _plain(score_table(scores, newest=max(1, count - 1))[:count]),
    )


def _events(picture: Picture, width: int) -> Section:
    newest = list(picture.events)[-MOST_EVENTS:]
    rows: list[Line] = [
        ((f"{clock_words(secs - picture.began_secs):>8}  ", "dim"), (" ".join(text.split()), ""))
        for secs, text in newest
    ]
    return Section(rank=7, wanted=len(rows), least=1, fit=lambda count: rows[len(rows) - count :])


def _folder(picture: Picture, width: int) -> Section:
    pieces = [picture.folder[i : i + width] for i in range(0, len(picture.folder), width)]
    return _section(8, [((piece, "dim"),) for piece in pieces], 0)
