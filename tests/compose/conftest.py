"""Fixtures of the tests with containers: projects that are removed whatever happens, images built once."""

import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.compose.projects import BUILD_SECS, ONE_HOST, Project, docker
from tests.processes.owned import Owner

MakeProject = Callable[..., Project]
TEST_SECS = 1800
"""A first build of the images counts too."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """All tests of this folder are slow ones with containers."""
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.compose)
            item.add_marker(pytest.mark.slow)
            item.add_marker(pytest.mark.timeout(TEST_SECS))


@pytest.fixture(scope="session")
def engine() -> None:
    """A Docker engine with compose; skips the test where there is none."""
    for command in (("docker", "version"), ("docker", "compose", "version")):
        try:
            found = subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            pytest.skip(f"no Docker engine here: {error}")
        if found.returncode != 0:
            pytest.skip(f"no Docker engine here: `{' '.join(command)}` says {found.stderr.strip()}")


@pytest.fixture(scope="session")
def images(engine: None) -> None:
    """All images, built from the working tree under the tests' names."""
    with Owner() as owner:
        project = Project(owner, [ONE_HOST])
        project.compose("--profile", "*", "build", "--quiet", within_secs=BUILD_SECS)


@pytest.fixture
def owner() -> Iterator[Owner]:
    """Starts processes; whatever still runs at the end of the test is killed, by its id."""
    with Owner() as starting:
        yield starting


@pytest.fixture
def project(images: None, owner: Owner) -> Iterator[MakeProject]:
    """Makes projects of given files and environment; all are removed at the end of the test."""
    with ExitStack() as removing:

        def make(files: Sequence[Path] = (ONE_HOST,), **environment: str) -> Project:
            made = Project(owner, files, environment)
            removing.callback(made.remove)
            return made

        yield make


@pytest.fixture
def scenario(tmp_path: Path) -> Callable[[str], Path]:
    """Writes a scenario and a compose file that lays its folder over the shipped ones; returns that file."""

    def write(text: str) -> Path:
        folder = tmp_path / "scenarios"
        folder.mkdir(exist_ok=True)
        folder.chmod(0o755)
        (folder / "tiny.toml").write_text(text)
        path = tmp_path / "scenario.yaml"
        path.write_text(f'services: {{prepare: {{volumes: ["{folder}:/scenarios:ro"]}}}}\n')
        return path

    return write


@pytest.fixture(scope="session")
def joint(engine: None) -> Iterator[str]:
    """The name of a network that joins two projects, from which nobody reaches the world."""
    name = "babble-test-joint"
    docker("network", "create", "--internal", name)
    yield name
    docker("network", "rm", name)
