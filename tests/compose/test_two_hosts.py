"""Two compose projects as two hosts, joined by TLS over a network from which nobody reaches the world."""

import json
import os
from collections.abc import Callable, Set
from pathlib import Path

import pytest

from services.launcher.certs_folder import CertsFolder
from services.runtime.checkpoint import Checkpoints
from tests.compose.conftest import MakeProject
from tests.compose.ears import Ears
from tests.compose.projects import ACTORS, HOSTS, ONE_HOST, Project
from tests.processes.owned import wait_for

RUN = "tiny"
SCENARIO = """
scenario = "tiny"
[actors]
envs_per_actor = 2
[phases]
babble_steps = 5000000
ground_steps = 8192
walk_steps = 4096
practise_steps = 4096
iterations = 1
[encoder.encode]
updates = 100
[encoder.refine]
updates = 50
"""
"""BABBLE takes long enough for all that the test does to the second host; the rest is short."""
HEAD = """
services:
  router:
    ports: !reset []
    networks: !override {{actors: {{}}, core: {{}}, joint: {{aliases: [head]}}}}
networks:
  joint: {{external: true, name: {joint}}}
"""
SECOND = """
services:
  actor:
    networks: !override {{joint: {{}}}}
networks:
  joint: {{external: true, name: {joint}}}
"""
SOON_SECS = 60.0
RUN_SECS = 900.0

Join = Callable[[str, Path], Project]


@pytest.fixture
def certs(tmp_path: Path) -> CertsFolder:
    """An authority with a credential for the host `lab`; the containers can read all of it."""
    owner = (1000, 1000) if os.geteuid() == 0 else None
    folder = CertsFolder.create(tmp_path / "certs", ["head", "router"], owner=owner)
    folder.add("lab")
    return folder


@pytest.fixture
def head(
    project: MakeProject, scenario: Callable[[str], Path], certs: CertsFolder, joint: str, tmp_path: Path
) -> Project:
    """The host of the run, published nowhere but in the joint network."""
    path = tmp_path / "head.yaml"
    path.write_text(HEAD.format(joint=joint))
    files = [ONE_HOST, HOSTS, scenario(SCENARIO), path]
    return project(files, BABBLE_SCENARIO=RUN, BABBLE_ACTORS="1", BABBLE_CERTS=str(certs.path))


@pytest.fixture
def join(project: MakeProject, joint: str, tmp_path: Path) -> Join:
    """Makes the second host's project, for a run's name and a credential."""
    path = tmp_path / "second.yaml"
    path.write_text(SECOND.format(joint=joint))

    def made(run: str, credential: Path) -> Project:
        told = {"BABBLE_CONNECT": "tls/head:7447", "BABBLE_RUN": run, "BABBLE_CREDENTIAL": str(credential)}
        return project([ACTORS, path], BABBLE_ACTORS="2", **told)

    return made


def test_actors_of_a_second_host_join_work_vanish_return_and_the_run_completes(
    head: Project, join: Join, certs: CertsFolder, tmp_path: Path
) -> None:
    up = head.start("up")
    up.expect(" s  BABBLE", 180.0)
    ears = Ears(head, RUN)
    second = join(RUN, certs.path_of("actor.lab"))
    second.compose("up", "--detach")
    came = at_work(ears, 2)
    second.compose("down")
    wait_for("both to be missed", lambda: missed(head) >= came, SOON_SECS)
    assert up.running(), "the head ended without them"
    second.compose("up", "--detach")
    returned = at_work(ears, 2, before=came)
    assert up.ended(RUN_SECS) == 0, up.report()
    for number in range(2):
        wait_for(
            "actors to end",
            lambda number=number: second.state("actor", number)["Status"] == "exited",
            SOON_SECS,
        )
        assert second.state("actor", number)["ExitCode"] == 0, second.logs("actor")
    folder = head.fetch(RUN, tmp_path / "fetched")
    taken = segments_taken(folder / "checkpoints" / "encoder_learner")
    assert all(taken.get(life, 0) > 0 for life in came | returned), taken


def test_what_keeps_actors_of_a_second_host_out_is_one_sentence_there(
    head: Project, join: Join, certs: CertsFolder, tmp_path: Path
) -> None:
    head.compose("up", "--detach")
    wait_for("BABBLE", lambda: head.events(RUN, "phase"), 180.0)
    strangers = CertsFolder.create(
        tmp_path / "strangers", ["head", "router"], owner=(1000, 1000) if os.geteuid() == 0 else None
    )
    strangers.add("lab")
    wrong_run = join("another", certs.path_of("actor.lab"))
    stranger = join(RUN, strangers.path_of("actor.lab"))
    for host in (wrong_run, stranger):
        host.compose("up", "--detach")
    wrong_run.wait_for_words("no run 'another' is announced at tls/head:7447", "actor", SOON_SECS)
    said = stranger.wait_for_words("actor: cannot connect to tls/head:7447", "actor", SOON_SECS)
    assert "of another authority than the credential" in said, said
    assert "Traceback" not in wrong_run.logs("actor") + stranger.logs("actor")


def at_work(ears: Ears, number: int, *, before: Set[str] = frozenset()) -> set[str]:
    """The lives of the second host that are there now, once there are so many and each has sent a segment.

    `before`: those that have gone; their last words may still be fresh.
    """

    def there() -> set[str] | None:
        lives = {life for life in ears.actors(2.5) - before if life.startswith("actor-lab-")}
        return lives if len(lives) == number else None

    lives = wait_for(f"{number} actors of the second host", there, SOON_SECS)
    for life in lives:
        ears.wait_for_steps(life, SOON_SECS)
    return lives


def missed(head: Project) -> set[str]:
    """The lives whose end the coordinator has noted."""
    return {text.split()[0] for text in head.events(RUN, "lost")}


def segments_taken(checkpoints: Path) -> dict[str, int]:
    """Life -> how many of its segments a learner has taken."""
    found = Checkpoints(checkpoints).newest()
    assert found is not None
    assert isinstance(found[1], dict)
    streams = json.loads(found[1]["book"])["ledger"]["streams"]
    taken: dict[str, int] = {}
    for life, _, upto, _ in streams:
        taken[life] = taken.get(life, 0) + upto
    return taken
