"""What is learned, in a few numbers and words (pure)."""

import math
from collections.abc import Mapping

from services.launcher.members import Picture
from services.runtime.settings import GoalSettings

ENCODER = (
    ("loss", "InfoNCE"),
    ("accuracy", "accuracy"),
    ("alignment", "alignment"),
    ("uniformity", "uniformity"),
)
POLICY = (
    ("loss", "PPO loss"),
    ("policy_loss", "policy"),
    ("value_loss", "value"),
    ("approx_kl", "KL"),
    ("clip_fraction", "clipped"),
    ("entropy", "entropy"),
)
"""What a learner measures, and how it is called here."""

ABREAST = (
    ("encoder/loss", "InfoNCE"),
    ("policy/reward_mean", "reward"),
    ("policy/approx_kl", "KL"),
    ("policy/entropy", "entropy"),
    ("encoder/accuracy", "accuracy"),
    ("policy/lag_mean", "lag"),
)
"""Of many blocks, the most important first: in narrow terminals the last ones are left out."""
CELL = 8

Measured = Mapping[str, float]


def learning_words(picture: Picture) -> str:
    """The loss of the encoder and the reward of the first block, as far as they are known."""
    for measured in picture.measured().values():
        found = [("InfoNCE", measured.get("encoder/loss")), ("reward", measured.get("policy/reward_mean"))]
        return ", ".join(f"{name} {number(value)}" for name, value in found if value is not None)
    return ""


def model_words(picture: Picture, block: str) -> str:
    """The newest versions of a block, and how old the experience is that the policy learns from."""
    versions, measured = picture.versions(), picture.measured().get(block, {})
    words = [f"{kind} v{versions.get(f'{kind}/{block}', 0)}" for kind in ("encoder", "policy")]
    if (lag := measured.get("policy/lag_mean")) is not None:
        words.append(f"policy lag {number(lag)}, at most {number(measured.get('policy/lag_max', lag))}")
    return ", ".join(words)


def learning_table(picture: Picture, width: int) -> list[str]:
    """A line per block, the one that is farthest from its goals first."""
    measured = picture.measured()
    longest = max(map(len, ["block", *measured]))
    columns = ABREAST[: max(1, (width - longest) // (CELL + 2))]
    names = sorted(measured, key=lambda block: measured[block].get("policy/reward_mean", 0.0))
    heads = "".join(f"  {head:>{CELL}}" for _, head in columns)
    return [f"{'block':<{longest}}{heads}"] + [
        f"{block:<{longest}}"
        + "".join(f"  {_cell(measured[block].get(name)):>{CELL}}" for name, _ in columns)
        for block in names
    ]


def encoder_words(measured: Measured) -> list[str]:
    """The encoder's measures, those that are known."""
    return _words(measured, "encoder", ENCODER)


def policy_words(measured: Measured, goals: GoalSettings | None) -> list[str]:
    """The policy's measures, those that are known."""
    reward, distance = measured.get("policy/reward_mean"), goal_distance(measured, goals)
    words = [] if reward is None else [f"reward {number(reward)}"]
    words += [] if distance is None else [f"distance to goal {number(distance)}"]
    return words + _words(measured, "policy", POLICY)


def goal_distance(measured: Measured, goals: GoalSettings | None) -> float | None:
    """How far latents are from their goals, read off the mean reward; None where it does not tell.

    The root mean square of |g - z| where the reward is squared (eq. 12), its mean where it is dense (eq. 9).
    """
    reward = measured.get("policy/reward_mean")
    if reward is None or goals is None or goals.goal_weight == 0 or goals.reward == "sparse":
        return None
    external = goals.external_weight * measured.get("policy/external_reward_mean", 0.0)
    distance = max(0.0, -(reward - external) / goals.goal_weight)
    return math.sqrt(distance) if goals.reward == "squared" else distance


def number(value: float) -> str:
    """Three digits that count."""
    return f"{value:.3g}"


def _cell(value: float | None) -> str:
    return "-" if value is None else number(value)


def _words(measured: Measured, model: str, names: tuple[tuple[str, str], ...]) -> list[str]:
    known = [(shown, measured.get(f"{model}/{name}")) for name, shown in names]
    return [f"{shown} {number(value)}" for shown, value in known if value is not None]
