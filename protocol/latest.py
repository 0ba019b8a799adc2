"""What counts as news among messages of which only the newest matters."""

from protocol.messages import Model, PhaseAnnounced


class LatestModel:
    """A model counts only if its version grows, per (encoder or policy, block); whoever sent it."""

    def __init__(self) -> None:
        self._versions: dict[tuple[str, str], int] = {}
        self.stale = 0
        """Models that were not newer than the one held."""
        self.last_stale = ""
        """Why the last stale one did not count; one sentence, or empty."""

    def version(self, model_kind: str, block: str) -> int:
        """The newest version heard of; 0 if none."""
        return self._versions.get((model_kind, block), 0)

    def admit(self, model: Model) -> bool:
        """True if the model is newer than all before it, and so to be used."""
        held = self.version(model.model, model.block)
        if model.version <= held:
            self.stale += 1
            self.last_stale = (
                f"{model.model} {model.version} of {model.block} is not newer than {held}, which is held"
            )
            return False
        self._versions[model.model, model.block] = model.version
        return True


class LatestPhase:
    """An announcement counts if its term grows, or repeats the current term unchanged.

    A restarted coordinator is a new life and repeats the current term too.
    """

    def __init__(self) -> None:
        self.current: PhaseAnnounced | None = None
        """The newest announcement; a repeat takes the place of what it repeats."""
        self.stale = 0
        """Announcements of an older term, or of another phase in the same term."""
        self.last_stale = ""
        """Why the last stale one did not count; one sentence, or empty."""

    def admit(self, announced: PhaseAnnounced) -> bool:
        """True for a new term and for a repeat; compare the terms to tell them apart."""
        held = self.current
        if held is not None and _place(announced) != _place(held) and announced.term <= held.term:
            self.stale += 1
            self.last_stale = (
                f"{announced.phase} of term {announced.term} comes after {held.phase} of term {held.term}"
            )
            return False
        self.current = announced
        return True


def _place(announced: PhaseAnnounced) -> tuple[object, ...]:
    return (
        announced.term,
        announced.phase,
        announced.level,
        announced.iteration,
        announced.iterations,
        announced.evaluates,
    )
