"""Inside a network: its nodes run one by one on what the network read, with what each writes and how long it takes."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import onnxruntime as ort

from postfx.errors import CaptureError, ModelError
from postfx.runtime.records import Dispatch
from postfx.runtime.session import Placement, first_line, providers_of, session_options
from postfx.runtime.snapshot import CapturedNetwork, CapturedNode, CapturedValue, Snapshot, content
from postfx.runtime.states import Binding
from postfx.runtime.tensor import Tensor

if TYPE_CHECKING:
    from onnx import ModelProto, NodeProto, TensorProto

Keep = Callable[[np.ndarray, str, bool], Snapshot | None]
"""Keeps what it is to of an array; given a name for files, and whether only figures are wanted."""


def look_inside(dispatch: Dispatch, placement: Placement, keep: Keep, ran: bool) -> CapturedNetwork:
    """Run the nodes of a dispatch's network; `ran` tells whether the network itself has written its outputs.

    Checks no hazards: the caller stands between two commands of the queue.
    """
    assert dispatch.state is not None and dispatch.model is not None  # it runs a network
    bindings = dispatch.state.bindings
    inputs = _named(bindings, "read", dispatch.reads)
    written = _named(bindings, "write", dispatch.writes) if ran else {}
    found, errors = CapturedNetwork(), []
    for node in run_nodes(dispatch.model, placement, inputs):
        found.nodes.append(_captured(node, keep))
        errors += [largest_error(written[n], array)[0] for n, array in node.outputs.items() if n in written]
    if errors and not any(node.error for node in found.nodes):
        found.difference = max(errors)
    return found


def _captured(node: NodeRun, keep: Keep) -> CapturedNode:
    values = [
        CapturedValue(name, array.shape, array.dtype.name, array.nbytes,
                      snapshot=keep(array, f"n{node.index:04d}.{name}", node.constant))
        for name, array in node.outputs.items()
    ]
    return CapturedNode(node.index, node.op, node.name, node.constant, node.milliseconds, node.error, values)


def _named(bindings: Sequence[Binding], access: str, tensors: Sequence[Tensor]) -> dict[str, np.ndarray]:
    names = [binding.name for binding in bindings if binding.access == access]
    return {name: content(tensor) for name, tensor in zip(names, tensors, strict=True) if tensor.nbytes}


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
    return bytes(alone.SerializeToString())


def _as_weights(arrays: Mapping[str, np.ndarray]) -> dict[str, TensorProto]:
    from onnx import numpy_helper

    return {name: numpy_helper.from_array(array, name) for name, array in arrays.items()}


def _last_reads(model: ModelProto) -> dict[str, int]:
    """Number of the last node that reads a value, by its name."""
    return {name: index for index, node in enumerate(model.graph.node) for name in reads(node)}


def run_profiled(
    model: bytes, placement: Placement, inputs: Mapping[str, np.ndarray]
) -> tuple[dict[str, np.ndarray], float]:
    """Outputs by name, and the milliseconds of the kernels alone. Nothing is fused, moved or folded."""
    options = session_options(placement, {})
    options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_DISABLE_ALL
    options.enable_profiling = True
    with tempfile.TemporaryDirectory(prefix="postfx-profile-") as folder:
        options.profile_file_prefix = str(Path(folder) / "run")
        session = ort.InferenceSession(model, options, providers=providers_of(placement, exclusive=False))
        names = [item.name for item in session.get_outputs()]
        try:
            arrays = session.run(names, dict(inputs))
        finally:
            profile = session.end_profiling()
        return dict(zip(names, arrays, strict=True)), _milliseconds(Path(profile))


def _milliseconds(profile: Path) -> float:
    events = json.loads(profile.read_text(encoding="utf-8"))
    return float(sum(e["dur"] for e in events if e.get("cat") == "Node" and e["name"].endswith("_kernel_time"))) / 1000


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


_BLOCK = 1 << 20


def largest_error(a: np.ndarray, b: np.ndarray) -> tuple[float, tuple[int, ...]]:
    """The largest relative error of `a` against the reference `b`, and its index.

    An element's is |a - b| / max(|b|, mean of |b|): elements near 0 are measured by the array's usual size. NaN equals
    NaN and an infinity one of its sign; finite against not finite is an infinite error. Works on blocks, so it takes
    little memory.
    """
    left, right = a.reshape(-1), b.reshape(-1)
    usual = _mean_size(right)
    worst, place = 0.0, 0
    for start in range(0, left.size, _BLOCK):
        errors = _errors(left[start : start + _BLOCK], right[start : start + _BLOCK], usual)
        at = int(errors.argmax())
        if errors[at] > worst:
            worst, place = float(errors[at]), start + at
    return worst, tuple(int(i) for i in np.unravel_index(place, a.shape))


def _errors(a: np.ndarray, b: np.ndarray, usual: float) -> np.ndarray:
    a, b = a.astype(np.float64), b.astype(np.float64)
    same = (a == b) | (np.isnan(a) & np.isnan(b))
    with np.errstate(invalid="ignore", divide="ignore"):
        errors = np.abs(a - b) / np.maximum(np.abs(b), usual)
    return np.where(same, 0.0, np.where(np.isfinite(a) & np.isfinite(b), errors, np.inf))


def _mean_size(values: np.ndarray) -> float:
    total, count = 0.0, 0
    for start in range(0, values.size, _BLOCK):
        block = np.abs(values[start : start + _BLOCK].astype(np.float64))
        kept = block[np.isfinite(block)]
        total, count = total + float(kept.sum()), count + kept.size
    return total / count if count else 0.0
