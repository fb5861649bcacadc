"""Convolutions of 3x3 pixels in float32 that kernels of ours compute where a CPU runs a network.

They go by tiles (`kernels/winograd.h`), which takes about half of ONNX Runtime's time. Results
differ from its own by some 1e-6 of the largest one, about as much as those of two processors do.

One of ours also adds the results of several convolutions, joins the channels of several pictures,
enlarges those of half the size, and cuts results below 0, where a network does so around it. None
of that is stored between. Means of windows along rows and columns are ours, too.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from postfx.compiled.library import library_of
from postfx.errors import DeviceError
from postfx.runtime.model_file import (
    FLOAT,
    ModelFile,
    Node,
    Weights,
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
OTHER_FLOATS = {10, 11, 16}
"""ONNX's numbers of the element types float16, float64 and bfloat16."""
MEAN_OPTIONS = ("ceil_mode", "count_include_pad")
"""Attributes that windows of ours do not have."""
MOST_ADDED = 3
"""Convolutions whose sum is one of ours."""
MOST_PICTURES = 4
"""Pictures whose channels one of ours reads."""
DOUBLING = {"mode": "nearest", "coordinate_transformation_mode": "asymmetric",
            "nearest_mode": "floor"}
"""Attributes of a node that makes four equal pixels of each."""
TWICE = np.array([1, 1, 2, 2], "<f4").tobytes()
"""Its scales."""


def with_own_convolutions(content: bytes) -> bytes:
    """A model's file whose convolutions of 3x3 pixels are ours, together with the activations
    behind them; the same content if it has none, or no library for this machine."""
    model = parse_model(content)
    if any(node.operator in IN_INTEGERS or node.has_graph for node in model.nodes):
        return content
    swapped = _Plan(model).swapped()
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


@dataclass
class _Sum:
    """Convolutions whose results are added: one of ours does them all.

    Attributes:
        convolutions: the nodes, in the order in which their channels are added.
        result: the name of the sum.
        is_rectified: whether an activation follows.
    """

    convolutions: list[Node]
    result: str
    is_rectified: bool = False


