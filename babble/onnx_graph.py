"""ONNX graphs, node by node: the parts that the models of babble.onnx_model are made of."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import onnx
from numpy.typing import ArrayLike, NDArray
from onnx import helper, numpy_helper

Floats = NDArray[np.float32]

OPSET = 17
IR_VERSION = 8
"""Old enough for every ONNX Runtime since 2022, and all that these graphs need."""


@dataclass(frozen=True)
class Layer:
    """An affine layer: y = x @ weight.T + bias; or, with a weight of four dimensions, a convolution."""

    weight: Floats
    """(out, in), or (out, in, kernel, kernel)"""
    bias: Floats
    """(out,)"""


class Graph:
    """Nodes and constants on their way to a model; a value goes by its name."""

    def __init__(self, block: str = "") -> None:
        """In the model, every name begins with "<block>/": models of several blocks can be joined then."""
        self._prefix = f"{block}/" if block else ""
        self._nodes: list[onnx.NodeProto] = []
        self._constants: list[onnx.TensorProto] = []

    def constant(self, name: str, value: ArrayLike) -> str:
        """A float32 constant; returns its name."""
        return self._keep(name, np.asarray(value, dtype=np.float32))

    def whole(self, name: str, numbers: Sequence[int]) -> str:
        """A constant list of whole numbers, as shapes and borders are; returns its name."""
        return self._keep(name, np.asarray(numbers, dtype=np.int64))

    def node(
        self, operator: str, inputs: Sequence[str], output: str, **attributes: int | Sequence[int]
    ) -> str:
        """The operator's result under the name `output`, which is returned."""
        given = [self._prefix + value for value in inputs]
        self._nodes.append(helper.make_node(operator, given, [self._prefix + output], **attributes))
        return output

    def sliced(self, value: str, start: int, stop: int, output: str) -> str:
        """The columns from `start` to before `stop` of a value (B, n)."""
        borders = [
            self.whole(f"{output}/{word}", [number])
            for word, number in (("start", start), ("stop", stop), ("axis", 1))
        ]
        return self.node("Slice", [value, *borders], output)

    def reshaped(self, value: str, shape: Sequence[int], output: str) -> str:
        """The value in another shape; -1 stands for what is left."""
        return self.node("Reshape", [value, self.whole(f"{output}/shape", shape)], output)

    def affine(self, value: str, layer: Layer, suffix: str, output: str) -> str:
        """x @ weight.T + bias."""
        weight = self.constant(f"weight{suffix}", layer.weight)
        return self.node(
            "Gemm", [value, weight, self.constant(f"bias{suffix}", layer.bias)], output, transB=1
        )

    def layers(self, layers: Sequence[Layer], start: str, end: str) -> None:
        """Affine layers from `start` to `end` with tanh between them."""
        before = start
        for i, layer in enumerate(layers, start=1):
            if i == len(layers):
                self.affine(before, layer, str(i), end)
            else:
                before = self.node("Tanh", [self.affine(before, layer, str(i), f"sum{i}")], f"h{i}")

    def model(self, name: str, inputs: Mapping[str, int], outputs: Mapping[str, int]) -> bytes:
        """The checked model, with inputs and outputs (batch, size) float32."""
        ends = self._values(inputs), self._values(outputs)
        graph = helper.make_graph(self._nodes, self._prefix + name, *ends, self._constants)
        opset = helper.make_opsetid("", OPSET)
        model = helper.make_model(graph, producer_name="babble", opset_imports=[opset], ir_version=IR_VERSION)
        onnx.checker.check_model(model, full_check=True)
        return bytes(model.SerializeToString(deterministic=True))

    def _keep(self, name: str, value: NDArray[np.float32] | NDArray[np.int64]) -> str:
        self._constants.append(numpy_helper.from_array(value, self._prefix + name))
        return name

    def _values(self, sizes: Mapping[str, int]) -> list[onnx.ValueInfoProto]:
        return [
            helper.make_tensor_value_info(self._prefix + name, onnx.TensorProto.FLOAT, ["batch", size])
            for name, size in sizes.items()
        ]
