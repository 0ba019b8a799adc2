"""The pages of one block: its latents, and its learning."""

import rerun.blueprint as rrb

from services.dashboard.views import RECENT_SECS, ago, plot, simplex_view, usage
from services.runtime.settings import BlockSettings


def latent_page(block: BlockSettings) -> rrb.Container:
    """Its simplex, and what is measured of its latents."""
    measures = rrb.Vertical(
        plot(
            f"Squared distance to the goal{ago(RECENT_SECS)}",
            [f"/measures/{block.name}/goal_distance/**"],
            RECENT_SECS,
        ),
        plot(
            f"Entropy, 0 to 1{ago(RECENT_SECS)}",
            [f"/measures/{block.name}/latent_entropy", f"/measures/{block.name}/usage_entropy"],
            RECENT_SECS,
            axis=rrb.ScalarAxis(range=(0.0, 1.05)),
        ),
        usage(block.name, RECENT_SECS),
    )
    reading = rrb.TextDocumentView(origin=f"/status/reading/{block.name}", name="How to read it")
    name = f"Latents of {block.name}, d = {block.latent_dim}"
    drawing = rrb.Vertical(simplex_view(block, name), reading, row_shares=[7, 1])
    return rrb.Horizontal(drawing, measures, column_shares=[1.6, 1], name=block.name)


def learning_page(block: str) -> rrb.Container:
    """What its learners measure, and its scores."""
    encoder, policy = f"/learning/{block}/encoder", f"/learning/{block}/policy"
    plots = [
        plot("Encoder: InfoNCE loss", [f"{encoder}/loss"]),
        plot("Encoder: alignment and uniformity", [f"{encoder}/alignment", f"{encoder}/uniformity"]),
        plot("Encoder: accuracy", [f"{encoder}/accuracy"]),
        plot("Policy: reward per step", [f"{policy}/reward_mean"]),
        plot("Policy: losses of PPO", [f"{policy}/loss", f"{policy}/policy_loss", f"{policy}/value_loss"]),
        plot("Policy: KL divergence and clipped share", [f"{policy}/approx_kl", f"{policy}/clip_fraction"]),
        plot("Policy: entropy", [f"{policy}/entropy"]),
        plot("Policy: explained variance", [f"{policy}/explained_variance"]),
        plot("Scores of each evaluation", [f"/scores/{block}/**"]),
    ]
    table = rrb.TextDocumentView(origin="/status/scores", name="Scores")
    return rrb.Vertical(
        *(rrb.Horizontal(*plots[row : row + 3]) for row in range(0, len(plots), 3)),
        table,
        row_shares=[1, 1, 1, 0.8],
        name=block,
    )
