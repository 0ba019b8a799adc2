"""What a person gets wrong is one sentence in the log, without a traceback."""

import os
import socket
from collections.abc import Callable
from pathlib import Path

import pytest

from services.launcher.certs_folder import CertsFolder
from tests.compose.conftest import MakeProject
from tests.compose.projects import ACTORS, ONE_HOST, Project
from tests.compose.test_one_host import ENDLESS
from tests.processes.owned import wait_for

SAID_SECS = 90.0


def sentence(project: Project, service: str) -> str:
    """The only line that a service said, once it has ended with code 2 or is about to be tried again."""

    def ended() -> bool:
        facts = project.inspect(project.ids(service)[0])
        return facts["RestartCount"] > 0 or facts["State"]["Status"] in ("exited", "restarting")

    wait_for(f"{service} to give up", ended, SAID_SECS)
    lines = {line for line in project.logs(service).splitlines() if " INFO " not in line}
    assert len(lines) == 1, lines
    return lines.pop()


def test_a_scenario_that_is_missing_is_named_with_those_there_are_and_nothing_starts(
    project: MakeProject,
) -> None:
    host = project(BABBLE_SCENARIO="nosuch")
    assert host.compose("up", check=False).returncode != 0
    assert sentence(host, "prepare").startswith("babble prepare: there is no scenario 'nosuch'; give")
    assert "cuboid" in sentence(host, "prepare")
    running = host.compose("ps", "--quiet", "--status", "running").stdout
    assert not running.split()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root makes a folder that others cannot write")
def test_a_volume_that_cannot_be_written_is_named_with_the_user(project: MakeProject, tmp_path: Path) -> None:
    folder = tmp_path / "runs"
    folder.mkdir(mode=0o755)
    host = project(BABBLE_RUNS=str(folder))
    assert host.compose("up", check=False).returncode != 0
    assert sentence(host, "prepare").startswith("babble prepare: user 1000 cannot write into /runs")


def test_a_run_of_that_name_with_another_scenario_is_not_touched(
    project: MakeProject, scenario: Callable[[str], Path]
) -> None:
    files = [ONE_HOST, scenario(ENDLESS)]
    first = project(files, BABBLE_SCENARIO="tiny", BABBLE_RUN="mine")
    first.compose("run", "--rm", "prepare")
    first.environment["BABBLE_SEED"] = "7"
    assert first.compose("up", check=False).returncode != 0
    assert "was begun with other settings: seed" in sentence(first, "prepare")


def test_a_port_in_use_is_named_by_the_engine(project: MakeProject) -> None:
    with socket.socket() as holder:
        holder.bind(("127.0.0.1", 0))
        holder.listen()
        port = str(holder.getsockname()[1])
        host = project(BABBLE_DASHBOARD_PORT=port)
        up = host.compose("up", "--detach", check=False)
    assert up.returncode != 0
    assert f"127.0.0.1:{port}" in up.stderr
    assert "address already in use" in up.stderr


@pytest.fixture
def certs(tmp_path: Path) -> CertsFolder:
    """An authority whose credentials the containers can read."""
    tmp_path.chmod(0o755)
    return CertsFolder.create(tmp_path / "certs", ["head"], owner=(1000, 1000) if os.geteuid() == 0 else None)


def test_actors_elsewhere_say_what_is_wrong_with_their_credential(
    project: MakeProject, certs: CertsFolder, tmp_path: Path
) -> None:
    rubbish = tmp_path / "rubbish.pem"
    rubbish.write_text("nothing")
    rubbish.chmod(0o644)
    expected = {
        certs.path_of("coordinator"): "is the credential of coordinator",
        rubbish: "is no credential",
    }
    for path, words in expected.items():
        settings = {"BABBLE_CONNECT": "tls/head:7447", "BABBLE_RUN": "cuboid", "BABBLE_CREDENTIAL": str(path)}
        host = project([ACTORS], BABBLE_ACTORS="1", **settings)
        host.compose("up", "--detach")
        said = sentence(host, "actor")
        assert said.startswith("actor: ")
        assert words in said
        assert "PRIVATE" not in said


def test_actors_elsewhere_need_an_address_a_run_and_a_credential_that_is_there(project: MakeProject) -> None:
    told = {"BABBLE_CONNECT": "tls/head:7447", "BABBLE_RUN": "cuboid", "BABBLE_CREDENTIAL": "/nosuch.pem"}
    for name, words in {"BABBLE_CONNECT": "say where the router is", "BABBLE_RUN": "say which run"}.items():
        refused = project([ACTORS], **{**told, name: ""}).compose("up", "--detach", check=False)
        assert words in refused.stderr
    host = project([ACTORS], **told)
    assert "/nosuch.pem" in host.compose("up", "--detach", check=False).stderr
