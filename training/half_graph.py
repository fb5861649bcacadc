"""The graph of a denoised upscaler in half precision: see `training.halve`.

Tensor cores want the channels of a pixel together and their number a multiple of 8. So the network begins with packed
inputs and ends with raw heads, for which `postfx.kernels.denoise_half` has kernels; ONNX Runtime then finds nothing
between its convolutions to transpose, pad or cast.
"""

from __future__ import annotations

import numpy as np
import onnx
from onnx import GraphProto, NodeProto, TensorProto, helper, numpy_helper

from postfx.kernels.denoise_half import width
from postfx.passes._denoise_network import CHANNELS, FEATURE_PARTS, PACKED, PHASED_FINE, RAW

CHANNELS_FIRST, CHANNELS_LAST = (0, 3, 1, 2), (0, 2, 3, 1)


def halve(model: onnx.ModelProto) -> onnx.ModelProto:
    """From a network as `export` writes it, with weights in half precision and a cast, the same one for GPUs."""
    model = onnx.ModelProto.FromString(model.SerializeToString())
    graph = model.graph
    alike = alike_of(graph)
    _use_stored_weights(graph)
    _narrow(graph, alike)
    _join_features(graph)
    heads = [value if value.name in alike else _leave_raw(graph, value.name) for value in graph.output]
    reads = [name for name in CHANNELS if any(name in node.input for node in graph.node)]
    inputs = [_take_packed(graph, name, CHANNELS[name]) for name in reads]
    del graph.output[:], graph.input[:]
    graph.output.extend(heads)
    graph.input.extend(inputs)
    _drop_unused(graph)
    onnx.checker.check_model(model)
    return model


def alike_of(graph: GraphProto) -> set[str]:
    """Outputs that are constants: heads that are the same at all pixels. They stay float32."""
    return {value.name for value in graph.output} & {weight.name for weight in graph.initializer}


def computed_levels(graph: GraphProto) -> int:
    """Levels of the pyramid whose heads a network computes."""
    return sum("level" in value.name for value in graph.output) - len(alike_of(graph))


def _use_stored_weights(graph: GraphProto) -> None:
    """Nodes read weights as they are stored; the casts go."""
    weights = {weight.name for weight in graph.initializer}
    casts = [node for node in graph.node if node.op_type == "Cast" and node.input[0] in weights]
    renamed = {cast.output[0]: cast.input[0] for cast in casts}
    for node in casts:
        graph.node.remove(node)
    for node in graph.node:
        node.input[:] = [renamed.get(name, name) for name in node.input]


def _narrow(graph: GraphProto, kept: set[str]) -> None:
    """What is left in float32, but for some and for the scales of a Resize, which have to be."""
    kept = kept | {name for node in graph.node if node.op_type == "Resize" for name in node.input[1:]}
    for weight in graph.initializer:
        if weight.data_type == TensorProto.FLOAT and weight.name not in kept:
            weight.CopyFrom(numpy_helper.from_array(_array(weight).astype(np.float16), weight.name))


def _join_features(graph: GraphProto) -> None:
    """One convolution of all features in place of those of their parts and the sum."""
    first, last = (next(node for node in graph.node if part in node.input) for part in FEATURE_PARTS)
    total = next(node for node in graph.node if {*first.output, *last.output} == {*node.input})
    weights = [_array(_weight(graph, node.input[1])) for node in (first, last)]
    _add_weight(graph, "stem.weight", np.concatenate(weights, 1))
    first.input[:2] = ["features", "stem.weight"]
    first.output[:] = total.output
    graph.node.remove(last)
    graph.node.remove(total)


def _leave_raw(graph: GraphProto, head: str) -> onnx.ValueInfoProto:
    """Add what a head's convolution gives, channels last, without its activation; returns the new output."""
    made = {name: node for node in graph.node for name in node.output}
    fine = head == PHASED_FINE
    inputs, weight, bias = (_phases if fine else _last_convolution)(graph, head, made)
    raw, missing = f"{RAW}{'fine' if fine else head}", width(len(bias)) - len(bias)
    _add_weight(graph, f"{raw}_weight", np.pad(weight, [(0, missing), (0, 0), (0, 0), (0, 0)]))
    _add_weight(graph, f"{raw}_bias", np.pad(bias, (0, missing)))
    graph.node.append(helper.make_node("Conv", [inputs, f"{raw}_weight", f"{raw}_bias"], [f"{raw}_first"]))
    graph.node.append(helper.make_node("Transpose", [f"{raw}_first"], [raw], perm=CHANNELS_LAST))
    return helper.make_tensor_value_info(raw, TensorProto.FLOAT16, [1, None, None, width(len(bias))])


def _last_convolution(graph: GraphProto, head: str, made: dict[str, NodeProto]) -> tuple[str, np.ndarray, np.ndarray]:
    """Input, weight and bias of the 1x1 convolution that makes a head."""
    node = made[head]
    while node.op_type != "Conv":
        node = made[node.input[0]]
    return node.input[0], _array(_weight(graph, node.input[1])), _array(_weight(graph, node.input[2]))


def _phases(graph: GraphProto, head: str, made: dict[str, NodeProto]) -> tuple[str, np.ndarray, np.ndarray]:
    """The same for the fine head, of which all channels of a phase come after those of another."""
    inputs, weight, bias = _last_convolution(graph, head, made)
    rows = np.arange(len(bias)).reshape(-1, 4).T.ravel()
    return inputs, weight[rows], bias[rows]


def _take_packed(graph: GraphProto, name: str, channels: int) -> onnx.ValueInfoProto:
    """Let convolutions of an input read it channels last and filled up with zeros; returns the new input."""
    packed, wide = f"{PACKED}{name}", width(channels)
    for node in (node for node in graph.node if name in node.input):
        filled = np.pad(_array(_weight(graph, node.input[1])), [(0, 0), (0, wide - channels), (0, 0), (0, 0)])
        _add_weight(graph, f"{node.input[1]}_filled", filled)
        node.input[:2] = [f"{packed}_first", f"{node.input[1]}_filled"]
    graph.node.insert(0, helper.make_node("Transpose", [packed], [f"{packed}_first"], perm=CHANNELS_FIRST))
    return helper.make_tensor_value_info(packed, TensorProto.FLOAT16, [1, "height", "width", wide])


def _drop_unused(graph: GraphProto) -> None:
    """Nodes and weights that no output needs."""
    needed, kept = {value.name for value in graph.output}, []
    for node in reversed(graph.node):
        if needed.intersection(node.output):
            kept.append(node)
            needed.update(node.input)
    weights = [weight for weight in graph.initializer if weight.name in needed]
    del graph.node[:], graph.initializer[:]
    graph.node.extend(reversed(kept))
    graph.initializer.extend(weights)


def _add_weight(graph: GraphProto, name: str, value: np.ndarray) -> None:
    graph.initializer.append(numpy_helper.from_array(np.ascontiguousarray(value, np.float16), name))


def _weight(graph: GraphProto, name: str) -> TensorProto:
    return next(weight for weight in graph.initializer if weight.name == name)


def _array(weight: TensorProto) -> np.ndarray:
    return numpy_helper.to_array(weight)
