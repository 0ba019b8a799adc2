"""`babble study PLAN`: all conditions x seeds of a study, then its table, figures and verdicts."""

import argparse
import os
import shlex
import sys
import time
from pathlib import Path

from services.launcher.config import at_least, check_world, known_scenarios
from services.launcher.interrupts import Interrupts
from services.launcher.study_display import study_display_for
from services.launcher.study_folder import StudyFolder
from services.launcher.study_measurement import MeasurementError
from services.launcher.study_plan import (
    MOST_STEPS,
    Plan,
    Run,
    StudyError,
    base_settings,
    load_plan,
    runs_of,
    seeds_of,
)
from services.launcher.study_runs import LocalWorkshop
from services.launcher.study_service import StudyService
from services.launcher.study_words import ended_words

STUDIES = Path("runs")


def run(arguments: argparse.Namespace) -> int:
    """Run what is missing, then write the report; returns the exit code.

    0 all done, 1 some run failed, 128 and its number after a signal. Raises `UserError` before anything
    has started.
    """
    path = plan_path(arguments.plan)
    plan = load_plan(path)
    steps = arguments.steps or plan.steps
    folder = StudyFolder(arguments.folder or default_folder(plan, steps))
    report = arguments.report or folder.path / "report"
    if arguments.report_only:
        return _report(StudyFolder.find(folder.path), report)
    base = base_settings(plan, path)
    runs = runs_of(
        plan,
        base,
        steps=steps,
        seeds=arguments.seeds or plan.seeds,
        only=arguments.only or (),
        actors=arguments.actors,
    )
    for settings in {each.settings.world.model_dump_json(): each.settings for each in runs}.values():
        check_world(settings, origin=str(path.parent / plan.base))
    jobs = arguments.jobs or max(1, (os.cpu_count() or 1) // arguments.actors)
    with folder.locked():
        folder.prepare(plan, runs, steps)
        code = _work(folder, runs, jobs, discard_states=arguments.discard_states)
    return max(code, _report(folder, report)) if code in (0, 1) else code


def plan_path(text: str) -> Path:
    """The TOML of a study, given by its path or by its bare name in scenarios/. Raises `StudyError`."""
    given = Path(os.path.expanduser(text))
    if given.is_file():
        return given
    known = known_scenarios()
    if (name := text.removesuffix(".toml")) in known:
        return known[name]
    raise StudyError(
        f"there is no study {text!r}; give the path of a TOML file such as scenarios/table1.toml"
    )


def default_folder(plan: Plan, steps: int) -> Path:
    """Where its runs are unless somebody says otherwise; shorter ones are kept apart."""
    return STUDIES / (plan.study if steps == plan.steps else f"{plan.study}-{steps}")


def _work(folder: StudyFolder, runs: list[Run], jobs: int, *, discard_states: bool) -> int:
    began_secs = time.monotonic()
    print(f"study      {folder.path}\nruns       {len(runs)}, {jobs} at once", flush=True)
    workshop = LocalWorkshop(folder, discard_states=discard_states)
    with Interrupts() as interrupts, study_display_for(sys.stdout, began_secs) as display:
        service = StudyService(runs, workshop, jobs=jobs, display=display)
        service.know(_known_secs(folder))
        code = service.run(interrupts)
    print(*ended_words(service.queue), sep="\n", flush=True)
    if code > 1:
        print(f"stopped; go on with: babble {shlex.join(sys.argv[1:])}", flush=True)
    return code


def _known_secs(folder: StudyFolder) -> dict[str, float]:
    """Condition -> what one of its runs took, of those that are done."""
    try:
        measurements = folder.measurements()
    except MeasurementError:
        return {}  # it is measured anew, or refused with its sentence, when its turn comes
    return {
        condition: sum(each.trained_secs for each in by_seed.values()) / len(by_seed)
        for condition, by_seed in measurements.items()
    }


def _report(folder: StudyFolder, report: Path) -> int:
    """Write the report of what is done; 1 if there is nothing to write of."""
    from services.launcher.study_report import write_study_report

    if not folder.measurements():
        print("no run is done yet, so there is nothing to report", file=sys.stderr, flush=True)
        return 1
    written = write_study_report(folder, report)
    print(f"read {written}", flush=True)
    return 0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `babble study`."""
    parser.add_argument("plan", metavar="STUDY", help="a TOML file such as scenarios/table1.toml")
    parser.add_argument(
        "--steps",
        type=at_least(1, MOST_STEPS),
        metavar="N",
        help="environment steps of each run (default: the study's)",
    )
    parser.add_argument(
        "--seeds", type=_seeds, metavar="A-B|a,b", help="seeds of each condition (default: the study's)"
    )
    parser.add_argument(
        "--only", type=_ids, metavar="C1,C5", help="only these conditions (default: all of the study)"
    )
    parser.add_argument(
        "--jobs", type=at_least(1, 64), metavar="J", help="runs at once (default: cores / actors)"
    )
    parser.add_argument(
        "--actors", type=at_least(1, 64), default=1, metavar="K", help="actors of each run (default: 1)"
    )
    parser.add_argument("--folder", type=Path, metavar="D", help="where the runs are (default: runs/NAME)")
    parser.add_argument(
        "--report", type=Path, metavar="D", help="where the report goes (default: report/ in the folder)"
    )
    parser.add_argument(
        "--report-only", action="store_true", help="run nothing; write the report of what is done"
    )
    parser.add_argument(
        "--discard-states",
        action="store_true",
        help="delete the data set of each run once it is measured (some 400 MB per million steps)",
    )


def _ids(text: str) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()]


def _seeds(text: str) -> list[int]:
    try:
        return seeds_of(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
