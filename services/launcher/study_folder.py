"""A study's folder: its plan, its runs, their logs, and the lock that keeps a second study out."""

import fcntl
import json
import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from services.launcher.run_folder import RunFolder, config_text
from services.launcher.study_measurement import Measurement, MeasurementError, read_measurement
from services.launcher.study_plan import Plan, Run, StudyError, parse_plan, run_folder_name
from services.launcher.study_queue import Stage
from services.runtime.checkpoint import DRAFT_SUFFIX, refuse_storage, write_atomically
from services.runtime.settings import RunSettings

RECORD = "study.json"
STATES = "states"


class StudyFolder:
    """Of one study."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @classmethod
    def find(cls, path: Path) -> "StudyFolder":
        """One that is there. Raises `StudyError` if it is none."""
        if not (path / RECORD).is_file():
            raise StudyError(f"{path} is not the folder of a study (it has no {RECORD}); give --folder")
        return cls(path)

    def prepare(self, plan: Plan, runs: Sequence[Run], steps: int) -> None:
        """Write the plan and the scenarios of its conditions; begin runs anew that never came to be.

        Raises `StudyError` if a run in it was begun with other settings, `StorageError`.
        """
        for run in runs:
            self._discard_unborn(run)
            self._check(run)
        seeds = {*plan.seeds, *(run.seed for run in runs)}
        if (self.path / RECORD).is_file():
            seeds |= set(self.plan()[2])
        record = {"steps": steps, "seeds": sorted(seeds), "plan": plan.model_dump(mode="json")}
        write_atomically(self.path / RECORD, json.dumps(record, indent=2).encode() + b"\n")
        for run in runs:
            write_atomically(self.scenario_path(run), config_text(run.settings).encode())

    def plan(self) -> tuple[Plan, int, list[int]]:
        """The plan, the steps of a run, and all seeds that were ever asked for. Raises `StudyError`."""
        path = self.path / RECORD
        try:
            record = json.loads(path.read_bytes())
            steps, seeds, table = int(record["steps"]), list(record["seeds"]), record["plan"]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise StudyError(f"cannot read {path} ({error}); `babble study` writes it anew") from None
        return parse_plan(table, origin=str(path)), steps, seeds

    def measurements(self) -> dict[str, dict[int, Measurement]]:
        """Condition -> seed -> what was measured, of the runs that are done. Raises `UserError`."""
        plan, _, seeds = self.plan()
        found: dict[str, dict[int, Measurement]] = {}
        for condition in plan.condition:
            for seed in seeds:
                measured = read_measurement(self.path / run_folder_name(condition.id, seed))
                if measured is not None:
                    found.setdefault(condition.id, {})[seed] = measured
        return found

    def missing(self) -> list[str]:
        """The names of the runs that are not done. Raises `UserError`."""
        plan, _, seeds = self.plan()
        found = self.measurements()
        return [
            run_folder_name(condition.id, seed)
            for seed in seeds
            for condition in plan.condition
            if seed not in found.get(condition.id, {})
        ]

    def run_path(self, run: Run) -> Path:
        """The run's folder."""
        return self.path / run.name

    def scenario_path(self, run: Run) -> Path:
        """The settings with which it is begun."""
        return self.path / "scenarios" / f"{run.name}.toml"

    def log_path(self, run: Run) -> Path:
        """What its launcher says."""
        return self.path / "logs" / f"{run.name}.log"

    def stage(self, run: Run) -> Stage:
        """How far it is, by what is on the disk. Raises `UserError` for damaged files."""
        try:
            measured = read_measurement(self.run_path(run))
        except MeasurementError:
            # Such as one of an earlier version: what is still there is measured anew.
            if not (self.run_path(run) / STATES).exists():
                raise
            measured = None
        if measured is not None and measured.rows == run.rows:
            return Stage.DONE
        begun = self._begun(run)
        return Stage.TRAINED if begun is not None and begun.result() else Stage.WAITING

    def is_begun(self, run: Run) -> bool:
        """True if there is something to go on with."""
        return self._begun(run) is not None

    def in_use(self, run: Run) -> bool:
        """True while another process trains it."""
        begun = self._begun(run)
        return begun is not None and begun.in_use()

    def discard_states(self, run: Run) -> None:
        """Its data set goes; what was measured stays."""
        shutil.rmtree(self.run_path(run) / STATES, ignore_errors=True)

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Hold the folder for this study. Raises `StudyError` if another one has it.

        The lock is the kernel's (flock), so that it goes with the process however that ends.
        """
        path = self.path / "lock"
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            handle = os.open(path, os.O_RDONLY | os.O_CREAT, 0o644)
        except OSError as error:
            refuse_storage(path, error)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise StudyError(
                f"the study in {self.path} is going on in another process; wait for it, or give --folder"
            ) from None
        else:
            yield
        finally:
            os.close(handle)

    def _begun(self, run: Run) -> RunFolder | None:
        path = self.run_path(run)
        return RunFolder.find(str(path)) if (path / "run.json").is_file() else None

    def _check(self, run: Run) -> None:
        begun = self._begun(run)
        if begun is None:
            return
        if differs := _difference(begun.settings(), run.settings):
            raise StudyError(
                f"{begun.shown} was begun with other settings ({differs}); delete it, or give --folder"
            )

    def _discard_unborn(self, run: Run) -> None:
        """A launcher that was killed while it made the folder leaves what is neither empty nor a run."""
        path = self.run_path(run)
        if not path.is_dir() or (path / "run.json").exists():
            return
        names = [file.name for file in path.iterdir()]
        if all(name == "config.toml" or name.endswith(DRAFT_SUFFIX) for name in names):
            shutil.rmtree(path)


def _difference(there: RunSettings, wanted: RunSettings) -> str:
    """The first setting that matters to a result and is otherwise; empty if there is none."""
    left, right = _flat(there.model_dump(mode="json")), _flat(wanted.model_dump(mode="json"))
    for key in sorted(left.keys() | right.keys()):
        # Another study may give each run more actors: they do the same, sooner.
        if key != "actors.count" and left.get(key) != right.get(key):
            return f"{key} is {left.get(key)} there and {right.get(key)} here"
    return ""


def _flat(table: dict[str, Any], before: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in table.items():
        flat |= _flat(value, f"{before}{key}.") if isinstance(value, dict) else {f"{before}{key}": value}
    return flat
