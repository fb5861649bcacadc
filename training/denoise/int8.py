"""Rewrite an exported network for int8 arithmetic: pairs of quantise and dequantise nodes around
convolutions.

A run-time that knows the pattern dequantise - convolution - quantise runs it in integers; any other
gets the same numbers in float. Activations are unsigned 8 bits with one scale a tensor; weights are
signed with one scale an output channel (`training.denoise.int8`).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
import onnx
from onnx import NodeProto, TensorProto, helper, numpy_helper

from postfx.passes.denoise.network import (
    CODING,
    FEATURE_PARTS,
    PHASED_FINE,
    PRODUCTS,
    SCALING,
    STORED,
    stored_channels,
)
from training.export import add_constant, append_node, constant_value, drop_unused, replace_nodes

FIRST_TO_LAST, LAST_TO_FIRST = (0, 2, 3, 1), (0, 3, 1, 2)
"""Axes of channels brought to the end, and back."""

# Rounding -----------------------------------------------------------------------------------------
# Round a convolution's weights to integers, one after the other; each compensates the errors of
# those before it.
#
# Frantar et al., "GPTQ" (2022): the weights that are not yet rounded take up the change that
# rounding one weight makes in the sums, by the second moments of the convolution's input.

LIMIT = 63
"""Greatest integer: 7 bits, because x86 processors without VNNI add two products in 16 bits and
saturate."""
PATCHES = 256
"""Positions of a frame that moments are taken from."""
DAMPING = 0.01
"""This part of the mean moment is added to all moments, so that rounding does not rely on inputs
that hardly vary."""
SHARES = (1.0, 0.9, 0.8, 0.7, 0.6)
"""Limits for weights that are tried, as parts of the largest weight."""


class Rounded(NamedTuple):
    """Integer weights, in the shape of the weights, and the step of each output channel,
    float32."""

    factors: np.ndarray
    steps: np.ndarray


class Moments:
    """Mean products of a convolution's inputs, over its window and channels."""

    def __init__(self, side: int, pad: int, stride: int) -> None:
        self._side, self._pad, self._stride = side, pad, stride
        self._sum: np.ndarray = np.zeros((), np.float32)
        self._random = np.random.default_rng(0)

    @classmethod
    def of(cls, convolution: NodeProto) -> Moments:
        """For a square convolution, with the same padding on all sides."""
        facts = {fact.name: list(fact.ints) for fact in convolution.attribute}
        return cls(*(facts[name][0] for name in ("kernel_shape", "pads", "strides")))

    def add(self, planes: np.ndarray) -> None:
        """Add some positions of its input (1, C, h, w)."""
        padded = np.pad(planes[0], ((0, 0), *2 * [(self._pad, self._pad)]))
        windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * (self._side,), (1, 2))
        windows = windows[:, ::self._stride, ::self._stride]
        rows, columns = (self._random.integers(0, size, PATCHES) for size in windows.shape[1:3])
        some = windows[:, rows, columns].transpose(1, 0, 2,
                                                   3).reshape(PATCHES, -1).astype(np.float32)
        self._sum = self._sum + some.T @ some / PATCHES

    def round_weights(self, weight: np.ndarray) -> Rounded:
        """The convolution's weights (outputs, C, side, side) in integers."""
        factors, steps = round_compensated(weight.reshape(len(weight), -1),
                                           self._sum.astype(np.float64))
        return Rounded(factors.reshape(weight.shape), steps)


def round_compensated(weights: np.ndarray, moments: np.ndarray) -> Rounded:
    """Integers up to LIMIT for weights (outputs, inputs), by least squared error of the sums.

    Args:
        moments: (inputs, inputs), the mean product of inputs.
    """
    count = weights.shape[1]
    # 1: inputs that are always zero
    damped = moments + (DAMPING * np.trace(moments) / count or 1.0) * np.eye(count)
    upper = np.linalg.cholesky(np.linalg.inv(damped)).T
    best = np.full(len(weights), np.inf)
    factors, steps = np.zeros(weights.shape), np.ones(len(weights), np.float32)
    for share in SHARES:
        step = np.maximum(np.abs(weights).max(1) * share / LIMIT, 1e-12).astype(np.float32)
        tried = _compensated(weights.astype(np.float64), upper, step)
        apart = tried * step[:, None] - weights
        error = ((apart @ damped) * apart).sum(1)
        better = error < best
        best[better], factors[better], steps[better] = error[better], tried[better], step[better]
    return Rounded(factors, steps)


