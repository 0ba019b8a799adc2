"""Where the time of an actor's step goes."""

import time
from collections import defaultdict
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any
from unittest import mock

import onnxruntime

import services.actor.outbox
from babble.policy.act import EncoderModel, PolicyModel
from babble.policy.goals import GoalClock
from babble.segments import SegmentBuilder
from babble.worlds.batch import PointWorld
from bench.stand_in import StandIn
from bench.tables import Table
from services.actor.ways import PractiseWay

OTHERS = "the other side"
PLACES: dict[str, tuple[Any, str]] = {
    "world step": (PointWorld, "step"),
    "encoder, around ONNX Runtime": (EncoderModel, "latent"),
    "policy, sampling and log-probability": (PolicyModel, "act"),
    "record of the step": (PractiseWay, "record"),
    "goals": (GoalClock, "tick"),
    "into the segment": (SegmentBuilder, "add"),
    "encode of the frame": (services.actor.outbox, "encode"),
    OTHERS: (StandIn, "poll"),
}
ONNX = {
    "encoder, around ONNX Runtime": "encoder, in ONNX Runtime",
    "policy, sampling and log-probability": "policy, in ONNX Runtime",
}
REST = "collector, service, inbox"


class Stopwatch:
    """Time by place, each place without those it calls."""

    def __init__(self) -> None:
        self.secs: dict[str, float] = defaultdict(float)
        self.calls: dict[str, int] = defaultdict(int)
        self._places = [REST]
        self._since = time.perf_counter()

    def timed(self, function: Callable[..., Any], name: Callable[[str], str]) -> Callable[..., Any]:
        """The function, on the clock of the place that `name` gives for the calling place."""

        def run(*args: Any, **given: Any) -> Any:
            self._switch()
            self._places.append(name(self._places[-1]))
            self.calls[self._places[-1]] += 1
            try:
                return function(*args, **given)
            finally:
                self._switch()
                self._places.pop()

        return run

    def _switch(self) -> None:
        now = time.perf_counter()
        self.secs[self._places[-1]] += now - self._since
        self._since = now


def shares_of(run: Callable[[int], Any], steps: int) -> Table:
    """Microseconds of each place per step of all worlds, over at least so many environment steps."""
    watch = Stopwatch()
    session = onnxruntime.InferenceSession
    with ExitStack() as stack:
        for place, (owner, attribute) in PLACES.items():
            timed = watch.timed(getattr(owner, attribute), _always(place))
            stack.enter_context(mock.patch.object(owner, attribute, timed))
        inside = watch.timed(session.run, lambda place: ONNX.get(place, place))
        stack.enter_context(mock.patch.object(session, "run", inside))
        run(steps)
    del watch.secs[OTHERS]
    done, total = watch.calls["world step"], sum(watch.secs.values())
    ordered = sorted(watch.secs.items(), key=lambda item: -item[1])
    rows = [[place, f"{secs / done * 1e6:.1f}", f"{secs / total:.0%}"] for place, secs in ordered]
    rows.append(["all", f"{total / done * 1e6:.1f}", "100%"])
    readings = sum(watch.calls.values()) / done
    note = f"{readings:.1f} readings of the stopwatch per step, about {_overhead_us():.1f} us each, are in it"
    return Table("Where an actor's step of all its worlds goes", ["", "us per step", "share"], rows, [note])


def _always(place: str) -> Callable[[str], str]:
    return lambda _: place


def _overhead_us(calls: int = 20_000) -> float:
    def nothing() -> None:
        pass

    timed = Stopwatch().timed(nothing, lambda place: place)
    began = time.perf_counter()
    for _ in range(calls):
        timed()
    return (time.perf_counter() - began) / calls * 1e6
