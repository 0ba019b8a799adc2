"""Of models and announcements only the newest counts."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.latest import LatestModel, LatestPhase
from protocol.messages import Model, Phase, PhaseAnnounced
from tests.protocol.golden.make import GOLDEN


def model(version: int, *, kind: str = "encoder", block: str = "body", life: str = "a") -> Model:
    """A version of a model."""
    return GOLDEN["model"].model_copy(
        update={"version": version, "model": kind, "block": block, "life": life}
    )


def phase(term: int, phase: Phase = Phase.WALK, *, life: str = "a", seq: int = 0) -> PhaseAnnounced:
    """An announcement."""
    return GOLDEN["phase"].model_copy(update={"term": term, "phase": phase, "life": life, "seq": seq})


def test_a_model_counts_only_if_its_version_grows():
    latest = LatestModel()
    assert [latest.admit(model(version)) for version in (3, 3, 2, 4)] == [True, False, False, True]
    assert latest.stale == 2
    assert latest.version("encoder", "body") == 4
    assert latest.last_stale == "encoder 2 of body is not newer than 3, which is held"


def test_a_new_life_of_the_learner_does_not_make_an_old_version_new():
    latest = LatestModel()
    latest.admit(model(3))
    assert not latest.admit(model(3, life="b"))
    assert latest.admit(model(4, life="b"))


def test_blocks_and_kinds_have_versions_of_their_own():
    latest = LatestModel()
    latest.admit(model(3))
    assert latest.admit(model(1, kind="policy"))
    assert latest.admit(model(1, block="hand"))
    assert [latest.version(*which) for which in (("encoder", "body"), ("policy", "hand"))] == [3, 0]


@given(versions=st.lists(st.integers(1, 9), max_size=30))
def test_the_version_held_is_the_greatest_heard(versions):
    latest = LatestModel()
    taken = [version for version in versions if latest.admit(model(version))]
    assert taken == sorted(set(taken))
    assert latest.version("encoder", "body") == max(versions, default=0)
    assert latest.stale == len(versions) - len(taken)


def test_a_term_never_goes_back():
    latest = LatestPhase()
    assert [latest.admit(phase(term)) for term in (2, 5, 4, 2)] == [True, True, False, False]
    assert (latest.current.term, latest.stale) == (5, 2)
    assert latest.last_stale == "walk of term 2 comes after walk of term 5"


@pytest.mark.parametrize("life", ["a", "restarted"])
def test_a_repeat_counts_whoever_says_it(life):
    latest = LatestPhase()
    latest.admit(phase(5))
    assert latest.admit(phase(5, life=life, seq=1))
    assert latest.current.life == life
    assert latest.stale == 0


@pytest.mark.parametrize(
    "change", [{"phase": Phase.DONE}, {"level": 0}, {"iteration": 3}, {"iterations": 9}, {"evaluates": None}]
)
def test_another_phase_in_the_same_term_is_no_repeat(change):
    latest = LatestPhase()
    first = phase(5)
    latest.admit(first)
    assert not latest.admit(first.model_copy(update=change))
    assert latest.current is first
    assert latest.stale == 1
