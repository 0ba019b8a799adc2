"""What an actor makes of models that do not fit its blocks: counted, named, and never acted with."""

import numpy as np
import pytest

from babble.blocks import BlockSpec, BlockTree
from babble.onnx_model import EncoderWeights, Layer, PolicyWeights, encoder_onnx, policy_onnx
from protocol.messages import Model
from services.actor.models import ModelShelf
from services.runtime.models import ModelKind, ModelOffer

TREE = BlockTree(
    [BlockSpec("x", 2, (0,), (0,)), BlockSpec("y", 3, (1,), (1,)), BlockSpec("top", 2, children=("x", "y"))],
    2,
    2,
)
SIZES = {"x": (1, 2, 1), "y": (1, 3, 1), "top": (5, 2, 5)}
"""By block: what it observes, its latent dimension, its actions."""


def layer(into: int, out: int, value: float = 0.1) -> Layer:
    return Layer(np.full((out, into), value, np.float32), np.zeros(out, np.float32))


def encoder(observed: int, latent_dim: int, value: float = 0.1) -> bytes:
    return encoder_onnx(
        EncoderWeights(np.zeros(observed, np.float32), 1.0, [layer(observed, latent_dim, value)])
    )


def policy(latent_dim: int, actions: int, value: float = 0.1) -> bytes:
    return policy_onnx(
        PolicyWeights(latent_dim, [layer(2 * latent_dim, actions)], np.full(actions, value, np.float32))
    )


def message(block: str, kind: ModelKind, onnx: bytes, version: int = 1) -> Model:
    offer = ModelOffer(kind=kind, version=version, encoder_version=1, onnx=onnx, keep=False)
    return offer.message(run="r", term=1, block=block, life="l", fingerprint="0" * 16)


def test_models_of_the_sizes_of_their_blocks_are_held() -> None:
    shelf = ModelShelf(TREE)
    for block, (n, d, a) in SIZES.items():
        assert shelf.admit(message(block, "encoder", encoder(n, d)))
        assert shelf.admit(message(block, "policy", policy(d, a)))
    assert shelf.unusable == 0
    assert len(shelf.versions()) == 6


@pytest.mark.parametrize(
    ("block", "kind", "onnx", "sentence"),
    [
        ("x", "encoder", encoder(1, 3), "its latent has the size 3, and the block's has 2"),
        ("top", "encoder", encoder(4, 2), "its observation has the size 4, and the block's has 5"),
        ("y", "policy", policy(2, 1), "its latent has the size 2, and the block's has 3"),
        ("top", "policy", policy(2, 4), "its mean has the size 4, and the block's has 5"),
        ("x", "encoder", encoder(1, 2, np.nan), "it gives something else than numbers"),
        ("x", "policy", policy(2, 1, np.nan), "it gives something else than numbers"),
    ],
)
def test_a_model_that_the_block_cannot_act_with_is_counted_and_named(
    block: str, kind: ModelKind, onnx: bytes, sentence: str
) -> None:
    shelf = ModelShelf(TREE)
    assert not shelf.admit(message(block, kind, onnx, version=7))
    assert shelf.unusable == 1
    assert shelf.last_error == f"{kind} version 7 of {block}: {sentence}"
    assert not shelf.versions(), "nobody acts with it"
