"""Compose projects of a test's own: unused names, nothing published but on loopback, always removed."""

import json
import os
import secrets
import signal
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tests.processes.owned import ROOT, Owner, Process, free_port, wait_for

IMAGES = "babble-test"
"""The images of the tests have names of their own, so that a test changes nobody's."""
DEPLOY = ROOT / "deploy"
ROOT_FILE = ROOT / "compose.yaml"
ONE_HOST = DEPLOY / "compose.yaml"
HOSTS = DEPLOY / "compose.hosts.yaml"
ACTORS = DEPLOY / "compose.actors.yaml"
COMMAND_SECS = 120.0
BUILD_SECS = 1800.0
RUN_SECS = 300.0
BECOME = "import os, sys; os.execvp(sys.argv[1], sys.argv[1:])"
"""An owner starts Python, which becomes the command that follows."""


def docker(*arguments: str, within_secs: float = COMMAND_SECS, check: bool = True) -> str:
    """What a docker command says on stdout. AssertionError with its complaint if it fails."""
    done = subprocess.run(
        ["docker", *arguments], capture_output=True, text=True, timeout=within_secs, check=False
    )
    assert done.returncode == 0 or not check, f"docker {' '.join(arguments)}: {done.stderr}"
    return done.stdout


class Project:
    """One `docker compose` project, which stands for a host."""

    def __init__(
        self, owner: Owner, files: Sequence[Path], environment: Mapping[str, str] | None = None
    ) -> None:
        self.name = f"babble-test-{secrets.token_hex(4)}"
        self._owner = owner
        self._files = files
        settings = {
            "BABBLE_IMAGES": IMAGES,
            "BABBLE_DASHBOARD_PORT": str(free_port()),
            "BABBLE_DASHBOARD_DATA_PORT": str(free_port()),
            "COMPOSE_ANSI": "never",
            "COMPOSE_PROGRESS": "plain",
            "COMPOSE_PROJECT_NAME": self.name,
        }
        ours = {
            name: value for name, value in os.environ.items() if not name.startswith(("BABBLE_", "COMPOSE_"))
        }
        self.environment = {**ours, **settings, **(environment or {})}

    def command(self, *arguments: str) -> list[str]:
        """A command of compose for this project."""
        return [
            "docker",
            "compose",
            *(word for file in self._files for word in ("-f", str(file))),
            *arguments,
        ]

    def compose(
        self, *arguments: str, within_secs: float = COMMAND_SECS, check: bool = True
    ) -> subprocess.CompletedProcess[str]:
        """Run a command of compose to its end. AssertionError if it fails."""
        done = subprocess.run(
            self.command(*arguments),
            cwd=ROOT,
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=within_secs,
            check=False,
        )
        assert done.returncode == 0 or not check, f"{arguments}: {done.stdout[-3000:]}{done.stderr[-3000:]}"
        return done

    def start(self, *arguments: str) -> Process:
        """Start a command of compose that goes on, such as `up` in a terminal."""
        return self._owner.start(
            "compose", "-c", BECOME, *self.command(*arguments), environment=self.environment
        )

    def ids(self, service: str) -> list[str]:
        """The containers of a service, also those that have ended, in the order of their numbers."""
        found = self.compose("ps", "--all", "--format", "json", service, check=False).stdout
        rows = [json.loads(line) for line in found.splitlines()]
        return [row["ID"] for row in sorted(rows, key=lambda row: int(row["Name"].rpartition("-")[2]))]

    def inspect(self, container: str) -> dict[str, Any]:
        """All that the engine knows of a container."""
        facts: dict[str, Any] = json.loads(docker("inspect", container))[0]
        return facts

    def state(self, service: str, number: int = 0) -> dict[str, Any]:
        """How one container of a service is; empty if there is none."""
        ids = self.ids(service)
        state: dict[str, Any] = self.inspect(ids[number])["State"] if len(ids) > number else {}
        return state

    def services(self) -> set[str]:
        """All services of the project."""
        return set(self.compose("config", "--services").stdout.split())

    def logs(self, *services: str) -> str:
        """What the containers have said so far."""
        return self.compose("logs", "--no-color", "--no-log-prefix", *services).stdout

    def wait_for_words(self, words: str, service: str, within_secs: float = COMMAND_SECS) -> str:
        """The first line in a service's log with these words."""

        def look() -> str | None:
            return next((line for line in self.logs(service).splitlines() if words in line), None)

        return wait_for(f"{words!r} in the log of {service}", look, within_secs)

    def crash(self, service: str, number: int = 0) -> str:
        """kill -9 of a container's first process from the host, as a crash looks to the engine; its id."""
        container = self.ids(service)[number]
        os.kill(int(self.inspect(container)["State"]["Pid"]), signal.SIGKILL)
        return container

    def read(self, path: str, service: str = "coordinator") -> str:
        """A file of a running container; empty if one or the other is not there."""
        done = self.compose("exec", "-T", service, "cat", path, check=False)
        return done.stdout if done.returncode == 0 else ""

    def events(self, run: str, what: str) -> list[str]:
        """The texts of one kind of the run's milestones so far."""
        lines = self.read(f"/runs/{run}/events.jsonl").splitlines()
        return [event["text"] for event in map(json.loads, lines) if event["what"] == what]

    def fetch(self, run: str, into: Path) -> Path:
        """A copy of the run's folder, as a person takes it out of the volume."""
        self.compose("cp", f"report:/runs/{run}", str(into))
        return into / run if (into / run).is_dir() else into

    def remove(self) -> None:
        """Containers, networks and volumes go; a container of `run --rm` holds a volume until it is away."""
        ours = f"label=com.docker.compose.project={self.name}"
        down = ("--profile", "*", "down", "--volumes", "--remove-orphans", "--timeout", "3")

        def gone() -> bool:
            self.compose(*down, check=False)
            containers = docker("ps", "--all", "--quiet", "--filter", ours)
            return not (containers + docker("volume", "ls", "--filter", ours, "--quiet")).split()

        wait_for(f"containers and volumes of {self.name} to go", gone, COMMAND_SECS)
