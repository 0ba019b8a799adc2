"""What the recorder grants, counts, writes and says."""

import logging
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from babble.recording import Recording
from protocol.messages import Phase
from tests.unit.recorder_stage import (
    COLUMNS,
    LIFE,
    ROWS,
    STEPS,
    RecorderStage,
    open_loop,
    settings_of,
)


def started(settings: Any, tmp_path: Path, phase: Phase = Phase.BABBLE, actors: int = 1) -> RecorderStage:
    """A recorder in term 1 of a run, and actors that know what they may send."""
    stage = RecorderStage(settings, tmp_path)
    for number in range(1, actors + 1):
        stage.actor(number)
    stage.start(LIFE)
    stage.announce(phase, 1, ["body"])
    stage.poll(2)
    return stage


def acted(first: float, steps: int = STEPS) -> dict[str, Any]:
    """A latent and a goal of the block "body"."""
    latent = np.full((steps, COLUMNS, 2), 0.5, np.float32)
    latent[..., 0] = first
    goal = np.zeros((steps, COLUMNS, 2), np.float32)
    goal[..., 1] = 1
    return {"latent/body": latent, "goal/body": goal}


def zeros(block: str, dims: int) -> dict[str, Any]:
    """A latent and a goal of nothing but zeros."""
    return {f"{what}/{block}": np.zeros((STEPS, COLUMNS, dims), np.float32) for what in ("latent", "goal")}


def test_an_open_loop_is_granted_exactly_what_it_wants(tmp_path: Path) -> None:
    wanted = 11 * ROWS - 5
    stage = started(open_loop(wanted), tmp_path, actors=3)
    stage.until_finished(1)
    assert sum(actor.sent for actor in stage.actors) == 11
    progress = stage.status(LIFE).progress
    assert [(p.block, p.done, p.wanted, p.unit) for p in progress] == [("body", 11 * ROWS, wanted, "steps")]
    assert Recording.open(tmp_path).rows == 11 * ROWS, "finished means that all of it is in files"


def test_acks_tell_how_much_of_an_open_loop_is_held(tmp_path: Path) -> None:
    stage = started(open_loop(8 * ROWS), tmp_path)
    stage.until_finished(1)
    stage.turn(Phase.BABBLE, 1)
    shares = [ack.progress for ack in stage.actors[0].acks]
    assert shares[0] == 0
    assert shares == sorted(shares)
    assert shares[-1] == 1


def test_every_nth_step_is_a_row_and_counts_as_n_steps(tmp_path: Path) -> None:
    stage = started(open_loop(5 * ROWS, recording={"every_steps": 5, "group_rows": 1024}), tmp_path)
    stage.actors[0].send(Phase.BABBLE, 1)
    stage.poll(2)
    assert stage.status(LIFE).progress[0].finished
    steps = Recording.open(tmp_path).table(["step"]).column("step").to_pylist()
    assert sorted(set(steps)) == list(range(0, 5 * STEPS, 5))


def test_a_restart_goes_on_with_the_count_of_the_term(tmp_path: Path) -> None:
    stage = started(open_loop(40 * ROWS), tmp_path)
    for _ in range(6):
        stage.turn(Phase.BABBLE, 1)
    done = stage.status(LIFE).progress[0].done
    assert 0 < done < 40 * ROWS
    stage.crash(LIFE)
    stage.start("recorder-2")
    stage.announce(Phase.BABBLE, 1, ["body"])
    stage.poll(1)
    assert stage.status("recorder-2").progress[0].done >= done


def test_a_run_that_learns_may_send_without_bound_in_every_term(tmp_path: Path) -> None:
    stage = started(settings_of(), tmp_path)
    for term, phase in enumerate((Phase.BABBLE, Phase.GROUND, Phase.EVALUATE, Phase.DONE), start=1):
        stage.announce(phase, term, ["body"])
        stage.poll(2)
        ack = stage.actors[0].hear()
        assert ack is not None
        assert (ack.term, ack.granted, ack.progress) == (term, 2**53, 0.0)
        assert stage.status(LIFE).progress == []


