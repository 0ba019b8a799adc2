"""The networks as ONNX models, built from plain arrays; an actor needs nothing else to run them.

Building the graph directly takes about a millisecond and ties neither side to torch; the exports
(babble.encoder.export, babble.policy.export) check the result against torch.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import prod

from babble.onnx_graph import Floats, Graph, Layer

__all__ = [
    "CHECKED_ROWS",
    "TOLERANCE",
    "EncoderWeights",
    "ExportError",
    "EyesWeights",
    "Layer",
    "PolicyWeights",
    "encoder_onnx",
    "policy_onnx",
]

TOLERANCE = 1e-5
"""An exported model may be so far off the network that it was made from."""
CHECKED_ROWS = 64
"""Random inputs on which the two are compared at each export."""


class ExportError(RuntimeError):
    """An exported model that does not compute what the network does."""

    def __init__(self, kind: str, difference: float) -> None:
        super().__init__(f"the exported {kind} is {difference:g} off the network, over {TOLERANCE:g}")


@dataclass(frozen=True)
class EyesWeights:
    """features = tanh(readout(convolutions(image))) of each eye, ReLU after each convolution."""

    start: int
    """where its images begin in the observation"""
    shape: tuple[int, ...]
    """(eyes, height, width, channels)"""
    convolutions: Sequence[Layer]
    stride: int
    padding: int
    readout: Layer


@dataclass(frozen=True)
class EncoderWeights:
    """z = softmax(layers(v)), tanh between the layers (eq. 10); z = layers(v) without the simplex.

    v = (x - mean) / scale, in which the images are replaced by what the eyes find, put at the end.
    """

    mean: Floats
    """(n,)"""
    scale: Floats | float
    """(n,), or one number for all"""
    layers: Sequence[Layer]
    eyes: Sequence[EyesWeights] = ()
    """in the order of their images in x"""
    simplex: bool = True


@dataclass(frozen=True)
class PolicyWeights:
    """mean action = layers([z, g]), tanh between the layers (eq. 11), with a log deviation per action."""

    latent_dim: int
    layers: Sequence[Layer]
    log_std: Floats
    """(a,)"""


def encoder_onnx(weights: EncoderWeights, block: str = "") -> bytes:
    """A model with input observation (B, n) and output latent (B, d), float32; see `Graph` for `block`."""
    graph, n = Graph(block), len(weights.mean)
    graph.constant("mean", weights.mean)
    graph.constant("scale", weights.scale)
    graph.node("Sub", ["observation", "mean"], "centred")
    graph.node("Div", ["centred", "scale"], "standardised")
    joined = _joined(graph, "standardised", n, weights.eyes) if weights.eyes else "standardised"
    graph.layers(weights.layers, joined, "logits" if weights.simplex else "latent")
    if weights.simplex:
        graph.node("Softmax", ["logits"], "latent", axis=-1)
    return graph.model("encoder", {"observation": n}, {"latent": len(weights.layers[-1].bias)})


def policy_onnx(weights: PolicyWeights, block: str = "") -> bytes:
    """A model with inputs latent and goal (B, d), and outputs mean and log_std (B, a), float32."""
    graph = Graph(block)
    graph.constant("deviations", weights.log_std)
    graph.node("Concat", ["latent", "goal"], "h0", axis=1)
    graph.layers(weights.layers, "h0", "mean")
    graph.node("Shape", ["mean"], "shape")
    graph.node("Expand", ["deviations", "shape"], "log_std")
    actions = len(weights.log_std)
    inputs = {"latent": weights.latent_dim, "goal": weights.latent_dim}
    return graph.model("policy", inputs, {"mean": actions, "log_std": actions})


def _joined(graph: Graph, value: str, size: int, eyes: Sequence[EyesWeights]) -> str:
    """The numbers of (B, n) outside the images, in their order, and then the features of the images."""
    vectors, features, start = [], [], 0
    for k, some in enumerate(eyes, start=1):
        stop = some.start + prod(some.shape)
        if some.start > start:
            vectors.append(graph.sliced(value, start, some.start, f"vectors{k}"))
        images = graph.sliced(value, some.start, stop, f"images{k}")
        features.append(_seen(graph, images, some, f"eyes{k}"))
        start = stop
    if size > start:
        vectors.append(graph.sliced(value, start, size, "vectors"))
    return graph.node("Concat", [*vectors, *features], "h0", axis=1)


def _seen(graph: Graph, images: str, eyes: EyesWeights, name: str) -> str:
    """The features (B, eyes * f) of flat images (B, eyes * height * width * channels)."""
    count, *image = eyes.shape
    apart = graph.reshaped(images, [-1, *image], f"{name}/apart")
    maps = graph.node("Transpose", [apart], f"{name}/maps", perm=[0, 3, 1, 2])
    pads, strides = [eyes.padding] * 4, [eyes.stride] * 2
    for i, layer in enumerate(eyes.convolutions, start=1):
        weight = graph.constant(f"{name}/weight{i}", layer.weight)
        bias = graph.constant(f"{name}/bias{i}", layer.bias)
        summed = graph.node("Conv", [maps, weight, bias], f"{name}/sum{i}", pads=pads, strides=strides)
        maps = graph.node("Relu", [summed], f"{name}/maps{i}")
    flat = graph.reshaped(maps, [-1, eyes.readout.weight.shape[1]], f"{name}/flat")
    read = graph.affine(flat, eyes.readout, f"/{name}", f"{name}/read")
    features = graph.node("Tanh", [read], f"{name}/each")
    return graph.reshaped(features, [-1, count * len(eyes.readout.bias)], name)
