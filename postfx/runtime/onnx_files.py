"""ONNX files as graphs. The package `onnx` is loaded only when they are asked for: to run networks needs none."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from postfx.errors import CaptureError, ModelError
from postfx.runtime.session import first_line

if TYPE_CHECKING:
    from onnx import ModelProto, NodeProto

MISSING = "the graphs of networks need the package onnx: pip install 'postfx[capture]'"


def require_onnx() -> None:
    """Raises CaptureError with what to install when there is no package `onnx`."""
    try:
        import onnx  # noqa: F401
    except ImportError:
        raise CaptureError(MISSING) from None


def load_graph(path: Path) -> ModelProto:
    """A model with its weights, also those in files beside it.

    Raises CaptureError without the package `onnx`, ModelError when a file cannot be read.
    """
    require_onnx()
    import onnx

    try:
        return onnx.load(str(path))
    except Exception as error:  # protobuf's errors have no common base
        raise ModelError(f"model '{path}' cannot be read: {first_line(error)}") from error


def reads(node: NodeProto) -> list[str]:
    """Names of the values that a node may read, each once: its inputs, and all that the graphs inside it name."""
    inner = [graph for item in node.attribute for graph in (item.g, *item.graphs)]
    deeper = (name for graph in inner for child in graph.node for name in reads(child))
    results = (item.name for graph in inner for item in graph.output)
    return list(dict.fromkeys(name for name in (*node.input, *deeper, *results) if name))


def constant_nodes(model: ModelProto) -> set[int]:
    """Numbers of the nodes that depend on no input of the graph, such as those that unpack weights."""
    varying = {item.name for item in model.graph.input} - {item.name for item in model.graph.initializer}
    found = set()
    for index, node in enumerate(model.graph.node):
        if varying.isdisjoint(reads(node)):
            found.add(index)
        else:
            varying.update(node.output)
    return found
