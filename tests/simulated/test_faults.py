"""Lost, doubled and reordered frames, crashes and late comers: the run ends and nothing counts twice."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from services.runtime.checkpoint import Checkpoints
from services.runtime.errors import CheckpointError
from services.runtime.memory_bus import Faults, MemoryBus
from services.runtime.settings import RunSettings
from tests.simulated.harness import Simulation

Simulate = Callable[..., Simulation]

PHASES = ["babble", "encode", "ground", "evaluate", "walk", "refine", "practise"]


def phase_of(run_dir: Path) -> str:
    """The phase that was announced last; empty before the first."""
    if not (run_dir / "events.jsonl").exists():
        return ""
    events = [json.loads(line) for line in (run_dir / "events.jsonl").read_text().splitlines()]
    return [event["text"].split()[0] for event in events if event["what"] == "phase"][-1]


def assert_complete_and_exact(simulation: Simulation) -> None:
    """The run is done; no learner used more than was sent, or took a segment of a stream twice."""
    assert phase_of(simulation.run_dir) == "done"
    assert len({term for _, term, _ in simulation.used_steps}) == 4, "babble, ground, walk and practise"
    for key, used in simulation.used_steps.items():
        assert used <= sum(simulation.sent_steps[key].values()), f"{key} counted experience twice"
    for learner in ("encoder_learner", "policy_learner"):
        book = simulation.book(learner)
        taken = sum(upto for _, _, upto, _ in book["ledger"]["streams"])
        assert book["received"] == taken == book["ledger"]["counts"]["new"]


@pytest.mark.parametrize("seed", range(4))
def test_a_bad_link_slows_a_run_and_changes_nothing_else(
    tiny: RunSettings, simulate: Simulate, seed: int
) -> None:
    simulation = simulate(tiny, hub=MemoryBus(seed=seed))
    simulation.hub.faults = Faults(
        drop=0.15, duplicate=0.15, reorder=0.15, kinds=frozenset({"segment", "ack", "status", "phase"})
    )
    simulation.start_all(actors=2)
    simulation.until_all_ended()
    assert simulation.hub.dropped > 0
    assert simulation.hub.duplicated > 0
    assert_complete_and_exact(simulation)


@pytest.mark.parametrize("service", ["encoder_learner", "policy_learner", "coordinator", "actor"])
@pytest.mark.parametrize("phase", PHASES)
def test_any_service_may_be_killed_in_any_phase_and_be_replaced(
    tiny: RunSettings, simulate: Simulate, service: str, phase: str
) -> None:
    simulation = simulate(tiny)
    simulation.start_all(actors=2)
    simulation.until(lambda: phase_of(simulation.run_dir) == phase)
    for _ in range(3):
        simulation.round()
    simulation.crash(f"{service}-0")
    for _ in range(20):
        simulation.round()
    simulation.start(service, f"{service}-reborn")
    simulation.until_all_ended()
    assert_complete_and_exact(simulation)


@pytest.mark.parametrize("phase", PHASES)
def test_everything_may_be_killed_at_once_and_resumed(
    tiny: RunSettings, simulate: Simulate, phase: str
) -> None:
    simulation = simulate(tiny)
    simulation.start_all(actors=2)
    simulation.until(lambda: phase_of(simulation.run_dir) == phase)
    simulation.round()
    for life in list(simulation.running):
        simulation.crash(life)
    for service in ("coordinator", "encoder_learner", "policy_learner", "actor"):
        simulation.start(service, f"{service}-reborn")
    simulation.until_all_ended()
    assert_complete_and_exact(simulation)


def test_a_run_that_lost_all_actors_goes_on_with_a_late_comer(tiny: RunSettings, simulate: Simulate) -> None:
    simulation = simulate(tiny)
    simulation.start_all(actors=1)
    simulation.until(lambda: phase_of(simulation.run_dir) == "ground")
    simulation.crash("actor-0")
    for _ in range(100):
        simulation.round()
    assert phase_of(simulation.run_dir) == "ground", "nobody can ground a policy without experience"
    simulation.start("actor", "actor-late", 1)
    simulation.until_all_ended()
    assert_complete_and_exact(simulation)


def test_an_actor_cut_off_for_a_while_comes_back_and_nothing_of_it_counts_twice(
    tiny: RunSettings, simulate: Simulate
) -> None:
    simulation = simulate(tiny)
    simulation.start_all(actors=2)
    simulation.until(lambda: phase_of(simulation.run_dir) == "ground")
    simulation.hub.cut("actor-0")
    for _ in range(150):
        simulation.round()
    simulation.hub.mend("actor-0")
    simulation.until_all_ended()
    assert "actor-0" in simulation.ended
    assert_complete_and_exact(simulation)


@pytest.mark.parametrize("phase", ["ground", "refine", "practise"])
@pytest.mark.parametrize("learner", ["encoder_learner", "policy_learner"])
def test_a_learner_whose_newest_checkpoint_is_truncated_goes_on_from_the_one_before(
    tiny: RunSettings, simulate: Simulate, learner: str, phase: str, caplog: pytest.LogCaptureFixture
) -> None:
    simulation = simulate(tiny)
    simulation.start_all(actors=2)
    simulation.until(lambda: phase_of(simulation.run_dir) == phase)
    for _ in range(3):
        simulation.round()
    simulation.crash(f"{learner}-0")
    newest = max((simulation.run_dir / "checkpoints" / learner).glob("*.checkpoint"))
    newest.write_bytes(newest.read_bytes()[:-10])
    simulation.start(learner, f"{learner}-reborn")
    assert f"skipping the damaged checkpoint {newest}" in caplog.text
    simulation.until_all_ended()
    assert_complete_and_exact(simulation)


@pytest.mark.parametrize("learner", ["encoder_learner", "policy_learner"])
def test_a_learner_that_lost_what_the_run_stands_on_says_so_and_ends(
    tiny: RunSettings, simulate: Simulate, learner: str
) -> None:
    simulation = simulate(tiny)
    simulation.start_all(actors=2)
    simulation.until(lambda: phase_of(simulation.run_dir) == "practise")
    simulation.crash(f"{learner}-0")
    shutil.rmtree(simulation.run_dir / "checkpoints" / learner)
    simulation.start(learner, f"{learner}-reborn")
    with pytest.raises(CheckpointError, match=r"the run needs (encoder 2|policy \d+) of body"):
        simulation.until_all_ended()


@pytest.mark.parametrize("learner", ["encoder_learner", "policy_learner"])
def test_a_checkpoint_of_another_version_or_other_settings_is_one_sentence(
    tiny: RunSettings, simulate: Simulate, learner: str
) -> None:
    simulation = simulate(tiny)
    simulation.start_all(actors=1)
    simulation.until(lambda: phase_of(simulation.run_dir) == "ground")
    simulation.crash(f"{learner}-0")
    checkpoints = Checkpoints(simulation.run_dir / "checkpoints" / learner)
    generation, payload = checkpoints.newest() or (0, {})
    assert isinstance(payload, dict)
    old_book = {name: value for name, value in json.loads(payload["book"]).items() if name != "stale"}
    section = getattr(tiny, learner.partition("_")[0])
    wider = tiny.model_copy(update={learner.partition("_")[0]: section.model_copy(update={"hidden": [16]})})
    for settings, parts in ((wider, payload), (tiny, {**payload, "book": json.dumps(old_book).encode()})):
        checkpoints.save(generation := generation + 1, parts)
        simulation.settings = settings
        with pytest.raises(CheckpointError, match="another version of Babble, or with other") as said:
            simulation.start(learner, f"{learner}-{generation}")
        assert "start a new run" in str(said.value)
        assert "\n" not in str(said.value)


def test_an_encoder_lost_with_its_checkpoint_is_fitted_again_before_the_run_goes_on(
    tiny: RunSettings, simulate: Simulate
) -> None:
    simulation = simulate(tiny)
    simulation.start_all(actors=2)
    simulation.until(lambda: phase_of(simulation.run_dir) == "encode")
    folder = simulation.run_dir / "checkpoints" / "encoder_learner"
    simulation.until(lambda: len(list((simulation.run_dir / "models").rglob("encoder-1.onnx"))) == 1)
    simulation.crash("encoder_learner-0")
    newest = max(folder.glob("*.checkpoint"))
    newest.write_bytes(newest.read_bytes()[:-10])
    first = (simulation.run_dir / "models/body/encoder-1.onnx").read_bytes()
    simulation.until(lambda: phase_of(simulation.run_dir) == "ground")
    simulation.start("encoder_learner", "encoder_learner-reborn")
    simulation.until_all_ended()
    assert_complete_and_exact(simulation)
    assert (simulation.run_dir / "models/body/encoder-1.onnx").read_bytes() == first
    assert (simulation.run_dir / "models/body/encoder-2.onnx").exists()
