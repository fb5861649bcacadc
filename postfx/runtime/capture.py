"""Captures: what command buffers did, command by command and inside networks node by node, and what
each wrote."""

from __future__ import annotations

import json
import os
import re
import secrets
import shutil
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, Self

import numpy as np

from postfx.errors import CaptureError, CommandError, ModelError, offer
from postfx.files import is_process_alive
from postfx.runtime.encoders import Barrier, ConsumerBarrier, Dispatch, EncoderBarrier, Record
from postfx.runtime.heap import Heap
from postfx.runtime.memory import Ranges
from postfx.runtime.session import Placement, first_line, ort, providers_of, session_options
from postfx.runtime.snapshot import (
    MOST_SLICES,
    NODE_PICTURES,
    CapturedBarrier,
    CapturedBuffer,
    CapturedDispatch,
    CapturedNetwork,
    CapturedNode,
    CapturedTensor,
    CapturedValue,
    Pictures,
    Snapshot,
    content,
    take,
)
from postfx.runtime.states import Binding, PipelineState
from postfx.runtime.tensor import Tensor, TensorDevice
from postfx.version import pip_install

if TYPE_CHECKING:
    from onnx import ModelProto, NodeProto, TensorProto

TENSORS_FOLDER = "tensors"
"""Where the files of tensors are, in the folder of a capture."""
_KEPT_BY = re.compile(r"(?P<process>\d{1,9})-[0-9a-f]{8}")
"""Name of the folder of one capture's tensors."""
_TENSOR_FILE = re.compile(r"\d{4}\..+\.npy")
"""Name of a tensor of version 0.2.0 and before, which kept all captures in one place."""
KEPT_TENSORS = ("thumbnails", "none", "all")
"""What a capture keeps of tensors: figures and small pictures, nothing, or also the whole content
in files."""


class CapturableDevice(TensorDevice, Protocol):
    """What a capture needs of the device whose commands it records."""

    active_capture: Capture | None

    @property
    def threads(self) -> int: ...

    @property
    def heap(self) -> Heap: ...

    @property
    def placement(self) -> Placement: ...

    @property
    def commit_lock(self) -> threading.Lock: ...


class CapturableCommands(Protocol):
    """What a capture needs of a command buffer."""

    label: str
    records: list[Record]

    @property
    def device(self) -> CapturableDevice: ...


@dataclass
class Recorder:
    """Fills a captured buffer while its commands run; the command buffer calls it on the queue's
    thread."""

    capture: Capture
    buffer: CapturedBuffer
    _commands: CapturableCommands
    _of: dict[Dispatch, CapturedDispatch]
    _inputs: dict[tuple[int, int, tuple[int, ...], str],
                  Snapshot | None] = field(default_factory=dict)
    done: threading.Event = field(default_factory=threading.Event)

    def note_run(self, dispatch: Dispatch, milliseconds: float) -> None:
        """Note a dispatch that has run, before the next one begins."""
        captured = self._of[dispatch]
        captured.milliseconds = milliseconds
        with self._guard():
            self._look_at(dispatch, captured)
            self._look_inside(dispatch, captured)

    def note_failure(self, dispatch: Dispatch, error: CommandError, ran: bool) -> None:
        """Note a dispatch that failed, or did not run because its input was lost."""
        self._of[dispatch].error = str(error)
        if ran:
            with self._guard():
                self._look_inside(dispatch, self._of[dispatch])

    def finish(self) -> None:
        """Finish the buffer: no more of its commands will run. Drops its tensors."""
        heap = self._commands.device.heap
        self.buffer.heap_used = heap.used
        self.buffer.heap_peak = heap.peak
        self.buffer.heap_size = heap.size
        self._of = {}
        self.done.set()

    @contextmanager
    def _guard(self) -> Iterator[None]:
        try:
            yield
        except Exception as error:  # keep the queue's thread alive: `Capture.__exit__` raises it
            self.capture.failure = self.capture.failure or error

    def _look_at(self, dispatch: Dispatch, captured: CapturedDispatch) -> None:
        written = self.capture.written
        for tensor, kept in zip(dispatch.reads, captured.reads, strict=True):
            if not written.covers(tensor.start, tensor.end):
                kept.snapshot = self._input(tensor, captured.index)
        for number, (tensor, kept) in enumerate(zip(dispatch.writes, captured.writes, strict=True)):
            kept.snapshot = self.capture.snapshot(tensor, f"{captured.index:04d}.{number}")
            written.add(tensor.start, tensor.end)

    def _look_inside(self, dispatch: Dispatch, captured: CapturedDispatch) -> None:
        if not self.capture.network or dispatch.model is None:
            return
        placement, ran = self._commands.device.placement, captured.error is None
        captured.network = look_inside(dispatch, placement,
                                       partial(self.capture.value, captured.index), ran)

    def _input(self, tensor: Tensor, index: int) -> Snapshot | None:
        key = (tensor.start, tensor.end, tensor.shape, tensor.dtype)
        if key not in self._inputs:
            self._inputs[key] = self.capture.snapshot(tensor, f"{index:04d}.in{len(self._inputs)}")
        return self._inputs[key]


