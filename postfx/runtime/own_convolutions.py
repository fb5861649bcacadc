"""Convolutions of 3x3 pixels in float32 that kernels of ours compute where a CPU runs a network.

They go by tiles (`kernels/winograd.h`), which takes about half of ONNX Runtime's time. Results
differ from its own by some 1e-6 of the largest one, about as much as those of two processors do.
"""

from __future__ import annotations

import logging
from functools import cache
from pathlib import Path

from postfx.compiled.library import library_of
from postfx.errors import DeviceError
from postfx.runtime.model_file import (
    FLOAT,
    ModelFile,
    Node,
    import_operators,
    parse_model,
    swap_nodes,
)

DOMAIN = "postfx"
"""Of the operators, as `kernels/operators.cpp` registers them."""
REGISTER = "RegisterCustomOps"
"""The function that ONNX Runtime looks for in a library of operators."""
KERNEL_SIDE = 3
FIXED = {"kernel_shape": (KERNEL_SIDE, KERNEL_SIDE), "pads": (1, 1, 1, 1), "strides": (1, 1),
         "dilations": (1, 1), "group": (1,)}
"""Attributes of the convolutions; only the first two are never left out."""
IN_INTEGERS = {"DequantizeLinear", "QLinearConv", "ConvInteger"}
"""Operators of networks that compute in integers: their convolutions are ONNX Runtime's."""
MOVES = {"Identity", "Split", "Reshape"}
"""Operators whose results are parts of their first input."""


def with_own_convolutions(content: bytes) -> bytes:
    """A model's file whose convolutions of 3x3 pixels are ours, together with the activations
    behind them; the same content if it has none, or no library for this machine."""
    model = parse_model(content)
    if any(node.operator in IN_INTEGERS or node.has_graph for node in model.nodes):
        return content
    swapped = _swapped(model)
    if not swapped or operators_library() is None:
        return content
    return import_operators(swap_nodes(content, swapped), DOMAIN)


def has_own_convolutions(content: bytes) -> bool:
    """Whether a model's file is one of `with_own_convolutions`."""
    return content.endswith(import_operators(b"", DOMAIN))


@cache
def operators_library() -> Path | None:
    """The library that has the operators; None where there is none and none can be made."""
    try:
        return library_of(REGISTER)
    except DeviceError as error:
        logging.getLogger(__name__).info("convolutions are ONNX Runtime's: %s", error)
        return None


def _swapped(model: ModelFile) -> dict[int, Node | None]:
    """Nodes by their places in a model that others replace, None those that go."""
    makers = {output: node for node in model.nodes for output in node.outputs}
    whole = {one.name for one in model.weights if one.kind == FLOAT}
    readers: dict[str, list[int]] = {}
    for place, node in enumerate(model.nodes):
        for name in node.inputs:
            readers.setdefault(name, []).append(place)
    kept = {output.name for output in model.outputs}

    def is_weight(name: str) -> bool:
        """Whether a value is made of float32 weights alone, or of others that become such."""
        maker = makers.get(name)
        if maker is None:
            return name in whole
        if maker.operator == "Cast":
            return maker.integers.get("to") == (FLOAT,) and maker.inputs[0] not in makers
        return maker.operator in MOVES and is_weight(maker.inputs[0])

    found: dict[int, Node | None] = {}
    for place, node in enumerate(model.nodes):
        if not (_is_convolution(node) and is_weight(node.inputs[1])):
            continue
        result, operator = node.outputs[0], "Convolve3x3"
        behind = readers.get(result, [])
        if len(behind) == 1 and result not in kept and _is_relu(model.nodes[behind[0]]):
            result, operator = model.nodes[behind[0]].outputs[0], "Convolve3x3Relu"
            found[behind[0]] = None
        found[place] = Node(operator, DOMAIN, node.inputs, [result])
    return found


def _is_relu(node: Node) -> bool:
    return node.operator == "Relu" and not node.domain


def _is_convolution(node: Node) -> bool:
    given = {name: node.integers.get(name, usual) for name, usual in FIXED.items()}
    return (node.operator == "Conv" and not node.domain and given == FIXED
            and {"kernel_shape", "pads"} <= node.integers.keys()
            and node.words.get("auto_pad", "NOTSET") == "NOTSET")
