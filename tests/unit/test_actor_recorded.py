"""An actor and its recorder: what is granted is acted, what is full is sent, and the last rows are too."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from babble.worlds import WORLDS, WorldEntry
from protocol import keys
from protocol.codec import decode, encode
from protocol.messages import (
    ALL_BLOCKS,
    RECORDER,
    Ack,
    Message,
    ModelFloor,
    Phase,
    PhaseAnnounced,
    Segment,
    Status,
)
from services.actor.service import FLUSH_SECS, Actor, build
from services.actor.ways import RandomWay
from services.runtime.bus import Frame, Inbox, Wakeup
from services.runtime.clock import HandClock
from services.runtime.errors import UserError
from services.runtime.memory_bus import MemoryBus
from services.runtime.process import Context
from services.runtime.settings import SettingsError, parse

RUN, LIFE, COLUMNS, CHUNK, WINDOW = "recorded", "actor-1", 2, 16, 3
FOREVER = 2**53
EPISODIC = WorldEntry("Episodic", "a line", "2", "tests.simulated.episodic")


class Stage:
    """An actor on the memory bus, and everyone that it speaks with: played by the test."""

    def __init__(self, *, open_loop: bool = False, every_steps: int = 1, **tables: Any) -> None:
        hub, self.clock = MemoryBus(), HandClock(1_000.0)
        wakeup = Wakeup()
        table = {
            "scenario": "test",
            "actors": {"envs_per_actor": COLUMNS, "segment_steps": CHUNK, "window": WINDOW},
            "phases": {"open_loop": open_loop},
            "recording": {"every_steps": every_steps},
        }
        context = Context(
            bus=hub.connect(LIFE, wakeup),
            clock=self.clock,
            settings=parse(table | tables, origin="test"),
            run=RUN,
            run_dir=Path(),
            life=LIFE,
            wakeup=wakeup,
        )
        self.actor: Actor = build(context)
        self._others = hub.connect("others")
        self._inbox = Inbox(max_frames=100_000)
        self._others.subscribe("segment", keys.segment(RUN, "*", "*", "*"), self._inbox)
        self._others.subscribe("status", keys.status(RUN, "*", "*"), self._inbox)
        self.chunks: dict[int, Segment] = {}
        """each that was sent to the recorder, by its number"""
        self.segments: list[Segment] = []
        """those to others"""
        self.status: Status | None = None
        self.term = 0

    def announce(self, phase: Phase, **about: Any) -> None:
        self.term += 1
        blocks = {} if phase is Phase.DONE else {"body": ModelFloor()}
        header = {
            "run": RUN,
            "term": self.term,
            "block": ALL_BLOCKS,
            "life": "coordinator-0",
            "seq": self.term,
        }
        message = PhaseAnnounced(**header, phase=phase, blocks=blocks, **about)
        self._others.publish("phase", keys.phase(RUN), encode(message))

    def ack(self, consumer: str = RECORDER, *, granted: int = FOREVER, upto: int = 0, **about: Any) -> None:
        message = Ack(
            run=RUN,
            term=self.term,
            block=ALL_BLOCKS if consumer == RECORDER else "body",
            life=f"{consumer}-0",
            seq=0,
            to=LIFE,
            consumer=consumer,
            upto=upto,
            granted=granted,
            **about,
        )
        self._others.publish("ack", keys.ack(RUN, LIFE, consumer), encode(message))

    def poll(self, times: int = 1, secs: float = 0.3) -> float | None:
        """So many polls, `secs` apart."""
        wanted: float | None = None
        for _ in range(times):
            wanted = self.actor.poll(self.clock.now_secs())
            self.clock.advance(secs)
            for arrival in self._inbox.take_all():
                assert isinstance(arrival, Frame)
                self._note(decode(arrival.data))
        return wanted

    def _note(self, message: Message) -> None:
        if isinstance(message, Status):
            self.status = message
        elif isinstance(message, Segment) and message.consumer == RECORDER:
            assert self.chunks.setdefault(message.seq, message) == message, "what is sent again is the same"
        elif isinstance(message, Segment):
            self.segments.append(message)

    @property
    def total(self) -> dict[str, int]:
        """The totals of the actor's last status."""
        assert self.status is not None
        return self.status.totals

    @property
    def waiting_for(self) -> str:
        assert self.status is not None
        return self.status.waiting_for

    def steps(self) -> list[int]:
        """The environment steps of this life that were sent, in the order of the stream."""
        chunks = [self.chunks[seq] for seq in sorted(self.chunks)]
        return [step for c in chunks for step in range(c.first_step, c.first_step + c.steps)]