class Capture:
    """Records the command buffers committed while it is active. Made by `Device.capture`; a context
    manager.

    Leaving it blocks until the recorded buffers are done; the caller still has to `wait` for each.

    Attributes:
        buffers: the buffers in the order of commit.
        tensors, folder, network: what it keeps, see `Device.capture`.
        kept_in: where files of tensors are, relative to the folder. Each capture has a place of its
            own, so what another one kept stays until `report.page.write_capture` is done.
    """

    def __init__(self, device: CapturableDevice, tensors: str, folder: str | Path | None,
                 network: bool) -> None:
        if tensors not in KEPT_TENSORS:
            raise CaptureError(f"a capture cannot keep '{tensors}' of tensors"
                               f"{offer(tensors, KEPT_TENSORS, 'use one of')}")
        if (tensors == "all") != (folder is not None):
            raise CaptureError("a capture with tensors='all' needs a folder=, any other has none")
        if network and tensors == "none":
            raise CaptureError("a capture of networks (network=True, --capture-network) cannot "
                               "keep 'none' of tensors")
        if network:
            require_onnx()
        self.device = device
        self.tensors = tensors
        self.folder = None if folder is None else Path(folder)
        self.network = network
        self.buffers: list[CapturedBuffer] = []
        self.kept_in = f"{TENSORS_FOLDER}/{os.getpid()}-{secrets.token_hex(4)}"
        self.written = Ranges()
        self.failure: Exception | None = None
        self._recorders: list[Recorder] = []
        self._count = 0

    def __enter__(self) -> Self:
        with self.device.commit_lock:
            if self.device.active_capture is not None:
                raise CaptureError(f"{self.device!r} is being captured already: end that capture "
                                   "first")
            self.device.active_capture = self
        return self

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        with self.device.commit_lock:
            self.device.active_capture = None
        if kind is not None:  # a command may hang; do not hide the error that says so
            return
        for recorder in self._recorders:
            recorder.done.wait()
        if self.failure is not None:
            self.discard()
            raise CaptureError("the capture is not complete: "
                               f"{first_line(self.failure)}") from self.failure

    def discard(self) -> None:
        """Remove the files of tensors that it wrote."""
        if self.folder is not None:
            shutil.rmtree(self.folder / self.kept_in, ignore_errors=True)
            with suppress(OSError):  # others may lie there
                (self.folder / TENSORS_FOLDER).rmdir()

    def record(self, commands: CapturableCommands) -> Recorder:
        """Start recording a buffer; its commit calls this, under the commit lock."""
        records, of = [], {}
        for record in commands.records:
            if isinstance(record, Dispatch):
                of[record] = _capture_dispatch(self._count, record)
                self._count += 1
            records.append(of[record] if isinstance(record, Dispatch) else _capture_barrier(record))
        self.buffers.append(CapturedBuffer(commands.label, records))
        self._recorders.append(Recorder(self, self.buffers[-1], commands, of))
        return self._recorders[-1]

    def snapshot(self, tensor: Tensor, number: str) -> Snapshot | None:
        """The tensor's content now, as far as this capture keeps it."""
        if self.tensors == "none":
            return None
        return take(content(tensor), Pictures(MOST_SLICES if self.folder else 3), self.folder,
                    self._file(number, tensor.name))

    def value(self, index: int, array: np.ndarray, name: str,
              figures_only: bool) -> Snapshot | None:
        """The output of a node inside the network of command `index`, as far as this capture keeps
        it."""
        if figures_only:
            return take(array, Pictures(0))
        return take(array, NODE_PICTURES, self.folder, self._file(f"{index:04d}", name))

    def remove_older(self) -> None:
        """Remove tensors that captures before kept in the same folder, also those of processes
        that were killed; not those of another living process."""
        if self.folder is None:
            return
        for path in (self.folder / TENSORS_FOLDER).glob("*"):
            made = _KEPT_BY.fullmatch(path.name)
            if path == self.folder / self.kept_in or path.is_symlink():
                continue
            if path.is_dir() and made and (int(made["process"]) == os.getpid()
                                           or not is_process_alive(int(made["process"]))):
                shutil.rmtree(path, ignore_errors=True)
            elif path.is_file() and _TENSOR_FILE.fullmatch(path.name):
                with suppress(OSError):
                    path.unlink()

    def _file(self, number: str, name: str) -> str:
        name = re.sub(r"[^\w.-]+", "_", name)[:60]
        return f"{self.kept_in}/{number}.{name}.npy"


