"""The golden messages, and the program that writes their frames.

Run `python -m tests.protocol.golden.make` after adding a message to GOLDEN. It writes what is not
there yet and never changes a committed frame: if one no longer fits, the protocol has changed, and
SPEC.md section 7 says what to do.
"""

import hashlib
from pathlib import Path

import numpy as np

from protocol.codec import encode
from protocol.messages import (
    Ack,
    Command,
    Frozen,
    Message,
    Model,
    ModelFloor,
    Phase,
    PhaseAnnounced,
    Progress,
    Reply,
    Score,
    Segment,
    SettingsAnnounced,
    Status,
    View,
)

FOLDER = Path(__file__).parent
ONNX = bytes(range(16))


def ramp(shape: tuple[int, ...], dtype: str) -> np.ndarray:
    """An array of 0, 1, 2... in a shape."""
    return np.arange(np.prod(shape)).astype(dtype).reshape(shape)


def header(block: str = "body", life: str = "actor-7f3a") -> dict[str, object]:
    """The fields of every message."""
    return {"run": "cuboid-1", "term": 3, "block": block, "life": life, "seq": 12}


def segment(phase: Phase, arrays: dict[str, np.ndarray], *, block: str = "body", **fields: object) -> Segment:
    """A segment of 2 steps and 3 columns."""
    return Segment(
        **header(block),
        fingerprint="0123456789abcdef",
        phase=phase,
        steps=2,
        columns=3,
        first_step=64,
        arrays=arrays,
        **fields,
    )


