"""Which actor is shown to people: counted by containers, made up by further hosts, told by a person."""

import argparse
import re
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from services.actor import index
from services.actor.index import FIRST_OWN, add_options, index_of, replica_of
from services.runtime.bus import Wakeup
from services.runtime.clock import HandClock
from services.runtime.memory_bus import MemoryBus
from services.runtime.process import NO_FOLDER, Context
from services.runtime.settings import parse


def context(*told: str, life: str = "actor-000003e8", run_dir: Path = NO_FOLDER) -> Context:
    """An actor's, with its command line."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--connect", default="tcp/127.0.0.1:7447")
    add_options(parser)
    return Context(
        bus=MemoryBus().connect(life),
        clock=HandClock(),
        settings=parse({"scenario": "x"}, origin="test"),
        run="x",
        run_dir=run_dir,
        life=life,
        wakeup=Wakeup(),
        options=parser.parse_args(told),
    )


@pytest.fixture
def named(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Lets the name server call this machine so."""

    def name(answer: str) -> None:
        monkeypatch.setattr(socket, "gethostbyaddr", lambda _: (answer, [], []))

    return name


@pytest.mark.parametrize(
    ("name", "replica"),
    [
        ("babble-actor-1.babble_actors", 0),
        ("my-project-actor-12.my-project_actors", 11),
        ("babble_actor_3.babble_default", 2),
        ("actor-2", 1),
        ("localhost", None),
        ("", None),
        ("actor", None),
        ("babble-actor-0.babble_actors", None),
        ("babble-router-1.babble_actors", None),
        ("node-12.cluster.local", None),
        ("babble-actor-7d9f8c5b6-x2x4z", None),
        ("factor-3.lab", None),
    ],
)
def test_a_containers_number_is_read_from_its_name(name: str, replica: int | None) -> None:
    assert replica_of(name) == replica


@pytest.mark.parametrize("life", ["actor-000003e8", "actor-local-000003e8"])
def test_a_scaled_container_takes_its_replica_number(named: Any, life: str) -> None:
    named("babble-actor-3.babble_actors")
    assert index_of(context("--index", "auto", life=life)) == 2


def test_elsewhere_it_makes_up_one_that_is_not_shown(named: Any) -> None:
    named("workstation.lab")
    assert index_of(context("--index", "auto")) == FIRST_OWN + 1000


def test_a_further_host_never_takes_a_number_of_the_runs_own(named: Any) -> None:
    named("babble-actor-1.babble_actors")
    assert index_of(context("--index", "auto", life="actor-lab_2-00000000")) == FIRST_OWN


def test_the_default_is_zero_with_a_folder_and_auto_by_name(named: Any, tmp_path: Path) -> None:
    named("babble-actor-5.babble_actors")
    assert index_of(context(run_dir=tmp_path)) == 0
    assert index_of(context()) == 4


def test_what_a_person_said_holds(named: Any) -> None:
    named("babble-actor-5.babble_actors")
    assert index_of(context("--index", "7", life="actor-lab-00000000")) == 7


@pytest.mark.parametrize("text", ["-1", "one", "1.5", "²", ""])
def test_other_indices_are_refused(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        context(f"--index={text}")
    assert re.search("must be a whole number of at least 0, or auto", capsys.readouterr().err)


@pytest.fixture
def silent_name_server(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """One that does not answer before the test is over."""
    over = threading.Event()

    def look_up(_: object) -> tuple[str, list[str], list[str]]:
        over.wait(20.0)
        return "babble-actor-1.babble_actors", [], []

    monkeypatch.setattr(socket, "gethostbyaddr", look_up)
    yield
    over.set()


@pytest.mark.usefixtures("silent_name_server")
def test_a_name_server_that_does_not_answer_holds_nobody_up() -> None:
    began = time.monotonic()
    assert index_of(context("--index", "auto")) >= FIRST_OWN
    assert time.monotonic() - began < 2.0


@pytest.mark.parametrize("endpoint", ["nonsense", "tcp/", "tcp/127.0.0.1:http:x", "tls/[::1]:7447"])
def test_no_address_breaks_the_look_up(endpoint: str) -> None:
    assert isinstance(index._look_up(endpoint), str)
