"""Demand is shared out exactly: nobody is asked for what nobody wants, and a lost actor's share goes on."""

from hypothesis import given
from hypothesis import strategies as st

from services.runtime.allotment import Allotment


def fresh(window: int = 4) -> Allotment:
    return Allotment(columns_per_segment=8, window=window, patience_secs=10.0)


def test_two_actors_share_a_rollout_evenly() -> None:
    allotment = fresh()
    allotment.appeared("a", 0, 0.0)
    allotment.appeared("b", 0, 0.0)
    allotment.want(16)
    assert allotment.grant(0.0) == {"a": 1, "b": 1}
    assert allotment.grant(0.1) == {"a": 1, "b": 1}, "asking again grants nothing new"


def test_one_actor_alone_gets_the_whole_demand() -> None:
    allotment = fresh()
    allotment.appeared("a", 0, 0.0)
    allotment.want(16)
    assert allotment.grant(0.0) == {"a": 2}


def test_the_window_bounds_what_one_actor_owes() -> None:
    allotment = fresh(window=3)
    allotment.appeared("a", 0, 0.0)
    allotment.want(1000)
    assert allotment.grant(0.0) == {"a": 3}
    allotment.received("a", upto=1, columns=8, now_secs=0.5)
    assert allotment.grant(0.5) == {"a": 4}


def test_a_rollout_does_not_wait_for_an_actor_four_times_as_slow() -> None:
    """16 columns are two segments: the fast one's two come before the slow one's first."""
    allotment = fresh()
    for life in ("fast", "slow"):
        allotment.appeared(life, 0, 0.0)
    allotment.want(16)
    assert allotment.grant(0.0) == {"fast": 1, "slow": 1}, "nobody is known to be slow yet"
    allotment.received("fast", upto=1, columns=8, now_secs=0.1)
    allotment.received("slow", upto=1, columns=8, now_secs=0.4)
    assert allotment.grant(0.5) == {"fast": 3, "slow": 1}


def test_an_actor_half_as_fast_gets_its_share() -> None:
    allotment = fresh()
    for life in ("fast", "slow"):
        allotment.appeared(life, 0, 0.0)
    allotment.want(16)
    allotment.grant(0.0)
    allotment.received("fast", upto=1, columns=8, now_secs=0.1)
    allotment.received("slow", upto=1, columns=8, now_secs=0.2)
    allotment.want(24)
    assert allotment.grant(0.5) == {"fast": 3, "slow": 2}


def test_an_actor_that_was_slow_once_is_tried_again() -> None:
    allotment = fresh()
    for life in ("fast", "slow"):
        allotment.appeared(life, 0, 0.0)
    allotment.want(16)
    allotment.grant(0.0)
    allotment.received("fast", upto=1, columns=8, now_secs=0.1)
    allotment.received("slow", upto=1, columns=8, now_secs=9.0)
    assert allotment.grant(9.1)["slow"] == 1
    allotment.received("fast", upto=3, columns=8, now_secs=9.2)
    assert allotment.grant(15.0)["slow"] == 2


def test_an_actor_that_is_tried_again_and_was_quick_is_slow_no_more() -> None:
    """Such as the fast one, which seemed slow while the learner itself was busy for a minute."""
    allotment = fresh()
    for life in ("fast", "slow"):
        allotment.appeared(life, 0, 0.0)
    allotment.want(16)
    allotment.grant(0.0)
    allotment.received("slow", upto=1, columns=8, now_secs=0.4)
    allotment.received("fast", upto=1, columns=8, now_secs=60.0)
    allotment.want(8)
    assert allotment.grant(66.0) == {"fast": 2, "slow": 1}
    allotment.received("fast", upto=2, columns=8, now_secs=66.1)
    allotment.want(16)
    assert allotment.grant(66.1) == {"fast": 3, "slow": 2}, "both were asked for nothing for so long"
    allotment.received("fast", upto=3, columns=8, now_secs=66.2)
    allotment.received("slow", upto=2, columns=8, now_secs=66.6)
    assert allotment.grant(66.6) == {"fast": 5, "slow": 2}


def test_what_a_vanished_actor_owes_is_granted_to_the_others() -> None:
    allotment = fresh()
    for life in ("a", "b"):
        allotment.appeared(life, 0, 0.0)
    allotment.want(16)
    allotment.grant(0.0)
    allotment.vanished("b")
    assert allotment.grant(0.1) == {"a": 2}


def test_a_late_segment_of_a_vanished_actor_does_not_bring_it_back() -> None:
    allotment = fresh()
    for life in ("a", "b"):
        allotment.appeared(life, 0, 0.0)
    allotment.vanished("b")
    allotment.received("b", upto=1, columns=8, now_secs=0.1)
    allotment.want(16)
    assert allotment.grant(0.2) == {"a": 2}


def test_what_a_stuck_actor_owes_is_granted_anew_after_the_patience() -> None:
    allotment = fresh()
    for life in ("a", "b"):
        allotment.appeared(life, 0, 0.0)
    allotment.want(16)
    allotment.grant(0.0)
    allotment.received("a", upto=1, columns=8, now_secs=1.0)
    allotment.want(8)
    assert allotment.grant(9.0)["a"] == 1, "b may still deliver"
    assert allotment.grant(10.5)["a"] == 2
    assert allotment.overdue(10.5) == ["b"]


def test_a_learner_that_comes_back_grants_beyond_what_it_holds_already() -> None:
    allotment = fresh()
    allotment.appeared("a", 7, 0.0)
    allotment.want(8)
    assert allotment.grant(0.0) == {"a": 8}


def test_a_new_term_takes_back_what_was_granted() -> None:
    allotment = fresh()
    allotment.appeared("a", 0, 0.0)
    allotment.want(32)
    allotment.grant(0.0)
    allotment.new_term()
    allotment.want(0)
    assert allotment.grant(0.1) == {"a": 0}


@given(
    wanted=st.integers(1, 400),
    sizes=st.dictionaries(st.sampled_from("abcdef"), st.integers(1, 64), min_size=1),
    order=st.randoms(use_true_random=False),
)
def test_whatever_the_actors_demand_is_met_without_a_segment_too_many(wanted, sizes, order) -> None:  # type: ignore[no-untyped-def]
    allotment = fresh()
    sent = dict.fromkeys(sizes, 0)
    for life, columns in sizes.items():
        allotment.appeared(life, 0, 0.0)
        allotment.received(life, 0, columns, 0.0)
    missing = wanted
    for _ in range(2000):
        allotment.want(missing)
        granted = allotment.grant(0.0)
        able = [life for life in sorted(sizes) if sent[life] < granted[life]]
        if not able:
            break
        life = order.choice(able)
        sent[life] += 1
        missing -= sizes[life]
        allotment.received(life, sent[life], sizes[life], 0.0)
    assert missing <= 0
    assert sum(sent[life] * sizes[life] for life in sizes) < wanted + max(sizes.values()) * len(sizes)
