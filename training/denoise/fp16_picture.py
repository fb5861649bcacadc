"""The graph of a network that gives the picture, with its convolutions in half precision.

`fp16.py` makes the variant's file and card from it. Planes of light, albedo and normal, and what is
computed of them, stay in float32: only the streams between convolutions are halves.

ONNX Runtime's kernels for a GPU want the channels of a pixel together, and their number a multiple
of `CHANNEL_STEP`. Around them it copies, and half of a frame's time were copies. So:

| in the float32 network | here |
| --- | --- |
| a sum of convolutions, each of an input of its own | one, over all inputs beside each other |
| narrow convolutions of the same input | one, whose channels are then taken apart |
| an input of 3 planes, or 9 | filled up by its first planes, whose weights are 0 |
| a convolution of a coarser level that was enlarged | a transposed one, added to the finer one's |
| an activation, then the largest of 2x2 pixels | the largest, then the activation |
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import onnx
from onnx import NodeProto, TensorProto, helper, numpy_helper

from training.export import drop_unused, replace_nodes

CHANNEL_STEP = 8
"""Tensor cores read and write so many channels at once."""
NARROW = 16
"""Most channels of a convolution that is joined with others of the same input."""
STREAM_OPERATORS = {"Relu", "MaxPool", "Resize", "Concat", "Add"}
"""What may lie between two convolutions of a stream."""
CHANNELS_AXIS = 1


class Result(NamedTuple):
    """Channels of a convolution that other nodes know by a name."""

    name: str
    channels: int


@dataclass
class Convolution:
    """One convolution with a stride of 1 that keeps the size, or several in one.

    Attributes:
        sources: names of what it reads, beside each other.
        weight: (channels, channels of all sources, k, k), float32.
        bias: (channels,), float32.
        results: its channels, in order.
    """

    sources: list[str]
    weight: np.ndarray
    bias: np.ndarray
    results: list[Result]

    @property
    def name(self) -> str:
        return self.results[0].name

    @property
    def side(self) -> int:
        """Of the kernel, in pixels."""
        return int(self.weight.shape[2])

    def is_narrow(self) -> bool:
        return all(result.channels <= NARROW for result in self.results)


def halve_picture(model: onnx.ModelProto) -> onnx.ModelProto:
    """A network with float32 inputs and outputs of the same names, as `export` writes it, and
    convolutions in half precision."""
    model = onnx.ModelProto.FromString(model.SerializeToString())
    network = _Network(model)
    network.fold_weights()
    convolutions = _take_convolutions(network)
    streams = _find_streams(network, convolutions)
    _Writer(network, streams).write(convolutions)
    network.save()
    drop_unused(model.graph)
    onnx.checker.check_model(model)
    return model


class _Network:
    """The nodes of a graph, in any order, and its weights as arrays."""

    def __init__(self, model: onnx.ModelProto) -> None:
        inferred = onnx.shape_inference.infer_shapes(model).graph
        self._graph = model.graph
        self.nodes = list(model.graph.node)
        self.weights = {weight.name: numpy_helper.to_array(weight)
                        for weight in model.graph.initializer}
        self.channels = {
            value.name: value.type.tensor_type.shape.dim[1].dim_value
            for value in (*inferred.input, *inferred.value_info)
            if len(value.type.tensor_type.shape.dim) == 4}

    def makers(self) -> dict[str, NodeProto]:
        """The node of each result."""
        return {name: node for node in self.nodes for name in node.output}

    def readers(self) -> dict[str, list[NodeProto]]:
        """The nodes that read each value."""
        found: dict[str, list[NodeProto]] = {}
        for node in self.nodes:
            for name in node.input:
                found.setdefault(name, []).append(node)
        return found

    def remove(self, nodes: Iterable[NodeProto]) -> None:
        gone = {id(node) for node in nodes}
        self.nodes = [node for node in self.nodes if id(node) not in gone]

    def fold_weights(self) -> None:
        """Compute casts and parts of weights."""
        done = []
        for node in self.nodes:
            if not node.input or node.input[0] not in self.weights:
                continue
            weight = self.weights[node.input[0]]
            if node.op_type == "Cast":
                self.weights[node.output[0]] = weight.astype(np.float32)
                done.append(node)
            elif node.op_type == "Split":
                ends = np.cumsum(self.weights[node.input[1]])[:-1]
                parts = np.split(weight, ends, _attribute(node, "axis", 0))
                self.weights |= dict(zip(node.output, parts, strict=True))
                done.append(node)
        self.remove(done)

    def convolution(self, node: NodeProto) -> Convolution:
        """A node as a convolution."""
        weight = self.weights[node.input[1]].astype(np.float32)
        bias = (self.weights[node.input[2]].astype(np.float32) if len(node.input) > 2
                else np.zeros(len(weight), np.float32))
        return Convolution([node.input[0]], weight, bias, [Result(node.output[0], len(weight))])

    def save(self) -> None:
        """Write nodes, in the order in which they can run, and weights into the graph."""
        graph = self._graph
        replace_nodes(graph, _in_order(
            self.nodes, {*self.weights, *(value.name for value in graph.input), ""}))
        del graph.initializer[:], graph.value_info[:]
        graph.initializer.extend(numpy_helper.from_array(np.ascontiguousarray(weight), name)
                                 for name, weight in self.weights.items())


def _in_order(nodes: list[NodeProto], known: set[str]) -> list[NodeProto]:
    """Nodes behind those whose results they read."""
    known, ordered, waiting = set(known), list[NodeProto](), nodes
    while waiting:
        ready = [node for node in waiting if known.issuperset(node.input)]
        if not ready:
            raise ValueError(f"nothing gives what {waiting[0].op_type} reads: {waiting[0].input}")
        ordered += ready
        known.update(name for node in ready for name in node.output)
        waiting = [node for node in waiting if not known.issuperset(node.output)]
    return ordered


def _attribute(node: NodeProto, name: str, default: Any = None) -> Any:
    return next((helper.get_attribute_value(one) for one in node.attribute if one.name == name),
                default)


# Convolutions -------------------------------------------------------------------------------------


def _take_convolutions(network: _Network) -> list[Convolution]:
    """Take the convolutions out of a network, sums of them as one, and narrow ones of the same
    input as one."""
    found = []
    for nodes in _sums(network):
        terms = [network.convolution(node) for node in nodes if node.op_type == "Conv"]
        found.append(_join_sum(terms, nodes[0].output[0]))
        network.remove(nodes)
    for node in [node for node in network.nodes if node.op_type == "Conv"]:
        one = network.convolution(node)
        others = (other for other in found if other.sources == one.sources
                  and other.side == one.side and other.is_narrow() and one.is_narrow())
        other = next(others, None)
        if other is None:
            found.append(one)
        else:
            other.weight = np.concatenate([other.weight, one.weight])
            other.bias = np.concatenate([other.bias, one.bias])
            other.results += one.results
        network.remove([node])
    return found


def _sums(network: _Network) -> list[list[NodeProto]]:
    """The nodes of each sum of convolutions alone, its last addition first."""
    makers, readers = network.makers(), network.readers()

    def follow(node: NodeProto) -> list[NodeProto] | None:
        """The nodes of a sum; None where something else is added."""
        if node.op_type == "Conv":
            return [node]
        if node.op_type != "Add":
            return None
        nodes = [node]
        for name in node.input:
            if name not in makers or len(readers[name]) > 1:
                return None
            term = follow(makers[name])
            if term is None:
                return None
            nodes += term
        return nodes

    found = []
    for node in network.nodes:
        is_last = not any(reader.op_type == "Add" for reader in readers.get(node.output[0], []))
        if node.op_type == "Add" and is_last:
            nodes = follow(node)
            if nodes is not None:
                found.append(nodes)
    return found


def _join_sum(terms: list[Convolution], name: str) -> Convolution:
    """One convolution over the inputs of several that are added."""
    side = max(term.side for term in terms)
    weights = []
    for term in terms:
        ring = (side - term.side) // 2
        weights.append(np.pad(term.weight, [(0, 0), (0, 0), (ring, ring), (ring, ring)]))
    bias = np.sum([term.bias for term in terms], axis=0)
    return Convolution([term.sources[0] for term in terms], np.concatenate(weights, 1), bias,
                       [Result(name, len(bias))])


def transposed_weight(weight: np.ndarray) -> np.ndarray:
    """A convolution of 3x3 pixels of what was enlarged twice by repeating pixels, (M, C, 3, 3), as
    a transposed one of what was not, with a stride of 2, (C, M, 4, 4)."""
    for axis in (2, 3):
        first, middle, last = np.moveaxis(weight, axis, 0)
        weight = np.stack([last, middle + last, first + middle, first], axis)
    return np.swapaxes(weight, 0, 1)


# Streams ------------------------------------------------------------------------------------------


@dataclass
class Streams:
    """What is in half precision.

    Attributes:
        names: of the tensors.
        nodes: between convolutions.
        channels: of a tensor that a convolution makes.
    """

    names: set[str] = field(default_factory=set)
    nodes: list[NodeProto] = field(default_factory=list)
    channels: dict[str, int] = field(default_factory=dict)


def _find_streams(network: _Network, convolutions: list[Convolution]) -> Streams:
    """Wide results of convolutions, and what is made of them up to the next ones."""
    streams = Streams()
    stand_ins = []
    for one in convolutions:
        streams.channels |= dict(one.results)
        if len(one.results) == 1 and one.results[0].channels % CHANNEL_STEP == 0:
            streams.names.add(one.name)
        stand_ins.append(helper.make_node("Conv", one.sources, [name for name, _ in one.results]))
    nodes = [*network.nodes, *stand_ins]
    read = {name for node in nodes for name in node.input}
    made = {name for node in nodes for name in node.output}
    for node in _in_order(nodes, read - made):
        if node.op_type in STREAM_OPERATORS and _goes_on(node, network, streams.names):
            streams.names.update(node.output)
            streams.nodes.append(node)
    return streams


def _goes_on(node: NodeProto, network: _Network, names: set[str]) -> bool:
    """Whether a node reads a stream and gives one."""
    if not names.intersection(node.input):
        return False
    adds_constant = node.op_type == "Add" and any(name in network.weights for name in node.input)
    smooths = node.op_type == "Resize" and _attribute(node, "mode") != b"nearest"
    return not (adds_constant or smooths)


class _Writer:
    """Writes convolutions in half precision into a network that lacks them."""

    def __init__(self, network: _Network, streams: Streams) -> None:
        self._network, self._streams = network, streams
        self._makers = network.makers()
        self._stream_nodes = {id(node) for node in streams.nodes}
        self._casts: dict[tuple[str, int], str] = {}
        self._filled: dict[str, str] = {}

    def write(self, convolutions: list[Convolution]) -> None:
        for node in self._network.nodes:
            if id(node) not in self._stream_nodes:
                self._read_whole(node)
        for one in convolutions:
            self._write_convolution(one)
        self._pool_first()

    def _read_whole(self, node: NodeProto) -> None:
        """Let a node of planes read streams in float32."""
        node.input[:] = [self._cast(name, TensorProto.FLOAT) if name in self._streams.names
                         else name for name in node.input]

    def _write_convolution(self, one: Convolution) -> None:
        sources, columns, coarse = [], [], []
        begin = 0
        for source in (part for name in one.sources for part in self._parts(name)):
            end = begin + self._channels(source)
            weight = one.weight[:, begin:end]
            begin = end
            maker = self._makers.get(source)
            if source not in self._streams.names:
                source, weight = self._fill(source, weight)
            elif maker is not None and maker.op_type == "Resize" and one.side == 3:
                coarse.append((maker.input[0], weight))
                continue
            sources.append(source)
            columns.append(weight)
        missing = -len(one.bias) % CHANNEL_STEP
        weight = np.pad(np.concatenate(columns, 1), [(0, missing), (0, 0), (0, 0), (0, 0)])
        is_stream = one.name in self._streams.names
        fine = f"{one.name}_fine" if coarse or not is_stream else one.name
        self._convolve("Conv", self._beside(sources, fine), weight, fine,
                       np.pad(one.bias, (0, missing)))
        if coarse:
            self._add_coarse(fine, coarse, one.name)
        if not is_stream:
            self._take_apart(fine, one.results)

    def _parts(self, name: str) -> list[str]:
        """The tensors beside each other in a stream, each by itself."""
        node = self._makers.get(name)
        if node is None or node.op_type != "Concat" or id(node) not in self._stream_nodes:
            return [name]
        return [part for one in node.input for part in self._parts(one)]

    def _channels(self, name: str) -> int:
        return self._streams.channels.get(name) or self._network.channels[name]

    def _fill(self, name: str, weight: np.ndarray) -> tuple[str, np.ndarray]:
        """Planes in half precision and their weights, with a multiple of CHANNEL_STEP channels:
        the planes again, from the first one on, as anything that is finite would do."""
        count = self._channels(name)
        missing = -count % CHANNEL_STEP
        if missing and name not in self._filled:
            self._filled[name] = f"{name}_filled"
            repeated = [name] * (1 + -(-missing // count))
            self._add("Concat", repeated, f"{name}_repeated", axis=CHANNELS_AXIS)
            self._slice(f"{name}_repeated", 0, count + missing, f"{name}_filled")
        filled = self._cast(self._filled.get(name, name), TensorProto.FLOAT16)
        return filled, np.pad(weight, [(0, 0), (0, missing), (0, 0), (0, 0)])

    def _beside(self, sources: list[str], name: str) -> str:
        """All sources as one tensor."""
        if len(sources) == 1:
            return sources[0]
        self._add("Concat", sources, f"{name}_inputs", axis=CHANNELS_AXIS)
        return f"{name}_inputs"

    def _add_coarse(self, fine: str, coarse: list[tuple[str, np.ndarray]], name: str) -> None:
        """Add transposed convolutions of coarser levels to what the finer one gave."""
        terms = [fine]
        for number, (source, weight) in enumerate(coarse):
            terms.append(f"{name}_coarse_{number}")
            self._convolve("ConvTranspose", source, transposed_weight(weight), terms[-1])
        self._add("Sum" if len(terms) > 2 else "Add", terms, name)

    def _convolve(self, operator: str, source: str, weight: np.ndarray, name: str,
                  bias: np.ndarray | None = None) -> None:
        reads = [source, f"{name}_weight"]
        self._network.weights[f"{name}_weight"] = weight.astype(np.float16)
        if bias is not None:
            reads.append(f"{name}_bias")
            self._network.weights[f"{name}_bias"] = bias.astype(np.float16)
        side = weight.shape[2]
        step = 2 if operator == "ConvTranspose" else 1
        self._add(operator, reads, name, kernel_shape=[side, side], strides=[step, step],
                  pads=[(side - 1) // 2] * 4)

    def _take_apart(self, name: str, results: list[Result]) -> None:
        """Planes in float32 from the channels of a convolution."""
        whole, first = self._cast(name, TensorProto.FLOAT), 0
        for result in results:
            self._slice(whole, first, first + result.channels, result.name)
            first += result.channels

    def _pool_first(self) -> None:
        """Take the largest of 2x2 pixels before the activation: the result is the same."""
        makers, readers = self._network.makers(), self._network.readers()
        for pool in [node for node in self._network.nodes if node.op_type == "MaxPool"]:
            relu = makers[pool.input[0]]
            if relu.op_type != "Relu" or len(readers[relu.output[0]]) > 1:
                continue
            before, between, behind = relu.input[0], relu.output[0], pool.output[0]
            pool.input[0], pool.output[0] = before, between
            relu.input[0], relu.output[0] = between, behind

    def _cast(self, name: str, kind: int) -> str:
        """A tensor in another precision."""
        key = name, kind
        if key not in self._casts:
            self._casts[key] = f"{name}_{'half' if kind == TensorProto.FLOAT16 else 'whole'}"
            self._add("Cast", [name], self._casts[key], to=kind)
        return self._casts[key]

    def _slice(self, source: str, begin: int, end: int, name: str) -> None:
        """Some channels of a tensor."""
        numbers = [begin, end, CHANNELS_AXIS]
        self._network.weights |= {f"number_{one}": np.array([one], np.int64) for one in numbers}
        self._add("Slice", [source, *(f"number_{one}" for one in numbers)], name)

    def _add(self, operator: str, reads: list[str], name: str, **attributes: Any) -> None:
        self._network.nodes.append(helper.make_node(operator, reads, [name], **attributes))