def test_nothing_is_begun_before_the_recorder_has_granted_it() -> None:
    stage = Stage()
    stage.announce(Phase.BABBLE)
    stage.ack("encoder_learner")
    stage.poll(5)
    assert stage.total["env_steps"] == 0
    assert stage.waiting_for == "a grant of recorder"
    stage.ack()
    stage.poll(5)
    assert stage.total["env_steps"] > 0
    assert stage.waiting_for != "a coordinator's announcement"


def test_a_recorder_alone_does_not_make_an_actor_act_where_learners_want_nothing() -> None:
    stage = Stage()
    stage.announce(Phase.BABBLE)
    stage.ack()
    stage.poll(5)
    assert stage.total["env_steps"] == 0
    assert stage.waiting_for == "a grant of encoder_learner"


def test_a_full_window_stops_the_actor_and_an_acknowledgement_lets_it_go_on() -> None:
    stage = Stage()
    stage.announce(Phase.BABBLE, level=0, iteration=0)
    stage.ack()
    stage.ack("encoder_learner")
    for upto in range(20):
        stage.ack("encoder_learner", upto=len({s.seq for s in stage.segments}))
        stage.poll(5)
        assert sorted(stage.chunks) == list(range(upto + WINDOW))
        assert stage.waiting_for == "a grant of recorder"
        stage.ack(upto=upto + 1)
    assert stage.steps() == list(range(CHUNK * (19 + WINDOW)))
    assert stage.total["recorded_rows"] == stage.total["env_steps"] == CHUNK * (19 + WINDOW) * COLUMNS
    assert stage.total["resent"] > 0, "what was not acknowledged for a second"


def test_what_was_recorded_is_what_the_learner_is_sent() -> None:
    stage = Stage()
    stage.announce(Phase.BABBLE, iteration=0)
    stage.ack()
    stage.ack("encoder_learner")
    stage.poll(8, secs=0.01)
    assert len(stage.segments) == len(stage.chunks) == WINDOW
    for segment in stage.segments:
        np.testing.assert_array_equal(
            stage.chunks[segment.seq].arrays["state"], segment.arrays["observation"]
        )


def test_the_experience_is_the_same_whether_it_is_recorded_or_not() -> None:
    sent = []
    for every_steps in (0, 2):
        stage = Stage(every_steps=every_steps)
        stage.announce(Phase.BABBLE)
        stage.ack()
        stage.ack("encoder_learner", granted=WINDOW)
        stage.poll(8, secs=0.01)
        sent.append(stage.segments)
    assert len(sent[0]) == WINDOW
    assert sent[0] == sent[1]