def _capture_dispatch(index: int, dispatch: Dispatch) -> CapturedDispatch:
    names = (dispatch.label, dispatch.command, dispatch.stage, dispatch.encoder, dispatch.model)
    dims: dict[str, int] = (dict(dispatch.state.dims) if isinstance(dispatch.state, PipelineState)
                            else {})
    reads, writes = _capture_tensors(dispatch.reads), _capture_tensors(dispatch.writes)
    return CapturedDispatch(index, *names, reads, writes, dims=dims)


def _capture_tensors(tensors: Iterable[Tensor]) -> list[CapturedTensor]:
    return [CapturedTensor(str(t.name), t.shape, t.dtype, t.nbytes, t.start, t.end)
            for t in tensors]


def _capture_barrier(record: Barrier) -> CapturedBarrier:
    if isinstance(record, EncoderBarrier):
        return CapturedBarrier("encoder", record.encoder)
    form = "consumer" if isinstance(record, ConsumerBarrier) else "producer"
    return CapturedBarrier(form, record.encoder, tuple(sorted(record.after)),
                           tuple(sorted(record.before)))


Keep = Callable[[np.ndarray, str, bool], Snapshot | None]
"""Keeps a snapshot of an array. Arguments: the array, a name for its file, whether to keep figures
only."""


def look_inside(dispatch: Dispatch, placement: Placement, keep: Keep, ran: bool) -> CapturedNetwork:
    """Run the nodes of a dispatch's network; `ran` tells whether the network itself has written its
    outputs.

    Checks no hazards: the caller stands between two commands of the queue.
    """
    assert dispatch.state is not None and dispatch.model is not None  # it runs a network
    bindings = dispatch.state.bindings
    if any(binding.access == "read-write" for binding in bindings):
        raise CaptureError(f"{dispatch} changes what it reads in place, so its nodes cannot be run "
                           "again: capture without network=True")
    inputs = _name_content(bindings, "read", dispatch.reads)
    written = _name_content(bindings, "write", dispatch.writes) if ran else {}
    found, errors = CapturedNetwork(), []
    for node in run_nodes(dispatch.model, placement, inputs):
        found.nodes.append(_capture_node(node, keep))
        errors += [largest_error(written[n], array)[0]
                   for n, array in node.outputs.items() if n in written]
    if errors and not any(node.error for node in found.nodes):
        found.difference = max(errors)
    return found


def _capture_node(node: NodeRun, keep: Keep) -> CapturedNode:
    values = [
        CapturedValue(name, array.shape, array.dtype.name, array.nbytes,
                      snapshot=keep(array, f"n{node.index:04d}.{name}", node.constant))
        for name, array in node.outputs.items()
    ]
    return CapturedNode(node.index, node.op, node.name, node.constant, node.milliseconds,
                        node.error, values)


def _name_content(bindings: Sequence[Binding], access: str,
                  tensors: Sequence[Tensor]) -> dict[str, np.ndarray]:
    names = [binding.name for binding in bindings if binding.access == access]
    return {name: content(tensor)
            for name, tensor in zip(names, tensors, strict=True) if tensor.nbytes}


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


