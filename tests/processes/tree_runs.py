"""Runs of a whole tree as a person starts them, and what `babble score` says of its blocks."""

import json
import time
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.processes.owned import Owner

REACHED = 0.9
MOST_RUN_SECS = 1200.0
"""Of one run on a machine that has other work too; how long it took is a figure of its own."""


@dataclass(frozen=True)
class Posture:
    """Where the children of a block ended at its goals, in one iteration."""

    ends: Mapping[int, Mapping[str, tuple[str, float]]]
    """By goal and child: the named posture of what the child moves, where there are some, else its vertex;
    and the share of legs that ended at it."""
    differing: int
    """In how many children two goals differ; of the pair of goals that are most alike."""

    @property
    def not_at_an_end(self) -> list[str]:
        """The children that were at no end of their range, with the goal and the share of legs."""
        return [
            f"{child} at goal {goal}: {name} in {share:.0%}"
            for goal, row in self.ends.items()
            for child, (name, share) in row.items()
            if share < REACHED
        ]


@dataclass(frozen=True)
class TreeScores:
    """A completed run, scored anew in fresh worlds with mean actions."""

    seed: int
    scores_secs: float
    """from the start of the processes to the scores, as `babble up` tells it"""
    cpu_secs: float
    """of all processes"""
    wall_secs: float
    """all of `babble up`, with its report"""
    best: Mapping[str, int]
    """by block"""
    top: str
    """the block that is the child of none"""
    children: Mapping[str, Sequence[str]]
    """by block"""
    rows: Mapping[str, Mapping[int, Mapping[str, Any]]]
    """by block and iteration, what `babble score --json` prints"""
    postures: Mapping[int, Posture]
    """of the top block, by iteration"""

    def shortfalls(self, least_differing: int) -> dict[str, list[str]]:
        """What is below its bar, by kind; z_min of the top block in every iteration, the rest in the best."""
        top, posture = self.rows[self.top], self.postures[self.best[self.top]]
        z_min = {f"z_min of iteration {number}": row["z_min"] for number, row in top.items()}
        leaves = [block for block, below in self.children.items() if not below]
        differing = [f"goals differ in {posture.differing} children"]
        return {
            "z_min": missed(self.top, z_min),
            "ends": posture.not_at_an_end,
            "differing": differing if posture.differing < least_differing else [],
            "landmarks": missed(self.top, self._ends_reached(self.top)),
            "leaves": [
                words
                for leaf in leaves
                for words in missed(leaf, {"z_min": self._kept(leaf)["z_min"], **self._ends_reached(leaf)})
            ],
        }

    def line(self, least_differing: int) -> dict[str, Any]:
        """One JSON object with everything that is asked of a run."""
        kept = ("z_min", "separation", "landmarks", "landmark_vertices")
        return {
            "seed": self.seed,
            "scores_secs": self.scores_secs,
            "cpu_secs": round(self.cpu_secs, 1),
            "wall_secs": round(self.wall_secs, 1),
            "best": dict(self.best),
            "z_min": {number: row["z_min"] for number, row in self.rows[self.top].items()},
            "differing": {number: posture.differing for number, posture in self.postures.items()},
            "shortfalls": self.shortfalls(least_differing),
            "scores": {
                block: {number: {name: row[name] for name in kept} for number, row in rows.items()}
                for block, rows in self.rows.items()
            },
            "ends": {number: posture.ends for number, posture in self.postures.items()},
        }

    def _kept(self, block: str) -> Mapping[str, Any]:
        """The row of the block's best iteration."""
        return self.rows[block][self.best[block]]

    def _ends_reached(self, block: str) -> dict[str, float]:
        """How surely its best iteration reaches the named postures, or how far apart it ends without any."""
        row = self._kept(block)
        return row["landmarks"] or {"separation": row["separation"]}


def train_and_score(
    owner: Owner, scenario: str | Path, seed: int, folder: Path, run_secs: float = MOST_RUN_SECS
) -> TreeScores:
    """Train a tree from nothing and score it. AssertionError if a command fails or takes too long."""
    began_secs = time.monotonic()
    options = ("--actors", "2", "--seed", str(seed), "--run-dir", str(folder), "--no-dashboard")
    said(owner, "up", str(scenario), *options, within_secs=run_secs)
    return scored(owner, folder, seed, time.monotonic() - began_secs)


def scored(owner: Owner, folder: Path, seed: int, wall_secs: float) -> TreeScores:
    """What `babble score` finds of a completed run in fresh worlds."""
    children = children_in(folder)
    rows: dict[str, dict[int, dict[str, Any]]] = {block: {} for block in children}
    postures: dict[int, Posture] = {}
    top = top_of(children)
    for line in said(owner, "score", str(folder), "--all", "--json"):
        row = json.loads(line)
        if "goals" in row and row["block"] == top:
            postures[row["iteration"]] = posture_of(row)
        elif "goals" not in row and row["policy"] == "mean":
            rows[row["block"]][row["iteration"]] = row
    result = read(folder, "result.json")
    return TreeScores(
        seed=seed,
        scores_secs=result["scores_secs"],
        cpu_secs=sum(result["cpu_secs"].values()),
        wall_secs=wall_secs,
        best={block: kept["iteration"] for block, kept in read(folder, "best.json").items()},
        top=top,
        children=children,
        rows=rows,
        postures=postures,
    )


def missed(block: str, measured: Mapping[str, float]) -> list[str]:
    """Which measures are below the bar."""
    return [f"{block}: {name} {value:.2f}" for name, value in measured.items() if value < REACHED]


def posture_of(row: Mapping[str, Any]) -> Posture:
    """From a row of `babble score --json` with "goals"."""

    def end(child: Mapping[str, Any]) -> tuple[str, float]:
        if child["landmark"] is not None:
            return child["landmark"], child["landmark_share"]
        return f"vertex {child['vertex']}", min(child["share"], child["reached"])

    return Posture(
        ends={
            goal["goal"]: {name: end(at) for name, at in goal["children"].items()} for goal in row["goals"]
        },
        differing=min((len(pair["children"]) for pair in row["differing"]), default=0),
    )


def said(owner: Owner, *arguments: str, within_secs: float = MOST_RUN_SECS) -> list[str]:
    """Run a `babble` command to its end; its lines on stdout. AssertionError if it fails."""
    process = owner.start("babble", "-m", "services.launcher", *arguments)
    assert process.ended(within_secs) == 0, process.report()
    return process.out


def children_in(folder: Path) -> dict[str, list[str]]:
    """The children of each block of a run, none for leaves."""
    blocks = tomllib.loads((folder / "config.toml").read_text())["block"]
    return {block["name"]: block.get("children", []) for block in blocks}


def top_of(children: Mapping[str, Iterable[str]]) -> str:
    """The block that is the child of none."""
    below = {child for each in children.values() for child in each}
    [top] = [block for block in children if block not in below]
    return top


def read(folder: Path, name: str) -> Any:
    """A JSON file of a run."""
    return json.loads((folder / name).read_text())


def rows(folder: Path, name: str) -> list[dict[str, Any]]:
    """The whole lines of one of a run's files so far."""
    path = folder / name
    whole = path.read_text().split("\n")[:-1] if path.exists() else []
    return [json.loads(line) for line in whole]


def scenario_of(path: Path) -> dict[str, Any]:
    """A scenario as it stands in its file."""
    return tomllib.loads(path.read_text())


def merged(table: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """A table with some entries changed, at any depth."""
    inner = {name: merged(table.get(name, {}), new) for name, new in changes.items() if isinstance(new, dict)}
    return {**table, **changes, **inner}
