"""The answer to a describe command fits into a reply, whatever there is to tell."""

import json
from dataclasses import replace

from protocol.messages import ALL_BLOCKS, MAX_REPLY_CHARS, Phase, Status
from services.coordinator import words
from services.coordinator.report import describe
from services.coordinator.state import Member, State
from services.launcher.status_command import status_lines
from tests.unit.coordinator_play import FLAT, score
from tests.unit.coordinator_stage import RUN


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
    at = words.Frozen(encoder=2**53, policy=2**53, of_encoder=2**53, of_policy=2**53)
    scores = tuple(score(state, block) for block in blocks)
    state = replace(state, scores=scores, frozen=dict.fromkeys(blocks, at))
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
