"""Run folders with models whose scores are known beforehand, written without any training."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from babble.onnx_model import EncoderWeights, Layer, PolicyWeights, encoder_onnx, policy_onnx

DIRECTION = {"Cuboid": (1.0, 1.0, 1.0), "Ellipsoid": (1.0, 0.0, 0.0), "Dumbbell": (1.0, 0.0, 0.0)}
"""Where a push leads to one end of the longest diagonal."""
FACE = (1.0, 0.0, 0.0)
"""In the cuboid a push along x only ends anywhere on a face: 2.0 apart in x, whatever y and z."""
SHARP = 3.0
"""So steep a latent is within 0.003 of the vertex at the ends; at 0.1 it stays near the middle."""


TREE = """
[[block]]
name = "x"
observes = [0]
drives = [0]

[[block]]
name = "yz"
observes = [1, 2]
drives = [1, 2]

[[block]]
name = "body"
children = ["x", "yz"]
"""
"""The cuboid in two parts, and a block above them."""


def encoder(
    direction: Sequence[float], sharpness: float = SHARP, latent_dim: int = 2, block: str = ""
) -> bytes:
    """z = softmax(sharpness * [w.x, -w.x, 0...]) for the given w."""
    w = np.array(direction, np.float32)
    weight = np.zeros((latent_dim, len(w)), np.float32)
    weight[0], weight[1] = sharpness * w, -sharpness * w
    layer = Layer(weight, np.zeros(latent_dim, np.float32))
    return encoder_onnx(EncoderWeights(np.zeros(len(w), np.float32), 1.0, [layer]), block)


def policy(direction: Sequence[float], latent_dim: int = 2, block: str = "") -> bytes:
    """Full speed along `direction` for goal 0 and against it for goal 1, whatever z is."""
    push = np.array(direction, np.float32)
    weight = np.zeros((len(push), 2 * latent_dim), np.float32)
    weight[:, latent_dim], weight[:, latent_dim + 1] = push, -push
    layer = Layer(weight, np.zeros(len(push), np.float32))
    return policy_onnx(PolicyWeights(latent_dim, [layer], np.zeros(len(push), np.float32)), block)


def parts() -> dict[str, tuple[bytes, bytes]]:
    """Models of "x" and "yz" of the tree, which reach both ends of what they move."""
    return {
        "x": (encoder([1.0], block="x"), policy([1.0], block="x")),
        "yz": (encoder([1.5, 1.0], block="yz"), policy([1.0, 1.0], block="yz")),
    }


def composed() -> dict[str, tuple[bytes, bytes]]:
    """Models of "body" of the tree: goal 0 sends both children to vertex 0, goal 1 to vertex 1."""
    signs = (1, -1, 1, -1)
    return {"body": (encoder(signs, block="body"), policy(signs, block="body"))}


def write_run(
    folder: Path,
    iterations: Sequence[Mapping[str, tuple[bytes, bytes]]],
    *,
    world: str = "Cuboid",
    best: int = 0,
    settings: str = "",
    phase: str = "done (level 0, iteration 0, term 9)",
) -> Path:
    """A run folder with, per iteration, the (encoder, policy) of each block; its recorded scores are made up.

    `settings` is TOML after the world. Versions are 1 + iteration for encoders, ten times that for policies.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "run.json").write_text(json.dumps({"run": folder.name, "seed": 0, "packages": {"numpy": "2"}}))
    (folder / "config.toml").write_text(f'scenario = "analytic"\nworld = {{ id = "{world}" }}\n{settings}')
    rows: list[dict[str, Any]] = []
    for iteration, blocks in enumerate(iterations):
        for block, models in blocks.items():
            versions = {"encoder": 1 + iteration, "policy": 10 * (1 + iteration)}
            place = folder / "models" / block
            place.mkdir(parents=True, exist_ok=True)
            for (kind, version), onnx in zip(versions.items(), models, strict=True):
                (place / f"{kind}-{version}.onnx").write_bytes(onnx)
            rows += [_row(folder.name, block, iteration, versions, mode) for mode in ("mean", "sampled")]
    (folder / "scores.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    kept = {
        block: {"iteration": best, "reason": "made up"} for block in (iterations[0] if iterations else ())
    }
    (folder / "best.json").write_text(json.dumps(kept))
    events = [(100.0, "babble (level 0, iteration 0, term 1)"), (103.5, phase)]
    lines = [{"time": "then", "secs": secs, "what": "phase", "text": text} for secs, text in events]
    (folder / "events.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    return folder


def good(world: str = "Cuboid") -> dict[str, tuple[bytes, bytes]]:
    """Models of the block "body" that reach both ends."""
    w = (1.0, 0.6, 0.3) if world == "Cuboid" else FACE
    return {"body": (encoder(w), policy(DIRECTION[world]))}


def flat() -> dict[str, tuple[bytes, bytes]]:
    """Both ends of the cuboid are reached, but the latent stays near its middle, as in a control."""
    return {"body": (encoder((1.0, 0.6, 0.3), sharpness=0.1), policy(DIRECTION["Cuboid"]))}


def face() -> dict[str, tuple[bytes, bytes]]:
    """The latent is sharp, but the policy goes from face to face of the cuboid."""
    return {"body": (encoder(FACE), policy(FACE))}


def _row(run: str, block: str, iteration: int, versions: Mapping[str, int], mode: str) -> dict[str, Any]:
    return {
        "run": run,
        "block": block,
        "iteration": iteration,
        "phase": "practise" if iteration else "ground",
        "separation": 0.95,
        "separation_worst": 0.91,
        "z_min": 0.83 if iteration else 0.97,
        "z_goal": 0.98,
        "switch_success": 1.0,
        "crossing": None,
        "policy": mode,
        "steps": 100,
        "encoder_version": versions["encoder"],
        "policy_version": versions["policy"],
    }
