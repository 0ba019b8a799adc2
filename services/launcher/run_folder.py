"""A run's folder: what the launcher writes into it, and what it reads back."""

import fcntl
import json
import os
import platform
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

from services.launcher.config import ROOT
from services.launcher.records import Records
from services.launcher.timeline import timeline_of
from services.runtime.checkpoint import refuse_storage, write_atomically
from services.runtime.errors import StorageError, UserError
from services.runtime.process import read_run_name
from services.runtime.settings import RunSettings, load

RUNS = Path("runs")
ENDPOINT = "endpoint"
"""The file with the router's address."""
DASHBOARD = "dashboard"
"""The file with the dashboard's address for a browser; there is none while there is no dashboard."""
LONGEST_SCENARIO = 32
"""So much of the scenario's name goes into the run's, which is at most 64 characters."""
MOST_ALIKE = 100
LOCK_SECS = 0.2
"""Whoever only looks whether the folder is in use holds its lock for far less."""
LOCK_POLL_SECS = 0.01
GIT_SECS = 5.0
PACKAGES = (
    "eclipse-zenoh",
    "gymnasium",
    "matplotlib",
    "msgpack",
    "numpy",
    "onnx",
    "onnxruntime",
    "pyarrow",
    "pydantic",
    "rerun-sdk",
    "scikit-dimension",
    "scipy",
    "stable-baselines3",
    "torch",
)


class RunFolderError(UserError):
    """A folder that cannot be the folder of this run."""


