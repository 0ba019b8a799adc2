"""Each container is killed with -9 from the host: it comes back by itself, and the run completes."""

import json
from collections.abc import Callable
from pathlib import Path

from services.runtime.checkpoint import Checkpoints
from tests.compose.conftest import MakeProject
from tests.compose.projects import ONE_HOST, Project
from tests.processes.owned import wait_for

MANY = """
scenario = "tiny"
[actors]
envs_per_actor = 4
[phases]
babble_steps = 8192
ground_steps = 8192
walk_steps = 2048
practise_steps = 4096
iterations = 60
[encoder.encode]
updates = 50
[encoder.refine]
updates = 20
[evaluation]
columns = 4
legs = 3
leg_steps = 20
"""
RUN = "tiny"
VICTIMS = ("actor", "router", "encoder_learner", "coordinator", "policy_learner", "dashboard", "report")
BACK_SECS = 120.0
RUN_SECS = 900.0


def test_every_container_crashes_once_and_the_run_completes_with_nothing_lost_or_counted_twice(
    project: MakeProject, scenario: Callable[[str], Path], tmp_path: Path
) -> None:
    host = project([ONE_HOST, scenario(MANY)], BABBLE_SCENARIO=RUN)
    up = host.start("up")
    up.expect("PRACTISE", BACK_SECS)
    for service in VICTIMS:
        progress_after_crash_of(host, service)
    assert up.ended(RUN_SECS) == 0, up.report()
    for service in host.services():
        assert host.state(service)["ExitCode"] == 0, f"{service}: {host.logs(service)[-2000:]}"
    folder = host.fetch(RUN, tmp_path / "fetched")
    lines = [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]
    lost = [event["text"] for event in lines if event["what"] == "lost"]
    for service in ("actor", "encoder_learner", "policy_learner"):
        assert any(f"({service}) is gone" in text for text in lost), lost
    for learner in ("encoder_learner", "policy_learner"):
        assert_took_each_segment_once(folder / "checkpoints" / learner)


def progress_after_crash_of(host: Project, service: str) -> None:
    """Kill one container of a service; it comes back by itself, and the run gets on to another phase."""
    crashed = host.crash(service)

    def back() -> bool:
        facts = host.inspect(crashed)
        return facts["RestartCount"] == 1 and facts["State"]["Running"]

    wait_for(f"{service} to come back", back, BACK_SECS)
    phases = wait_for("the coordinator", lambda: host.events(RUN, "phase"), BACK_SECS)
    assert not phases[-1].startswith("done"), (
        f"the run was over before {service} was back; give it more iterations"
    )
    wait_for("another phase", lambda: len(host.events(RUN, "phase")) > len(phases), BACK_SECS)


def assert_took_each_segment_once(checkpoints: Path) -> None:
    """The book of a learner's last checkpoint: of each life the segments 1 to n, each of them once."""
    found = Checkpoints(checkpoints).newest()
    assert found is not None
    assert isinstance(found[1], dict)
    book = json.loads(found[1]["book"])
    streams = book["ledger"]["streams"]
    assert streams
    assert book["received"] == sum(upto for _, _, upto, _ in streams)