def run_nodes(path: Path, placement: Placement,
              inputs: Mapping[str, np.ndarray]) -> Iterator[NodeRun]:
    """Run the nodes of a file one by one in order, up to the first that fails.

    Each runs as a model of its own: no optimisation can change its output, and memory holds only
    values that later nodes read. All outputs of `denoise_upscale.m` at 960x544 would take 1.6 GB.

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
        given = {name: values[name] for name in names_read(node) if name in values}
        try:
            outputs, milliseconds = run_profiled(_extract_node(model, node, weights, given),
                                                 placement, given)
        except Exception as error:  # ONNX Runtime's errors have no common base
            yield NodeRun(*what, error=first_line(error))
            return
        yield NodeRun(*what, outputs, milliseconds)
        if index in constant:
            weights.update(_as_weights(outputs))
        else:
            values.update(outputs)
        values = {name: array for name, array in values.items() if last.get(name, -1) > index}


def _extract_node(
    model: ModelProto, node: NodeProto, weights: Mapping[str, TensorProto],
    given: Mapping[str, np.ndarray]
) -> bytes:
    """A model of one node, with the weights that it reads."""
    from onnx import ValueInfoProto, helper

    inputs = [
        helper.make_tensor_value_info(name, helper.np_dtype_to_tensor_dtype(array.dtype),
                                      array.shape)
        for name, array in given.items()
    ]
    # ONNX Runtime works the types out
    outputs = [ValueInfoProto(name=name) for name in node.output if name]
    own = [weights[name] for name in names_read(node) if name in weights and name not in given]
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
    return {name: index for index, node in enumerate(model.graph.node) for name in names_read(node)}


def run_profiled(
    model: bytes, placement: Placement, inputs: Mapping[str, np.ndarray]
) -> tuple[dict[str, np.ndarray], float]:
    """Outputs by name, and the milliseconds of the kernels alone. Nothing is fused, moved or
    folded."""
    options = session_options(placement, {})
    options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_DISABLE_ALL
    options.enable_profiling = True
    with tempfile.TemporaryDirectory(prefix="postfx-profile-") as folder:
        options.profile_file_prefix = str(Path(folder) / "run")
        session = ort.InferenceSession(model, options,
                                       providers=providers_of(placement, exclusive=False))
        names = [item.name for item in session.get_outputs()]
        try:
            arrays = session.run(names, dict(inputs))
        finally:
            profile = session.end_profiling()
        return dict(zip(names, arrays, strict=True)), _milliseconds(Path(profile))


def _milliseconds(profile: Path) -> float:
    events = json.loads(profile.read_text(encoding="utf-8"))
    return float(sum(e["dur"] for e in events
                     if e.get("cat") == "Node" and e["name"].endswith("_kernel_time"))) / 1000


MISSING = f"the graphs of networks need the package onnx: {pip_install('capture')}"


def require_onnx() -> None:
    """Raises CaptureError, which says what to install, if the package `onnx` is missing."""
    try:
        import onnx  # noqa: F401
    except ImportError:
        raise CaptureError(MISSING) from None


def load_graph(path: Path) -> ModelProto:
    """A model with its weights, including those in separate files.

    Raises CaptureError without the package `onnx`, ModelError when a file cannot be read.
    """
    require_onnx()
    import onnx

    try:
        return onnx.load(str(path))
    except Exception as error:  # protobuf's errors have no common base
        raise ModelError(f"model '{path}' cannot be read: {first_line(error)}") from error


def names_read(node: NodeProto) -> list[str]:
    """Names of the values that a node may read, without repeats: its inputs and all names in its
    subgraphs."""
    inner = [graph for item in node.attribute for graph in (item.g, *item.graphs)]
    deeper = (name for graph in inner for child in graph.node for name in names_read(child))
    results = (item.name for graph in inner for item in graph.output)
    return list(dict.fromkeys(name for name in (*node.input, *deeper, *results) if name))


def constant_nodes(model: ModelProto) -> set[int]:
    """Numbers of the nodes that depend on no input of the graph, such as those that unpack
    weights."""
    varying = {item.name for item in model.graph.input} - {item.name
                                                           for item in model.graph.initializer}
    found = set()
    for index, node in enumerate(model.graph.node):
        if varying.isdisjoint(names_read(node)):
            found.add(index)
        else:
            varying.update(node.output)
    return found


_BLOCK_BYTES = 1 << 20


def largest_error(a: np.ndarray, b: np.ndarray) -> tuple[float, tuple[int, ...]]:
    """The largest relative error of `a` against the reference `b`, and its index.

    An element's is |a - b| / max(|b|, mean of |b|): elements near 0 are measured by the array's
    usual size. NaN equals NaN and an infinity one of its sign; finite against not finite is an
    infinite error. Works on blocks, so it takes little memory.
    """
    left, right = a.reshape(-1), b.reshape(-1)
    usual = _mean_size(right)
    worst, place = 0.0, 0
    for start in range(0, left.size, _BLOCK_BYTES):
        errors = _errors(left[start : start + _BLOCK_BYTES], right[start : start + _BLOCK_BYTES],
                         usual)
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
    for start in range(0, values.size, _BLOCK_BYTES):
        block = np.abs(values[start : start + _BLOCK_BYTES].astype(np.float64))
        kept = block[np.isfinite(block)]
        total, count = total + float(kept.sum()), count + kept.size
    return total / count if count else 0.0
