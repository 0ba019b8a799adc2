"""Actors that have a run's name and nothing else: they join, share its work, leave and return."""

import json
import shutil
import signal
import time
from functools import partial
from pathlib import Path

import psutil
import pytest

from services.runtime.checkpoint import Checkpoints
from services.runtime.settings import parse
from tests.processes.credentials_stage import CredentialsStage
from tests.processes.distributed import LEARNERS, RUN, RUN_SECS, DistributedRun
from tests.processes.owned import Owner, Process, RunningRouter, wait_for

pytestmark = pytest.mark.processes

TINY = """
scenario = "tiny"
[actors]
envs_per_actor = 4
segment_steps = 64
[phases]
babble_steps = 2048
ground_steps = 2048
walk_steps = 2048
practise_steps = 2048
iterations = 1
[encoder.encode]
updates = 30
[encoder.refine]
updates = 20
[evaluation]
columns = 8
legs = 3
leg_steps = 20
[wire]
connect_secs = 60.0
status_secs = 0.2
"""
LONGER = TINY.replace("2048", "16384")
MISSING_MODEL = """
scenario = "own-model"
[world]
id = "Mjcf"
parameters = { file = "/nowhere/robot.xml" }
"""


class RemoteRun(DistributedRun):
    """A run whose actors have nothing of its folder."""

    def __init__(self, owner: Owner, run_dir: Path, config: str = TINY) -> None:
        super().__init__(owner, run_dir)
        (run_dir / "config.toml").write_text(config)

    def join(self, name: str) -> Process:
        """An actor that is given the run's name."""
        self.running[name] = actor(self._owner, self.router, RUN)
        return self.running[name]

    def start_home(self) -> None:
        """Everything but actors."""
        for name in ("coordinator", *LEARNERS):
            self.start(name)

    def begin_again(self, run_dir: Path, config: str) -> None:
        """Everything but actors of another run, which has the name of this one."""
        run_dir.mkdir()
        shutil.copy(self.run_dir / "run.json", run_dir / "run.json")
        (run_dir / "config.toml").write_text(config)
        self.run_dir = run_dir
        self.start_home()

    def env_steps(self, process: Process) -> int:
        """What the process says it has done, in its present life."""
        life = life_of(process)
        status = self.statuses().get(life)
        return 0 if status is None else status.totals["env_steps"]


def actor(owner: Owner, router: RunningRouter, run: str, *more: str) -> Process:
    """An actor that joins a run by its name."""
    return owner.start_service("actor", "--run", run, "--connect", router.endpoint, *more)


def babble_actor(owner: Owner, router: RunningRouter, run: str, *more: str) -> Process:
    """`babble actor` on this host."""
    command = ("-m", "services.launcher", "actor", "--connect", router.endpoint, "--run", run)
    return owner.start("babble actor", *command, *more)


def life_of(process: Process) -> str:
    """The life that a process's newest log line is of; "" before there is one."""
    lives = [line.split()[1] for line in list(process.err) if " ready in run " in line]
    return lives[-1] if lives else ""


def lives(process: Process) -> set[str]:
    """All lives that were ready, by its log."""
    return {line.split()[1] for line in list(process.err) if " ready in run " in line}


def was_lost(run: RemoteRun, process: Process, times: int) -> bool:
    """Whether the coordinator has missed it so often."""
    return sum(life_of(process) in text for text in run.events("lost")) == times


def said(process: Process, words: str) -> bool:
    """Whether the words are in its log."""
    return any(words in line for line in list(process.err))


