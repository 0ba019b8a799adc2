"""docs/phases.md, drawn from `table.py` (pure); a test compares the committed page with this one."""

from services.coordinator.table import DUTY, NEXT, ONLY, OPEN_LOOP, Duty, Phase

REDRAW = ".venv/bin/python -m services.coordinator.diagram > docs/phases.md"
"""The command that draws the page anew."""


def mermaid() -> str:
    """The legal moves as a Mermaid state diagram."""
    lines = ["stateDiagram-v2", f"    [*] --> {Phase.BABBLE.value}"]
    for phase, moves in NEXT.items():
        for to, condition in moves.items():
            label = "" if condition == ONLY else f" : {condition}"
            lines.append(f"    {phase.value} --> {to.value}{label}")
    lines += [f"    {phase.value} --> [*]" for phase, moves in NEXT.items() if not moves]
    return "\n".join(lines)


def table() -> str:
    """The phases as a Markdown table: what is done, who ends it, what is counted, what may follow."""
    rows = ["| phase | what is done | ended by | counts | next |", "|---|---|---|---|---|"]
    for phase in Phase:
        rows.append(_row(phase.value, DUTY[phase], phase))
        if phase in OPEN_LOOP:
            rows.append(_row(f"{phase.value} (open loop)", OPEN_LOOP[phase], phase))
    return "\n".join(rows)


def page() -> str:
    """The whole page."""
    return f"""# The phases of a run

Drawn from `services/coordinator/table.py`, which is also what the coordinator moves by; do not edit.
To draw it anew: `{REDRAW}`

```mermaid
{mermaid()}
```

{table()}

Each move begins a new term. A phase ends when the process named here has reported, in the current term,
that it is finished with every block of the level; "finished" means done, checkpointed and published.
Open loop (`phases.open_loop`) is a run in which nothing is learned and what actors do is recorded.
The first EVALUATE of a level measures GROUND, the others measure PRACTISE.
"""


def _row(name: str, duty: Duty, phase: Phase) -> str:
    moves = "; ".join(_move(to, condition) for to, condition in NEXT[phase].items())
    return "| " + " | ".join((name, duty.does, duty.worker or "", duty.counts, moves)) + " |"


def _move(to: Phase, condition: str) -> str:
    return to.value if condition == ONLY else f"{to.value}, if {condition}"


if __name__ == "__main__":
    print(page(), end="")