def _compensated(left: np.ndarray, upper: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Round column by column; each one's error is compensated by the columns behind it."""
    found = np.empty_like(left)
    for i in range(left.shape[1]):
        found[:, i] = np.clip(np.rint(left[:, i] / step), -LIMIT, LIMIT)
        missing = (left[:, i] - found[:, i] * step) / upper[i, i]
        left[:, i:] -= missing[:, None] * upper[i, i:]
    return found


# Quantised convolutions ---------------------------------------------------------------------------

ACTIVATION_LEVELS = 255
BIAS_LIMIT = 2**30
SAME_RANGE = ("MaxPool", "Resize")  # their outputs are values of their inputs


class Range(NamedTuple):
    """Coding of a tensor in 8 bits: value = scale * (stored - zero)."""

    scale: float
    zero: int

    @classmethod
    def of(cls, low: float, high: float) -> Range:
        """A range over low..high that holds zero exactly, as borders are filled with zeros."""
        low, high = min(low, 0.0), max(high, 0.0)
        scale = max((high - low) / ACTIVATION_LEVELS, 1e-12)
        return cls(scale, round(-low / scale))

    def decode(self, values: np.ndarray) -> np.ndarray:
        """Values after coding and decoding."""
        stored = np.clip(np.rint(values / self.scale) + self.zero, 0, ACTIVATION_LEVELS)
        return (stored - self.zero) * self.scale


def unfold_half(model: onnx.ModelProto) -> onnx.ModelProto:
    """The model with its weights as float32 instead of half precision and a cast."""
    model = onnx.ModelProto.FromString(model.SerializeToString())
    weights = {weight.name: weight for weight in model.graph.initializer}
    casts = [node
             for node in model.graph.node if node.op_type == "Cast" and node.input[0] in weights]
    for cast in casts:
        values = numpy_helper.to_array(weights[cast.input[0]]).astype(np.float32)
        weights[cast.input[0]].CopyFrom(numpy_helper.from_array(values, cast.output[0]))
        model.graph.node.remove(cast)
    return model


def convolutions(graph: onnx.GraphProto, layers: Collection[str]) -> list[NodeProto]:
    """Convolutions of the torch modules called `layers` ('up.0.2.weight' is of 'up' and of
    'up.0')."""
    starts = tuple(f"{layer}." for layer in layers)
    return [node
            for node in graph.node if node.op_type == "Conv" and node.input[1].startswith(starts)]


def activations(graph: onnx.GraphProto, layers: Collection[str]) -> dict[str, str]:
    """Tensors to store in 8 bits: inputs and outputs of the convolutions, and copies of them.

    Each maps to the tensor whose range it takes: itself, or the one that it copies.
    """
    activated = {node.input[0]: node.output[0] for node in graph.node if node.op_type == "Relu"}
    found: dict[str, str] = {}
    for node in convolutions(graph, layers):
        found |= {name: name
                  for name in (node.input[0], activated.get(node.output[0], node.output[0]))}
    for node in graph.node:
        if node.op_type in SAME_RANGE and node.input[0] in found:
            found[node.output[0]] = found[node.input[0]]
    return found


def quantise(model: onnx.ModelProto, layers: Collection[str], ranges: Mapping[str, Range],
             weights: Mapping[str, Rounded]) -> onnx.ModelProto:
    """A float32 model with the convolutions of `layers` in int8.

    Args:
        ranges: the coding of each of `activations`.
        weights: the integers of the weights of each of these convolutions.
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
    """Turns nodes, in order, into those of the quantised graph."""

    def __init__(self, graph: onnx.GraphProto, ranges: Mapping[str, Range],
                 rounded: Mapping[str, Rounded]) -> None:
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
        """Store a tensor in 8 bits, if it has a range; later nodes read the decoded values."""
        if name in self._ranges:
            scale, zero = self._ranges[name]
            self._store(f"{name}_scale", np.array(scale, np.float32))
            self._store(f"{name}_zero", np.array(zero, np.uint8))
            stored = [f"{name}_quantised", f"{name}_scale", f"{name}_zero"]
            self.nodes.append(helper.make_node("QuantizeLinear", [name, *stored[1:]], stored[:1]))
            self.nodes.append(helper.make_node("DequantizeLinear", stored, [f"{name}_kept"]))
            self._kept[name] = f"{name}_kept"

    def _keep_constant(self, name: str) -> None:
        """Store the constant of a sum in 8 bits: a sum is in integers if both parts are."""
        values = numpy_helper.to_array(self.weights.pop(name))
        scale, zero = Range.of(float(values.min()), float(values.max()))
        stored = [f"{name}_quantised", f"{name}_scale", f"{name}_zero"]
        for key, held in zip(stored, (np.rint(values / scale) + zero, scale, zero), strict=True):
            self._store(key, np.asarray(held, np.float32 if key == stored[1] else np.uint8))
        self.nodes.append(helper.make_node("DequantizeLinear", stored, [f"{name}_kept"]))
        self._kept[name] = f"{name}_kept"

    def _quantise_weights(self, node: NodeProto) -> None:
        """Weights in 7 bits with a scale for each output channel, the bias in 32 bits as ONNX
        Runtime wants it."""
        read = np.float32(self._ranges[node.input[0]].scale)
        factors, scale = self._rounded[node.input[1]]
        weight = numpy_helper.to_array(self.weights.pop(node.input[1]))
        bias = (numpy_helper.to_array(self.weights.pop(node.input[2])) if len(node.input) > 2
                else None)
        if bias is not None:  # a channel with hardly any weight: its bias must still fit
            wider = np.maximum(scale, np.abs(bias) / (read * BIAS_LIMIT)).astype(np.float32)
            factors = np.where((wider > scale)[:, None, None, None],
                               weight / wider[:, None, None, None], factors)
            scale = wider
        node.input[1] = self._constant(node.input[1], factors, scale, np.int8)
        if bias is not None:
            node.input[2] = self._constant(node.input[2], bias / (scale * read), scale * read,
                                           np.int32)

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
    model.graph.output.extend(helper.make_tensor_value_info(name, TensorProto.FLOAT, None)
                              for name in names)
    return model


# Integer forms ------------------------------------------------------------------------------------
# Forms of a quantised network that ONNX Runtime computes faster than plain quantise nodes.
#
# Enlarging by repeated pixels copies 8-bit values, channels last, like the convolutions around it.
# Heads are products of 8-bit values, summed in 32 bits: a kernel scales and activates them
# (`postfx.kernels.denoise.network_io`), which nodes could do only in another pass over 160 MB.
# Weights are the first factor of these products, so that each channel is a plane: reordering 32-bit
# results afterwards takes twice as long.

KEPT, QUANTISED = "_kept", "_quantised"
SIGN = 128
"""The processor's 8-bit products take codes of values less this."""
MIDDLE = 64
"""The processor's 8-bit products take weights with this added."""


def in_integers(model: onnx.ModelProto, weights: Mapping[str, Rounded],
                stem: Stem | None = None) -> onnx.ModelProto:
    """A model of `quantise` with its enlargements and heads in integers, and with that `stem`, if
    any.

    The outputs ``phased_fine`` and ``level1`` .. ``level4`` become ``products_fine``,
    ``products_level1`` and so on, (C, h * w) of int32, each with ``scaling_...`` (2, C): scale and
    bias of the logits. With a stem, the inputs become ``stored_features`` and ``stored_guides``,
    (1, h, w, C) of uint8, with ``coding_...`` (2, C) among the outputs.

    Args:
        weights: those of the heads in integers, by name.
    """
    model = onnx.ModelProto.FromString(model.SerializeToString())
    for resize in [one for one in model.graph.node
                   if one.op_type == "Resize" and one.input[0].endswith(KEPT)]:
        _repeat(model.graph, resize)
    for name, head in heads(model.graph).items():
        _multiply(model.graph, name, head, weights[head.input[1]])
    if stem:
        stem.write(model.graph)
    drop_unused(model.graph)
    onnx.checker.check_model(model)
    return model


def facts(model: onnx.ModelProto) -> dict[str, Any]:
    """Inputs and outputs of such a model, for its card."""
    found = {"outputs": _listed(model.graph.output)}
    for weight in model.graph.initializer:
        if weight.name in found["outputs"]:
            found["outputs"][weight.name]["constant"] = True
    if model.graph.input[0].name.startswith(STORED):
        found["inputs"] = _listed(model.graph.input)
    return found


def _listed(values: Iterable[onnx.ValueInfoProto]) -> dict[str, Any]:
    return {value.name: {"shape": [dim.dim_value or dim.dim_param
                                   for dim in value.type.tensor_type.shape.dim],
                         "meaning": "see postfx/kernels/denoise/network_io.py"} for value in values}


def _repeat(graph: onnx.GraphProto, resize: NodeProto) -> None:
    """Replace a node that enlarges by repeating 8-bit pixels twice along both axes."""
    name, source = resize.output[0], resize.input[0].removesuffix(KEPT) + QUANTISED
    made: list[NodeProto] = []
    shape = append_node(made, "Shape", [source], f"{name}_shape")
    last = append_node(made, "Transpose", [source], f"{name}_last", perm=FIRST_TO_LAST)
    for side, axis in (("columns", 2), ("rows", 1)):
        count = append_node(made, "Gather", [shape, f"{side}_axis"], f"{name}_{side}")
        end = append_node(made, "Mul", [count, "two"], f"{name}_{side}_end")
        twice = append_node(made, "Range", ["zero", end, "one"], f"{name}_{side}_range")
        places = append_node(made, "Div", [twice, "two"], f"{name}_{side}_places")
        last = append_node(made, "Gather", [last, places], f"{name}_{side}_repeated", axis=axis)
    append_node(made, "Transpose", [last], f"{name}{QUANTISED}", perm=LAST_TO_FIRST)
    for key, number in {"zero": 0, "one": 1, "two": 2, "rows_axis": 2, "columns_axis": 3}.items():
        add_constant(graph, key, np.array(number, np.int64))
    quantiser = next(one for one in graph.node if one.input[:1] == [name])
    at = list(graph.node).index(quantiser)
    nodes = [one for one in graph.node if one is not resize and one is not quantiser]
    replace_nodes(graph, [*nodes[:at - 1], *made, *nodes[at - 1:]])


def heads(graph: onnx.GraphProto) -> dict[str, NodeProto]:
    """Output -> the convolution of its logits; constant outputs have none."""
    makers = {output: one for one in graph.node for output in one.output}
    found = {}
    for output in (one for one in graph.output if one.name in makers):
        maker = makers[output.name]
        while maker.op_type != "Conv":
            maker = makers[maker.input[0]]
        found[output.name] = maker
    return found


def _multiply(graph: onnx.GraphProto, output: str, convolution: NodeProto,
              weights: Rounded) -> None:
    """Replace a 1x1 convolution and everything after it by a product of 8-bit values."""
    name = "fine" if output == PHASED_FINE else output
    source = convolution.input[0].removesuffix(KEPT)
    add_constant(graph, f"{name}_factors", (weights.factors[:, :, 0, 0] + MIDDLE).astype(np.uint8))
    bias = constant_value(graph, convolution.input[2])
    scaling = np.stack([weights.steps * constant_value(graph, f"{source}_scale"), bias])
    add_constant(graph, f"{SCALING}{name}", scaling.astype(np.float32))
    made = _signed(graph, source, weights.factors.shape[1])
    signed = [f"{name}_factors", f"{source}_signed", "middle", f"{source}_signed_zero"]
    append_node(made, "MatMulInteger", signed, f"{PRODUCTS}{name}")
    graph.node.extend(made)
    graph.output.remove(next(one for one in graph.output if one.name == output))
    places = f"height*width/{4 ** (1 if name == 'fine' else int(name[-1]))}"
    graph.output.extend([
        helper.make_tensor_value_info(f"{PRODUCTS}{name}", TensorProto.INT32,
                                      [len(weights.steps), places]),
        helper.make_tensor_value_info(f"{SCALING}{name}", TensorProto.FLOAT,
                                      [2, len(weights.steps)])])


def _signed(graph: onnx.GraphProto, source: str, channels: int) -> list[NodeProto]:
    """Nodes that make a tensor's 8-bit values signed, as the second factor of a product requires:
    codes minus 128, (C, h * w). Empty if the graph already has them."""
    made: list[NodeProto] = []
    name, codes = f"{source}_signed", f"{source}{QUANTISED}"
    if any(name in one.output for one in graph.node):
        return made
    flat = append_node(made, "Reshape", [codes, f"{source}_flat"], f"{source}_codes")
    flipped = append_node(made, "BitwiseXor", [flat, "sign"], f"{source}_turned")
    append_node(made, "Cast", [flipped], name, to=TensorProto.INT8)
    zero = np.array(int(constant_value(graph, f"{source}_zero")) - SIGN, np.int8)
    for key, held in {f"{source}_flat": np.array([channels, -1]), "sign": np.array(SIGN, np.uint8),
                      "middle": np.array(MIDDLE, np.uint8), f"{name}_zero": zero}.items():
        add_constant(graph, key, held)
    return made


# The stem -----------------------------------------------------------------------------------------
# The first convolution of a quantised network: it reads features as 8-bit codes
# (`postfx.kernels.denoise.network_io`).
#
# Channels have their own ranges, so the weights of one output channel differ too much for plain
# 7-bit rounding: only compensated rounding (`round_compensated`) is as good as float32.

MOST = 255
LIGHT = (0.0, 5.5)
"""Range of the codes of light."""
ALBEDO = (0.0, 1.25)
"""Range of the codes of an albedo."""
SEEN = (*6 * [ALBEDO], *3 * [(-1.0, 1.0)], (0.0, 1.0), (0.0, 1.0))
"""Ranges of both albedos, normal, roughness and depth."""
LIMITS = {
    "features": np.array([*9 * [LIGHT], *SEEN, (-1.0, 1.0), *2 * [(0.0, 1.0)], *2 * [(-0.5, 0.5)],
                          (0.0, 1.25), (0.0, 1.0), *8 * [(-1.0, 1.0)]]),
    "guides": np.array(4 * SEEN)}
"""Least and greatest value of each channel that codes can hold: light of 240 times white, motion of
150 pixels."""


class Coding(NamedTuple):
    """Factor and code of zero of each channel, both (C,)."""

    scale: np.ndarray
    zero: np.ndarray

    @classmethod
    def of(cls, name: str) -> Coding:
        """Coding of some planes, padding channels included."""
        low, high = LIMITS[name].T
        signed = low < 0
        scale = np.where(signed, (MOST // 2) / high, MOST / high)
        filled = (0, stored_channels(name) - len(low))
        zero = (MOST + 1) // 2 * signed
        return cls(*(np.pad(values, filled).astype(np.float32) for values in (scale, zero)))

    def codes(self, planes: np.ndarray) -> np.ndarray:
        """Codes minus that of zero of planes (1, C, h, w): float32, padding channels included."""
        scale, zero = (x[:, None, None] for x in self)
        planes = np.pad(planes, ((0, 0), (0, len(self.scale) - planes.shape[1]), (0, 0), (0, 0)))
        return np.clip(np.floor(planes * scale + zero + np.float32(0.5)), 0, MOST) - zero


class Stem:
    """The first convolution of a float network, over all planes that it reads.

    Attributes:
        names: of the planes, 'features' and 'guides' or the first alone.
        ring: pixels around the picture that it reads.
    """

    def __init__(self, graph: onnx.GraphProto) -> None:
        found = {one.input[0]: one for one in graph.node
                 if one.op_type == "Conv" and one.input[0] in (*FEATURE_PARTS, "guides")}
        weights = {name: constant_value(graph, one.input[1]).astype(np.float32)
                   for name, one in found.items()}
        self._bias = sum(constant_value(graph, one.input[2]).astype(np.float32)
                         for one in found.values() if len(one.input) > 2)
        self.ring = next(list(a.ints)
                         for a in found[next(iter(FEATURE_PARTS))].attribute if a.name == "pads")[0]
        parts = {"features": np.concatenate([weights[part] for part in FEATURE_PARTS], 1)}
        if "guides" in weights:
            parts["guides"] = weights["guides"]
        self.names = tuple(parts)
        self._coding = {name: Coding.of(name) for name in parts}
        self._weights = np.concatenate([self._folded(name, weight)
                                        for name, weight in parts.items()], 1)
        self._moments = Moments(self._weights.shape[2], self.ring, stride=2)

    def _folded(self, name: str, weight: np.ndarray) -> np.ndarray:
        """Weights of codes."""
        scale = self._coding[name].scale
        more = len(scale) - weight.shape[1]
        return np.pad(weight, ((0, 0), (0, more), (0, 0), (0, 0))) / np.where(scale, scale,
                                                                              1)[:, None, None]

    def add(self, reads: Mapping[str, np.ndarray]) -> None:
        """Add the inputs of a run of the float network."""
        planes = {"features": np.concatenate([reads[part] for part in FEATURE_PARTS], 1), **reads}
        codes = np.concatenate([self._coding[name].codes(planes[name]) for name in self.names], 1)
        self._moments.add(codes)

    def write(self, graph: onnx.GraphProto) -> None:
        """Replace the float convolutions and their inputs in a quantised graph."""
        target = next(one for one in graph.node if one.op_type == "Relu").input[0]
        behind = [NodeProto.FromString(one.SerializeToString()) for one in graph.node]
        for one in behind:
            one.input[:] = ["stem" if name == target else name for name in one.input]
        made = self._convolution(graph)
        del graph.node[:], graph.input[:]
        graph.node.extend([*made, *behind])
        sides = [f"ringed_{side}" if self.ring else side for side in ("height", "width")]
        for name in self.names:
            count = stored_channels(name)
            add_constant(graph, f"{CODING}{name}", np.stack(self._coding[name]))
            graph.input.append(helper.make_tensor_value_info(f"{STORED}{name}", TensorProto.UINT8,
                                                             [1, *sides, count]))
            graph.output.append(helper.make_tensor_value_info(f"{CODING}{name}", TensorProto.FLOAT,
                                                              [2, count]))

    def _convolution(self, graph: onnx.GraphProto) -> list[NodeProto]:
        """Nodes that compute 'stem' from the stored planes; the bias subtracts the codes of
        zero."""
        factors, steps = self._moments.round_weights(self._weights)
        zero = np.concatenate([self._coding[name].zero for name in self.names])
        offset = np.rint(self._bias / steps) - (factors * zero[:, None, None]).sum((1, 2, 3))
        made: list[NodeProto] = []
        stored = [f"{STORED}{name}" for name in self.names]
        last = (append_node(made, "Concat", stored, "stored", axis=3) if len(stored) > 1
                else stored[0])
        first = append_node(made, "Transpose", [last], "stem_codes", perm=LAST_TO_FIRST)
        reads = [append_node(made, "DequantizeLinear", [first, "stem_one", "stem_zero"],
                             "stem_read")]
        for name, kept in (("weight", factors.astype(np.int8)), ("bias", offset.astype(np.int32))):
            add_constant(graph, f"stem_{name}", kept)
            add_constant(graph, f"stem_{name}_zero", np.zeros(len(steps), kept.dtype))
            coded = [f"stem_{name}", "stem_steps", f"stem_{name}_zero"]
            reads.append(append_node(made, "DequantizeLinear", coded, f"stem_{name}_kept", axis=0))
        add_constant(graph, "stem_steps", steps)
        add_constant(graph, "stem_one", np.array(1, np.float32))
        add_constant(graph, "stem_zero", np.array(0, np.uint8))
        append_node(made, "Conv", reads, "stem", strides=[2, 2], pads=[0] * 4,
                    kernel_shape=list(factors.shape[2:]))
        return made