def test_actors_that_know_only_the_runs_name_do_all_its_work(owner: Owner, tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    first.mkdir()
    run = RemoteRun(owner, first, LONGER)
    early = run.join("actor-early")
    wait_for("an actor without a coordinator", lambda: said(early, "waiting for the settings"))
    run.start("coordinator")
    wait_for("an actor that knows the settings", lambda: life_of(early))
    before = life_of(early)
    run.kill("coordinator")
    run.begin_again(second, TINY)
    run.join("actor-late")
    run.end()
    assert life_of(early) != before, "the run of its name is another one"
    assert [row["policy"] for row in run.scores()] == ["mean", "sampled"] * 2
    run.statuses().pop(before, None)
    run.assert_nothing_lost_or_counted_twice()
    assert {text.split("-")[0] for text in run.events("joined")} >= {"actor"}


@pytest.mark.slow
def test_actors_of_different_speed_share_the_work_and_come_and_go(owner: Owner, tmp_path: Path) -> None:
    run = RemoteRun(owner, tmp_path, LONGER)
    run.start("coordinator")
    steady, slow, doomed = (run.join(f"actor-{name}") for name in ("steady", "slow", "doomed"))
    wait_for("three actors", lambda: all(map(life_of, (steady, slow, doomed))))
    for learner in LEARNERS:
        run.start(learner)
    for times, phase in enumerate(("babble", "ground", "walk"), start=1):
        run.wait_for_phase(phase)
        slow.freeze()
        wait_for("a frozen actor to be missed", partial(was_lost, run, slow, times))
        slow.thaw()
        if phase == "ground":
            assert run.env_steps(doomed) > 0
            run.kill("actor-doomed")
            returned = run.join("actor-returned")
    run.end()
    assert 0 < run.env_steps(slow) < run.env_steps(steady)
    assert run.env_steps(returned) > 0
    run.assert_nothing_lost_or_counted_twice()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_babble_actor_ends_within_seconds_and_leaves_nobody_behind(
    owner: Owner, tmp_path: Path, router: RunningRouter, number: signal.Signals
) -> None:
    coordinator(owner, tmp_path, router)
    crew = babble_actor(owner, router, RUN, "--count", "2")
    wait_for("two actors", lambda: len(lives(crew)) == 2)
    actors = psutil.Process(crew.pid).children()
    assert len(actors) == 2
    crew.interrupt(number)
    assert crew.ended(6.0) == 128 + number
    assert not any(child.is_running() for child in actors)
    assert crew.err[-1] == f"babble actor: left run {RUN}"
    assert not any("Traceback" in line for line in crew.err)


def test_babble_actor_looks_after_the_actors_of_a_host_behind_a_closed_door(
    owner: Owner, tmp_path: Path
) -> None:
    stage = CredentialsStage(tmp_path / "certs")
    guarded = stage.router(owner, ["lab"])
    home = tmp_path / "run"
    home.mkdir()
    (home / "config.toml").write_text(TINY)
    (home / "run.json").write_text(json.dumps({"run": RUN}))

    def start(name: str) -> Process:
        return owner.start_service(
            name,
            *("--run-dir", str(home), "--connect", guarded.endpoint),
            *("--credential", str(stage.path(name))),
        )

    shown = ("--credential", str(stage.path("actor.lab")))
    running = [start("coordinator"), babble_actor(owner, guarded, RUN, *shown, "--count", "2")]
    misled = babble_actor(owner, guarded, "crash-tset", *shown, "--count", "3")
    crew = running[1]
    wait_for("two actors", lambda: len(lives(crew)) == 2)
    psutil.Process(crew.pid).children()[0].kill()
    wait_for("a third life", lambda: len(lives(crew)) == 3)
    running += map(start, LEARNERS)
    for process in running:
        assert process.ended(RUN_SECS) == 0, process.report()
    assert said(crew, "babble actor: actor 1 was killed by SIGKILL; it is started again in 0.25 s")
    assert crew.err[-1] == f"babble actor: all actors have ended in order, for run {RUN} is done"
    assert all(life.startswith("actor-lab-") for life in lives(crew))
    learned = Checkpoints(home / "checkpoints" / "encoder_learner").newest()
    assert learned is not None
    streams = json.loads(learned[1]["book"])["ledger"]["streams"]  # type: ignore[index]
    assert {life for life, *_ in streams} <= lives(crew)
    assert streams
    assert "body" in json.loads((home / "best.json").read_text())
    assert misled.ended(40.0) == 2
    assert [line for line in misled.err if "no run" in line] == [
        f"babble actor: no run 'crash-tset' is announced at {guarded.endpoint} (there is '{RUN}'): check "
        "--run (the run's name, see `babble status` there), or the coordinator is not up yet"
    ]
    assert misled.err[-1].startswith("babble actor: no run")


def test_a_stop_while_waiting_ends_at_once(owner: Owner, router: RunningRouter) -> None:
    waiting = actor(owner, router, "nobody")
    wait_for("an actor that waits", lambda: said(waiting, "waiting for the settings"))
    waiting.interrupt(signal.SIGTERM)
    began = time.monotonic()
    assert waiting.ended(10.0) == 0
    assert time.monotonic() - began < 2.0


def test_a_router_that_was_replaced_still_tells_late_comers(
    owner: Owner, tmp_path: Path, router: RunningRouter
) -> None:
    home = coordinator(owner, tmp_path, router)
    wait_for("the coordinator", lambda: said(home, "ready in run"))
    router.kill()
    router.start_again()
    late = actor(owner, router, RUN, "--print-config")
    assert late.ended(40.0) == 0, late.report()
    told = parse(json.loads("\n".join(late.out)), origin="test")
    assert (told.scenario, told.actors.segment_steps) == ("tiny", 64)


def test_a_model_file_that_is_not_on_this_host_is_named(
    owner: Owner, tmp_path: Path, router: RunningRouter
) -> None:
    coordinator(owner, tmp_path, router, MISSING_MODEL)
    lacking = actor(owner, router, RUN)
    assert lacking.ended(40.0) == 2
    assert lacking.err[-1] == (
        "actor: Mjcf: there is no model file /nowhere/robot.xml; only the settings of run crash-test come "
        "over the network, so have the same file at the same path on this host"
    )


@pytest.mark.slow
def test_when_the_run_is_begun_again_in_its_middle_under_its_name_the_actors_of_before_take_part(
    owner: Owner, tmp_path: Path
) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    first.mkdir()
    run = RemoteRun(owner, first, LONGER)
    run.start_home()
    remote = run.join("actor-remote")
    run.wait_for_phase("ground")
    before = life_of(remote)
    for name in ("coordinator", *LEARNERS):
        run.kill(name)
    run.begin_again(second, TINY)
    run.end()
    assert life_of(remote) not in ("", before)
    assert said(remote, "beginning anew")
    assert run.scores()
    del run.statuses()[before]  # its books went with the run that was left
    run.assert_nothing_lost_or_counted_twice()


def coordinator(owner: Owner, run_dir: Path, router: RunningRouter, config: str = TINY) -> Process:
    """A coordinator of a run that nobody else takes part in."""
    (run_dir / "config.toml").write_text(config)
    (run_dir / "run.json").write_text(json.dumps({"run": RUN}))
    return owner.start_service("coordinator", "--run-dir", str(run_dir), "--connect", router.endpoint)