GOLDEN: dict[str, Message] = {
    "segment-babble": segment(
        Phase.BABBLE,
        {"observation": ramp((2, 3, 4), "<f4"), "episode": ramp((2, 3), "<i4")},
        consumer="encoder_learner",
    ),
    "segment-walk": segment(
        Phase.WALK,
        {
            "observation": ramp((2, 3, 4), "<f4"),
            "image": ramp((2, 3, 24), "|u1"),
            "episode": ramp((2, 3), "<i4"),
        },
        consumer="encoder_learner",
        encoder_version=1,
        policy_version=8,
        policy="sampled",
    ),
    "segment-practise": segment(
        Phase.PRACTISE,
        {
            **{name: ramp((2, 3, 2), "<f4") for name in ("latent", "next_latent", "goal")},
            "action": ramp((2, 3, 5), "<f4"),
            "log_prob": -ramp((2, 3), "<f4"),
            "truncated": ramp((2, 3), "|u1"),
            "terminated": np.zeros((2, 3), "|u1"),
        },
        consumer="policy_learner",
        encoder_version=2,
        policy_version=9,
        policy="sampled",
    ),
    "segment-ground-rewarded": segment(
        Phase.GROUND,
        {
            **{name: ramp((2, 3, 2), "<f4") for name in ("latent", "next_latent", "goal")},
            "action": ramp((2, 3, 5), "<f4"),
            "log_prob": -ramp((2, 3), "<f4"),
            "truncated": ramp((2, 3), "|u1"),
            "terminated": np.zeros((2, 3), "|u1"),
            "external_reward": ramp((2, 3), "<f4"),
        },
        consumer="policy_learner",
        encoder_version=2,
        policy_version=9,
        policy="sampled",
    ),
    "segment-evaluate": segment(
        Phase.EVALUATE,
        {
            "posture": ramp((4, 3, 6), "<f4"),
            "latent": ramp((4, 3, 2), "<f4"),
            "goal": ramp((4, 3), "<i4"),
        },
        consumer="policy_learner",
        policy="mean",
    ),
    "segment-evaluate-rewarded": segment(
        Phase.EVALUATE,
        {
            "start_posture": ramp((3, 6), "<f4"),
            "posture": ramp((4, 3, 6), "<f4"),
            "latent": ramp((4, 3, 2), "<f4"),
            "goal": ramp((4, 3), "<i4"),
            "external_reward": -ramp((4, 3), "<f4"),
        },
        consumer="policy_learner",
        policy="sampled",
    ),
    "segment-evaluate-sides": segment(
        Phase.EVALUATE,
        {
            "posture": ramp((4, 3, 6), "<f4"),
            "latent": ramp((4, 3, 2), "<f4"),
            "goal": ramp((4, 3), "<i4"),
            "side": -ramp((4, 3), "<f4"),
        },
        consumer="policy_learner",
        policy="mean",
    ),
    "segment-recorder": segment(
        Phase.PRACTISE,
        {
            "state": ramp((2, 3, 4), "<f4"),
            "episode": ramp((2, 3), "<i4"),
            "external_reward": -ramp((2, 3), "<f4"),
            "latent/thumb": ramp((2, 3, 2), "<f4"),
            "goal/thumb": ramp((2, 3, 2), "<f4"),
            "latent/hand": ramp((2, 3, 5), "<f4"),
            "goal/hand": ramp((2, 3, 5), "<f4"),
        },
        block="all",
        consumer="recorder",
        level=1,
        iteration=2,
    ),
    "segment-recorder-babble": segment(
        Phase.BABBLE,
        {"state": ramp((2, 3, 4), "<f4"), "episode": ramp((2, 3), "<i4")},
        block="all",
        consumer="recorder",
    ),
    "ack": Ack(
        **header(life="policy-0c11"),
        to="actor-7f3a",
        consumer="policy_learner",
        upto=12,
        granted=16,
        policy_floor=8,
        want="sampled",
    ),
    "ack-recorder": Ack(
        **header(block="all", life="recorder-3e1d"),
        to="actor-7f3a",
        consumer="recorder",
        upto=12,
        granted=2**53,
        progress=0.25,
    ),
    "model": Model(
        **header(life="encoder-55aa"),
        model="encoder",
        version=2,
        encoder_version=2,
        fingerprint="0123456789abcdef",
        digest=hashlib.sha256(ONNX).hexdigest(),
        arrays={"onnx": np.frombuffer(ONNX, np.uint8)},
    ),
    "phase": PhaseAnnounced(
        **header(block="all", life="coordinator-1"),
        phase=Phase.EVALUATE,
        level=1,
        iteration=2,
        iterations=4,
        evaluates=Phase.PRACTISE,
        blocks={"body": ModelFloor(encoder=2, policy=9), "hand": ModelFloor()},
    ),
    "phase-frozen": PhaseAnnounced(
        **header(block="all", life="coordinator-1"),
        phase=Phase.BABBLE,
        level=1,
        iterations=1,
        blocks={"hand": ModelFloor()},
        frozen={
            "thumb": Frozen(encoder=4, policy=19, of_encoder=2, of_policy=9),
            "index": Frozen(encoder=3, policy=18, of_encoder=3, of_policy=18),
        },
    ),
    "settings": SettingsAnnounced(
        **header(block="all", life="coordinator-1"),
        config='{"scenario": "cuboid", "seed": 1, "world": {"id": "Cuboid", "parameters": {}}}',
        began_ms=1_795_384_800_000,
    ),
    "status": Status(
        **header(block="all", life="policy-0c11"),
        service="policy_learner",
        phase=Phase.EVALUATE,
        versions={"policy/body": 9},
        totals={"segments": 2**53, "updates": 0},
        progress=[Progress(block="body", done=16, wanted=16, unit="columns", finished=True)],
        scores=[
            Score(
                run="cuboid-1",
                block="body",
                iteration=2,
                phase=Phase.PRACTISE,
                separation=0.99,
                separation_worst=0.75,
                z_min=0.5,
                z_goal=0.25,
                switch_success=1.0,
                crossing=-0.0,
                policy="mean",
                steps=8000,
            )
        ],
        metrics={"loss": float("inf"), "rate_per_sec": 1234.5},
        duplicated=1,
        refused={"stale": 3},
        waiting_for="policy_learner: 3 of 16 columns; Überraschung ✓",
    ),
    "status-landmarks": Status(
        **header(block="all", life="policy-0c11"),
        service="policy_learner",
        phase=Phase.EVALUATE,
        scores=[
            Score(
                run="hand-1",
                block="body",
                iteration=1,
                phase=Phase.PRACTISE,
                separation=0.5,
                separation_worst=0.25,
                z_min=0.75,
                z_goal=0.875,
                switch_success=1.0,
                landmarks={"open": 0.96875, "closed": 0.0},
                landmark_vertices={"open": 3},
                external_reward=-0.5,
                external_reward_by_vertex=[0.25, None, -1.25, 0.0],
                policy="sampled",
                steps=8000,
            )
        ],
    ),
    "view": View(
        **header(),
        view="latent",
        env_step=777,
        title="two latents",
        arrays={"latent": ramp((3, 2), "<f4"), "goal": ramp((3, 2), "<f4")},
    ),
    "view-latent-trail": View(
        **header(),
        view="latent",
        env_step=777,
        arrays={
            "latent": ramp((3, 2), "<f4"),
            "goal": ramp((3, 2), "<f4"),
            "posture": ramp((3, 4), "<f4"),
            "trail": ramp((5, 2), "<f4"),
            "path": -ramp((5, 4), "<f4"),
        },
    ),
    "view-posture": View(
        **header(block="all"),
        view="posture",
        env_step=12,
        arrays={"posture": ramp((3, 4), "<f4"), "path": ramp((5, 4), "<f4")},
    ),
    "view-pose": View(
        **header(block="all"),
        view="pose",
        env_step=778,
        arrays={"position": ramp((6, 3), "<f4"), "quaternion": ramp((6, 4), "<f4")},
    ),
    "view-pose-touch": View(
        **header(block="all"),
        view="pose",
        env_step=779,
        arrays={
            "position": ramp((6, 3), "<f4"),
            "quaternion": ramp((6, 4), "<f4"),
            "touch": ramp((7,), "<f4"),
        },
    ),
    "view-image": View(
        **header(block="all"),
        view="image",
        env_step=780,
        title="left eye",
        arrays={"pixels": ramp((2, 4, 3), "|u1")},
    ),
    "command": Command(**header(block="all", life="launcher-1"), id="q1", name="describe"),
    "reply": Reply(**header(block="all", life="coordinator-1"), id="q1", ok=True, text="all is well"),
}


def path(name: str) -> Path:
    """Where the frame of a golden message is kept."""
    return FOLDER / f"{name}.bin"


def main() -> None:
    """Write the frames that are missing."""
    for name, message in GOLDEN.items():
        if not path(name).exists():
            path(name).write_bytes(encode(message))
            print(f"wrote {path(name).name}")


if __name__ == "__main__":
    main()
