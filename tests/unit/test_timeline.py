"""When a run was in which phase, who was missing, when it was started again; and learning over that time."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread

from protocol.messages import Phase
from services.launcher.curves import MOST_POINTS, POLICY_PHASES, clock, read_curves
from services.launcher.learning_figure import draw_learning
from services.launcher.timeline import Timeline, timeline_of
from services.launcher.timeline_figure import PHASE_COLOURS, draw_timeline

NAMES = ("babble", "encode", "ground", "evaluate of ground", "walk", "refine", "practise", "done")
MEMBERS = ("actor-1 (actor)", "encoder_learner-1 (encoder_learner)", "policy_learner-1 (policy_learner)")


def said(name: str, term: int) -> str:
    return f"{name} (level 0, iteration {int(term > 4)}, term {term})"


def event(secs: float, what: str, text: str) -> dict[str, Any]:
    return {"secs": secs, "what": what, "text": text}


def joined(secs: float, members: Iterable[str] = MEMBERS) -> list[dict[str, Any]]:
    return [event(secs, "joined", f"{member} joined") for member in members]


def whole_run() -> list[dict[str, Any]]:
    """Ten seconds in each phase, everybody there from the first second on."""
    phases = [event(1000.0 + 10 * i, "phase", said(name, i + 1)) for i, name in enumerate(NAMES)]
    return [phases[0], *joined(1001.0), *phases[1:], event(1070.0, "end", "the run is done")]


def test_phases_follow_one_another_as_announced() -> None:
    timeline = timeline_of(whole_run())
    told = [(span.announced.phase, span.begin_secs, span.end_secs) for span in timeline.spans]
    order = [Phase(name.split()[0]) for name in NAMES[:-1]]
    assert told == [(phase, 10.0 * i, 10.0 * (i + 1)) for i, phase in enumerate(order)]
    assert timeline.done
    assert timeline.newest == said("done", 8)
    assert timeline.spans[3].announced.evaluates is Phase.GROUND
    assert [span.announced.iteration for span in timeline.spans] == [0, 0, 0, 0, 1, 1, 1]
    assert timeline.waits == [(0.0, 1.0)]
    assert timeline.actors == [(1.0, 1)]


def test_only_those_whom_the_phase_needs_are_waited_for() -> None:
    encode = event(110.0, "phase", said("encode", 2))
    events = [event(100.0, "phase", said("babble", 1)), *joined(101.0, MEMBERS[:2]), encode]
    events += [event(112.0, "lost", "actor-1 (actor) is gone"), event(120.0, "phase", said("ground", 3))]
    events += [*joined(123.0, (MEMBERS[0], MEMBERS[2])), event(130.0, "phase", said("walk", 4))]
    assert timeline_of(events).waits == [(0.0, 1.0), (20.0, 23.0)]


def test_the_time_before_a_resume_is_left_out() -> None:
    events = [event(100.0, "phase", said("babble", 1)), *joined(100.0), event(105.0, "end", "it stops")]
    events += [event(1105.0, "phase", said("babble", 1)), *joined(1106.0)]
    events += [event(1115.0, "phase", said("encode", 2)), event(1120.0, "end", "it stops")]
    timeline = timeline_of(events)
    spans = [(span.announced.phase, span.begin_secs, span.end_secs) for span in timeline.spans]
    assert spans == [(Phase.BABBLE, 0, 5), (Phase.BABBLE, 5, 15), (Phase.ENCODE, 15, 20)]
    assert [(again.at_secs, again.stopped_secs) for again in timeline.restarts] == [(5.0, 1000.0)]
    assert timeline.waits == [(5.0, 6.0)]
    assert (timeline.running(104.0), timeline.running(1110.0)) == (4.0, 10.0)
    assert (timeline.wall(4.0), timeline.wall(10.0)) == (4.0, 1010.0)


def test_a_power_cut_is_told_from_a_coordinator_that_was_started_again() -> None:
    events = [event(100.0, "phase", said("babble", 1)), event(160.0, "phase", said("babble", 1))]
    # A learner said something a second before the second announcement: only the coordinator had gone.
    assert [again.stopped_secs for again in timeline_of(events, [120.0, 159.0]).restarts] == [0.0]
    (again,) = timeline_of(events, [120.0]).restarts
    assert (again.at_secs, again.stopped_secs) == (20.0, 40.0)


def test_what_goes_on_ends_at_the_last_sign_of_life() -> None:
    events = [event(100.0, "phase", said("babble", 1))]
    assert timeline_of(events, [101.0, 130.0]).end_secs == 30.0
    assert timeline_of(events).spans == []


def test_a_clock_that_is_set_back_and_rubbish_leave_no_negative_times() -> None:
    events = [event(100.0, "phase", said("babble", 1)), event(50.0, "phase", said("encode", 2))]
    events += [event(120.0, "phase", "sing (level 0, iteration 0, term 3)"), {"secs": "x"}]
    events += [event(float("nan"), "phase", said("ground", 3)), event(130.0, "end", "")]
    timeline = timeline_of(events)
    assert [(span.announced.phase, span.secs) for span in timeline.spans] == [(Phase.ENCODE, 30.0)]


def line(secs: float, term: int, phase: str, **metrics: float) -> dict[str, Any]:
    told = {f"body/{name.replace('__', '/')}": value for name, value in metrics.items()}
    return {"now_secs": secs, "term": term, "phase": phase, "metrics": told}


def test_curves_hold_what_is_new_and_not_what_is_repeated() -> None:
    lines = [
        line(1020.0 + i, 3, "ground", policy__loss=0.0, policy__reward_mean=-5.0 + i) for i in range(1, 4)
    ]
    # In EVALUATE, and at the beginning of PRACTISE, the learner still tells its last.
    lines += [line(1031.0, 4, "evaluate", policy__reward_mean=-2.0)]
    lines += [line(1061.0, 7, "practise", policy__reward_mean=-2.0)]
    lines += [line(1062.0, 7, "practise", policy__reward_mean=-2.0)]
    lines += [line(1064.0, 7, "practise", policy__reward_mean=-1.0)]
    lines += [line(1065.0, 7, "practise", policy__reward_mean=float("nan"))]
    curves = read_curves(lines)
    (series,) = curves.of("body").values()
    assert list(series.value) == [-4.0, -3.0, -2.0, -1.0]
    hands = clock(timeline_of(whole_run()), POLICY_PHASES)
    assert hands.borders == [0.0, 10.0, 20.0]
    np.testing.assert_allclose(hands.of(series.secs), [1, 2, 3, 14])


def test_long_series_are_thinned_and_keep_their_ends() -> None:
    steps = 10 * MOST_POINTS
    curves = read_curves(line(1000.0 + i, 2, "encode", encoder__loss=float(i)) for i in range(steps))
    (series,) = curves.of("body").values()
    assert MOST_POINTS / 4 < len(series.value) <= MOST_POINTS
    assert series.value[0] < 32
    assert series.value[-1] > steps - 32
    assert (np.diff(series.value) > 0).all()


def test_the_figure_shows_each_phase_in_its_colour_from_left_to_right(tmp_path: Path) -> None:
    draw_timeline(tmp_path / "timeline.png", timeline_of(whole_run()), "a run")
    picture = imread(tmp_path / "timeline.png")[..., :3]
    height = picture.shape[0]
    bars = picture[: height // 2]
    centres = []
    for phase in (Phase(name.split()[0]) for name in NAMES[:-1]):
        colour = [int(PHASE_COLOURS[phase][i : i + 2], 16) / 255 for i in (1, 3, 5)]
        columns = np.flatnonzero((np.abs(bars - colour).max(axis=2) < 0.02).sum(axis=0) > 15)
        assert len(columns) > 100, f"{phase} is not there"
        centres.append(np.median(columns))
    assert centres == sorted(centres)
    np.testing.assert_allclose(np.diff(centres), np.mean(np.diff(centres)), rtol=0.1)


@pytest.mark.parametrize("points", [1, 50, 500, 3000])
@pytest.mark.parametrize("known", [True, False])
def test_learning_is_drawn_with_and_without_phases(tmp_path: Path, points: int, known: bool) -> None:
    timeline = timeline_of(whole_run()) if known else Timeline()
    secs = np.linspace(1021.0, 1029.0, points)
    lines = [line(at, 3, "ground", policy__reward_mean=float(np.sin(at))) for at in secs]
    path = tmp_path / "learning.png"
    draw_learning(path, "body", [], None, read_curves(lines), timeline, "a run")
    picture = imread(path)[..., :3]
    green = [int(PHASE_COLOURS[Phase.GROUND][i : i + 2], 16) / 255 for i in (1, 3, 5)]
    shade = 1 - 0.22 * (1 - np.array(green))
    assert ((np.abs(picture - shade).max(axis=2) < 0.02).sum() > 1000) == known
    assert (picture.max(axis=2) < 0.3).sum() > 100
