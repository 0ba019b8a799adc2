import numpy as np
import pytest
import torch

from babble.encoder.cltt import alignment, info_nce, similarities, uniformity

Z = torch.tensor([[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]])
NEAR = torch.tensor([[0.8, 0.2], [0.5, 0.5], [0.3, 0.7]])


def by_hand(similarity, temperature):
    """Eq. 4 written out."""
    total = 0.0
    for i, z in enumerate(Z.numpy()):
        sims = []
        for other in NEAR.numpy():
            match similarity:
                case "l2":
                    sims.append(-np.sum((z - other) ** 2))
                case "cosine":
                    sims.append(z @ other / np.linalg.norm(z) / np.linalg.norm(other))
                case "dot":
                    sims.append(z @ other)
        weights = np.exp(np.array(sims) / temperature)
        total -= np.log(weights[i] / weights.sum())
    return total / len(Z)


@pytest.mark.parametrize("similarity", ["l2", "cosine", "dot"])
@pytest.mark.parametrize("temperature", [0.1, 1.0])
def test_the_loss_is_equation_4(similarity, temperature):
    found = info_nce(Z, NEAR, temperature, similarity).item()
    assert found == pytest.approx(by_hand(similarity, temperature), rel=1e-5)


def test_the_loss_is_one_directional():
    assert info_nce(Z, NEAR, 0.3).item() != pytest.approx(info_nce(NEAR, Z, 0.3).item(), rel=1e-3)


def test_the_loss_pulls_positives_together_and_pushes_negatives_apart():
    anchor = torch.tensor([[0.6, 0.4], [0.4, 0.6]], requires_grad=True)
    info_nce(anchor, torch.tensor([[0.9, 0.1], [0.1, 0.9]]), 0.3).backward()
    assert anchor.grad[0, 0] < 0 < anchor.grad[0, 1]
    assert anchor.grad[1, 1] < 0 < anchor.grad[1, 0]


def test_a_collapsed_latent_costs_the_log_of_the_batch():
    same = torch.full((16, 2), 0.5)
    assert info_nce(same, same, 0.3).item() == pytest.approx(np.log(16))


def test_an_unknown_similarity_is_refused():
    with pytest.raises(ValueError, match="choose l2, cosine or dot"):
        similarities(Z, Z, "l1")


def test_alignment_and_uniformity():
    assert alignment(Z, Z).item() == 0
    assert alignment(Z, NEAR).item() == pytest.approx((0.08 + 0 + 0.18) / 3)
    assert uniformity(torch.full((8, 2), 0.5)).item() == pytest.approx(0)
    assert uniformity(Z).item() == pytest.approx(np.log((2 * np.exp(-1) + np.exp(-4)) / 3), rel=1e-5)
