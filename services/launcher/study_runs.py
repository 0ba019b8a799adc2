"""The runs of a study as processes of this machine, and how far each of them is."""

from pathlib import Path
from typing import Protocol

from services.launcher.child import ChildProcess
from services.launcher.study_folder import STATES, StudyFolder
from services.launcher.study_plan import Run
from services.launcher.study_queue import Stage
from services.launcher.supervisor import Child, Part

TAIL_BYTES = 4096
COMPLAINTS = ("babble up: ", "measure: ")
"""With these begin the sentences with which a process ends."""
EVALUATED = "phase=evaluate"
"""The part of a data set that is not measured."""


class Workshop(Protocol):
    """Where runs are worked at; for tests it need not be this machine."""

    def stage(self, run: Run) -> Stage:
        """How far it is, by what it left. Raises `UserError` for damaged files."""
        ...

    def in_use(self, run: Run) -> bool:
        """True while somebody else trains it."""
        ...

    def train(self, run: Run) -> Child:
        """Begin it, or go on with it. Raises `UserError`."""
        ...

    def measure(self, run: Run) -> Child:
        """Measure what was trained. Raises `UserError`."""
        ...

    def rows(self, run: Run) -> int:
        """States that are safely there and will be measured."""
        ...

    def signs(self, run: Run) -> object:
        """Something that is another one after each step forward."""
        ...

    def last_words(self, run: Run) -> str:
        """The last line that it said; empty if it said nothing."""
        ...

    def put_away(self, run: Run) -> None:
        """It is done."""
        ...


class LocalWorkshop:
    """Trains by `babble up`, each run with a log of its own; all of it dies with this process."""

    def __init__(self, folder: StudyFolder, *, discard_states: bool) -> None:
        self._folder = folder
        self._discard_states = discard_states
        self._rows: dict[Path, int] = {}

    def stage(self, run: Run) -> Stage:
        """See `Workshop`."""
        return self._folder.stage(run)

    def in_use(self, run: Run) -> bool:
        """See `Workshop`."""
        return self._folder.in_use(run)

    def train(self, run: Run) -> Child:
        """See `Workshop`."""
        return self._start(run, training_arguments(self._folder, run))

    def measure(self, run: Run) -> Child:
        """See `Workshop`."""
        path = str(self._folder.run_path(run))
        prefixes = [str(rows) for rows in run.curve if rows < run.rows]
        measuring = ["-m", "services.launcher.study_measure", path, "--rows", str(run.rows)]
        return self._start(run, [*measuring, *(["--curve", *prefixes] if prefixes else [])])

    def rows(self, run: Run) -> int:
        """See `Workshop`; of each file of the data set only the end is read, once."""
        return sum(self._rows_of(path) for path in self._files(run) if EVALUATED not in path.parts)

    def signs(self, run: Run) -> object:
        """See `Workshop`: the data set, and what the coordinator and the learners write."""
        logs = ("events.jsonl", "scores.jsonl", "metrics.jsonl")
        sizes = [_size(self._folder.run_path(run) / name) for name in logs]
        return len(self._files(run)), sizes

    def last_words(self, run: Run) -> str:
        """See `Workshop`."""
        try:
            with self._folder.log_path(run).open("rb") as log:
                log.seek(max(0, log.seek(0, 2) - TAIL_BYTES))
                lines = log.read().decode("utf-8", "replace").splitlines()
        except OSError:
            return ""
        said = [line.strip() for line in lines if line.strip()]
        return next((line for line in reversed(said) if line.startswith(COMPLAINTS)), "".join(said[-1:]))

    def put_away(self, run: Run) -> None:
        """See `Workshop`."""
        if self._discard_states:
            self._folder.discard_states(run)

    def _start(self, run: Run, arguments: list[str]) -> Child:
        return ChildProcess(
            Part(name=run.name, arguments=tuple(arguments), log=self._folder.log_path(run).resolve())
        )

    def _files(self, run: Run) -> list[Path]:
        return list((self._folder.run_path(run) / STATES).glob("phase=*/part-*.parquet"))

    def _rows_of(self, path: Path) -> int:
        if path not in self._rows:
            from pyarrow.parquet import read_metadata

            try:
                self._rows[path] = int(read_metadata(path).num_rows)
            except (OSError, ValueError):
                return 0  # a recorder that begins again takes files back
        return self._rows[path]


def training_arguments(folder: StudyFolder, run: Run) -> list[str]:
    """What follows `python` on the command line that begins a run, or goes on with one."""
    path = str(folder.run_path(run))
    command = ["-m", "services.launcher", "up", "--no-dashboard"]
    if folder.is_begun(run):
        return [*command, "--resume", path]
    seed = ["--seed", str(run.seed)]
    return [*command, str(folder.scenario_path(run)), *seed, "--run-dir", path]


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0