def test_rows_lie_in_the_folder_of_their_phase_with_what_blocks_acted_on(tmp_path: Path) -> None:
    stage = started(settings_of(), tmp_path)
    (actor,) = stage.actors
    actor.send(Phase.BABBLE, 1)
    actor.send(Phase.GROUND, 3, arrays=acted(0.25), level=0, iteration=0)
    actor.send(Phase.PRACTISE, 9, arrays=acted(0.75), level=0, iteration=2)
    actor.send(Phase.EVALUATE, 10, arrays=acted(0.0), level=1, iteration=2)
    stage.poll(2)
    stage.services[LIFE].stop()
    stage.poll(1)
    assert {p.parent.name for p in tmp_path.rglob("part-*.parquet")} == {
        "phase=babble", "phase=ground", "phase=practise", "phase=evaluate"
    }  # fmt: skip
    recording = Recording.open(tmp_path)
    columns = ["phase", "term", "level", "iteration", "latent/body/0", "goal/body/1", "reward/body"]
    rows = recording.table(columns, phases=recording.phases).to_pylist()
    firsts = [tuple(rows[number].values()) for number in range(0, 4 * ROWS, ROWS)]
    assert firsts == [
        ("babble", 1, 0, 0, None, None, None),
        ("ground", 3, 0, 0, 0.25, 1.0, pytest.approx(-(0.25**2 + 0.5**2))),
        ("practise", 9, 0, 2, 0.75, 1.0, pytest.approx(-(0.75**2 + 0.5**2))),
        ("evaluate", 10, 1, 2, 0.0, 1.0, pytest.approx(-0.25)),
    ]


def test_one_file_holds_rows_with_and_without_a_latent(tmp_path: Path) -> None:
    stage = started(settings_of(), tmp_path, Phase.GROUND)
    stage.actors[0].send(Phase.GROUND, 1)
    stage.actors[0].send(Phase.GROUND, 1, arrays=acted(0.25))
    stage.poll(2)
    stage.services[LIFE].stop()
    stage.poll(1)
    assert len(list(tmp_path.rglob("part-*.parquet"))) == 1
    latents = Recording.open(tmp_path).table(["latent/body/0"]).column(0).to_pylist()
    assert latents == [None] * ROWS + [0.25] * ROWS


def test_steps_that_were_never_sent_are_counted_here_and_by_the_reader(tmp_path: Path) -> None:
    stage = started(settings_of(), tmp_path)
    stage.actors[0].send(Phase.BABBLE, 1)
    stage.actors[0].send(Phase.BABBLE, 1, first_step=STEPS + 3)
    stage.poll(6)
    assert stage.status(LIFE).totals["gaps"] == 3 * COLUMNS
    stage.services[LIFE].stop()
    stage.poll(1)
    assert Recording.open(tmp_path).audit().gaps == 3 * COLUMNS


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({"arrays": {"state": np.zeros((STEPS, COLUMNS, 4), np.float32)}}, "have 4 components, and .* 3"),
        ({"first_step": 4}, "begins at step 4, and 16 is the next one"),
        ({"arrays": {"external_reward": np.zeros((STEPS, COLUMNS), np.float32)}}, "the world has no task"),
        ({"arrays": zeros("foot", 2)}, "no place in the run's tree"),
        ({"arrays": zeros("body", 3)}, "the block has 2 vertices"),
    ],
    ids=["state", "steps", "reward", "block", "vertices"],
)  # fmt: skip
def test_what_cannot_be_recorded_is_counted_with_a_sentence(
    fields: dict[str, Any], sentence: str, tmp_path: Path
) -> None:
    stage = started(settings_of(), tmp_path)
    stage.actors[0].send(Phase.BABBLE, 1)
    stage.actors[0].send(Phase.BABBLE, 1, **fields)
    stage.poll(6)
    status = stage.status(LIFE)
    assert (status.totals["rows"], status.totals["unusable"]) == (ROWS, 1)
    assert status.refused == {"bad-array": 1}
    assert re.search(sentence, status.last_error)
    stage.services[LIFE].stop()
    stage.poll(1)
    assert Recording.open(tmp_path).rows == ROWS


