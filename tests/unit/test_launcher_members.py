"""The launcher's picture of a run, from messages and times that the test makes up."""

import pytest

from protocol.messages import ALL_BLOCKS, Phase, PhaseAnnounced, Progress, Status
from services.launcher.learning import goal_distance
from services.launcher.members import MOST_LAST_WORDS, Picture, Tally
from services.runtime.phases import phase_words
from services.runtime.settings import GoalSettings
from services.runtime.speed import Speed

RUN = "cuboid-20260101-120000-0"


def announced(term: int, phase: Phase, **more: object) -> PhaseAnnounced:
    fields = {"run": RUN, "block": ALL_BLOCKS, "life": "coordinator-1", "seq": term, "blocks": {}, **more}
    return PhaseAnnounced.model_validate({"term": term, "phase": phase, **fields})


def status(life: str, term: int = 1, **more: object) -> Status:
    fields = {"run": RUN, "block": ALL_BLOCKS, "seq": 0, "service": life.rsplit("-", 1)[0], **more}
    return Status.model_validate({"life": life, "term": term, **fields})


def picture() -> Picture:
    seen = Picture(RUN, f"runs/{RUN}", 0.0)
    for life in ("actor-1", "actor-2", "coordinator-1"):
        seen.appeared(life.rsplit("-", 1)[0], life, 0.0)
    seen.news.clear()
    return seen


def alive(seen: Picture) -> list[str]:
    return [member.life for member in seen.members() if member.lost_secs is None]


def test_a_member_that_goes_is_lost_and_later_forgotten() -> None:
    seen = picture()
    seen.vanished("actor-1", 5.0)
    seen.settle(5.5)
    assert alive(seen) == ["actor-2", "coordinator-1"]
    assert list(seen.news) == ["actor-1 is lost"]
    assert len(seen.members()) == 3
    seen.settle(16.0)
    assert len(seen.members()) == 2


def test_a_member_that_goes_after_the_run_is_done_has_left() -> None:
    seen = picture()
    seen.hear_phase(announced(3, Phase.DONE), 0.0)
    seen.news.clear()
    seen.vanished("actor-1", 5.0)
    seen.settle(5.5)
    assert list(seen.news) == ["actor-1 has left"]
    assert [member.life for member in seen.members() if member.went_in_order] == ["actor-1"]


def test_when_the_own_link_goes_no_member_is_lost() -> None:
    seen = picture()
    for life in ("actor-1", "actor-2", "coordinator-1"):
        seen.vanished(life, 5.0)
    seen.link(False, 5.1)
    seen.settle(60.0)
    assert len(alive(seen)) == 3
    seen.link(True, 61.0)
    seen.appeared("actor", "actor-1", 61.0)
    seen.appeared("coordinator", "coordinator-1", 61.0)
    seen.settle(61.5)
    assert len(alive(seen)) == 3
    seen.settle(64.1)
    assert alive(seen) == ["actor-1", "coordinator-1"]
    assert list(seen.news) == ["the link to the router is lost", "the router is back", "actor-2 is lost"]


def test_a_phase_is_news_once_and_an_older_one_never() -> None:
    seen = picture()
    for message in (announced(1, Phase.BABBLE), announced(1, Phase.BABBLE), announced(2, Phase.ENCODE)):
        seen.hear_phase(message, 0.0)
    seen.hear_phase(announced(1, Phase.BABBLE), 0.0)
    assert list(seen.news) == ["BABBLE", "ENCODE"]
    assert not seen.done
    seen.hear_phase(announced(3, Phase.DONE), 0.0)
    assert seen.done


def test_phases_in_words() -> None:
    assert phase_words(announced(1, Phase.PRACTISE, iteration=2, iterations=4)) == "PRACTISE 2 of 4"
    evaluate = announced(1, Phase.EVALUATE, evaluates=Phase.GROUND, iterations=4)
    assert phase_words(evaluate) == "EVALUATE after GROUND"


def test_speed_is_over_the_last_seconds_and_survives_a_new_count() -> None:
    speed = Speed()
    for second in range(20):
        speed.hear(float(second), 100 * second if second < 10 else 1000 + 300 * (second - 10))
    assert speed.per_sec(19.0) == 300.0
    speed.hear(20.0, 50)
    assert speed.per_sec(20.0) is None
    speed.hear(21.0, 60)
    assert speed.per_sec(21.0) == 10.0


def test_remaining_time_is_of_the_current_term_only() -> None:
    seen = picture()
    seen.hear_phase(announced(1, Phase.GROUND), 0.0)
    for second, done in ((0.0, 0), (2.0, 200)):
        progress = [Progress(block="body", done=done, wanted=1000, unit="steps")]
        seen.hear_status(status("policy_learner-1", progress=progress), second)
    (work,) = seen.work(2.0)
    assert work.progress is not None
    assert (work.progress.done, work.left_secs) == (200, 8.0)
    seen.hear_phase(announced(2, Phase.WALK), 0.0)
    assert seen.work(2.0) == []
    stale = [Progress(block="body", done=900, wanted=1000, unit="steps")]
    seen.hear_status(status("policy_learner-1", term=1, progress=stale), 3.0)
    assert seen.work(3.0) == []


