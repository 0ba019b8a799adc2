"""Scores of a tree by seed: `python -m tests.processes.sweep_tree SCENARIO --seeds 0-9 --out FILE`."""

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from tests.processes.owned import Owner
from tests.processes.tree_runs import TreeScores, train_and_score


def main() -> None:
    """Train and score each seed in turn; lines are appended as they come, so that a part of them is kept."""
    parser = argparse.ArgumentParser(prog="python -m tests.processes.sweep_tree", description=__doc__)
    parser.add_argument("scenario", metavar="SCENARIO", help="a TOML, or the name of one under scenarios/")
    parser.add_argument("--seeds", type=seeds_of, default="0-9", metavar="S", help="0-9, or 3, or 1,4,7-9")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="appended to")
    parser.add_argument("--runs", type=Path, metavar="FOLDER", help="keep the runs there")
    parser.add_argument("--differing", type=int, default=4, help="children two goals must differ in")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        for seed in chosen.seeds:
            folder = (chosen.runs or Path(scratch)).resolve() / f"{Path(chosen.scenario).stem}-{seed}"
            try:
                with Owner() as owner:
                    found = train_and_score(owner, chosen.scenario, seed, folder)
                line, told = found.line(chosen.differing), words(found, chosen.differing)
            except AssertionError as error:
                line, told = {"seed": seed, "failed": str(error)}, f"seed {seed} failed: {error}"
            with chosen.out.open("a") as file:
                file.write(json.dumps(line) + "\n")
            print(told, file=sys.stderr, flush=True)


def seeds_of(text: str) -> Sequence[int]:
    """0-9, or 3, or 1,4,7-9. Raises ValueError for other texts."""
    spans = [list(map(int, part.split("-"))) for part in text.split(",")]
    return [seed for span in spans for seed in range(span[0], span[-1] + 1)]


def words(found: TreeScores, least_differing: int) -> str:
    """A seed in one line for a person."""
    z_min = " ".join(f"{row['z_min']:.3f}" for _, row in sorted(found.rows[found.top].items()))
    missing = [each for group in found.shortfalls(least_differing).values() for each in group]
    return (
        f"seed {found.seed}: {found.scores_secs:.0f} s, z_min by iteration {z_min}; "
        f"{'; '.join(missing) or 'all bars reached'}"
    )


if __name__ == "__main__":
    main()