class RunFolder:
    """The folder of one run; it exists and holds `run.json` and `config.toml`."""

    def __init__(self, path: Path, run: str) -> None:
        self.path = path
        self.run = run

    @classmethod
    def create(
        cls, settings: RunSettings, where: Path | None, command: Sequence[str], *, run: str = ""
    ) -> "RunFolder":
        """A new folder, at `where` or as `runs/<scenario>-<time>-<seed>`, for a run that may have a name.

        Raises `RunFolderError` if `where` is in use for something else, `StorageError` if the disk refuses.
        """
        made = datetime.now()
        name = run_name(settings, made)
        path = _new_folder(name) if where is None else _empty_folder(where)
        run = run or (path.name if where is None else name)
        record: dict[str, Any] = {"run": run, "created": made.astimezone(UTC).isoformat(timespec="seconds")}
        record |= {"seed": settings.seed, "seed_tree": "run -> service or actor index -> life"}
        record |= {"command": [*command], **versions()}
        # One right after the other: a folder with one of them is neither empty nor a run.
        write_atomically(path / "config.toml", config_text(settings).encode())
        write_atomically(path / "run.json", json.dumps(record, indent=2).encode() + b"\n")
        return cls(path, run)

    @classmethod
    def find(cls, text: str) -> "RunFolder":
        """An existing run, given by its folder or by its name under runs/. Raises `RunFolderError`."""
        for path in (Path(os.path.expanduser(text)), RUNS / text):
            # os.path, because a name that is too long, or a folder that is closed to this user, is none.
            if all(os.path.isfile(path / name) for name in ("run.json", "config.toml")):
                return cls(path.resolve(), read_run_name(path))
        raise RunFolderError(
            f"{text!r} is not the folder of a run (it has no run.json and config.toml) "
            f"nor a name under {RUNS}/; give the folder that `babble up` made"
        )

    @property
    def shown(self) -> str:
        """The path as a person here would type it."""
        here = Path.cwd()
        return str(self.path.relative_to(here) if self.path.is_relative_to(here) else self.path)

    def note_endpoint(self, address: str) -> None:
        """Record where the router is. Raises `StorageError`."""
        write_atomically(self.path / ENDPOINT, f"{address}\n".encode())

    def endpoint(self) -> str:
        """The router's address while the run goes on. Raises `RunFolderError` if none is recorded."""
        try:
            return (self.path / ENDPOINT).read_text().strip()
        except OSError as error:
            sentence = (
                f"cannot read {self.path / ENDPOINT} ({error.strerror}); give the address with --connect"
            )
            raise RunFolderError(sentence) from None

    def dashboard(self) -> str:
        """The dashboard's address for a browser of the run's machine; empty if there is none."""
        try:
            return (self.path / DASHBOARD).read_text().strip()
        except OSError:
            return ""

    def note_dashboard(self, url: str) -> None:
        """Record where the dashboard is, or that there is none. Raises `StorageError`."""
        if url:
            write_atomically(self.path / DASHBOARD, f"{url}\n".encode())
        else:
            self._remove(DASHBOARD)

    def forget_addresses(self) -> None:
        """Nobody is at the router's and the dashboard's address any more. Raises `StorageError`."""
        self._remove(DASHBOARD)
        self._remove(ENDPOINT)

    def recorded(self) -> bool:
        """True if there is something for `babble view` to show."""
        return any((self.path / "recording").glob("*.rrd"))

    def settings(self) -> RunSettings:
        """The run's settings, as recorded at its start. Raises `SettingsError`."""
        return load(self.path / "config.toml")

    def log(self, name: str) -> Path:
        """The log file of a process."""
        return self.path / "logs" / f"{name}.log"

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Hold the folder for this launcher. Raises `RunFolderError` if another one has it.

        The lock is the kernel's (flock), so that it goes with the launcher however that ends.
        """
        path = self.path / "lock"
        try:
            handle = os.open(path, os.O_RDONLY | os.O_CREAT, 0o644)
        except OSError as error:
            refuse_storage(path, error)
        try:
            if not _lock(handle, fcntl.LOCK_EX, LOCK_SECS):
                raise RunFolderError(
                    f"the run {self.shown} is going on in another process; "
                    f"see it with `babble status {self.shown}`"
                )
            yield
        finally:
            os.close(handle)

    def in_use(self) -> bool:
        """True while a launcher holds the folder; any number may look at once."""
        try:
            handle = os.open(self.path / "lock", os.O_RDONLY)
        except OSError:
            return False  # none has ever held it
        try:
            return not _lock(handle, fcntl.LOCK_SH)
        finally:
            os.close(handle)

    def scores(self) -> list[dict[str, Any]]:
        """The rows of `scores.jsonl`; none if there are none yet."""
        try:
            lines = (self.path / "scores.jsonl").read_bytes().split(b"\n")
        except OSError:
            return []
        rows = []
        # The last part is empty, or a line that is being written.
        for number, line in enumerate(lines[:-1], start=1):
            try:
                rows.append(json.loads(line))
            except ValueError:
                raise StorageError(
                    f"line {number} of {self.path / 'scores.jsonl'} is damaged; delete the file, "
                    "and the coordinator writes it anew from its journal when the run is resumed"
                ) from None
        return rows

    def scores_size(self) -> int:
        """Bytes of `scores.jsonl`, which only grows; 0 if there is none."""
        try:
            return (self.path / "scores.jsonl").stat().st_size
        except OSError:
            return 0

    def events(self, newest: int) -> list[dict[str, Any]]:
        """So many of the last rows of `events.jsonl`, less those that cannot be read."""
        rows: list[dict[str, Any]] = []
        try:
            lines = (self.path / "events.jsonl").read_bytes().split(b"\n")[:-1]
        except OSError:
            return rows
        for line in lines[-newest:]:
            with suppress(ValueError):
                row = json.loads(line)
                rows += [row] if isinstance(row, dict) else []
        return rows

    def best(self) -> dict[str, dict[str, Any]]:
        """Block -> the iteration that is kept, its versions and why; empty if there is none yet."""
        return self._read("best.json")

    def result(self) -> dict[str, Any]:
        """What `finish` wrote; empty if the run is not completed."""
        return self._read("result.json")

    def completed(self) -> bool:
        """True once the run is done, whoever looked after it: `finish` is called by launchers only."""
        return bool(self.result()) or timeline_of(Records(self.path / "events.jsonl")).done

    def finish(self, result: dict[str, Any]) -> None:
        """Record that the run is completed. Raises `StorageError`."""
        write_atomically(self.path / "result.json", json.dumps(result, indent=2).encode() + b"\n")

    def _remove(self, name: str) -> None:
        try:
            (self.path / name).unlink(missing_ok=True)
        except OSError as error:
            refuse_storage(self.path / name, error)

    def _read(self, name: str) -> dict[str, Any]:
        path = self.path / name
        try:
            found = json.loads(path.read_bytes())
        except FileNotFoundError:
            return {}
        except (OSError, ValueError) as error:
            raise RunFolderError(
                f"cannot read {path} ({error}); put back a copy of it or delete it"
            ) from None
        return found if isinstance(found, dict) else {}


def running() -> list[RunFolder]:
    """The runs under runs/ that a launcher holds, the newest last; a damaged folder is none."""
    found: list[tuple[float, RunFolder]] = []
    for path in RUNS.glob("*/run.json"):
        with suppress(UserError, OSError):
            folder = RunFolder.find(str(path.parent))
            if folder.in_use():
                found.append((path.stat().st_mtime, folder))
    return [folder for _, folder in sorted(found, key=lambda each: each[0])]


def run_name(settings: RunSettings, made: datetime) -> str:
    """`<scenario>-<time>-<seed>`, a `Name` of the protocol."""
    return f"{settings.scenario[:LONGEST_SCENARIO]}-{made:%Y%m%d-%H%M%S}-{settings.seed}"


def config_text(settings: RunSettings) -> str:
    """All settings as TOML; what is None is left out, as in a scenario."""
    import tomli_w

    return tomli_w.dumps(settings.model_dump(mode="json", exclude_none=True))


def versions() -> dict[str, Any]:
    """The version of the code, of Python and of the packages that matter to a result."""
    return {
        "babble": {
            "version": metadata.version("babble"),
            "commit": _git("rev-parse", "HEAD"),
            "dirty": _dirty(),
        },
        "python": platform.python_version(),
        "platform": platform.platform(),
        "packages": {name: version for name in PACKAGES if (version := installed(name)) is not None},
    }


def installed(package: str) -> str | None:
    """The version of an installed package, or None."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _dirty() -> bool | None:
    changes = _git("status", "--porcelain")
    return None if changes is None else bool(changes)


