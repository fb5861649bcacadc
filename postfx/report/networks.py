"""The nodes of ONNX files, for people to read. Works without the package `onnx`, but then has nothing to tell."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

LONGEST = 80
MISSING = "install the package onnx to see its nodes: pip install onnx"


def describe(path: Path) -> dict[str, Any]:
    """What is in a model file: {'name', 'file', 'note', 'inputs', 'outputs', 'parameters', 'nodes'}.

    `note` says why there are no nodes, or is None. Each node has 'op', 'name', 'attributes' (text), 'inputs', 'outputs'
    and 'parameters', the count of its constants' elements; a constant that two nodes share counts for both.
    """
    head = {"name": path.name.removesuffix(".onnx"), "file": str(path)}
    empty = {"inputs": [], "outputs": [], "parameters": 0, "nodes": []}
    try:
        import onnx
    except ImportError:
        return {**head, "note": MISSING, **empty}
    try:
        graph = onnx.load(str(path), load_external_data=False).graph
    except Exception as error:  # protobuf's errors have no common base
        return {**head, "note": f"cannot be read: {error}", **empty}
    sizes = {item.name: math.prod(item.dims) for item in graph.initializer}
    return {
        **head,
        "note": None,
        "inputs": [_value(item) for item in graph.input if item.name not in sizes],
        "outputs": [_value(item) for item in graph.output],
        "parameters": sum(sizes.values()),
        "nodes": [_node(node, sizes) for node in graph.node],
    }


def _node(node: Any, sizes: dict[str, int]) -> dict[str, Any]:
    return {
        "op": node.op_type,
        "name": node.name,
        "attributes": ", ".join(_attribute(item) for item in node.attribute),
        "inputs": list(node.input),
        "outputs": list(node.output),
        "parameters": sum(sizes.get(name, 0) for name in node.input),
    }


def _attribute(item: Any) -> str:
    import onnx

    value = onnx.helper.get_attribute_value(item)
    if item.type == onnx.AttributeProto.TENSOR:
        text = f"tensor {tuple(value.dims)}"
    elif item.type == onnx.AttributeProto.GRAPH:
        text = f"graph of {len(value.node)} nodes"
    else:
        text = value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
    return f"{item.name}={text if len(text) <= LONGEST else text[:LONGEST] + '...'}"


def _value(item: Any) -> str:
    shape = [dimension.dim_param or dimension.dim_value for dimension in item.type.tensor_type.shape.dim]
    return f"{item.name} ({', '.join(str(size) for size in shape)})"
