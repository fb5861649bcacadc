"""Small steps that rewriting ONNX graphs is made of."""

from __future__ import annotations

import numpy as np
import onnx
from onnx import NodeProto, helper, numpy_helper

FIRST_TO_LAST, LAST_TO_FIRST = (0, 2, 3, 1), (0, 3, 1, 2)
"""Axes of channels brought to the end, and back."""


def node(made: list[NodeProto], kind: str, inputs: list[str], output: str, **attributes: object) -> str:
    """Append a node with one output, whose name is returned."""
    made.append(helper.make_node(kind, inputs, [output], name=f"node_{output}", **attributes))
    return output


def constant(graph: onnx.GraphProto, name: str, array: np.ndarray) -> None:
    """Give a graph a constant, unless it has one of that name."""
    if all(weight.name != name for weight in graph.initializer):
        graph.initializer.append(numpy_helper.from_array(np.array(array, order="C"), name))


def value(graph: onnx.GraphProto, name: str) -> np.ndarray:
    """A constant's, which may be kept in half precision with a cast."""
    cast = next((node for node in graph.node if node.op_type == "Cast" and node.output[0] == name), None)
    stored = cast.input[0] if cast else name
    return numpy_helper.to_array(next(weight for weight in graph.initializer if weight.name == stored))


def prune(graph: onnx.GraphProto) -> None:
    """Leave what outputs need."""
    needed, nodes = {value.name for value in graph.output}, []
    for one in reversed(graph.node):
        if needed & set(one.output):
            nodes.append(one)
            needed |= set(one.input)
    replace(graph, nodes[::-1])
    weights = [weight for weight in graph.initializer if weight.name in needed]
    del graph.initializer[:]
    graph.initializer.extend(weights)


def replace(graph: onnx.GraphProto, nodes: list[NodeProto]) -> None:
    """Give a graph these nodes alone, some of which may be its own."""
    nodes = [NodeProto.FromString(one.SerializeToString()) for one in nodes]
    del graph.node[:]
    graph.node.extend(nodes)