class _Plan:
    """Finds what ours can do in a model, and the nodes that stand in for others."""

    def __init__(self, model: ModelFile) -> None:
        self._nodes = model.nodes
        self._makers = {output: node for node in model.nodes for output in node.outputs}
        self._weights = {one.name: one for one in model.weights}
        self._kept = {output.name for output in model.outputs}
        self._readers: dict[str, list[Node]] = {}
        for node in model.nodes:
            for name in node.inputs:
                self._readers.setdefault(name, []).append(node)

    def swapped(self) -> dict[int, Node | None]:
        """Nodes by their places in the model that others replace, None those that go."""
        sums = self._sums()
        last = {id(self._makers[one.result]): self._joined(one) for one in sums.values()}
        gone = {id(node) for one in sums.values() for node in self._parts(one)}
        found = {place: last.get(id(node)) for place, node in enumerate(self._nodes)
                 if id(node) in gone | last.keys()}
        if found and not any(_is_cast_to_others(node) for node in self._nodes):
            found |= {place: _own_mean(node) for place, node in enumerate(self._nodes)
                      if _is_mean(node)}
        return found | self._unread(found)

    def _sums(self) -> dict[str, _Sum]:
        """By the names of their results, with activations joined."""
        sums: dict[str, _Sum] = {}
        for node in self._nodes:  # in the order in which they run
            if _is_convolution(node) and all(map(self._is_weight, node.inputs[1:])):
                sums[node.outputs[0]] = _Sum([node], node.outputs[0])
            elif _is_plain(node, "Add") and all(self._is_inner(name, sums) for name in node.inputs):
                added = [one for name in node.inputs for one in sums[name].convolutions]
                counts = {self._count_results(one) for one in added}
                if len(added) <= MOST_ADDED and len(counts) == 1 and counts != {None}:
                    for name in node.inputs:
                        del sums[name]
                    sums[node.outputs[0]] = _Sum(added, node.outputs[0])
        for name in list(sums):
            behind = self._readers.get(name, [])
            if self._is_inner(name, sums) and _is_plain(behind[0], "Relu"):
                one = sums.pop(name)
                one.result, one.is_rectified = behind[0].outputs[0], True
                sums[one.result] = one
        return sums

    def _is_inner(self, name: str, sums: dict[str, _Sum]) -> bool:
        """Whether a value is such a sum that one node reads, once."""
        return name in sums and len(self._readers.get(name, [])) == 1 and name not in self._kept

    def _is_weight(self, name: str) -> bool:
        """Whether a value is made of float32 weights alone, or of others that become such."""
        maker = self._makers.get(name)
        if maker is None:
            return name in self._weights and self._weights[name].kind == FLOAT
        if maker.operator == "Cast":
            return maker.integers.get("to") == (FLOAT,) and maker.inputs[0] not in self._makers
        return maker.operator in MOVES and self._is_weight(maker.inputs[0])

    def _count_results(self, convolution: Node) -> int | None:
        """How many channels a convolution makes; None if its weights do not tell."""
        name = convolution.inputs[1]
        while maker := self._makers.get(name):
            is_part = maker.operator == "Split" and maker.integers.get("axis") == (1,)
            if not is_part and maker.operator not in ("Cast", "Identity"):
                return None
            name = maker.inputs[0]
        return self._weights[name].dims[0]

    def _joined(self, one: _Sum) -> Node:
        """Our node for a sum."""
        ordered = sorted(one.convolutions, key=lambda node: not self._is_doubled(node.inputs[0]))
        pictures = [self._joined_by(node.inputs[0]) for node in ordered]
        if sum(map(len, pictures)) > MOST_PICTURES:
            pictures = [[node.inputs[0]] for node in ordered]
        names = [name for some in pictures for name in some]
        names = [*map(self._half, names[:-1]), names[-1]]  # the last one tells the size
        biases = [name for node in ordered for name in node.inputs[2:]]
        return Node("Convolve3x3Relu" if one.is_rectified else "Convolve3x3", DOMAIN,
                    [*(node.inputs[1] for node in ordered), *biases, *names], [one.result])

    def _joined_by(self, name: str) -> list[str]:
        """The pictures whose channels a value has one behind the other, if only convolutions read
        it."""
        maker = self._makers.get(name)
        if (maker is None or not _is_plain(maker, "Concat") or maker.integers.get("axis") != (1,)
            or not all(map(_is_convolution, self._readers[name]))):
            return [name]
        return maker.inputs

    def _half(self, name: str) -> str:
        """The picture of half the size that a value is an enlarged one of; else the value."""
        maker = self._makers.get(name)
        return maker.inputs[0] if maker and self._is_doubled(name) else name

    def _is_doubled(self, name: str) -> bool:
        """Whether each pixel of a picture becomes four equal ones in a value."""
        maker = self._makers.get(name)
        if maker is None or not _is_plain(maker, "Resize") or len(maker.inputs) != 3:
            return False
        scales = self._weights.get(maker.inputs[2], Weights())
        return ({key: maker.words.get(key) for key in DOUBLING} == DOUBLING and scales.raw
                and scales.kind == FLOAT and bytes(scales.content) == TWICE)

    def _parts(self, one: _Sum) -> list[Node]:
        """The nodes that a sum does: convolutions, additions and an activation."""
        found, names = [], [one.result]
        while names:
            node = self._makers[names.pop()]
            found.append(node)
            if node not in one.convolutions:
                names += node.inputs
        return found

    def _unread(self, swapped: dict[int, Node | None]) -> dict[int, None]:
        """The places of nodes that joined or enlarged what nobody reads any more."""
        found: dict[int, None] = {}
        for place, node in reversed([*enumerate(self._nodes)]):
            if node.operator not in ("Concat", "Resize") or self._kept & {*node.outputs}:
                continue
            left = (swapped.get(at, other) for at, other in enumerate(self._nodes)
                    if at not in found)
            if not any(output in other.inputs for other in left if other
                       for output in node.outputs):
                found[place] = None
        return found


def _is_cast_to_others(node: Node) -> bool:
    """Whether a network has numbers of floating point that are not float32."""
    return _is_plain(node, "Cast") and not OTHER_FLOATS.isdisjoint(node.integers.get("to", ()))


def _is_mean(node: Node) -> bool:
    """Whether a node takes means of windows of an odd number of pixels, along rows or columns, of
    those that are in the picture."""
    sides = node.integers.get("kernel_shape", ())
    if not _is_plain(node, "AveragePool") or len(sides) != 2:
        return False
    height, width = sides
    across, down = width // 2, height // 2
    return (height % 2 == width % 2 == 1 == min(height, width)
            and node.integers.get("pads") == (down, across, down, across)
            and node.integers.get("strides", (1, 1)) == (1, 1)
            and node.integers.get("dilations", (1, 1)) == (1, 1)
            and not any(node.integers.get(name, (0,))[0] for name in MEAN_OPTIONS)
            and node.words.get("auto_pad", "NOTSET") == "NOTSET")


def _own_mean(node: Node) -> Node:
    height, width = node.integers["kernel_shape"]
    return Node("WindowMean", DOMAIN, node.inputs, node.outputs,
                integers={"axis": (2 if height > 1 else 3,), "size": (max(height, width),)})


def _is_plain(node: Node, operator: str) -> bool:
    return node.operator == operator and not node.domain


def _is_convolution(node: Node) -> bool:
    given = {name: node.integers.get(name, usual) for name, usual in FIXED.items()}
    return (node.operator == "Conv" and not node.domain and given == FIXED
            and {"kernel_shape", "pads"} <= node.integers.keys()
            and node.words.get("auto_pad", "NOTSET") == "NOTSET")
