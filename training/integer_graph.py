"""Forms of a quantised network that ONNX Runtime computes in less time than those that quantise nodes give it.

Enlarging by repeated pixels copies 8-bit values, channels last, as the convolutions around it keep them. Heads are
products of 8-bit values, summed in 32 bits: a kernel scales and activates them (`postfx.kernels.denoise_products`),
which no node can do without another pass over 160 MB. Weights come first in these products, so that each channel is a
plane: brought there afterwards, 32 bits each, they take twice as long to open.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import onnx
from onnx import NodeProto, TensorProto, helper

from postfx.passes._denoise_network import PHASED_FINE, PRODUCTS, SCALING, STORED
from training.graph_parts import FIRST_TO_LAST, LAST_TO_FIRST, constant, node, prune, replace, value
from training.integer_stem import Stem
from training.rounding import Rounded

KEPT, QUANTISED = "_kept", "_quantised"
SIGN, MIDDLE = 128, 64
"""What is taken from codes of values, and what is added to weights: as the processor's products have them."""


def in_integers(model: onnx.ModelProto, weights: Mapping[str, Rounded], stem: Stem | None = None) -> onnx.ModelProto:
    """A model of `training.qdq.quantise` with its enlargements and heads in integers, and with that `stem`, if any.

    The outputs ``phased_fine`` and ``level1`` .. ``level4`` become ``products_fine``, ``products_level1`` and so on,
    (C, h * w) of int32, each with ``scaling_...`` (2, C): scale and bias of the logits. With a stem, the inputs
    become ``stored_features`` and ``stored_guides``, (1, h, w, C) of uint8, with ``coding_...`` (2, C) among the
    outputs.

    Args:
        weights: those of the heads in integers, by name.
    """
    model = onnx.ModelProto.FromString(model.SerializeToString())
    for resize in [one for one in model.graph.node if one.op_type == "Resize" and one.input[0].endswith(KEPT)]:
        _repeat(model.graph, resize)
    for name, head in heads(model.graph).items():
        _multiply(model.graph, name, head, weights[head.input[1]])
    if stem:
        stem.write(model.graph)
    prune(model.graph)
    onnx.checker.check_model(model)
    return model


def facts(model: onnx.ModelProto) -> dict[str, Any]:
    """What a card tells of such a model's inputs and outputs."""
    found = {"outputs": _listed(model.graph.output, "denoise_products")}
    for weight in model.graph.initializer:
        if weight.name in found["outputs"]:
            found["outputs"][weight.name]["constant"] = True
    if model.graph.input[0].name.startswith(STORED):
        found["inputs"] = _listed(model.graph.input, "denoise_store")
    return found


def _listed(values: Iterable[onnx.ValueInfoProto], kernels: str) -> dict[str, Any]:
    return {value.name: {"shape": [dim.dim_value or dim.dim_param for dim in value.type.tensor_type.shape.dim],
                         "meaning": f"see postfx/kernels/{kernels}.py"} for value in values}


def _repeat(graph: onnx.GraphProto, resize: NodeProto) -> None:
    """Every pixel of 8 bits twice as wide and as high, in place of a node that enlarges."""
    name, source = resize.output[0], resize.input[0].removesuffix(KEPT) + QUANTISED
    made: list[NodeProto] = []
    shape = node(made, "Shape", [source], f"{name}_shape")
    last = node(made, "Transpose", [source], f"{name}_last", perm=FIRST_TO_LAST)
    for side, axis in (("columns", 2), ("rows", 1)):
        count = node(made, "Gather", [shape, f"{side}_axis"], f"{name}_{side}")
        twice = node(made, "Range", ["zero", node(made, "Mul", [count, "two"], f"{name}_{side}_end"), "one"],
                      f"{name}_{side}_range")
        places = node(made, "Div", [twice, "two"], f"{name}_{side}_places")
        last = node(made, "Gather", [last, places], f"{name}_{side}_repeated", axis=axis)
    node(made, "Transpose", [last], f"{name}{QUANTISED}", perm=LAST_TO_FIRST)
    for key, number in {"zero": 0, "one": 1, "two": 2, "rows_axis": 2, "columns_axis": 3}.items():
        constant(graph, key, np.array(number, np.int64))
    quantiser = next(one for one in graph.node if one.input[:1] == [name])
    at = list(graph.node).index(quantiser)
    nodes = [one for one in graph.node if one is not resize and one is not quantiser]
    replace(graph, [*nodes[:at - 1], *made, *nodes[at - 1:]])


def heads(graph: onnx.GraphProto) -> dict[str, NodeProto]:
    """Outputs and the convolutions that give their logits; none of those that are constants."""
    makers = {output: one for one in graph.node for output in one.output}
    found = {}
    for output in (one for one in graph.output if one.name in makers):
        maker = makers[output.name]
        while maker.op_type != "Conv":
            maker = makers[maker.input[0]]
        found[output.name] = maker
    return found


def _multiply(graph: onnx.GraphProto, output: str, convolution: NodeProto, weights: Rounded) -> None:
    """A product of 8-bit values in place of a convolution of single pixels and what follows it."""
    name, source = "fine" if output == PHASED_FINE else output, convolution.input[0].removesuffix(KEPT)
    constant(graph, f"{name}_factors", (weights.factors[:, :, 0, 0] + MIDDLE).astype(np.uint8))
    scaling = np.stack([weights.steps * value(graph, f"{source}_scale"), value(graph, convolution.input[2])])
    constant(graph, f"{SCALING}{name}", scaling.astype(np.float32))
    made = _signed(graph, source, weights.factors.shape[1])
    signed = [f"{name}_factors", f"{source}_signed", "middle", f"{source}_signed_zero"]
    node(made, "MatMulInteger", signed, f"{PRODUCTS}{name}")
    graph.node.extend(made)
    graph.output.remove(next(one for one in graph.output if one.name == output))
    places = f"height*width/{4 ** (1 if name == 'fine' else int(name[-1]))}"
    graph.output.extend([
        helper.make_tensor_value_info(f"{PRODUCTS}{name}", TensorProto.INT32, [len(weights.steps), places]),
        helper.make_tensor_value_info(f"{SCALING}{name}", TensorProto.FLOAT, [2, len(weights.steps)])])


def _signed(graph: onnx.GraphProto, source: str, channels: int) -> list[NodeProto]:
    """Nodes that give a tensor's 8-bit values a sign, as the second factor of a product has to have: codes less 128,
    (C, h * w). None where they are there."""
    made: list[NodeProto] = []
    name, codes = f"{source}_signed", f"{source}{QUANTISED}"
    if any(name in one.output for one in graph.node):
        return made
    flat = node(made, "Reshape", [codes, f"{source}_flat"], f"{source}_codes")
    node(made, "Cast", [node(made, "BitwiseXor", [flat, "sign"], f"{source}_turned")], name, to=TensorProto.INT8)
    zero = np.int8(int(value(graph, f"{source}_zero")) - SIGN)
    for key, held in {f"{source}_flat": np.array([channels, -1]), "sign": np.uint8(SIGN), "middle": np.uint8(MIDDLE),
                      f"{name}_zero": zero}.items():
        constant(graph, key, held)
    return made
