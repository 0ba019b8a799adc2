"""Which iteration of a block is kept."""

import random
from dataclasses import asdict, replace

from hypothesis import given
from hypothesis import strategies as st

from protocol.messages import Score
from services.coordinator.best import best, measures, meets_bar, reason, weakest
from services.coordinator.table import Phase
from services.coordinator.words import ScoreRow
from services.launcher import evaluate
from services.launcher.evaluate import shortfalls

ROW = ScoreRow(
    block="body",
    iteration=1,
    phase=Phase.PRACTISE,
    separation=0.95,
    separation_worst=0.9,
    z_min=0.95,
    z_goal=0.97,
    switch_success=1.0,
    crossing=None,
    policy="mean",
    steps=1000,
    encoder_version=2,
    policy_version=20,
)


SHARES = st.sampled_from([0.0, 0.8999, 0.9, 1.0]) | st.floats(0, 1)


def row(iteration: int, separation: float, z_min: float, **changes: object) -> ScoreRow:
    return replace(ROW, iteration=iteration, separation=separation, z_min=z_min, **changes)  # type: ignore[arg-type]


def test_of_nothing_nothing_is_best() -> None:
    assert best([]) is None


def test_separation_alone_proves_nothing() -> None:
    assert best([row(1, 1.0, 0.5), row(2, 0.9, 0.9)]) == row(2, 0.9, 0.9)


def test_crossing_counts_where_there_is_a_bridge() -> None:
    stays, crosses = row(1, 0.99, 0.99, crossing=0.2), row(2, 0.91, 0.92, crossing=0.95)
    assert best([stays, crosses]) == crosses
    assert not meets_bar(stays)
    assert weakest(crosses) == 0.91


def test_with_landmarks_each_of_them_and_z_min_count_and_separation_does_not() -> None:
    near = row(1, 0.3, 0.95, landmarks={"open": 0.92, "closed": 1.0})
    far = row(2, 1.0, 0.95, landmarks={"open": 1.0, "closed": 0.89})
    assert meets_bar(near)
    assert not meets_bar(far)
    assert not meets_bar(row(3, 1.0, 0.85, landmarks={"open": 1.0, "closed": 1.0}))
    assert best([far, near]) == near
    assert reason(near).endswith("its weakest score is 0.920")


def test_while_a_landmark_is_reached_by_none_the_others_decide() -> None:
    early = row(1, 0.9, 0.95, landmarks={"open": 0.0, "closed": 1.0})
    late = row(2, 0.9, 0.95, landmarks={"open": 0.0, "closed": 0.5})
    assert best([early, late]) == early


def test_the_bar_is_met_at_exactly_nine_tenths() -> None:
    assert meets_bar(row(1, 0.9, 0.9, crossing=0.9))
    assert not meets_bar(row(1, 0.9, 0.8999))


def test_the_mean_policy_is_preferred_to_the_sampled_one() -> None:
    mean, sampled = row(1, 0.5, 0.5), row(2, 0.99, 0.99, policy="sampled")
    assert best([mean, sampled]) == mean
    assert best([sampled]) == sampled


def test_of_equals_the_later_iteration_is_kept() -> None:
    assert best([row(3, 0.95, 0.92), row(1, 0.92, 0.95), row(2, 0.92, 0.92)]) == row(3, 0.95, 0.92)


def test_the_reason_names_the_iteration_and_its_weakest_score() -> None:
    assert reason(row(3, 0.97, 0.95)) == "iteration 3 meets every bar of 0.9; its weakest score is 0.950"
    assert (
        reason(row(2, 0.4, 0.95)) == "no iteration meets every bar of 0.9; nearest is iteration 2 with 0.400"
    )


@given(
    separation=SHARES,
    z_min=SHARES,
    crossing=st.none() | SHARES,
    landmarks=st.dictionaries(st.sampled_from(["open", "closed"]), SHARES),
)
def test_coordinator_and_launcher_ask_the_same_of_a_success(
    separation: float, z_min: float, crossing: float | None, landmarks: dict[str, float]
) -> None:
    ours = row(1, separation, z_min, crossing=crossing, landmarks=landmarks)
    theirs = Score(run="r", **asdict(ours))
    assert meets_bar(ours) == (not shortfalls(theirs))
    assert measures(ours) == tuple(evaluate.measures(theirs).values())


@given(
    st.lists(st.builds(row, st.integers(0, 9), st.floats(0, 1), st.floats(0, 1)), min_size=1, max_size=8),
    st.randoms(use_true_random=False),
)
def test_the_best_does_not_depend_on_the_order_of_the_rows(
    rows: list[ScoreRow], chance: random.Random
) -> None:
    one, other = best(rows), best(chance.sample(rows, len(rows)))
    assert one is not None
    assert other is not None
    assert (weakest(one), one.iteration) == (weakest(other), other.iteration)
    assert all(weakest(one) >= weakest(each) for each in rows)
