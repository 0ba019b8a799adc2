"""Which blocks are whose: by level, by configuration, and by the index that a process is given."""

import argparse
from pathlib import Path
from typing import Any

import pytest

from protocol.codec import decode
from protocol.messages import Ack, Phase
from services.encoder_learner.service import build as build_encoder_learner
from services.launcher.address import address_of
from services.launcher.run_folder import RunFolder
from services.launcher.service import parts_of
from services.policy_learner.service import build as build_policy_learner
from services.runtime.bus import Frame, Inbox
from services.runtime.settings import RunSettings, SettingsError, parse
from services.runtime.sharing import VARIABLE, add_options, name_of, own_blocks
from tests.unit.learner_stage import LearnerStage

LEAVES: list[dict[str, Any]] = [
    {"name": name, "observes": [i], "drives": [i]} for i, name in enumerate(("x", "y", "z"))
]
TREE = [*LEAVES, {"name": "body", "children": ["x", "y", "z"]}]


def settings_of(**changes: Any) -> RunSettings:
    return parse({"scenario": "shared", "block": TREE, **changes}, origin="test")


def names(settings: RunSettings, index: int) -> list[str]:
    return [name for _, name in own_blocks(settings, "encoder", index)]


def test_one_learner_has_all_blocks_and_several_share_each_level() -> None:
    assert names(settings_of(), 0) == ["x", "y", "z", "body"]
    two = settings_of(learners={"encoder": 2, "policy": 2})
    assert [names(two, index) for index in (0, 1)] == [["x", "z", "body"], ["y"]]


def test_a_block_may_say_who_learns_it() -> None:
    said = [*LEAVES[:2], LEAVES[2] | {"learner": 1}, TREE[3] | {"learner": 1}]
    two = settings_of(block=said, learners={"encoder": 2, "policy": 2})
    assert [names(two, index) for index in (0, 1)] == [["x"], ["y", "z", "body"]]


@pytest.mark.parametrize("count", [1, 3])
def test_an_index_of_nobody_is_refused_in_a_sentence(count: int) -> None:
    settings = settings_of(learners={"encoder": count})
    with pytest.raises(
        SettingsError, match=f"no encoder learner of index 3: learners.encoder is {count}"
    ) as e:
        own_blocks(settings, "encoder", 3)
    assert "\n" not in str(e.value)


def index_of(*arguments: str) -> int:
    parser = argparse.ArgumentParser(exit_on_error=False)
    add_options(parser)
    index: int = parser.parse_args(arguments).index
    return index


def test_a_process_is_told_its_index_on_the_command_line_or_by_the_environment(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    assert (index_of(), index_of("--index", "2")) == (0, 2)
    monkeypatch.setenv(VARIABLE, "1")
    assert (index_of(), index_of("--index", "2")) == (1, 2)


@pytest.mark.parametrize("wrong", ["-1", "one", "1.5", "9" * 40])
def test_what_is_no_index_is_refused_wherever_it_comes_from(
    monkeypatch: pytest.MonkeyPatch, wrong: str
) -> None:
    with pytest.raises(argparse.ArgumentError, match=f"whole number .* got '{wrong}'"):
        index_of(f"--index={wrong}")
    monkeypatch.setenv(VARIABLE, wrong)
    with pytest.raises(argparse.ArgumentError, match=rf"whole number .*\${VARIABLE} .* got '{wrong}'"):
        index_of()


def test_babble_up_starts_as_many_learners_as_the_scenario_says_each_with_its_log(tmp_path: Path) -> None:
    settings = settings_of(learners={"encoder": 1, "policy": 2})
    parts = parts_of(RunFolder(tmp_path, "r"), settings, address_of(None))
    learners = {part.name: part for part in parts if "learner" in part.name}
    assert list(learners) == ["encoder_learner", "policy_learner", "policy_learner-1"]
    told = {name: part.arguments[part.arguments.index("--index") + 1] for name, part in learners.items()}
    assert list(told.values()) == ["0", "0", "1"]
    assert len({part.log for part in learners.values()}) == 3
    assert not any(part.expendable or part.optional for part in learners.values())


@pytest.mark.parametrize("build", [build_encoder_learner, build_policy_learner])
def test_two_learners_of_one_run_answer_for_their_own_blocks_only(tmp_path: Path, build: Any) -> None:
    settings = settings_of(learners={"encoder": 2, "policy": 2})
    stage = LearnerStage(settings, tmp_path, build)
    heard = Inbox()
    stage.hub.connect("actor-1").subscribe("ack", "babble/r/ack/actor-1/*", heard)
    stage.actor_appears("actor-1")
    for index in (0, 1):
        stage.start(f"learner-{index}", index)
    stage.announce(Phase.BABBLE, 1, ("x", "y", "z"))
    stage.poll()
    acks = [decode(frame.data) for frame in heard.take_all() if isinstance(frame, Frame)]
    answered = {(ack.life, ack.block) for ack in acks if isinstance(ack, Ack)}
    assert answered == {("learner-0", "x"), ("learner-0", "z"), ("learner-0", "body"), ("learner-1", "y")}
    service = stage.status("learner-0").service
    kept = {path.parent.name for path in (tmp_path / "checkpoints").rglob("*.checkpoint")}
    assert kept == {name_of(service, 0), name_of(service, 1)} == {service, f"{service}-1"}


def test_a_learner_without_a_block_at_work_waits_for_nobody(tmp_path: Path) -> None:
    settings = settings_of(learners={"encoder": 2, "policy": 2})
    stage = LearnerStage(settings, tmp_path, build_encoder_learner)
    for index in (0, 1):
        stage.start(f"learner-{index}", index)
    stage.announce(Phase.BABBLE, 1, ("body",))
    stage.poll()
    busy, idle = (stage.status(f"learner-{index}") for index in (0, 1))
    assert [progress.block for progress in busy.progress] == ["body"]
    assert busy.waiting_for.startswith("experience of body")
    assert (list(idle.progress), idle.waiting_for, idle.last_error) == ([], "", "")
