"""The examples do what they say."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from protocol import keys
from protocol.codec import encode
from protocol.messages import ModelFloor, Phase, PhaseAnnounced
from services.runtime.zenoh_bus import ZenohBus
from tests.processes.owned import Owner, RunningRouter

pytestmark = pytest.mark.processes


def test_one_process_learns_a_little_in_a_short_run(owner: Owner) -> None:
    code = "from examples.one_process import main; s = main(60, 2048); print('separation', s['separation'])"
    example = owner.start_code("one_process", code)
    assert example.ended(90.0) == 0, example.report()
    separation = next(line for line in example.out if line.startswith("separation")).split()[1]
    assert 0 < float(separation) <= 1.001
    assert sum(line.startswith("goal") for line in example.out) == 2


def test_listen_hears_a_run(
    owner: Owner, router: RunningRouter, connect: Callable[[str], ZenohBus], tmp_path: Path
) -> None:
    (tmp_path / "run.json").write_text(json.dumps({"run": "heard"}))
    (tmp_path / "endpoint").write_text(router.endpoint)
    announced = PhaseAnnounced(
        run="heard", term=3, block="all", life="c-1", seq=0, phase=Phase.WALK, blocks={"body": ModelFloor()}
    )
    connect("coordinator-1").publish("phase", keys.phase("heard"), encode(announced))
    example = owner.start("listen", "examples/listen.py", str(tmp_path), "--secs", "5")
    assert example.expect("term 3", 20.0) == "term 3: walk"
    assert example.ended(20.0) == 0
