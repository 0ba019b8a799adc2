"""Which phase the run is in: the bar, and the summary that a person reads first."""

from collections.abc import Iterable, Mapping

import numpy as np
import rerun as rr

from protocol.latest import LatestPhase
from protocol.messages import Phase, PhaseAnnounced, Progress
from services.dashboard.canvas import Canvas, Due, colours, page
from services.dashboard.colours import PHASE_COLOURS
from services.dashboard.latent_book import LatentBook, label_order
from services.dashboard.roster import Roster
from services.runtime.phases import phase_words
from services.runtime.settings import RunSettings
from services.runtime.speed import Speed

SUMMARY_SECS = 1.0
THIN_SECS = 10.0
REPEAT_SECS = 60.0
"""A phase that still goes on is said again so often, since viewers that join late get a limited past."""
MOST_BLOCKS = 6
MOST_ERRORS = 2
MOST_GOALS = 16
LONGEST_ERROR = 240


class PhasePanel:
    """Under /state/phase and /status/summary."""

    def __init__(self, roster: Roster, books: Mapping[str, LatentBook], settings: RunSettings) -> None:
        self._roster, self._books, self._levels = roster, books, settings.levels
        self._latest = LatestPhase()
        levels = range(len(self._levels))
        iterations = max(settings.of_level(level).phases.iterations for level in levels)
        self._states = phase_states(iterations, len(levels))
        self._speeds: dict[str, Speed] = {}
        self._notes: tuple[str, ...] = ()
        self._due, self._thin, self._repeat = Due(SUMMARY_SECS), Due(THIN_SECS), Due(REPEAT_SECS)
        self._drawn = ""
        self._drawn_term = -1

    @property
    def announced(self) -> PhaseAnnounced | None:
        """What the coordinator last said."""
        return self._latest.current

    @property
    def done(self) -> bool:
        """True once the coordinator has said that the run is done."""
        return self.announced is not None and self.announced.phase is Phase.DONE

    def hear(self, announced: PhaseAnnounced) -> bool:
        """Take the coordinator's word; True if it is a new term."""
        before = self.announced
        new = self._latest.admit(announced) and (before is None or announced.term > before.term)
        if new:
            self._speeds.clear()
        return new

    def note(self, sentences: Iterable[str]) -> None:
        """What the dashboard itself has to say, such as that nothing is recorded any more."""
        self._notes = tuple(sentence for sentence in sentences if sentence)

    def begin(self, canvas: Canvas) -> None:
        """Say the phases' colours, and the phase that goes on."""
        config = rr.StateConfiguration(values=list(self._states), colors=colours(list(self._states.values())))
        canvas.log("/state/phase", config, static=True)
        if self._drawn:
            canvas.log("/state/phase", rr.StateChange(state=self._drawn))

    def draw(self, canvas: Canvas, now_secs: float) -> None:
        """Log a new phase at once, and the summary each second."""
        announced = self.announced
        if announced is not None and (announced.term != self._drawn_term or self._repeat(now_secs)):
            self._drawn_term = announced.term
            self._drawn = self._state(announced)
            canvas.log("/state/phase", rr.StateChange(state=self._drawn))
        if self._due(now_secs):
            canvas.log(
                "/status/summary", page(self.summary(now_secs)), thin=self._thin(now_secs) or self.done
            )

    def summary(self, now_secs: float) -> str:
        """The state of the run in Markdown."""
        lines = [f"# {phase_words(self.announced)}", "", *self._facts(now_secs), ""]
        work = self._work()
        for progress in list(work.values())[:MOST_BLOCKS]:
            lines += [self._progress_words(progress, now_secs), ""]
        if len(work) > MOST_BLOCKS:
            lines += [f"and {len(work) - MOST_BLOCKS} more blocks", ""]
        waiting = self._waiting()
        if waiting and not work:
            lines += [f"{waiting}", ""]
        if goals := self._goals(now_secs):
            lines += [goals, ""]
        errors = [f"**{label}**: {text[:LONGEST_ERROR]}" for label, text in self._roster.errors.items()]
        for sentence in (*self._notes, *errors[-MOST_ERRORS:]):
            lines += [f"✖ {sentence}", ""]
        return "\n".join(lines)

    def _facts(self, now_secs: float) -> list[str]:
        actors = self._roster.of("actor")
        speeds = [speed for actor in actors if (speed := actor.env_steps.per_sec(now_secs)) is not None]
        found = [newest.distances for book in self._aiming(now_secs) for newest in book.acting(now_secs)]
        distances = np.concatenate(found) if found else np.zeros(0)
        counted = self._roster.ledger
        facts = {
            "actors": f"{len(actors)}",
            "env steps": f"{counted['env_steps']:,}",
            "steps/s": f"{sum(speeds):,.0f}" if speeds else "-",
            "goal distance": f"{distances.mean():.3f}" if len(distances) else "-",
            "lost": f"{counted['lost']:,}",
        }
        return [
            "| " + " | ".join(facts) + " |",
            "|" + "---|" * len(facts),
            "| " + " | ".join(facts.values()) + " |",
        ]

    def _work(self) -> dict[str, Progress]:
        if self.announced is None:
            return {}
        work: dict[str, Progress] = {}
        for member in self._roster:
            if (
                member.status is not None
                and member.lost_secs is None
                and member.status.term == self.announced.term
            ):
                work |= {progress.block: progress for progress in member.status.progress}
        return work

    def _progress_words(self, progress: Progress, now_secs: float) -> str:
        speed = self._speeds.setdefault(progress.block, Speed())
        speed.hear(now_secs, progress.done)
        share = min(1.0, progress.done / max(1, progress.wanted))
        per_sec = speed.per_sec(now_secs)
        left = f" · {duration_words((progress.wanted - progress.done) / per_sec)} left" if per_sec else ""
        if progress.finished or progress.done >= progress.wanted:
            left = " · finished"
        done = f"{progress.done:,} of {progress.wanted:,} {progress.unit}"
        return f"**{progress.block}** {share:.0%} · {done}{left}"

    def _waiting(self) -> str:
        ranked = sorted(self._roster, key=lambda member: member.service != "coordinator")
        said = [m.status.waiting_for for m in ranked if m.status is not None and m.lost_secs is None]
        return next((sentence for sentence in said if sentence), "")

    def _goals(self, now_secs: float) -> str:
        for book in self._aiming(now_secs):
            goals = {n.label: int(n.goal[0].argmax()) for n in book.acting(now_secs) if n.goal is not None}
            if goals:
                told = [f"{label}→g{goals[label]}" for label in sorted(goals, key=label_order)[:MOST_GOALS]]
                return " · ".join(told)
        return ""

    def _aiming(self, now_secs: float) -> list[LatentBook]:
        """The blocks of the highest level on which somebody acts: those below get their goals from them."""
        for names in reversed(self._levels):
            books = [self._books[name] for name in names]
            if any(book.acting(now_secs) for book in books):
                return books
        return []

    def _state(self, announced: PhaseAnnounced) -> str:
        level = _of_level(announced.level)
        numbered = f"{announced.phase} {announced.iteration}{level}"
        return numbered if numbered in self._states else f"{announced.phase}{level}"


MOST_NUMBERED = 50
"""With more iterations their numbers are not in the phase bar, for each needs an entry of its own."""


def phase_states(iterations: int, levels: int = 1) -> dict[str, int]:
    """What the phase bar may say, and its colour: the phases, and those of the loop with their iteration."""
    states: dict[str, int] = {}
    for level in map(_of_level, range(levels)):
        states |= {f"{phase}{level}": colour for phase, colour in PHASE_COLOURS.items()}
        if iterations * levels <= MOST_NUMBERED:
            for phase in (Phase.WALK, Phase.REFINE, Phase.PRACTISE, Phase.EVALUATE):
                for iteration in range(1, iterations + 1):
                    states[f"{phase} {iteration}{level}"] = PHASE_COLOURS[phase]
    return states


def _of_level(level: int) -> str:
    """Behind the name of a phase; nothing for the leaves, which are all there is in most runs."""
    return f", level {level}" if level else ""


def duration_words(secs: float) -> str:
    """ "8 s", "3 min", "2.5 h"."""
    if secs < 90:
        return f"{secs:.0f} s"
    return f"{secs / 60:.0f} min" if secs < 5400 else f"{secs / 3600:.1f} h"
