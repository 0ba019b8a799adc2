"""The coordinator on a bus and a disk: what it announces, writes, answers, and how it survives and ends."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from protocol import keys
from protocol.codec import decode
from protocol.messages import ALL_BLOCKS, MAX_REPLY_CHARS, Phase, Reply, Status
from services.coordinator.report import describe
from services.coordinator.state import Member, State
from services.launcher.status_command import status_lines
from services.runtime.errors import StorageError
from tests.unit.coordinator_play import FLAT, score
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


def test_describe_answers_with_the_newest_scores_however_many_there_are() -> None:
    state = State(term=1)
    row = replace(
        score(state, "body"),
        landmarks={"open": 1 / 3, "closed": 2 / 3},
        external_reward_by_vertex=(1 / 3,) * 64,
    )
    state = replace(state, scores=tuple(replace(row, iteration=number) for number in range(2000)))
    text = describe(RUN, FLAT, state, {})
    assert len(text) <= MAX_REPLY_CHARS
    told = [told["iteration"] for told in json.loads(text)["scores"]]
    assert len(told) > 30
    assert told == list(range(2000 - len(told), 2000))


def test_describe_fits_into_a_reply_however_much_there_is_to_tell() -> None:
    blocks = tuple(f"block-{number:056}" for number in range(256))
    plan = replace(FLAT, levels=(blocks,))
    lives = [f"actor-{number:056}" for number in range(300)]
    state = State(term=1, phase=Phase.EVALUATE, members={life: Member(service="actor") for life in lives})
    state = replace(state, scores=tuple(score(state, block) for block in blocks))
    heard = {
        life: Status(
            run=RUN, term=1, block=ALL_BLOCKS, life=life, seq=0, service="actor",
            totals={f"{number:0200}": number for number in range(256)}, last_error="é" * 2000,
        )
        for life in lives[1:]
    }  # fmt: skip
    text = describe(RUN, plan, state, heard)
    assert len(text) <= MAX_REPLY_CHARS
    told = json.loads(text)
    assert told["members"][0]["life"] == lives[0]
    assert len(told["members"]) + told["unlisted"] == 300
    assert status_lines(told)[2 + 1 + len(told["members"])] == f"and {told['unlisted']} more"


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
