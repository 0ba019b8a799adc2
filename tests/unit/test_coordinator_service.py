"""The coordinator on a bus and a disk: what it announces, writes, answers, and how it survives and ends."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from protocol import keys
from protocol.codec import decode
from protocol.messages import Frozen, Phase, Reply
from services.runtime.errors import StorageError
from services.runtime.settings import parse
from tests.unit.coordinator_stage import RUN, Stage


@pytest.fixture
def stage(tmp_path: Path) -> Iterator[Stage]:
    stage = Stage(tmp_path)
    stage.start("coordinator-1")
    yield stage
    if stage.coordinator is not None:
        stage.coordinator.stop()
        stage.poll()


def test_it_announces_babble_at_once_and_each_second(stage: Stage) -> None:
    stage.poll()
    (first,) = stage.announced()
    assert (first.term, first.phase, first.iterations, list(first.blocks)) == (1, Phase.BABBLE, 1, ["body"])
    assert stage.poll(0.5) == pytest.approx(0.5)
    assert stage.announced() == []
    stage.poll(0.5)
    (again,) = stage.announced()
    assert (again.term, again.seq) == (1, 1)


def test_it_drives_a_run_to_done_and_ends_when_all_have_left(stage: Stage) -> None:
    stage.everybody_joins()
    stage.poll()
    done = stage.finish_until(9)
    assert (done.phase, done.blocks) == (Phase.DONE, {})
    assert stage.poll(2.0) is not None
    assert [message.phase for message in stage.announced()] == [Phase.DONE]
    for life in ("encoder_learner-1", "policy_learner-1", "actor-1"):
        stage.hub.crash(life)
    assert stage.poll(0.1) is None
    assert stage.said()[-1].phase is Phase.DONE


def test_what_is_frozen_is_announced_told_and_noted_and_survives_a_kill(tmp_path: Path) -> None:
    blocks = [{"name": "hand", "children": ["thumb", "index"]}, {"name": "thumb"}, {"name": "index"}]
    level = [{}, {"phases": {"iterations": 0}}]
    table = {"scenario": "test", "phases": {"iterations": 1}, "block": blocks, "level": level}
    stage = Stage(tmp_path, parse(table, origin="test"))
    stage.start("coordinator-1")
    stage.everybody_joins()
    stage.poll()
    babble = stage.finish_until(9)
    assert (babble.phase, babble.level, babble.iterations) == (Phase.BABBLE, 1, 0)
    at = Frozen(encoder=7, policy=9, of_encoder=3, of_policy=6)
    assert babble.frozen == {"thumb": at, "index": at}
    stage.kill()
    stage.start("coordinator-2")
    stage.poll()
    assert stage.announced()[-1].frozen == babble.frozen
    assert stage.describe()["frozen"][0] == {"block": "thumb", **at.model_dump()}
    noted = [line["text"] for line in stage.lines("events.jsonl") if line["what"] == "frozen"]
    assert noted == [
        f"{block} is frozen at encoder 7 (that is 3 again) and policy 9 (that is 6 again)"
        for block in ("index", "thumb")
    ]
    stage.coordinator.stop()
    stage.poll()


def test_after_done_it_does_not_wait_for_stragglers_for_ever(stage: Stage) -> None:
    stage.everybody_joins()
    stage.poll()
    stage.finish_until(9)
    assert stage.poll(4.9) is not None
    assert stage.poll(0.2) is None


@pytest.mark.parametrize("service", ["dashboard", "recorder", "router"])
def test_after_done_it_waits_for_nobody_who_only_watches_or_carries_the_run(
    stage: Stage, service: str
) -> None:
    stage.everybody_joins()
    stage.join(service, f"{service}-1")
    stage.poll()
    stage.finish_until(9)
    for life in ("encoder_learner-1", "policy_learner-1", "actor-1"):
        stage.hub.crash(life)
    assert stage.poll(1.0) is None, "it must not hold up the end of the run"


def test_done_is_said_after_a_lost_link_is_back(stage: Stage) -> None:
    stage.everybody_joins()
    stage.poll()
    stage.finish_until(9)
    stage.hub.cut("coordinator-1")
    assert stage.poll(7.0) is not None, "nobody can have heard it yet"
    stage.hub.mend("coordinator-1")
    stage.announced()
    assert stage.poll(1.0) is not None
    assert [message.phase for message in stage.announced()] == [Phase.DONE]
    assert stage.poll(5.0) is None


def test_scores_and_the_best_are_written(stage: Stage) -> None:
    stage.everybody_joins()
    stage.poll()
    stage.finish_until(9)
    rows = stage.lines("scores.jsonl")
    assert [(row["iteration"], row["phase"], row["policy_version"]) for row in rows] == [
        (0, "ground", 5),
        (1, "practise", 6),
    ]
    assert list(rows[0]) == [
        "run",
        "block",
        "iteration",
        "phase",
        "separation",
        "separation_worst",
        "z_min",
        "z_goal",
        "switch_success",
        "crossing",
        "landmarks",
        "landmark_vertices",
        "external_reward",
        "external_reward_by_vertex",
        "policy",
        "steps",
        "encoder_version",
        "policy_version",
    ]
    best = json.loads((stage.run_dir / "best.json").read_text())
    assert best["body"]["policy_version"] == 6
    assert best["body"]["reason"].startswith("iteration 1 meets every bar")


@pytest.mark.parametrize("term", range(1, 10))
def test_killed_in_any_term_it_goes_on_there(stage: Stage, term: int) -> None:
    stage.everybody_joins()
    stage.poll()
    if term > 1:
        stage.finish_until(term)
    before = stage.describe()
    written = (stage.run_dir / "scores.jsonl").read_bytes()
    stage.kill()
    (stage.run_dir / "scores.jsonl").write_bytes(written[:-7])
    (stage.run_dir / "best.json").unlink()
    with (stage.run_dir / "events.jsonl").open("ab") as events:
        events.write(b'{"time": "torn')
    stage.start("coordinator-2")
    stage.announced()
    stage.poll()
    (again,) = stage.announced()
    after = stage.describe()
    assert (again.term, again.phase.value) == (term, before["phase"])
    for what in ("term", "phase", "iteration", "evaluates", "scores", "best"):
        assert after[what] == before[what]
    assert {member["life"] for member in after["members"]} >= {
        "encoder_learner-1",
        "policy_learner-1",
        "actor-1",
    }
    assert (stage.run_dir / "scores.jsonl").read_bytes() == written
    assert "lost" not in {line["what"] for line in stage.lines("events.jsonl")}, "it was away, not they"
    assert set(json.loads((stage.run_dir / "best.json").read_text())) == ({"body"} if term > 4 else set())


def test_a_journal_that_says_done_is_announced_until_latecomers_have_heard_it(stage: Stage) -> None:
    stage.poll()
    stage.finish_until(9)
    stage.kill()
    stage.start("coordinator-2")
    stage.announced()
    assert stage.poll() is not None
    assert [message.phase for message in stage.announced()] == [Phase.DONE]
    assert stage.poll(15.0) is not None, "who comes 15 s later hears it too"
    assert [message.phase for message in stage.announced()] == [Phase.DONE]
    assert stage.poll(5.0) is None


def test_stop_ends_it_without_done_and_it_can_be_resumed(stage: Stage) -> None:
    stage.everybody_joins()
    stage.poll()
    stage.finish_until(3)
    stage.said()
    assert stage.command("stop").ok
    assert stage.poll() is None
    last = stage.said()[-1]
    assert (last.term, last.phase) == (3, Phase.GROUND)
    assert "--resume" in last.waiting_for
    stage.hub.crash("coordinator-1")
    stage.start("coordinator-2")
    stage.announced()
    assert stage.poll() is not None
    assert [message.phase for message in stage.announced()] == [Phase.GROUND]


def test_a_signal_stops_it_as_the_command_does(stage: Stage) -> None:
    stage.poll()
    assert stage.coordinator is not None
    stage.coordinator.stop()
    assert stage.poll() is None
    assert stage.poll() is None, "once ended it stays so"


def test_describe_tells_who_is_there_and_what_it_waits_for(stage: Stage) -> None:
    stage.everybody_joins()
    stage.poll()
    stage.progress(40, term=1, waiting_for="experience")
    stage.poll()
    told = stage.describe()
    assert told["waiting"] == "waiting for encoder_learner: 40 of 100 steps of body"
    assert {member["service"] for member in told["members"]} == {"actor", "encoder_learner", "policy_learner"}
    assert (told["run"], told["phase"], told["iteration"], told["iterations"]) == (RUN, "babble", 0, 1)
    assert told["unlisted"] == 0


def test_blocks_with_long_lists_of_indices_do_not_keep_it_from_answering(stage: Stage) -> None:
    observes = list(range(100_000))
    block = stage.settings.block[0].model_copy(update={"observes": observes, "drives": [0]})
    stage.settings = stage.settings.model_copy(update={"block": [block]})
    stage.kill()
    stage.start("coordinator-2")
    assert stage.describe()["phase"] == "babble"


def test_a_command_that_cannot_be_read_is_answered_with_a_failure(stage: Stage) -> None:
    stage.poll()
    answer = stage.audience.ask(keys.command(RUN, "coordinator"), b"stop!", 5.0)
    assert answer
    reply = decode(answer)
    assert isinstance(reply, Reply)
    assert not reply.ok
    assert reply.text
    assert stage.poll() is not None


def test_its_status_says_what_it_waits_for_and_counts_what_it_refuses(stage: Stage) -> None:
    stage.audience.publish("status", keys.status(RUN, "actor", "stranger"), b"\x93junk")
    stage.poll()
    stage.poll(1.0)
    said = stage.said()[-1]
    assert said.waiting_for == "waiting for an encoder_learner to appear"
    assert sum(said.refused.values()) == 1


def test_a_stall_is_said_once_with_names_and_cleared_by_progress(stage: Stage) -> None:
    stage.everybody_joins()
    stage.poll()
    stage.progress(40, term=1, waiting_for="experience of body")
    stage.say("actor", term=1, waiting_for="a grant of encoder_learner")
    stage.poll()
    for _ in range(4):
        stage.poll(30.0)
    stalls = [line["text"] for line in stage.lines("events.jsonl") if line["what"] == "stalled"]
    assert len(stalls) == 1
    assert "waiting for encoder_learner: 40 of 100 steps of body" in stalls[0]
    assert "encoder_learner says it is waiting for experience of body" in stalls[0]
    assert "actor-1: a grant of encoder_learner" in stalls[0]
    assert stage.said()[-1].last_error == stalls[0]
    stage.progress(41, term=1)
    stage.poll(1.0)
    assert stage.said()[-1].last_error == ""


def test_learners_that_are_ahead_of_the_journal_are_named(stage: Stage) -> None:
    stage.everybody_joins()
    stage.poll()
    stage.say("policy_learner", term=7)
    stage.poll()
    stage.poll(60.0)
    (stall,) = (line["text"] for line in stage.lines("events.jsonl") if line["what"] == "stalled")
    assert "policy_learner-1 is already in term 7" in stall


def test_losing_its_own_link_is_not_losing_the_members(stage: Stage) -> None:
    stage.everybody_joins()
    stage.poll()
    stage.hub.cut("coordinator-1")
    stage.poll(1.0)
    stage.poll(20.0)
    assert "lost" not in {line["what"] for line in stage.lines("events.jsonl")}
    stage.hub.crash("actor-1")
    stage.hub.mend("coordinator-1")
    stage.poll(1.0)
    stage.poll(3.0)
    lost = [line["text"] for line in stage.lines("events.jsonl") if line["what"] == "lost"]
    assert lost == ["actor-1 (actor) is gone"]
    links = [line["text"].split()[-1] for line in stage.lines("events.jsonl") if line["what"] == "link"]
    assert links == ["down", "settling", "up"]


def test_milestones_are_written_for_people(stage: Stage) -> None:
    stage.everybody_joins()
    stage.poll()
    stage.finish_term()
    stage.hub.crash("actor-1")
    stage.poll(1.0)
    told = [(line["what"], line["text"]) for line in stage.lines("events.jsonl")]
    assert told == [
        ("phase", "babble (level 0, iteration 0, term 1)"),
        ("joined", "encoder_learner-1 (encoder_learner) joined"),
        ("joined", "policy_learner-1 (policy_learner) joined"),
        ("joined", "actor-1 (actor) joined"),
        ("phase", "encode (level 0, iteration 0, term 2)"),
        ("lost", "actor-1 (actor) is gone"),
    ]
    assert stage.lines("events.jsonl")[0]["time"].startswith("1970-01-01T00:16:40")


def test_words_that_say_nothing_new_are_not_in_the_journal(stage: Stage) -> None:
    stage.everybody_joins()
    stage.poll()
    stage.progress(40, term=1)
    stage.poll()
    written = stage.lines("journal.jsonl")
    for _ in range(20):
        stage.progress(40, term=1)
        stage.say("actor", term=1, versions={"encoder/body": 3})
        stage.poll(0.1)
    assert stage.lines("journal.jsonl") == written


def test_a_burst_of_words_is_taken_in_bounded_quanta(stage: Stage) -> None:
    stage.everybody_joins()
    stage.poll()
    for done in range(1, 601):
        stage.say("actor", term=1, totals={"env_steps": done})
    assert stage.poll() == 0.0
    assert stage.poll() == 0.0
    assert stage.poll() != 0.0


def test_a_journal_that_cannot_be_written_is_a_sentence(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_handle: int) -> None:
        raise OSError(28, "No space left on device")

    stage.poll()
    stage.join("actor", "actor-9")
    with monkeypatch.context() as patched:
        patched.setattr("os.fsync", full)
        with pytest.raises(StorageError, match=r"journal\.jsonl: No space left on device"):
            stage.poll()


def test_what_learners_measure_is_kept_line_by_line_while_they_work(stage: Stage) -> None:
    stage.everybody_joins()
    for updates in (1, 1, 2):
        stage.say(
            "policy_learner", term=1, totals={"body/policy_updates": updates}, metrics={"loss": 0.5 / updates}
        )
        stage.poll(0.1)
    stage.say("actor", term=1, totals={"env_steps": 9})
    stage.poll(0.1)
    kept = stage.lines("metrics.jsonl")
    assert [line["totals"]["body/policy_updates"] for line in kept] == [1, 2], "a repeat is not kept twice"
    assert kept[1]["metrics"]["loss"] == 0.25
    assert {line["service"] for line in kept} == {"policy_learner"}
