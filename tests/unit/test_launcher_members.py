"""The launcher's picture of a run, from messages and times that the test makes up."""

from protocol.messages import ALL_BLOCKS, Phase, PhaseAnnounced, Progress, Status
from services.launcher.members import Picture, Speed, phase_words

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
        seen.appeared(life.rsplit("-", 1)[0], life)
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
    seen.hear_phase(announced(3, Phase.DONE))
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
    seen.appeared("actor", "actor-1")
    seen.appeared("coordinator", "coordinator-1")
    seen.settle(61.5)
    assert len(alive(seen)) == 3
    seen.settle(64.1)
    assert alive(seen) == ["actor-1", "coordinator-1"]
    assert list(seen.news) == ["the link to the router is lost", "the router is back", "actor-2 is lost"]


def test_a_phase_is_news_once_and_an_older_one_never() -> None:
    seen = picture()
    for message in (announced(1, Phase.BABBLE), announced(1, Phase.BABBLE), announced(2, Phase.ENCODE)):
        seen.hear_phase(message)
    seen.hear_phase(announced(1, Phase.BABBLE))
    assert list(seen.news) == ["BABBLE", "ENCODE"]
    assert not seen.done
    seen.hear_phase(announced(3, Phase.DONE))
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
    seen.hear_phase(announced(1, Phase.GROUND))
    for second, done in ((0.0, 0), (2.0, 200)):
        progress = [Progress(block="body", done=done, wanted=1000, unit="steps")]
        seen.hear_status(status("policy_learner-1", progress=progress), second)
    (work,) = seen.work(2.0)
    assert (work.progress.done, work.left_secs) == (200, 8.0)
    seen.hear_phase(announced(2, Phase.WALK))
    assert seen.work(2.0) == []
    stale = [Progress(block="body", done=900, wanted=1000, unit="steps")]
    seen.hear_status(status("policy_learner-1", term=1, progress=stale), 3.0)
    assert seen.work(3.0) == []


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