def sharing() -> Picture:
    """Two learners in GROUND, each with a block half done."""
    seen = picture()
    seen.hear_phase(announced(1, Phase.GROUND, blocks={"arm": {}, "leg": {}}), 0.0)
    for life, block in (("policy_learner-1", "arm"), ("policy_learner-2", "leg")):
        seen.appeared("policy_learner", life, 0.0)
        progress = [Progress(block=block, done=50, wanted=100, unit="steps")]
        seen.hear_status(status(life, progress=progress), 0.5)
    return seen


def waiting_blocks(seen: Picture, now_secs: float) -> list[str]:
    return [work.block for work in seen.work(now_secs) if work.waits]


def test_the_blocks_of_a_lost_learner_wait_until_it_or_another_speaks_of_them() -> None:
    seen = sharing()
    assert waiting_blocks(seen, 3.0) == []
    seen.vanished("policy_learner-2", 4.0)
    for now_secs in (5.0, 30.0, 60.0):
        seen.settle(now_secs)
        assert waiting_blocks(seen, now_secs) == ["leg"], "also when it is shown among the members no more"
    first = seen.work(60.0)[0]
    assert (first.block, first.progress and first.progress.done) == ("leg", 50)
    seen.appeared("policy_learner", "policy_learner-3", 61.0)
    progress = [Progress(block="leg", done=20, wanted=100, unit="steps")]
    seen.hear_status(status("policy_learner-3", progress=progress), 61.0)
    assert waiting_blocks(seen, 62.0) == []


def test_a_block_that_is_finished_waits_for_nobody() -> None:
    seen = sharing()
    progress = [Progress(block="leg", done=100, wanted=100, unit="steps", finished=True)]
    seen.hear_status(status("policy_learner-2", progress=progress), 1.0)
    seen.vanished("policy_learner-2", 4.0)
    seen.settle(5.0)
    assert waiting_blocks(seen, 5.0) == []


def test_a_block_of_which_nobody_speaks_in_a_phase_waits_after_a_moment() -> None:
    seen = sharing()
    seen.hear_phase(announced(2, Phase.WALK, blocks={"arm": {}, "leg": {}}), 10.0)
    assert seen.work(10.5) == []
    progress = [Progress(block="arm", done=1, wanted=100, unit="steps")]
    seen.hear_status(status("encoder_learner-1", term=2, progress=progress), 11.0)
    assert waiting_blocks(seen, 11.5) == []
    assert waiting_blocks(seen, 13.0) == ["leg"]


def test_the_coordinators_sentence_comes_first_and_none_twice() -> None:
    seen = picture()
    seen.hear_status(status("actor-1", waiting_for="a grant"), 1.0)
    seen.hear_status(status("actor-2", waiting_for="a grant"), 1.0)
    seen.hear_status(status("coordinator-1", waiting_for="waiting for policy_learner"), 1.0)
    assert seen.waiting() == ["waiting for policy_learner", "a grant"]


def test_errors_of_one_process_are_news_now_and_then_and_the_newest_stays() -> None:
    seen = picture()
    for number in range(8):
        seen.hear_status(status("actor-1", last_error=f"refused {number}"), float(number))
    assert list(seen.news) == ["actor-1: refused 0"]
    assert list(seen.errors.values()) == ["actor-1: refused 7"]
    seen.hear_status(status("actor-1", last_error="refused 8"), 10.0)
    assert list(seen.news) == ["actor-1: refused 0", "actor-1: refused 8"]


def test_what_happened_can_be_seen_again_with_its_time() -> None:
    seen = picture()
    seen.hear_phase(announced(1, Phase.BABBLE), 4.0)
    seen.vanished("actor-1", 5.0)
    seen.settle(5.5)
    seen.news.clear()
    assert list(seen.events)[-2:] == [(4.0, "BABBLE"), (5.5, "actor-1 is lost")]


def test_losses_are_summed_over_all_lives_also_those_that_are_gone() -> None:
    seen = picture()
    refused = {"stale": 2, "malformed": 1}
    seen.hear_status(status("actor-1", totals={"resent": 4}, lost=1, refused=refused), 1.0)
    seen.hear_status(status("actor-1", totals={"resent": 5}, lost=2, refused=refused), 2.0)
    seen.hear_status(status("actor-2", totals={"resent": 1}, duplicated=7), 2.0)
    expected = Tally(lost=2, duplicated=7, refused=3, resent=6)
    assert seen.tally() == expected
    seen.vanished("actor-1", 5.0)
    for now in (5.5, 16.0):
        seen.settle(now)
    assert "actor-1" not in [member.life for member in seen.members()]
    assert seen.tally() == expected


