"""A tree of blocks over Zenoh, as a person starts it: a lost learner, and the death of everything."""

import hashlib
import os
import signal
from pathlib import Path
from typing import Any

import psutil
import pytest

from tests.processes.owned import Owner, Process, wait_for
from tests.processes.tree_runs import read, rows

pytestmark = pytest.mark.processes

LEAVES = ("x", "yz")
TREE = """
scenario = "tiny-tree"
[learners]
policy = 2
[phases]
babble_steps = 2048
ground_steps = 16384
walk_steps = 1024
practise_steps = 1024
iterations = 1
[encoder.encode]
updates = 30
[encoder.refine]
updates = 20
[evaluation]
columns = 8
legs = 3
leg_steps = 20
[[block]]
name = "x"
observes = ["x"]
drives = ["x"]
[[block]]
name = "yz"
observes = ["y", "z"]
drives = ["y", "z"]
[[block]]
name = "body"
children = ["x", "yz"]
[[level]]
[[level]]
decision_steps = 5
segment_steps = 8
phases = { babble_steps = 2048, ground_steps = 16384, walk_steps = 1024, practise_steps = 1024 }
babbling = { subgoal_steps = [5, 20] }
"""
"""GROUND takes a second or two, time enough for what the test does to it; the rest is short."""
RUN_SECS = 120.0
STATUS_SECS = 30.0


def test_a_tree_waits_for_a_lost_learner_and_after_the_death_of_everything_trains_no_level_again(
    owner: Owner, tmp_path: Path
) -> None:
    scenario, folder = tmp_path / "tree.toml", tmp_path / "run"
    scenario.write_text(TREE)
    run = babble(owner, "up", scenario, "--seed", "1", "--run-dir", folder, "--no-dashboard")
    wait_for("learners that are there", lambda: len(lines(folder, "joined", "_learner")) >= 3, RUN_SECS)
    wait_for("GROUND of level 0", lambda: lines(folder, "phase", "ground (level 0"), RUN_SECS)
    lose_the_second_policy_learner(owner, run, folder)
    wait_for("GROUND of level 1", lambda: lines(folder, "phase", "ground (level 1"), RUN_SECS)
    kill_everything(run)
    assert not lines(folder, "phase", "evaluate of ground (level 1"), "it was killed in the middle"
    level_0, earlier = kept_of(folder, LEAVES), len(lines(folder, "phase"))
    resumed = babble(owner, "up", "--resume", folder, "--no-dashboard")
    assert resumed.ended(RUN_SECS) == 0, resumed.report()
    assert kept_of(folder, LEAVES) == level_0
    assert not [text for text in lines(folder, "phase")[earlier:] if "level 0" in text]
    assert len(lines(folder, "phase", "babble (level 1")) == 1, "level 1 went on too"
    scored = [(row["block"], row["iteration"], row["policy"]) for row in rows(folder, "scores.jsonl")]
    assert sorted(scored) == sorted(
        (block, number, policy)
        for block in (*LEAVES, "body")
        for number in (0, 1)
        for policy in ("mean", "sampled")
    )
    assert not [line for line in (*run.out, *resumed.out) if "bug" in line]


def lose_the_second_policy_learner(owner: Owner, run: Process, folder: Path) -> None:
    """It is killed and nobody starts it again for a while; people are told whose work waits."""
    [victim] = [each for each in children(run) if "services.policy_learner" in each and "--index 1" in each]
    run.freeze()  # the launcher alone, so that it starts no other
    os.kill(children(run)[victim], signal.SIGKILL)
    wait_for("the loss", lambda: lines(folder, "lost", "policy_learner"), RUN_SECS)
    status = babble(owner, "status", folder)
    assert status.ended(STATUS_SECS) == 0, status.report()
    run.thaw()
    assert status.out[0].endswith(": GROUND, term 3"), status.report()
    assert status.out[1].startswith("waiting for policy_learner 1 of yz to appear"), status.report()


def kill_everything(run: Process) -> None:
    """kill -9 to the launcher, and with it to all that it started."""
    started = list(children(run).values())
    run.kill()
    wait_for("all to be gone", lambda: not any(map(running, started)), RUN_SECS)


def kept_of(folder: Path, blocks: tuple[str, ...]) -> dict[str, Any]:
    """What a run keeps of some blocks: their models, their best iterations, their scores, their updates."""
    models = [path for block in blocks for path in sorted((folder / "models" / block).iterdir())]
    updates: dict[str, int] = {}
    for row in rows(folder, "metrics.jsonl"):
        updates |= {name: count for name, count in row["totals"].items() if name.endswith("_updates")}
    return {
        "models": {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in models},
        "best": {block: read(folder, "best.json")[block] for block in blocks},
        "scores": [row for row in rows(folder, "scores.jsonl") if row["block"] in blocks],
        "updates": {name: count for name, count in updates.items() if name.split("/")[0] in blocks},
    }


def lines(folder: Path, what: str, text: str = "") -> list[str]:
    """The milestones of a run of one kind, with this text."""
    events = [row for row in rows(folder, "events.jsonl") if row["what"] == what]
    return [row["text"] for row in events if text in row["text"]]


def children(run: Process) -> dict[str, int]:
    """The processes of a launcher that run: command line and id."""
    found = psutil.Process(run.pid).children(recursive=True)
    return {" ".join(each.cmdline()): each.pid for each in found if running(each.pid)}


def running(process_id: int) -> bool:
    """True while it is neither gone nor waiting to be asked how it ended."""
    try:
        return psutil.Process(process_id).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def babble(owner: Owner, *arguments: str | Path) -> Process:
    """Start `babble <arguments>`."""
    return owner.start("babble", "-m", "services.launcher", *map(str, arguments))
