"""What an announcement of the coordinator is called, wherever people read it (pure)."""

from protocol.messages import Phase, PhaseAnnounced


def phase_words(announced: PhaseAnnounced | None) -> str:
    """The phase for a person: "PRACTISE 2 of 4", "EVALUATE after GROUND"."""
    if announced is None:
        return "Waiting for the coordinator"
    if announced.phase is Phase.DONE:
        return "DONE"
    name = announced.phase.upper()
    if announced.phase is Phase.EVALUATE and announced.evaluates is not None:
        name += f" after {announced.evaluates.upper()}"
    if announced.iteration > 0:
        name += f" {announced.iteration} of {announced.iterations}"
    return name + (f", level {announced.level}" if announced.level > 0 else "")
