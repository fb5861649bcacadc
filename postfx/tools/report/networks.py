"""The graphs of ONNX files in readable form, grouped into blocks to draw. Needs the package `onnx`.
"""

from __future__ import annotations

import heapq
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from postfx.errors import CaptureError, ModelError
from postfx.runtime.capture import constant_nodes, load_graph, names_read
from postfx.runtime.snapshot import statistics
from postfx.tools.report.capture_data import finite_or_text

if TYPE_CHECKING:
    from onnx import AttributeProto, ModelProto, NodeProto, TensorProto

LONGEST_TEXT = 200
"""Characters of an attribute that are shown."""
MOST_SHOWN_VALUES = 16
"""Weights of at most so many elements are shown in full."""


def describe(path: Path, dims: Mapping[str, int]) -> dict[str, Any]:
    """The graph in a model file with its free dimensions fixed to `dims`.

    Returns a dictionary:
        name, file, dims: as given.
        inputs, outputs: names.
        values: name -> 'dtype' and 'shape', if they can be inferred without running the graph.
        weights: name -> 'dtype', 'shape', 'bytes', 'statistics' and, if it is small, 'values'.
        nodes: in the order of the file. A node has 'op', 'domain', 'name', 'attributes', 'inputs'
            and 'outputs'; 'constant', whether it depends on no input of the graph; and 'weights',
            the names of the weights that it reads, directly or through constant nodes.
        blocks: lists of node numbers, in the order to draw them.
        note: why there are no nodes, or None.
    """
    head = {"name": path.name.removesuffix(".onnx"), "file": str(path), "dims": dict(dims)}
    try:
        return {**head, "note": None, **_graph(load_graph(path), dims)}
    except (CaptureError, ModelError) as error:
        empty: dict[str, Any] = {"inputs": [], "outputs": [], "values": {}, "weights": {},
                                 "nodes": [], "blocks": []}
        return {**head, "note": str(error), **empty}


def _graph(model: ModelProto, dims: Mapping[str, int]) -> dict[str, Any]:
    """The graph of a model in plain types, for a page. dims: sizes of its free dimensions."""
    graph = model.graph
    weights = {item.name: item for item in graph.initializer}
    inputs = [item.name for item in graph.input if item.name not in weights]
    nodes = _nodes(model, set(weights))
    parts = [Node(node["inputs"], node["outputs"], node["constant"]) for node in nodes]
    return {
        "inputs": inputs,
        "outputs": [item.name for item in graph.output],
        "values": _values(model, dims),
        "weights": {name: _weight(item) for name, item in weights.items()},
        "nodes": nodes,
        "blocks": blocks(parts),
    }


def _nodes(model: ModelProto, weights: set[str]) -> list[dict[str, Any]]:
    constant, behind, found = constant_nodes(model), {name: [name] for name in weights}, []
    for index, node in enumerate(model.graph.node):
        own = list(dict.fromkeys(weight for name in names_read(node)
                                 for weight in behind.get(name, ())))
        if index in constant:
            behind.update(dict.fromkeys(node.output, own))
        found.append(_node(node, index in constant, own))
    return found


def _node(node: NodeProto, constant: bool, weights: list[str]) -> dict[str, Any]:
    inner = [name for name in names_read(node) if name not in node.input]
    return {
        "op": node.op_type,
        "domain": node.domain,
        "name": node.name,
        "attributes": {item.name: _attribute(item) for item in node.attribute},
        "inputs": [*node.input, *inner],
        "outputs": list(node.output),
        "constant": constant,
        "weights": weights,
    }


def _attribute(item: AttributeProto) -> Any:
    """A number, a list of numbers, or text."""
    from onnx import AttributeProto, helper

    value = helper.get_attribute_value(item)
    if item.type == AttributeProto.TENSOR:
        return f"tensor {tuple(value.dims)}"
    if item.type == AttributeProto.GRAPH:
        return f"graph of {len(value.node)} nodes"
    if item.type == AttributeProto.FLOAT:
        return finite_or_text(float(value))
    if (item.type == AttributeProto.INT
        or (item.type == AttributeProto.INTS and len(value) <= MOST_SHOWN_VALUES)):
        return value if isinstance(value, int) else list(value)
    text = value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
    return text if len(text) <= LONGEST_TEXT else text[:LONGEST_TEXT] + "..."


def _weight(item: TensorProto) -> dict[str, Any]:
    from onnx import numpy_helper

    array = np.asarray(numpy_helper.to_array(item))
    plain = {"dtype": array.dtype.name, "shape": list(array.shape), "bytes": array.nbytes}
    if not array.size or array.dtype == object:
        return {**plain, "statistics": None}
    figures = {name: finite_or_text(value) for name, value in asdict(statistics(array)).items()}
    if array.size > MOST_SHOWN_VALUES:
        return {**plain, "statistics": figures}
    return {**plain, "statistics": figures,
            "values": [finite_or_text(value) for value in array.ravel().tolist()]}


