"""From the trained policy to the model that actors run."""

import numpy as np

from babble.onnx_model import CHECKED_ROWS, TOLERANCE, ExportError, policy_onnx
from babble.policy.act import PolicyModel
from babble.policy.goals import one_hot
from babble.policy.ppo import GoalPPO


def export_policy(ppo: GoalPPO, block: str = "") -> bytes:
    """The policy as ONNX, checked on random inputs. Raises `ExportError` beyond 1e-5 of difference.

    With the name of its `block` it can be joined with those of others (babble.policy.together).
    """
    exported = policy_onnx(ppo.export_weights(), block)
    rng = np.random.default_rng(0)
    z = rng.dirichlet(np.ones(ppo.latent_dim), CHECKED_ROWS).astype(np.float32)
    g = one_hot(rng.integers(0, ppo.latent_dim, CHECKED_ROWS), ppo.latent_dim)
    expected, log_std = ppo.distribution(z, g)
    mean, deviations = PolicyModel(exported).distribution(z, g)
    difference = max(float(np.abs(mean - expected).max()), float(np.abs(deviations - log_std).max()))
    if not difference <= TOLERANCE:
        raise ExportError("policy", difference)
    return exported
