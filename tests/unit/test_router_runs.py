"""The router's word in each run: only where a coordinator is, with the phase that is announced there."""

import json
from pathlib import Path

import pytest

from protocol import keys
from protocol.codec import decode, encode
from protocol.messages import Phase, PhaseAnnounced, Status
from services.router.runs import MOST_RUNS, Runs
from tests.unit.router_stage import PlayedRouter

LIFE = "router-00000001"
COORDINATORS, PHASES = keys.alive("*", "coordinator", "*"), keys.phase("*")


class Stage:
    def __init__(self) -> None:
        self.now_secs = 1000.0
        self.router = PlayedRouter()
        self.runs = Runs(LIFE)
        self.runs.attach(self.router)

    def coordinator(self, run: str, number: int = 1, present: bool = True) -> None:
        self.router.announces(COORDINATORS, keys.alive(run, "coordinator", f"coordinator-{number}"), present)

    def announce(self, run: str, term: int, phase: Phase) -> None:
        announced = PhaseAnnounced(
            run=run, term=term, block="all", life="coordinator-1", seq=0, phase=phase, blocks={}
        )
        self.router.publishes(PHASES, keys.phase(run), encode(announced))

    def poll(self) -> list[Status]:
        """What it says a second later."""
        self.now_secs += 1.0
        self.router.said.clear()
        self.runs.hear()
        self.runs.publish(self.now_secs, lambda: {"totals": {"clients": 3}})
        found = []
        for key, frame in self.router.said:
            status = decode(frame)
            assert isinstance(status, Status)
            assert key == keys.status(status.run, "router", LIFE)
            found.append(status)
        return found


def test_it_says_nothing_where_there_is_no_coordinator() -> None:
    stage = Stage()
    stage.announce("r", 1, Phase.BABBLE)
    assert stage.poll() == []


def test_each_run_with_a_coordinator_hears_it_with_its_own_phase() -> None:
    stage = Stage()
    stage.coordinator("one")
    stage.coordinator("two")
    stage.poll()
    stage.announce("two", 4, Phase.WALK)
    stage.router.publishes(PHASES, keys.phase("one"), b"garbage")
    said = {status.run: (status.term, status.phase, status.totals["clients"]) for status in stage.poll()}
    assert said == {"one": (0, None, 3), "two": (4, Phase.WALK, 3)}
    stage.coordinator("two", present=False)
    assert [status.run for status in stage.poll()] == ["one"]


def test_many_runs_get_no_more_than_it_can_serve(caplog: pytest.LogCaptureFixture) -> None:
    stage = Stage()
    for number in range(MOST_RUNS + 3):
        stage.coordinator(f"run{number}")
    assert len(stage.poll()) == MOST_RUNS
    assert "gets no status" in caplog.text
    stage.coordinator("run0", present=False)
    stage.coordinator("late")
    assert "late" in {status.run for status in stage.poll()}


@pytest.mark.parametrize("run", ["*", "a b", "R", "x" * 100])
def test_what_is_no_runs_name_gets_nothing_and_harms_nobody(run: str) -> None:
    stage = Stage()
    stage.coordinator(run)
    stage.coordinator("r")
    assert [status.run for status in stage.poll()] == ["r"]


def test_done_means_that_a_run_is_done_and_no_other_goes_on() -> None:
    stage = Stage()
    stage.poll()
    assert not stage.runs.done()
    stage.coordinator("one")
    stage.coordinator("two")
    stage.announce("one", 9, Phase.DONE)
    stage.announce("two", 9, Phase.WALK)
    stage.poll()
    assert not stage.runs.done()
    stage.coordinator("two", present=False)
    stage.poll()
    assert stage.runs.done()
    stage.coordinator("one", present=False)
    stage.poll()
    assert stage.runs.done()


def test_a_run_that_begins_again_under_its_old_name_is_not_done() -> None:
    stage = Stage()
    stage.coordinator("r")
    stage.announce("r", 9, Phase.DONE)
    stage.coordinator("r", present=False)
    stage.poll()
    stage.coordinator("r", number=2)
    stage.announce("r", 1, Phase.BABBLE)
    (status,) = stage.poll()
    assert (status.term, status.phase) == (1, Phase.BABBLE)
    assert not stage.runs.done()


def test_with_no_run_it_still_keeps_its_health_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BABBLE_HEALTH", str(tmp_path / "health"))
    stage = Stage()
    assert stage.poll() == []
    record = json.loads((tmp_path / "health").read_text())
    assert (record["service"], record["unlinked_secs"]) == ("router", None)
