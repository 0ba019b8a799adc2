"""A whole run of two levels is recorded: each environment step that an actor says it did, exactly once."""

from collections.abc import Callable

import numpy as np
import pytest

from protocol.messages import RECORDER, Phase, Segment
from services.recorder.service import build
from services.runtime.settings import parse
from tests.simulated import harness
from tests.simulated.harness import Simulation
from tests.simulated.test_tree import TREE

ACTING = {Phase.BABBLE, Phase.GROUND, Phase.WALK, Phase.PRACTISE, Phase.EVALUATE}


@pytest.fixture
def recorded(monkeypatch: pytest.MonkeyPatch, simulate: Callable[..., Simulation]) -> Simulation:
    """The tiny tree with two actors."""
    monkeypatch.setitem(harness.BUILDERS, "recorder", build)
    simulation = simulate(parse({**TREE, "recording": {"every_steps": 1}}, origin="the tiny tree"))
    simulation.start("recorder", "recorder-0")
    simulation.start_all(actors=2)
    simulation.until_all_ended()
    return simulation


def test_every_step_of_every_phase_and_level_is_a_row_once(recorded: Simulation) -> None:
    rows: dict[str, dict[int, Segment]] = {"actor-0": {}, "actor-1": {}}
    for segment in recorded.segments(*ACTING):
        if segment.consumer == RECORDER:
            rows[segment.life].setdefault(segment.seq, segment)
    for life, stream in rows.items():
        chunks = [stream[seq] for seq in range(len(stream))]
        _, last = recorded.statuses(life)[-1]
        steps = [step for chunk in chunks for step in range(chunk.first_step, chunk.first_step + chunk.steps)]
        assert steps == list(range(last.totals["env_steps"] // chunks[0].columns))
        assert last.totals["recorded_rows"] == last.totals["env_steps"]
        assert {(chunk.phase, chunk.level) for chunk in chunks} == {(p, k) for p in ACTING for k in (0, 1)}
        assert {chunk.iteration for chunk in chunks} == {0, 1}
        for chunk in chunks:
            check_what_acted(chunk)
            assert all(np.isfinite(array).all() for array in chunk.arrays.values())
    last = recorded.statuses("recorder-0")[-1][1]
    assert last.totals["rows"] == sum(c.steps * c.columns for s in rows.values() for c in s.values())


def check_what_acted(chunk: Segment) -> None:
    """At level 0 both leaves, above it the body with them; who babbles acts on nothing that it senses."""
    acting = {"x", "yz"} if chunk.level == 0 else {"x", "yz", "body"}
    if chunk.phase is Phase.BABBLE:
        acting -= {"x", "yz"} if chunk.level == 0 else {"body"}
    named = {name.partition("/")[2] for name in chunk.arrays if "/" in name}
    assert named == acting, (chunk.phase, chunk.level)