def test_what_learners_measure_is_told_by_block_and_models_by_their_newest_version() -> None:
    seen = picture()
    found = {"arm/encoder/loss": 1.5, "leg/encoder/loss": 2.5, "cpu_secs": 3.0}
    seen.hear_status(status("encoder_learner-1", metrics=found, versions={"encoder/arm": 2}), 1.0)
    found = {"arm/policy/loss": 0.5}
    versions = {"policy/arm": 7, "encoder/arm": 1}
    seen.hear_status(status("policy_learner-1", metrics=found, versions=versions), 1.0)
    assert seen.measured() == {
        "arm": {"encoder/loss": 1.5, "policy/loss": 0.5},
        "leg": {"encoder/loss": 2.5},
    }
    assert seen.versions() == {"encoder/arm": 2, "policy/arm": 7}


@pytest.mark.parametrize(
    ("goals", "distance"),
    [
        ({}, 0.5),
        ({"reward": "dense"}, 0.25),
        ({"reward": "sparse"}, None),
        ({"goal_weight": 0.25}, 1.0),
        ({"goal_weight": 0.0, "external_weight": 1.0}, None),
        ({"external_weight": 0.5}, 0.0),
    ],
)
def test_the_distance_to_the_goal_is_read_off_the_reward_where_that_tells_it(
    goals: dict[str, object], distance: float | None
) -> None:
    measured = {"policy/reward_mean": -0.25, "policy/external_reward_mean": -0.5}
    found = goal_distance(measured, GoalSettings.model_validate(goals))
    assert found == (None if distance is None else pytest.approx(distance))
    assert goal_distance({}, GoalSettings()) is None
    assert goal_distance(measured, None) is None


def test_what_the_launcher_deals_with_is_shown_for_a_while_and_remains_an_event() -> None:
    seen = picture()
    seen.note_mishap("actor-1 was killed", 5.0)
    seen.settle(34.0)
    assert list(seen.errors.values()) == ["actor-1 was killed"]
    seen.settle(36.0)
    assert not seen.errors
    assert list(seen.news) == ["actor-1 was killed"]
    assert (5.0, "actor-1 was killed") in seen.events


def test_a_member_that_was_forgotten_and_comes_back_counts_once() -> None:
    seen = picture()
    seen.hear_status(status("actor-1", lost=2), 1.0)
    seen.vanished("actor-1", 5.0)
    seen.settle(5.5)
    seen.settle(20.0)
    assert "actor-1" not in [member.life for member in seen.members()]
    assert seen.tally() == Tally(lost=2)
    seen.appeared("actor", "actor-1", 30.0)
    seen.hear_status(status("actor-1", lost=3), 31.0)
    assert seen.tally() == Tally(lost=3)


def test_of_many_forgotten_members_nothing_is_left_out_of_the_sum() -> None:
    seen = picture()
    for number in range(MOST_LAST_WORDS + 5):
        life = f"actor-x{number}"
        seen.hear_status(status(life, lost=1), 1.0)
        seen.vanished(life, 1.0)
    seen.settle(2.0)
    seen.settle(20.0)
    assert seen.tally() == Tally(lost=MOST_LAST_WORDS + 5)


def test_a_status_that_comes_before_its_token_does_not_hide_that_somebody_joined() -> None:
    seen = picture()
    seen.hear_status(status("actor-3"), 1.0)
    seen.appeared("actor", "actor-3", 1.1)
    seen.appeared("actor", "actor-3", 1.2)
    assert list(seen.news) == ["actor-3 is there"]


def test_the_router_has_no_token_and_is_forgotten_once_it_is_silent() -> None:
    seen = picture()
    for second in range(1, 30):
        seen.hear_status(status("router-1"), float(second))
        seen.settle(second + 0.5)
    assert "router-1" in alive(seen)
    seen.settle(35.0)
    assert "router-1" in alive(seen)
    seen.settle(41.0)
    assert "router-1" not in alive(seen)
    seen.hear_status(status("router-1"), 42.0)
    assert "router-1" in alive(seen), "it was only out of reach"
    for now_secs in (60.0, 80.0):
        seen.settle(now_secs)
    assert "router-1" not in [member.life for member in seen.members()]
    assert list(seen.news) == []


def test_cut_offs_are_the_routers_and_what_it_finds_to_be_garbage_is_not_counted_twice() -> None:
    seen = picture()
    said = "cut off actor.lab (192.0.2.7, 2 connections): 70 MB/s; it is kept out for 60 s"
    seen.hear_status(
        status("router-1", totals={"cut_off": 2}, refused={"malformed": 9}, last_error=said), 1.0
    )
    seen.hear_status(status("policy_learner-1", refused={"malformed": 9}), 1.0)
    assert seen.tally() == Tally(refused=9, cut_off=2)
    assert list(seen.news) == [f"router-1: {said}"]


def test_cpu_seconds_are_those_last_heard_also_of_the_gone() -> None:
    seen = picture()
    for secs in (1.0, 2.0):
        seen.hear_status(status("actor-1", metrics={"cpu_secs": 10 * secs}), secs)
        seen.hear_status(status("actor-2", metrics={"cpu_secs": secs}), secs)
    seen.vanished("actor-1", 5.0)
    for now_secs in (5.5, 20.0):
        seen.settle(now_secs)
    assert seen.cpu_secs() == {"actor-1": 20.0, "actor-2": 2.0}
