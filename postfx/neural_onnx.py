"""The ONNX form of a small network (`neural.Network`). Needs the package `onnx`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from onnx import TensorProto, helper, numpy_helper

OPSET = 20
"""The first with GELU."""
IR_VERSION = 9
"""The first that has this opset."""
ACTIVATION_OPERATORS = {"relu": "Relu", "gelu": "Gelu", "sine": "Sin"}


class _Graph:
    """Operators in the order in which they run, and the constants that they read."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.constants: dict[str, np.ndarray] = {}

    def op(self, kind: str, *inputs: str, **attributes: Any) -> str:
        """Add an operator; returns the name of its output."""
        name = f"v{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, inputs, [name], **attributes))
        return name

    def constant(self, values: Any, dtype: type = np.int64) -> str:
        """Add a constant; returns its name."""
        name = f"c{len(self.constants)}"
        self.constants[name] = np.asarray(values, dtype)
        return name


def to_onnx(shapes: Sequence[tuple[int, int]], activation: str, bands: int, encoded: int,
            parameters: np.ndarray | None) -> bytes:
    """A model: points (points, inputs) -> values (points, outputs).

    Args:
        shapes: (outputs, inputs) of every layer.
        activation: follows every layer but the last.
        bands, encoded: bands of the first inputs, and how many inputs have them.
        parameters: weights and biases, layer by layer, which the model then holds; None to make
            them its second input.
    """
    graph = _Graph()
    row = _inputs_with_waves(graph, bands, encoded)
    start = 0
    for index, (makes, reads) in enumerate(shapes):
        weights, biases = _layer(graph, parameters, start, makes, reads)
        row = graph.op("Gemm", row, weights, biases, transB=1)
        if index < len(shapes) - 1:
            row = graph.op(ACTIVATION_OPERATORS[activation], row)
        start += makes * (reads + 1)
    graph.nodes[-1].output[0] = "values"
    inputs = [_float_tensor("points", ("points", shapes[0][1] - 2 * bands * encoded))]
    if parameters is None:
        inputs.append(_float_tensor("parameters", (start,)))
    outputs = [_float_tensor("values", ("points", shapes[-1][0]))]
    model = helper.make_model(
        helper.make_graph(graph.nodes, "network", inputs, outputs,
                          [numpy_helper.from_array(array, name)
                           for name, array in graph.constants.items()]),
        opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION)
    return bytes(model.SerializeToString())


def _inputs_with_waves(graph: _Graph, bands: int, encoded: int) -> str:
    """The points, followed by sin(2^k pi x) and cos(2^k pi x) of the first `encoded` numbers x, for
    k < bands.

    With n = floor(2^k x + 0.5), the rest 2^k x - n is within half a turn: as in the kernels, its
    sine is taken and its sign changed where n is odd.
    """
    if not bands or not encoded:
        return "points"
    op, constant = graph.op, graph.constant
    chosen = op("Slice", "points", constant([0]), constant([encoded]), constant([1]))
    column = op("Unsqueeze", chosen, constant([1]))
    factors = 2.0 ** np.arange(bands)[:, None]
    half_turns = op("Mul", column, constant(factors, np.float32))
    whole = op("Floor", op("Add", half_turns, constant(0.5, np.float32)))
    angle = op("Mul", op("Sub", half_turns, whole), constant(np.pi, np.float32))
    odd = op("Mod", whole, constant(2.0, np.float32), fmod=1)
    sign = op("Sub", constant(1.0, np.float32),
              op("Mul", constant(2.0, np.float32), op("Abs", odd)))
    waves = [op("Unsqueeze", op("Mul", sign, op(kind, angle)), constant([3]))
             for kind in ("Sin", "Cos")]
    pairs = op("Concat", *waves, axis=3)
    return op("Concat", "points", op("Reshape", pairs, constant([-1, 2 * bands * encoded])), axis=1)


def _layer(graph: _Graph, parameters: np.ndarray | None, start: int, makes: int,
           reads: int) -> tuple[str, str]:
    """Weights (makes, reads) and biases (makes,) of the layer whose parameters begin at `start`:
    constants, or slices of the input 'parameters'."""
    middle, end = start + makes * reads, start + makes * (reads + 1)
    if parameters is not None:
        return (graph.constant(parameters[start:middle].reshape(makes, reads), np.float32),
                graph.constant(parameters[middle:end], np.float32))
    weights = graph.op("Slice", "parameters", graph.constant([start]), graph.constant([middle]))
    weights = graph.op("Reshape", weights, graph.constant([makes, reads]))
    biases = graph.op("Slice", "parameters", graph.constant([middle]), graph.constant([end]))
    return weights, biases


def _float_tensor(name: str, shape: tuple[int | str, ...]) -> Any:
    """What a model says of an input or output."""
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)