def test_numbers_that_fit_into_no_column_do_not_end_the_recorder_nor_its_restart(tmp_path: Path) -> None:
    stage = started(settings_of(), tmp_path)
    shape = (2, 2**15 + 1)
    many = {"state": np.zeros((*shape, 3), np.float32), "episode": np.zeros(shape, np.int32)}
    stage.actors[0].send(Phase.BABBLE, 2**53)
    stage.actors[0].send(Phase.BABBLE, 1, level=128)
    stage.actors[0].send(Phase.BABBLE, 1, iteration=2**15)
    stage.actors[0].send(Phase.BABBLE, 1, steps=shape[0], columns=shape[1], arrays=many)
    stage.actors[0].send(Phase.BABBLE, 1, first_step=2**53)
    stage.poll(6)
    assert "its columns is 32,769, more than 32,768" in stage.status(LIFE).last_error
    stage.crash(LIFE)
    stage.start("recorder-2")
    stage.poll(6)
    totals = stage.status("recorder-2").totals
    assert (totals["rows"], totals["unusable"], totals["gaps"]) == (ROWS, 4, 2**53)
    stage.services["recorder-2"].stop()
    stage.poll(1)
    assert Recording.open(tmp_path).rows == ROWS


def test_segments_sent_twice_or_too_early_are_counted_and_not_recorded(tmp_path: Path) -> None:
    stage = started(settings_of(), tmp_path)
    (actor,) = stage.actors
    actor.send(Phase.BABBLE, 1)
    actor.send(Phase.BABBLE, 1, seq=0)
    actor.send(Phase.BABBLE, 1, seq=7)
    stage.poll(6)
    status = stage.status(LIFE)
    assert (status.duplicated, status.totals["rows"]) == (1, ROWS)
    assert status.refused == {"duplicate": 1, "out-of-order": 1}


def test_at_the_end_it_waits_for_the_last_rows_of_the_actors_that_are_there(tmp_path: Path) -> None:
    stage = started(settings_of(), tmp_path)
    recorder, (actor,) = stage.services.pop(LIFE), stage.actors
    stage.announce(Phase.DONE, 2, [])
    for _ in range(6):
        assert recorder.poll(stage.clock.now_secs()) is not None
        stage.clock.advance(0.25)
    actor.send(Phase.BABBLE, 1)
    assert recorder.poll(stage.clock.now_secs()) is not None
    ack = actor.hear()
    assert ack is not None
    assert ack.upto == 1
    actor.leave()
    assert recorder.poll(stage.clock.now_secs()) is None
    assert Recording.open(tmp_path).rows == ROWS


def test_at_the_end_a_lost_link_is_not_taken_for_actors_that_have_gone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage = started(settings_of(), tmp_path)
    recorder, (actor,) = stage.services.pop(LIFE), stage.actors
    monkeypatch.setattr(type(stage.hub.connect("probe")), "linked", lambda bus: False)
    actor.leave()
    stage.announce(Phase.DONE, 2, [])
    for _ in range(8):
        assert recorder.poll(stage.clock.now_secs()) is not None
        stage.clock.advance(0.25)
    monkeypatch.undo()
    assert recorder.poll(stage.clock.now_secs()) is None


def test_an_actor_that_never_leaves_is_not_waited_for_without_end(tmp_path: Path) -> None:
    stage = started(settings_of(), tmp_path)
    recorder = stage.services.pop(LIFE)
    stage.announce(Phase.DONE, 2, [])
    began = stage.clock.now_secs()
    while recorder.poll(stage.clock.now_secs()) is not None:
        stage.clock.advance(0.25)
        assert stage.clock.now_secs() < began + 10
    assert stage.clock.now_secs() > began + 5, "actors are given that long"


def test_a_run_that_does_not_record_ends_with_a_sentence(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    stage = RecorderStage(settings_of(recording={"every_steps": 0}), tmp_path)
    stage.start(LIFE)
    with caplog.at_level(logging.WARNING):
        assert stage.services[LIFE].poll(0.0) is None
    assert "run r does not record its states" in caplog.text
    assert not (tmp_path / "states").exists()


def test_it_says_what_it_waits_for(tmp_path: Path) -> None:
    stage = RecorderStage(open_loop(1000 * ROWS), tmp_path)
    stage.start(LIFE)
    stage.poll(1)
    assert stage.status(LIFE).waiting_for == "a coordinator's announcement"
    stage.actor()
    stage.announce(Phase.BABBLE, 1, ["body"])
    stage.poll(60)
    waiting_for = stage.status(LIFE).waiting_for
    assert waiting_for == "states: 0 of 128,000 steps; actors here: 1; overdue: actor-1"
