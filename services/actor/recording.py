"""What a recorder is sent of an actor: the state of every column at each environment step of its life.

A row is one environment step of one column, in whatever phase and at whatever level: the state in which
the blocks acted, what they acted on, and what the step gave. Rows are kept until a chunk of them is full
or the term ends. When a simulation breaks down the rows that are open are dropped and counted, with those
of that step.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from babble.legs import Seen, Witness
from babble.worlds.batch import Flags, Floats, Step, World
from protocol.messages import PhaseAnnounced
from services.actor.views import Views

Array = NDArray[np.generic]


@dataclass(frozen=True)
class Chunk:
    """Rows of one term, to be sent."""

    announced: PhaseAnnounced
    first_step: int
    """environment steps of each column that the life had done before the first row"""
    arrays: Mapping[str, Array]
    """each (T, E, ...), as protocol/contents.py has them for the recorder"""

    @property
    def steps(self) -> int:
        """T."""
        return len(self.arrays["state"])

    @property
    def columns(self) -> int:
        """E."""
        return self.arrays["state"].shape[1]


class Recording(Witness):
    """Collects the rows of one life; each `every_steps`-th environment step is one of each column."""

    def __init__(self, *, every_steps: int, chunk_steps: int, columns: int) -> None:
        self.looking = False
        self.full: deque[Chunk] = deque()
        """to be sent, the oldest first; no more than one step of the stage makes, if all is sent before it"""
        self.dropped_rows = 0
        """in total, of simulations that broke down"""
        self._every = every_steps
        self._chunk_steps = chunk_steps
        self._columns = columns
        self._announced: PhaseAnnounced | None = None
        self._world: World | None = None
        self._step = 0
        """environment steps of each column in this life"""
        self._episode = np.zeros(columns, np.int32)
        self._arrays: dict[str, Array] = {}
        self._first_step = self._open = 0
        self._row_is_seen = False

    @property
    def open_steps(self) -> int:
        """Steps of which the rows are kept, and not yet full."""
        return self._open

    def enter(self, announced: PhaseAnnounced, world: World) -> None:
        """A new term, in which this body is acted in; what was open of the last one is full."""
        self.close()
        self._announced, self._world = announced, world
        self._episode = self._episode + np.int32(1)
        self._row_is_seen = False
        self.looking = self._is_due

    def close(self) -> None:
        """What is open is full."""
        if not self._open:
            return
        assert self._announced is not None
        arrays = {name: array[: self._open] for name, array in self._arrays.items()}
        self.full.append(Chunk(self._announced, self._first_step, arrays))
        self._arrays, self._open = {}, 0

    def see(self, observation: Floats, seen: Mapping[str, Seen | None]) -> None:
        """See `Witness.see`: the state, and what the blocks act on, before they have moved the body."""
        assert self._world is not None
        if not self._open:
            self._begin(seen)
        arrays, row = self._arrays, self._open
        arrays["state"][row] = self._world.state()
        for block, acted_on in seen.items():
            if acted_on is not None:
                arrays[f"latent/{block}"][row], arrays[f"goal/{block}"][row] = acted_on
        self._row_is_seen = True

    def stepped(self, step: Step) -> None:
        """See `Witness.stepped`: what the row's step gave."""
        if step.failed is not None and step.failed.any():
            self._drop()
        elif self._row_is_seen:
            arrays = self._arrays
            arrays["episode"][self._open] = self._episode
            if "external_reward" in arrays:
                arrays["external_reward"][self._open] = step.external_reward
            self._open += 1
            if self._open == self._chunk_steps:
                self.close()
        self._step += 1
        self._row_is_seen = False
        self.looking = self._is_due

    def begun(self, columns: Flags) -> None:
        """See `Witness.begun`."""
        self._episode = self._episode + columns.astype(np.int32)

    @property
    def _is_due(self) -> bool:
        return self._step % self._every == 0

    def _begin(self, seen: Mapping[str, Seen | None]) -> None:
        assert self._world is not None
        self._first_step = self._step
        steps, columns = self._chunk_steps, self._columns
        self._arrays = {
            "state": np.empty((steps, columns, len(self._world.state_names)), np.float32),
            "episode": np.empty((steps, columns), np.int32),
        }
        if self._world.rewarded:
            self._arrays["external_reward"] = np.empty((steps, columns), np.float32)
        for block, acted_on in seen.items():
            for what, vectors in zip(("latent", "goal"), acted_on or (), strict=False):
                self._arrays[f"{what}/{block}"] = np.empty((steps, *vectors.shape), np.float32)

    def _drop(self) -> None:
        self.dropped_rows += (self._open + self._row_is_seen) * self._columns
        self._arrays, self._open = {}, 0
        # Steps are missing, so what follows is a new episode in every column, restarted or not.
        self._episode = self._episode + np.int32(1)


class Tee(Witness):
    """The recording, which sees each of its rows, and the views, which see what they look at."""

    def __init__(self, recording: Recording, views: Views) -> None:
        self._recording, self._views = recording, views

    @property
    def looking(self) -> bool:  # type: ignore[override]
        """Whether either looks."""
        return self._recording.looking or self._views.looking

    def see(self, observation: Floats, seen: Mapping[str, Seen | None]) -> None:
        """To those that look."""
        if self._recording.looking:
            self._recording.see(observation, seen)
        if self._views.looking:
            self._views.see(observation, seen)

    def stepped(self, step: Step) -> None:
        """To the recording."""
        self._recording.stepped(step)

    def begun(self, columns: Flags) -> None:
        """To the recording."""
        self._recording.begun(columns)

    def passed(self) -> None:
        """To the views."""
        self._views.passed()

    def cut(self) -> None:
        """To the views."""
        self._views.cut()
