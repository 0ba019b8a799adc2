"""Simulations that break down: what they leave is dropped and counted, and not for ever."""

from babble.worlds.batch import Flags

MOST_IN_A_ROW = 20


class UnstableError(ValueError):
    """A world whose simulation breaks down again and again; the text is one sentence for a person."""


class Breakdowns:
    """Counts what was lost to breakdowns (`Step.failed`), since it was made."""

    def __init__(self, world: str) -> None:
        """`world` is its id, for the sentence."""
        self._world = world
        self._in_a_row = 0
        self.episodes = 0
        """episodes that ended by one"""
        self.segments = 0
        """unfinished segments and evaluations that were dropped, each block's counted"""

    def note(self, failed: Flags, segments: int) -> None:
        """The flagged columns (E,) broke down, and so many segments with them.

        Raises `UnstableError` the 20th time that it happens with nothing finished in between.
        """
        self.episodes += int(failed.sum())
        self.segments += segments
        self._in_a_row += 1
        if self._in_a_row >= MOST_IN_A_ROW:
            raise UnstableError(
                f"the simulation of {self._world} broke down {self._in_a_row} times in a row before "
                "anything was finished; give it a smaller timestep, weaker actuators or a lower gain"
            )

    def finish(self) -> None:
        """A segment or an evaluation was finished."""
        self._in_a_row = 0

    @property
    def sentence(self) -> str:
        """What was lost so far, for a person; empty if nothing was."""
        if not self.episodes:
            return ""
        return (
            f"the simulation of {self._world} breaks down now and then "
            f"(episodes lost: {self.episodes:,}, unfinished segments dropped: {self.segments:,})"
        )
