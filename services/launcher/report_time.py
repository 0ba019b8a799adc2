"""What the report says of a run's time: its phases, how long they were, and the environment steps in them."""

from protocol.messages import Phase
from services.launcher.report_tables import table_head, table_row
from services.launcher.survey import Survey
from services.launcher.timeline import Span, Timeline
from services.runtime.settings import RunSettings


def time_section(survey: Survey) -> list[str]:
    """Time and steps by level and phase; empty without events."""
    from services.launcher import timeline_figure
    from services.launcher.figures import picture

    timeline, run = survey.timeline, survey.run
    if not timeline.spans:
        return []
    timeline_figure.draw_timeline(run.folder / "figures" / "timeline.png", timeline, f"{run.name}: phases")
    by_phase: dict[tuple[int, Phase], list[Span]] = {}
    for span in timeline.spans:
        by_phase.setdefault((span.announced.level, span.announced.phase), []).append(span)
    heads = ["phase", "times", "seconds", "environment steps each (settings)", "in all"]
    is_tree = len(run.settings.block) > 1
    lines = ["## Time", "", *picture("timeline", "The phases over the time for which the run was running.")]
    lines += table_head(["level", *heads] if is_tree else heads)
    for (level, phase), spans in by_phase.items():
        secs, steps = sum(span.secs for span in spans), planned_steps(run.settings, level).get(phase)
        told = (
            ["none", "none"] if steps is None else [f"{steps:,}", f"{_completed(timeline, spans) * steps:,}"]
        )
        cells = [phase.value, str(len(spans)), f"{secs:.1f}", *told]
        lines.append(table_row([str(level), *cells] if is_tree else cells))
    whole_secs = sum(span.secs for span in timeline.spans)
    cells = ["all", "", f"{whole_secs:.1f}", "", f"{sum(steps_taken(survey)):,}"]
    lines.append(table_row(["", *cells] if is_tree else cells))
    return [*lines, "", _seconds_words(timeline), "", _steps_words(survey), *_restarts(timeline)]


def planned_steps(settings: RunSettings, level: int) -> dict[Phase, int]:
    """Environment steps of each phase of a level, which its blocks share; EVALUATE is of two modes."""
    here = settings.of_level(level)
    phases, legs = here.phases, here.evaluation
    return {
        Phase.BABBLE: phases.babble_steps,
        Phase.GROUND: phases.ground_steps,
        Phase.WALK: phases.walk_steps,
        Phase.PRACTISE: phases.practise_steps,
        Phase.EVALUATE: 2 * legs.columns * legs.legs * legs.leg_steps,
    }


def steps_taken(survey: Survey) -> tuple[int, int]:
    """Environment steps of the phases that were completed: to learn from, and in evaluations."""
    learned, evaluated = steps_by_level(survey)
    return sum(learned.values()), sum(evaluated.values())


def steps_by_level(survey: Survey) -> tuple[dict[int, int], dict[int, int]]:
    """Level -> environment steps of its phases that were completed: to learn from, and in evaluations."""
    learned, evaluated = dict[int, int](), dict[int, int]()
    for term in _completed_terms(survey.timeline):
        announced = survey.timeline.terms[term]
        counts = evaluated if announced.phase is Phase.EVALUATE else learned
        steps = planned_steps(survey.run.settings, announced.level).get(announced.phase, 0)
        counts[announced.level] = counts.get(announced.level, 0) + steps
    return learned, evaluated


def _completed_terms(timeline: Timeline) -> list[int]:
    """Those after which another was announced."""
    return sorted(timeline.terms)[:-1]


def _completed(timeline: Timeline, spans: list[Span]) -> int:
    """How many of the terms of these spans were completed; one that was resumed has several spans."""
    return len({span.announced.term for span in spans} & set(_completed_terms(timeline)))


def _steps_words(survey: Survey) -> str:
    learned, evaluated = steps_by_level(survey)
    if survey.run.settings.phases.open_loop:
        return f"In the phases that were completed: {sum(learned.values()):,} environment steps."
    whole = f"{sum(learned.values()):,} environment steps to learn from"
    if len(learned) > 1:
        parts = [f"level {level} {steps:,}" for level, steps in sorted(learned.items())]
        whole += f" ({', '.join(parts)})"
    return f"In the phases that were completed: {whole}, and {sum(evaluated.values()):,} in evaluations."


def _seconds_words(timeline: Timeline) -> str:
    waited_secs = sum(end - begin for begin, end in timeline.waits)
    waiting = (
        f", waiting included: {waited_secs:.1f} s for processes that were not there" if waited_secs else ""
    )
    return f"Seconds are wall-clock time between announcements{waiting}."


def _restarts(timeline: Timeline) -> list[str]:
    stopped_secs = [restart.stopped_secs for restart in timeline.restarts if restart.stopped_secs]
    again = len(timeline.restarts) - len(stopped_secs)
    told = []
    if stopped_secs:
        resumed = f"It was resumed {_times(len(stopped_secs))}"
        told.append(f"{resumed}; the {sum(stopped_secs):.0f} s in between are left out.")
    if again:
        told.append(f"The coordinator was started again {_times(again)} on the way.")
    if timeline.stalls:
        told.append(f"It stalled {_times(len(timeline.stalls))}; `events.jsonl` says who waited for whom.")
    return ["", " ".join(told)] if told else []


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"
