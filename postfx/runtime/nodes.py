"""A network run node by node, on the device's own provider: what each node writes, and how long it takes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from postfx.runtime.onnx_files import constant_nodes, load_graph, reads
from postfx.runtime.profiled import run_profiled
from postfx.runtime.session import Placement, first_line

if TYPE_CHECKING:
    from onnx import ModelProto, NodeProto, TensorProto


@dataclass(frozen=True)
class NodeRun:
    """One node's run.

    Attributes:
        index: its number in the file.
        outputs: name -> content.
        constant: whether it depends on no input of the network.
        milliseconds: its kernels' own time; None when it failed.
        error: why it failed, or None.
    """

    index: int
    op: str
    name: str
    constant: bool
    outputs: dict[str, np.ndarray] = field(default_factory=dict)
    milliseconds: float | None = None
    error: str | None = None


def run_nodes(path: Path, placement: Placement, inputs: Mapping[str, np.ndarray]) -> Iterator[NodeRun]:
    """Run the nodes of a file one by one in order, up to the first that fails.

    Each is a model of its own, so that no optimisation changes what a node writes and only what is still to be read
    stays in memory: all outputs of `denoise_upscale.m` at 960x544 would be 1.6 GB.

    Args:
        inputs: the network's inputs by name.

    Raises CaptureError without the package `onnx`, ModelError when the file cannot be read.
    """
    model = load_graph(path)
    constant, last = constant_nodes(model), _last_reads(model)
    weights = {item.name: item for item in model.graph.initializer}
    values = dict(inputs)
    for index, node in enumerate(model.graph.node):
        what = index, node.op_type, node.name, index in constant
        given = {name: values[name] for name in reads(node) if name in values}
        try:
            outputs, milliseconds = run_profiled(_alone(model, node, weights, given), placement, given)
        except Exception as error:  # ONNX Runtime's errors have no common base
            yield NodeRun(*what, error=first_line(error))
            return
        yield NodeRun(*what, outputs, milliseconds)
        if index in constant:
            weights.update(_as_weights(outputs))
        else:
            values.update(outputs)
        values = {name: array for name, array in values.items() if last.get(name, -1) > index}


def _alone(
    model: ModelProto, node: NodeProto, weights: Mapping[str, TensorProto], given: Mapping[str, np.ndarray]
) -> bytes:
    """A model of one node that has the weights it reads in it."""
    from onnx import ValueInfoProto, helper

    inputs = [
        helper.make_tensor_value_info(name, helper.np_dtype_to_tensor_dtype(array.dtype), array.shape)
        for name, array in given.items()
    ]
    outputs = [ValueInfoProto(name=name) for name in node.output if name]  # ONNX Runtime works the types out
    own = [weights[name] for name in reads(node) if name in weights and name not in given]
    alone = helper.make_model(
        helper.make_graph([node], "node", inputs, outputs, own),
        opset_imports=model.opset_import, ir_version=model.ir_version, functions=model.functions,
    )
    return alone.SerializeToString()


def _as_weights(arrays: Mapping[str, np.ndarray]) -> dict[str, TensorProto]:
    from onnx import numpy_helper

    return {name: numpy_helper.from_array(array, name) for name, array in arrays.items()}


def _last_reads(model: ModelProto) -> dict[str, int]:
    """Number of the last node that reads a value, by its name."""
    return {name: index for index, node in enumerate(model.graph.node) for name in reads(node)}
