"""The claims of the README: in ten runs per world both ends are reached, and a control is not believed.

Whole experiments over Zenoh with the scenarios as shipped, some ten minutes per world on two cores.
"""

import json
from pathlib import Path
from typing import Any

import pytest

from tests.processes.owned import Owner

pytestmark = [pytest.mark.slow, pytest.mark.processes]

SEEDS = range(10)
RUN_SECS = 300.0
ENOUGH = 9


def babble(owner: Owner, *arguments: str) -> list[str]:
    """Run a command to its end; returns the lines on stdout. AssertionError if it fails."""
    process = owner.start("babble", "-m", "services.launcher", *arguments)
    assert process.ended(RUN_SECS) == 0, process.report()
    return process.out


def reached(row: dict[str, Any]) -> bool:
    """The bar of success: separation and z_min together, and crossing where there are two halves."""
    crossing = row["crossing"] is None or row["crossing"] >= 0.9
    return bool(row["separation"] >= 0.9 and row["z_min"] >= 0.9 and crossing)


@pytest.mark.parametrize("world", ["cuboid", "ellipsoid", "dumbbell"])
def test_both_ends_are_reached_in_nine_of_ten_seeds_and_the_control_fails(
    owner: Owner, tmp_path: Path, world: str
) -> None:
    best = []
    for seed in SEEDS:
        folder = str(tmp_path / f"{world}-{seed}")
        babble(owner, "up", world, "--actors", "2", "--seed", str(seed), "--run-dir", folder)
        rows = [json.loads(line) for line in babble(owner, "score", folder, "--best", "--json")]
        best.append(next(row for row in rows if row["policy"] == "mean"))
    assert sum(map(reached, best)) >= ENOUGH, best
    control = [json.loads(line) for line in babble(owner, "score", folder, "--control", "--json")]
    assert not any(map(reached, control)), control