def _git(*arguments: str) -> str | None:
    """What git says about the code, None where there is no git or no repository."""
    if not (ROOT / ".git").exists():
        return None
    try:
        said = subprocess.run(
            ["git", "-C", str(ROOT), *arguments], capture_output=True, text=True, timeout=GIT_SECS, check=True
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return said.stdout.strip()


def _lock(handle: int, how: int, within_secs: float = 0.0) -> bool:
    """Whether the lock could be had in time."""
    deadline_secs = time.monotonic() + within_secs
    while True:
        try:
            fcntl.flock(handle, how | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() >= deadline_secs:
                return False
            time.sleep(LOCK_POLL_SECS)
        else:
            return True


def _new_folder(name: str) -> Path:
    for number in range(1, MOST_ALIKE):
        path = RUNS / (name if number == 1 else f"{name}-{number}")
        try:
            path.mkdir(parents=True)
        except FileExistsError:
            continue
        except OSError as error:
            refuse_storage(path, error)
        return path.resolve()
    raise RunFolderError(f"there are {MOST_ALIKE} runs {RUNS / name} already; wait a second and try again")


def _empty_folder(path: Path) -> Path:
    try:
        path.mkdir(parents=True, exist_ok=True)
        filled = any(path.iterdir())
    except OSError as error:
        refuse_storage(path, error)
    if (path / "run.json").exists():
        raise RunFolderError(f"{path} already holds a run; go on with it by `babble up --resume {path}`")
    if filled:
        raise RunFolderError(f"--run-dir {path} is not empty; give a new or empty folder")
    return path.resolve()
