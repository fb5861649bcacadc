"""Rewrite an exported network for int8 arithmetic: pairs of quantise and dequantise nodes around convolutions.

A run-time that knows the pattern dequantise - convolution - quantise runs it in integers; any other gets the same
numbers in float. Activations are unsigned 8 bits with one scale a tensor; weights are signed with one scale an output
channel (`training.rounding`).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import NamedTuple

import numpy as np
import onnx
from onnx import NodeProto, TensorProto, helper, numpy_helper

from training.rounding import Rounded

ACTIVATION_LEVELS = 255
BIAS_LIMIT = 2**30
SAME_RANGE = ("MaxPool", "Resize")  # what they give are values that they were given


class Range(NamedTuple):
    """How a tensor is kept in 8 bits: value = scale * (stored - zero)."""

    scale: float
    zero: int

    @classmethod
    def of(cls, low: float, high: float) -> Range:
        """Covers low..high and zero, which is exact: borders are filled with it."""
        low, high = min(low, 0.0), max(high, 0.0)
        scale = max((high - low) / ACTIVATION_LEVELS, 1e-12)
        return cls(scale, round(-low / scale))

    def rounded(self, values: np.ndarray) -> np.ndarray:
        """What is left of values."""
        stored = np.clip(np.rint(values / self.scale) + self.zero, 0, ACTIVATION_LEVELS)
        return (stored - self.zero) * self.scale


def unfold_half(model: onnx.ModelProto) -> onnx.ModelProto:
    """The model with its weights as float32 instead of half precision and a cast."""
    model = onnx.ModelProto.FromString(model.SerializeToString())
    weights = {weight.name: weight for weight in model.graph.initializer}
    casts = [node for node in model.graph.node if node.op_type == "Cast" and node.input[0] in weights]
    for cast in casts:
        values = numpy_helper.to_array(weights[cast.input[0]]).astype(np.float32)
        weights[cast.input[0]].CopyFrom(numpy_helper.from_array(values, cast.output[0]))
        model.graph.node.remove(cast)
    return model


def convolutions(graph: onnx.GraphProto, layers: Collection[str]) -> list[NodeProto]:
    """Convolutions of the torch modules called `layers` ('up.0.2.weight' is of 'up' and of 'up.0')."""
    starts = tuple(f"{layer}." for layer in layers)
    return [node for node in graph.node if node.op_type == "Conv" and node.input[1].startswith(starts)]


def activations(graph: onnx.GraphProto, layers: Collection[str]) -> dict[str, str]:
    """Tensors to keep in 8 bits: what the convolutions read and write, and what comes from that by copying.

    Each with the tensor whose range it takes: itself, or the one that it is a copy of.
    """
    activated = {node.input[0]: node.output[0] for node in graph.node if node.op_type == "Relu"}
    found = {}
    for node in convolutions(graph, layers):
        found |= {name: name for name in (node.input[0], activated.get(node.output[0], node.output[0]))}
    for node in graph.node:
        if node.op_type in SAME_RANGE and node.input[0] in found:
            found[node.output[0]] = found[node.input[0]]
    return found


def quantise(model: onnx.ModelProto, layers: Collection[str], ranges: Mapping[str, Range],
             weights: Mapping[str, Rounded]) -> onnx.ModelProto:
    """A float32 model with the convolutions of `layers` in int8.

    Args:
        ranges: for each of `activations`, how it is kept.
        weights: for the weights of each of these convolutions, the same.
    """
    model = onnx.ModelProto.FromString(model.SerializeToString())
    graph, rewriter = model.graph, _Rewriter(model.graph, ranges, weights)
    chosen = [node.name for node in convolutions(graph, layers)]
    for name in [value.name for value in graph.input]:
        rewriter.keep(name)
    for node in graph.node:
        rewriter.add(node, node.name in chosen)
    del graph.node[:], graph.initializer[:]
    graph.node.extend(rewriter.nodes)
    graph.initializer.extend(rewriter.weights.values())
    onnx.checker.check_model(model)
    return model


class _Rewriter:
    """Takes nodes in order and gives those of the quantised graph."""

    def __init__(self, graph: onnx.GraphProto, ranges: Mapping[str, Range], rounded: Mapping[str, Rounded]) -> None:
        self.nodes: list[NodeProto] = []
        self.weights = {weight.name: weight for weight in graph.initializer}
        self._ranges, self._rounded = ranges, rounded
        self._kept: dict[str, str] = {}

    def add(self, node: NodeProto, integer: bool) -> None:
        """One node of the float graph; `integer` for a convolution that is to run in int8."""
        if integer:
            self._quantise_weights(node)
        for index, name in enumerate(node.input):
            if node.op_type == "Add" and name in self.weights:
                self._keep_constant(name)
            node.input[index] = self._kept.get(name, name)
        self.nodes.append(node)
        for name in node.output:
            self.keep(name)

    def keep(self, name: str) -> None:
        """Keep a tensor in 8 bits, if it has a range: whoever reads it later reads what is left of it."""
        if name in self._ranges:
            scale, zero = self._ranges[name]
            self._store(f"{name}_scale", np.float32(scale))
            self._store(f"{name}_zero", np.uint8(zero))
            stored = [f"{name}_quantised", f"{name}_scale", f"{name}_zero"]
            self.nodes.append(helper.make_node("QuantizeLinear", [name, *stored[1:]], stored[:1]))
            self.nodes.append(helper.make_node("DequantizeLinear", stored, [f"{name}_kept"]))
            self._kept[name] = f"{name}_kept"

    def _keep_constant(self, name: str) -> None:
        """Keep what is added to a tensor in 8 bits: a sum is in integers where both of its parts are."""
        values = numpy_helper.to_array(self.weights.pop(name))
        scale, zero = Range.of(float(values.min()), float(values.max()))
        stored = [f"{name}_quantised", f"{name}_scale", f"{name}_zero"]
        for key, held in zip(stored, (np.rint(values / scale) + zero, scale, zero), strict=True):
            self._store(key, np.asarray(held, np.float32 if key == stored[1] else np.uint8))
        self.nodes.append(helper.make_node("DequantizeLinear", stored, [f"{name}_kept"]))
        self._kept[name] = f"{name}_kept"

    def _quantise_weights(self, node: NodeProto) -> None:
        """Weights in 7 bits with a scale for each output channel, the bias in 32 bits as ONNX Runtime wants it."""
        read = np.float32(self._ranges[node.input[0]].scale)
        factors, scale = self._rounded[node.input[1]]
        weight = numpy_helper.to_array(self.weights.pop(node.input[1]))
        bias = numpy_helper.to_array(self.weights.pop(node.input[2])) if len(node.input) > 2 else None
        if bias is not None:  # a channel that has hardly any weight: its bias must still fit
            wider = np.maximum(scale, np.abs(bias) / (read * BIAS_LIMIT)).astype(np.float32)
            factors = np.where((wider > scale)[:, None, None, None], weight / wider[:, None, None, None], factors)
            scale = wider
        node.input[1] = self._constant(node.input[1], factors, scale, np.int8)
        if bias is not None:
            node.input[2] = self._constant(node.input[2], bias / (scale * read), scale * read, np.int32)

    def _constant(self, name: str, values: np.ndarray, scale: np.ndarray, dtype: type) -> str:
        self._store(f"{name}_quantised", np.rint(values).astype(dtype))
        self._store(f"{name}_scale", scale)
        self._store(f"{name}_zero", np.zeros(len(scale), dtype))
        stored = [f"{name}_quantised", f"{name}_scale", f"{name}_zero"]
        self.nodes.append(helper.make_node("DequantizeLinear", stored, [f"{name}_kept"], axis=0))
        return f"{name}_kept"

    def _store(self, name: str, values: np.ndarray) -> None:
        self.weights[name] = numpy_helper.from_array(np.asarray(values), name)


def show(model: onnx.ModelProto, names: Iterable[str]) -> onnx.ModelProto:
    """The model with these tensors as its only outputs, of any shape."""
    model = onnx.ModelProto.FromString(model.SerializeToString())
    del model.graph.output[:]
    model.graph.output.extend(helper.make_tensor_value_info(name, TensorProto.FLOAT, None) for name in names)
    return model
