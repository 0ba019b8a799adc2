"""The networks as ONNX models, built from plain arrays; an actor needs nothing else to run them.

Building the graph directly takes about a millisecond and ties neither side to torch; the exports
(babble.encoder.export, babble.policy.export) check the result against torch.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import helper, numpy_helper

Floats = NDArray[np.float32]

OPSET = 17
IR_VERSION = 8
"""Old enough for every ONNX Runtime since 2022, and all that these graphs need."""


TOLERANCE = 1e-5
"""An exported model may be so far off the network that it was made from."""
CHECKED_ROWS = 64
"""Random inputs on which the two are compared at each export."""


class ExportError(RuntimeError):
    """An exported model that does not compute what the network does."""

    def __init__(self, kind: str, difference: float) -> None:
        super().__init__(f"the exported {kind} is {difference:g} off the network, over {TOLERANCE:g}")


@dataclass(frozen=True)
class Layer:
    """An affine layer: y = x @ weight.T + bias."""

    weight: Floats
    """(out, in)"""
    bias: Floats
    """(out,)"""


@dataclass(frozen=True)
class EncoderWeights:
    """z = softmax(layers((x - mean) / scale)), tanh between the layers (eq. 10)."""

    mean: Floats
    """(n,)"""
    scale: float
    layers: Sequence[Layer]


@dataclass(frozen=True)
class PolicyWeights:
    """mean action = layers([z, g]), tanh between the layers (eq. 11), with a log deviation per action."""

    latent_dim: int
    layers: Sequence[Layer]
    log_std: Floats
    """(a,)"""


def encoder_onnx(weights: EncoderWeights) -> bytes:
    """A model with input observation (B, n) and output latent (B, d), float32."""
    graph = _Graph()
    graph.constant("mean", weights.mean)
    graph.constant("scale", np.float32(weights.scale))
    graph.node("Sub", ["observation", "mean"], "centred")
    graph.node("Div", ["centred", "scale"], "h0")
    graph.layers(weights.layers, "h0", "logits")
    graph.node("Softmax", ["logits"], "latent", axis=-1)
    return graph.model(
        "encoder", {"observation": len(weights.mean)}, {"latent": len(weights.layers[-1].bias)}
    )


def policy_onnx(weights: PolicyWeights) -> bytes:
    """A model with inputs latent and goal (B, d), and outputs mean and log_std (B, a), float32."""
    graph = _Graph()
    graph.constant("deviations", weights.log_std)
    graph.node("Concat", ["latent", "goal"], "h0", axis=1)
    graph.layers(weights.layers, "h0", "mean")
    graph.node("Shape", ["mean"], "shape")
    graph.node("Expand", ["deviations", "shape"], "log_std")
    actions = len(weights.log_std)
    inputs = {"latent": weights.latent_dim, "goal": weights.latent_dim}
    return graph.model("policy", inputs, {"mean": actions, "log_std": actions})


class _Graph:
    """Nodes and constants on their way to a model."""

    def __init__(self) -> None:
        self._nodes: list[onnx.NodeProto] = []
        self._constants: list[onnx.TensorProto] = []

    def constant(self, name: str, value: Floats | np.float32) -> None:
        self._constants.append(numpy_helper.from_array(np.asarray(value, dtype=np.float32), name))

    def node(self, operator: str, inputs: list[str], output: str, **attributes: int) -> None:
        self._nodes.append(helper.make_node(operator, inputs, [output], **attributes))

    def layers(self, layers: Sequence[Layer], start: str, end: str) -> None:
        before = start
        for i, layer in enumerate(layers, start=1):
            last = i == len(layers)
            self.constant(f"weight{i}", layer.weight)
            self.constant(f"bias{i}", layer.bias)
            after = end if last else f"sum{i}"
            self.node("Gemm", [before, f"weight{i}", f"bias{i}"], after, transB=1)
            if not last:
                self.node("Tanh", [after], f"h{i}")
                before = f"h{i}"

    def model(self, name: str, inputs: dict[str, int], outputs: dict[str, int]) -> bytes:
        graph = helper.make_graph(self._nodes, name, _values(inputs), _values(outputs), self._constants)
        opset = helper.make_opsetid("", OPSET)
        model = helper.make_model(graph, producer_name="babble", opset_imports=[opset], ir_version=IR_VERSION)
        onnx.checker.check_model(model, full_check=True)
        return bytes(model.SerializeToString(deterministic=True))


def _values(sizes: dict[str, int]) -> list[onnx.ValueInfoProto]:
    return [
        helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, ["batch", size])
        for name, size in sizes.items()
    ]