def test_the_rows_of_a_term_that_is_over_are_sent_as_its_own() -> None:
    stage = Stage(actors={"envs_per_actor": COLUMNS, "segment_steps": 4096, "window": WINDOW})
    stage.announce(Phase.BABBLE, level=0, iteration=0)
    stage.ack()
    stage.ack("encoder_learner")
    stage.poll(3)
    assert not stage.chunks
    stage.announce(Phase.ENCODE, iteration=0)
    stage.poll(3)
    assert (stage.chunks[0].term, stage.chunks[0].phase) == (1, Phase.BABBLE)
    assert stage.steps() == list(range(stage.total["env_steps"] // COLUMNS))
    stage.announce(Phase.BABBLE, level=3, iteration=4)
    stage.ack(upto=1)
    stage.ack("encoder_learner")
    stage.poll(3)
    stage.announce(Phase.ENCODE)
    stage.poll(3)
    second = stage.chunks[1]
    assert (second.term, second.level, second.iteration) == (3, 3, 4)
    assert second.first_step == stage.chunks[0].steps, "the steps of a life are counted on"
    assert stage.steps() == list(range(stage.total["env_steps"] // COLUMNS))


def test_at_the_end_the_last_rows_are_sent_and_the_actor_goes_once_they_are_safe() -> None:
    stage = _with_open_rows()
    stage.announce(Phase.DONE)
    assert stage.poll(3) is not None, "they are not acknowledged"
    assert stage.steps() == list(range(stage.total["env_steps"] // COLUMNS))
    stage.ack(upto=1)
    assert stage.poll() is None
    assert stage.total["recorded_rows"] == stage.total["env_steps"]


def test_at_the_end_a_recorder_that_is_gone_is_waited_for_so_long_and_no_longer(
    caplog: pytest.LogCaptureFixture,
) -> None:
    stage = _with_open_rows()
    stage.announce(Phase.DONE)
    began_secs = stage.clock.now_secs()
    while stage.poll() is not None:
        assert stage.clock.now_secs() < began_secs + 10
    assert FLUSH_SECS <= stage.clock.now_secs() - began_secs < FLUSH_SECS + 1
    assert (
        caplog.messages.count("no recorder has acknowledged the last rows within 5 s; they may be missing")
        == 1
    )


def test_one_that_is_told_to_stop_sends_its_rows_and_goes_at_once() -> None:
    stage = _with_open_rows()
    stage.actor.stop()
    assert stage.poll() is None
    assert stage.steps() == list(range(stage.total["env_steps"] // COLUMNS))


def _with_open_rows() -> Stage:
    stage = Stage(actors={"envs_per_actor": COLUMNS, "segment_steps": 4096, "window": WINDOW})
    stage.announce(Phase.BABBLE)
    stage.ack()
    stage.ack("encoder_learner")
    stage.poll(3)
    assert not stage.chunks
    return stage


def test_an_open_loop_acts_for_the_recorder_alone_and_exactly_what_it_grants() -> None:
    stage = Stage(open_loop=True)
    stage.announce(Phase.BABBLE)
    stage.poll(3)
    assert stage.waiting_for == "a grant of recorder"
    for granted in (2, 5):
        stage.ack(granted=granted, upto=len(stage.chunks))
        stage.poll(12)
        assert sorted(stage.chunks) == list(range(granted))
        assert stage.total["env_steps"] == granted * CHUNK * COLUMNS
    assert stage.steps() == list(range(5 * CHUNK))
    assert not stage.segments
    stage.announce(Phase.DONE)
    stage.ack(upto=5, granted=5)
    assert stage.poll() is None
    assert len(stage.chunks) == 5


def test_in_an_open_loop_of_which_each_third_step_is_recorded_a_grant_is_of_so_many_rows() -> None:
    stage = Stage(open_loop=True, every_steps=3)
    stage.announce(Phase.BABBLE)
    stage.ack(granted=2)
    stage.poll(12)
    assert [(c.first_step, c.steps) for c in stage.chunks.values()] == [(0, CHUNK), (3 * CHUNK, CHUNK)]
    # The two steps after the last row would be of the next chunk.
    assert stage.total["env_steps"] == (2 * 3 * CHUNK - 2) * COLUMNS


def test_in_an_open_loop_too_a_simulation_that_breaks_down_again_and_again_ends_the_actor(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(WORLDS, "Episodic", EPISODIC)
    stage = Stage(open_loop=True, world={"id": "Episodic", "parameters": {"fails_every": 5}})
    stage.announce(Phase.BABBLE)
    stage.ack()
    with pytest.raises(UserError, match="broke down 20 times in a row"):
        stage.poll(40)
    assert not stage.chunks


def test_rows_of_a_simulation_that_breaks_down_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(WORLDS, "Episodic", EPISODIC)
    stage = Stage(open_loop=True, world={"id": "Episodic", "parameters": {"fails_every": 50}})
    stage.announce(Phase.BABBLE)
    for _ in range(20):
        stage.ack(upto=len(stage.chunks))
        stage.poll(3)
    # Three chunks of 16, one row that was open, and that of the step that broke down.
    assert len(stage.chunks) >= 9
    assert stage.steps()[46:50] == [46, 47, 50, 51]
    totals = stage.total
    assert totals["dropped_rows"] == 2 * COLUMNS * totals["failed_episodes"]
    assert totals["recorded_rows"] + totals["dropped_rows"] <= totals["env_steps"]


def test_the_noise_hears_how_far_the_term_is(monkeypatch: pytest.MonkeyPatch) -> None:
    heard: list[float] = []
    monkeypatch.setattr(RandomWay, "note_progress", lambda way, progress: heard.append(progress))
    stage = Stage(open_loop=True)
    stage.announce(Phase.BABBLE)
    stage.ack(granted=1, progress=0.25)
    stage.poll(2)
    assert set(heard) == {0.25}, "an actor that comes late begins there"
    stage.ack(granted=9, upto=1, progress=0.5)
    stage.poll(2)
    assert heard[-1] == 0.5
    stage.announce(Phase.BABBLE)
    stage.ack(granted=9, upto=len(stage.chunks))
    stage.poll(2)
    assert heard[-1] == 0.0, "another term is at its beginning"


def test_a_run_that_does_not_record_needs_no_recorder() -> None:
    stage = Stage(recording={})
    stage.announce(Phase.BABBLE)
    stage.ack("encoder_learner", granted=2)
    stage.poll(5)
    assert stage.total["env_steps"] == 2 * CHUNK * COLUMNS
    assert (stage.total["recorded_rows"], stage.chunks) == (0, {})
    assert {(segment.level, segment.iteration) for segment in stage.segments} == {(0, 0)}
    stage.announce(Phase.DONE)
    assert stage.poll() is None


def test_a_recorders_segment_that_fits_into_no_frame_is_a_sentence() -> None:
    with pytest.raises(SettingsError, match=r"a segment for the recorder would have .* MB .* lower actors"):
        Stage(
            actors={"envs_per_actor": 24, "segment_steps": 65536},
            block=[{"name": "one", "drives": [0]}, {"name": "other", "drives": [1, 2]}],
            recording={"every_steps": 1},
        )
