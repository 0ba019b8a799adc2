"""What holds of the coordinator's machine whatever it hears."""

import json
import random
from dataclasses import asdict, replace

from hypothesis import given, settings
from hypothesis import strategies as st

from services.coordinator.journal import parse, replay
from services.coordinator.machine import decide
from services.coordinator.state import Plan, State, blocks_at_work
from services.coordinator.table import NEXT, Phase
from services.coordinator.waiting import stalled, waiting
from services.coordinator.words import (
    Announce,
    BlockProgress,
    Event,
    LinkChanged,
    MemberAppeared,
    MemberVanished,
    Started,
    StatusReported,
    StopRequested,
    Ticked,
)
from tests.unit.coordinator_play import HAND, finishing, play, score

BLOCKS = st.sampled_from(["thumb", "index", "hand", "tail"])
SERVICES = st.sampled_from(["encoder_learner", "policy_learner", "actor", "coordinator"])
LIVES = st.sampled_from(["a", "b", "c"])
TIMES = st.floats(min_value=0.0, max_value=500.0)
SMALL = st.integers(min_value=0, max_value=3)
PROGRESS = st.builds(
    BlockProgress, block=BLOCKS, done=SMALL, wanted=SMALL, unit=st.just("steps"), finished=st.booleans()
)
SCORES = st.builds(
    score,
    st.builds(State, iteration=SMALL),
    BLOCKS,
    policy=st.sampled_from(["mean", "sampled"]),
    separation=st.floats(0, 1),
    phase=st.sampled_from([Phase.GROUND, Phase.PRACTISE]),
)
STATUSES = st.builds(
    StatusReported,
    now=TIMES,
    service=SERVICES,
    life=LIVES,
    term=st.integers(0, 18),
    versions=st.dictionaries(
        st.sampled_from(["encoder/thumb", "policy/hand", "encoder/tail", "x"]), SMALL, max_size=2
    ),
    progress=st.lists(PROGRESS, max_size=3).map(tuple),
    scores=st.lists(SCORES, max_size=2).map(tuple),
    waiting_for=st.sampled_from(["", "experience"]),
)
EVENTS = st.one_of(
    st.builds(Started, now=TIMES),
    st.builds(Ticked, now=TIMES),
    STATUSES,
    st.builds(MemberAppeared, now=TIMES, service=SERVICES, life=LIVES),
    st.builds(MemberVanished, now=TIMES, service=SERVICES, life=LIVES),
    st.builds(LinkChanged, now=TIMES, up=st.booleans()),
    st.builds(StopRequested, now=TIMES),
)
TERM_ENDS = st.just("the term ends")
WORD_IN_TERM = STATUSES.map(lambda word: (word,))


def histories(plan: Plan) -> st.SearchStrategy[list[Event]]:
    """Events of any kind, among them words of the current term and ends of terms, so that they go far."""

    def concrete(steps: list[object]) -> list[Event]:
        state, events = decide(plan, State(), Started(now=0.0))[0], [Started(now=0.0)]
        history: list[Event] = list(events)
        for step in steps:
            if step == "the term ends":
                event: Event = finishing(plan, state)
            elif isinstance(step, tuple):
                event = replace(step[0], term=state.term)
            else:
                event = step  # type: ignore[assignment]
            history.append(event)
            state, _ = decide(plan, state, event)
        return history

    steps = st.one_of(TERM_ENDS, TERM_ENDS, WORD_IN_TERM, EVENTS)
    return st.lists(steps, max_size=60).map(concrete)


@given(histories(HAND))
@settings(max_examples=150, deadline=None)
def test_hearing_everything_twice_changes_nothing(history: list[Event]) -> None:
    assert play(HAND, [event for event in history for _ in range(2)])[0] == play(HAND, history)[0]


@given(histories(HAND))
@settings(max_examples=150, deadline=None)
def test_hearing_the_words_of_earlier_terms_again_changes_nothing(history: list[Event]) -> None:
    state, _ = play(HAND, history)
    for event in history:
        if isinstance(event, StatusReported) and event.term != state.term:
            assert decide(HAND, state, event) == (state, [])


@given(histories(HAND), st.randoms(use_true_random=False))
@settings(max_examples=150, deadline=None)
def test_the_order_of_words_within_a_term_is_of_no_matter(
    history: list[Event], chance: random.Random
) -> None:
    state, _ = play(HAND, history)
    words = [
        replace(event, now=500.0, term=state.term, progress=_unfinished(event), scores=(), waiting_for="")
        for event in history
        if isinstance(event, StatusReported)
    ]
    shuffled = chance.sample(words, len(words))
    assert play(HAND, shuffled, state)[0] == play(HAND, words, state)[0]


def _unfinished(word: StatusReported) -> tuple[BlockProgress, ...]:
    return tuple(replace(said, finished=False) for said in word.progress)


@given(histories(HAND), EVENTS)
@settings(max_examples=300, deadline=None)
def test_any_event_in_any_state_moves_legally_or_changes_nothing(history: list[Event], event: Event) -> None:
    before, _ = play(HAND, history)
    after, orders = decide(HAND, before, event)
    announced = [order for order in orders if isinstance(order, Announce)]
    if after.term != before.term:
        assert after.term == before.term + 1
        assert after.phase in NEXT[before.phase]
        assert [order.term for order in announced] == [after.term]
    else:
        assert (after.phase, after.level, after.iteration) == (before.phase, before.level, before.iteration)
        assert not announced or isinstance(event, Started)
    assert 0 <= after.level < len(HAND.levels)
    assert set(after.frozen) == {block for level in HAND.levels[: after.level] for block in level}
    if after.level == before.level:
        assert after.frozen == before.frozen
    for at in after.frozen.values():
        assert (at.of_encoder, at.of_policy) <= (at.encoder, at.policy)
    assert 0 <= after.iteration <= HAND.iterations[after.level]
    assert len({row.key for row in after.scores}) == len(after.scores)


@given(histories(HAND))
@settings(max_examples=100, deadline=None)
def test_what_changed_the_state_leads_to_it_again_from_the_journal(history: list[Event]) -> None:
    state, lines = State(), list[bytes]()
    for event in history:
        before = state
        state, _ = decide(HAND, before, event)
        if state != before:
            lines.append(json.dumps({"event": type(event).__name__, "said": asdict(event)}).encode())
    assert replay(HAND, map(parse, lines)) == state


SHARED = replace(
    HAND,
    processes={"encoder_learner": 2, "policy_learner": 2},
    shares={("encoder_learner", "index"): 1, ("policy_learner", "index"): 1},
)


@given(histories(SHARED), st.floats(0.0, 1e6))
@settings(max_examples=150, deadline=None)
def test_in_any_state_there_is_one_sentence_on_who_is_waited_for(history: list[Event], now: float) -> None:
    state, _ = play(SHARED, history)
    sentence = waiting(SHARED, state)
    assert "\n" not in sentence
    assert bool(sentence) or state.phase is Phase.DONE
    if "learner 1 of" in sentence:
        assert set(blocks_at_work(SHARED, state)) - state.finished, "nobody is missed who has nothing to do"
    if state.working:
        assert sentence in stalled(SHARED, state, now)
