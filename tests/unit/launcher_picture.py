"""A picture of a run as the launcher may have one."""

from collections.abc import Sequence

from protocol.messages import ALL_BLOCKS, ModelFloor, Phase, PhaseAnnounced, Progress, Status
from services.launcher.lines import Line
from services.launcher.members import Picture
from services.runtime.settings import GoalSettings

MEASURED = {
    "body/policy/reward_mean": -0.25,
    "body/policy/loss": 0.01234,
    "body/policy/policy_loss": -0.5,
    "body/policy/value_loss": 0.125,
    "body/policy/approx_kl": 0.011,
    "body/policy/clip_fraction": 0.1,
    "body/policy/entropy": 1.42,
    "body/policy/lag_mean": 0.5,
    "body/policy/lag_max": 2.0,
    "body/encoder/loss": 2.345,
    "body/encoder/accuracy": 0.5,
    "body/encoder/alignment": 0.25,
    "body/encoder/uniformity": -1.5,
}
RUN = "a-scenario-with-quite-a-long-nam-20260101-120000-4294967295"


def row(
    iteration: int, policy: str = "mean", crossing: float | None = 0.5, block: str = "body"
) -> dict[str, object]:
    numbers = {"separation": 0.98765, "z_min": 0.5, "z_goal": 0.75, "switch_success": 1.0}
    return {"block": block, "iteration": iteration, "policy": policy, "crossing": crossing, **numbers}


def practising(actors: int = 3) -> Picture:
    """A run in its second round, 2 s after its start, with much to tell."""
    seen = Picture(RUN, f"/a/long/way/to/somewhere/on/this/disk/{RUN}", 0.0)
    seen.goals, seen.dashboard = GoalSettings(), "http://127.0.0.1:9090"
    common = {"run": RUN, "block": ALL_BLOCKS, "seq": 0, "term": 7}
    seen.hear_phase(
        PhaseAnnounced(**common, life="c-1", phase=Phase.PRACTISE, iteration=2, iterations=4, blocks={}), 0.5
    )
    waiting = "waiting for policy_learner: 1,228,800 of 12,288,000 steps of a-block-with-a-long-name"
    for service in ("coordinator", "encoder_learner", "policy_learner"):
        seen.appeared(service, f"{service}-0a1b2c3d", 0.0)
    seen.hear_status(
        Status(**common, life="coordinator-0a1b2c3d", service="coordinator", waiting_for=waiting), 1.0
    )
    for index in range(actors):
        life = f"actor-{index:08x}"
        seen.appeared("actor", life, 0.0)
        for now in (1.0, 2.0):
            totals = {"env_steps": round(12_345 * now), "resent": 1}
            metrics = {"cpu_secs": 0.5 * now, "rss_mb": 98.0}
            said = Status(**common, life=life, service="actor", totals=totals, metrics=metrics, queue_depth=2)
            seen.hear_status(said, now)
    for now, done in ((1.0, 1_000_000), (2.0, 1_228_800)):
        progress = [
            Progress(block=block, done=done, wanted=12_288_000, unit="steps")
            for block in ("body", "a-block-with-a-long-name-of-its-own")
        ]
        said = Status(
            **common,
            life="policy_learner-0a1b2c3d",
            service="policy_learner",
            progress=progress,
            last_error="x" * 300,
            versions={"encoder/body": 3, "policy/body": 14},
            metrics=MEASURED,
            lost=1,
        )
        seen.hear_status(said, now)
    seen.scores = [row(i, policy) for i in range(9) for policy in ("mean", "sampled")]
    return seen


def sharing(blocks: int = 1, lost: bool = False) -> Picture:
    """Two learners in GROUND with so many blocks each, half of their steps done; the second may be lost."""
    seen = Picture(RUN, f"runs/{RUN}", 0.0)
    common = {"run": RUN, "block": ALL_BLOCKS, "seq": 0, "term": 3}
    names = {f"policy_learner-{who}": [f"{who}{i}" for i in range(blocks)] for who in ("arm", "leg")}
    at_work = {block: ModelFloor() for listed in names.values() for block in listed}
    seen.hear_phase(PhaseAnnounced(**common, life="c-1", phase=Phase.GROUND, blocks=at_work), 0.0)
    for life, listed in names.items():
        seen.appeared("policy_learner", life, 0.0)
        progress = [Progress(block=block, done=50, wanted=100, unit="steps") for block in listed]
        seen.hear_status(Status(**common, life=life, service="policy_learner", progress=progress), 0.5)
    if lost:
        seen.vanished("policy_learner-leg", 1.0)
        seen.settle(2.0)
    return seen


def crowd(blocks: int = 18) -> Picture:
    """One learner in GROUND with so many blocks, the third of them far behind; all were scored twice."""
    seen = Picture(RUN, f"runs/{RUN}", 0.0)
    common = {"run": RUN, "block": ALL_BLOCKS, "seq": 0, "term": 3}
    names = [f"part_{i}" for i in range(blocks)]
    at_work = {block: ModelFloor() for block in names}
    seen.hear_phase(PhaseAnnounced(**common, life="c-1", phase=Phase.GROUND, blocks=at_work), 0.0)
    life = "policy_learner-0a1b2c3d"
    seen.appeared("policy_learner", life, 0.0)
    for now, share in ((0.5, 25), (1.5, 50)):
        progress = [
            Progress(block=block, done=10 if block == "part_2" else share, wanted=100, unit="steps")
            for block in names
        ]
        metrics = {f"{block}/policy/reward_mean": -0.1 * i for i, block in enumerate(names)}
        said = Status(**common, life=life, service="policy_learner", progress=progress, metrics=metrics)
        seen.hear_status(said, now)
    for block in names:
        seen.scores = [
            *seen.scores,
            *(row(i, policy, block=block) for i in (0, 1) for policy in ("mean", "sampled")),
        ]
    seen.scores = [{**each, "z_min": 0.25} if each["block"] == "part_7" else each for each in seen.scores]
    return seen


def texts(lines: Sequence[Line]) -> list[str]:
    return ["".join(text for text, _ in line) for line in lines]