def _values(model: ModelProto, dims: Mapping[str, int]) -> dict[str, dict[str, Any]]:
    """Type and shape of every value, as far as they follow without running the graph; '?' for an
    unknown size."""
    from onnx import ModelProto, helper, shape_inference

    fixed = ModelProto()
    fixed.CopyFrom(model)
    for item in fixed.graph.input:
        for size in item.type.tensor_type.shape.dim:
            if size.dim_param in dims:
                size.dim_value = dims[size.dim_param]
    for item in fixed.graph.output:  # shapes inferred from the inputs say more than their symbols
        item.type.tensor_type.ClearField("shape")
    try:
        fixed = shape_inference.infer_shapes(fixed, data_prop=True)
    except Exception:  # the checker may reject a graph that ONNX Runtime accepts: leave shapes out
        pass
    found = {}
    for item in (*fixed.graph.input, *fixed.graph.value_info, *fixed.graph.output):
        kind = item.type.tensor_type
        shape = ([size.dim_param or size.dim_value or "?" for size in kind.shape.dim]
                 if kind.HasField("shape") else None)
        dtype = helper.tensor_dtype_to_np_dtype(kind.elem_type).name if kind.elem_type else "?"
        found[item.name] = {"dtype": dtype, "shape": shape}
    return found


class Node(NamedTuple):
    """Names that a node reads and writes, and whether it is constant, which means that it depends
    on no input."""

    inputs: Sequence[str]
    outputs: Sequence[str]
    constant: bool = False


def blocks(nodes: Sequence[Node]) -> list[list[int]]:
    """All nodes' numbers, in blocks. Every node comes after those that it reads from.

    A block continues while a node is the only reader of the previous one and reads from no other.
    Constant nodes are not part of such a run: each comes right before the first node that reads it.
    """
    before, after = _neighbours(nodes)
    following = {a: b for a, (b, *more) in after.items() if not more and len(before[b]) == 1}
    inside = set(following.values())
    heads = [n for n, node in enumerate(nodes) if not node.constant and n not in inside]
    chains = {head: _chain(head, following) for head in heads}
    ordered = [chains[head] for head in _in_order(chains, before)]
    return _with_constants(nodes, ordered)


def _neighbours(nodes: Sequence[Node]) -> tuple[dict[int, list[int]], dict[int, list[int]]]:
    """For every node that is not constant, the nodes that it reads from, and the nodes that read
    from it."""
    writer = {name: n for n, node in enumerate(nodes) if not node.constant
              for name in node.outputs if name}
    before, after = defaultdict(list), defaultdict(list)
    for n, node in enumerate(nodes):
        for other in dict.fromkeys(writer[name] for name in node.inputs if name in writer):
            before[n].append(other)
            after[other].append(n)
    return before, after


def _chain(head: int, following: dict[int, int]) -> list[int]:
    chain = [head]
    while chain[-1] in following:
        chain.append(following[chain[-1]])
    return chain


def _in_order(chains: dict[int, list[int]], before: dict[int, list[int]]) -> list[int]:
    """Heads of the chains: each after the heads that it depends on, otherwise in the order of the
    file."""
    chain_of = {n: head for head, chain in chains.items() for n in chain}
    waits = {head: {chain_of[n] for n in before[head]} for head in chains}
    needed = defaultdict(list)
    for head, others in waits.items():
        for other in others:
            needed[other].append(head)
    ready, ordered = [head for head in chains if not waits[head]], []
    heapq.heapify(ready)
    while ready:
        head = heapq.heappop(ready)
        ordered.append(head)
        for other in needed[head]:
            waits[other].discard(head)
            if not waits[other]:
                heapq.heappush(ready, other)
    return ordered


def _with_constants(nodes: Sequence[Node], chains: list[list[int]]) -> list[list[int]]:
    """The chains with each constant node before its first reader; constant nodes without a reader
    come last."""
    writer = {name: n for n, node in enumerate(nodes) if node.constant
              for name in node.outputs if name}
    placed: set[int] = set()

    def with_constants(n: int) -> Iterator[int]:
        for constant in (writer[name] for name in nodes[n].inputs if name in writer):
            if constant not in placed:
                placed.add(constant)
                yield from with_constants(constant)
        yield n

    found = [[m for n in chain for m in with_constants(n)] for chain in chains]
    left = [n for n, node in enumerate(nodes) if node.constant and n not in placed]
    return [*found, left] if left else found
