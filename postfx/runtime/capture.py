"""Captures: what command buffers did, command by command, with what each of them wrote."""

from __future__ import annotations

import re
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Protocol, Self

import numpy as np

from postfx.errors import CaptureError, CommandError
from postfx.runtime.capture_network import look_inside, require_onnx
from postfx.runtime.heap import Heap
from postfx.runtime.memory import Ranges
from postfx.runtime.records import Barrier, ConsumerBarrier, Dispatch, EncoderBarrier, Record
from postfx.runtime.session import Placement, first_line
from postfx.runtime.snapshot import (
    MOST_SLICES,
    NODE_PICTURES,
    CapturedBarrier,
    CapturedBuffer,
    CapturedDispatch,
    CapturedTensor,
    Pictures,
    Snapshot,
    content,
    take,
)
from postfx.runtime.states import PipelineState
from postfx.runtime.tensor import Tensor, TensorDevice

TENSORS = ("thumbnails", "none", "all")
"""What a capture keeps of tensors: figures and small pictures, nothing, or also the whole content in files."""


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
    """Fills a captured buffer while its commands run; the command buffer calls it on the queue's thread."""

    capture: Capture
    buffer: CapturedBuffer
    _commands: CapturableCommands
    _of: dict[Dispatch, CapturedDispatch]
    _inputs: dict[tuple[int, int, tuple[int, ...], str], Snapshot | None] = field(default_factory=dict)
    done: threading.Event = field(default_factory=threading.Event)

    def ran(self, dispatch: Dispatch, milliseconds: float) -> None:
        """A dispatch is done, and no later one has begun."""
        captured = self._of[dispatch]
        captured.milliseconds = milliseconds
        with self._guarded():
            self._look_at(dispatch, captured)
            self._look_inside(dispatch, captured)

    def failed(self, dispatch: Dispatch, error: CommandError, ran: bool) -> None:
        """A dispatch failed while it ran, or did not run because what it reads was lost."""
        self._of[dispatch].error = str(error)
        if ran:
            with self._guarded():
                self._look_inside(dispatch, self._of[dispatch])

    def ended(self) -> None:
        """No more commands of the buffer will run; lets go of its tensors."""
        heap = self._commands.device.heap
        self.buffer.heap_used, self.buffer.heap_peak, self.buffer.heap_size = heap.used, heap.peak, heap.size
        self._of = {}
        self.done.set()

    @contextmanager
    def _guarded(self) -> Iterator[None]:
        try:
            yield
        except Exception as error:  # the queue's thread must go on: `Capture.__exit__` raises it
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
        captured.network = look_inside(dispatch, placement, partial(self.capture.value, captured.index), ran)

    def _input(self, tensor: Tensor, index: int) -> Snapshot | None:
        key = (tensor.start, tensor.end, tensor.shape, tensor.dtype)
        if key not in self._inputs:
            self._inputs[key] = self.capture.snapshot(tensor, f"{index:04d}.in{len(self._inputs)}")
        return self._inputs[key]


class Capture:
    """Records the command buffers that are committed while it is on. Made by `Device.capture`; a context manager.

    Leaving it waits until the recorded buffers are done, which does not count as waiting for them.

    Attributes:
        buffers: the buffers in the order of commit.
        tensors, folder, network: what is kept, see `Device.capture`.
    """

    def __init__(self, device: CapturableDevice, tensors: str, folder: str | Path | None, network: bool) -> None:
        if tensors not in TENSORS:
            raise CaptureError(f"a capture cannot keep '{tensors}' of tensors: use one of {', '.join(TENSORS)}")
        if (tensors == "all") != (folder is not None):
            raise CaptureError("a capture with tensors='all' needs a folder=, any other has none")
        if network and tensors == "none":
            raise CaptureError("a capture of networks (network=True, --capture-network) cannot keep 'none' of tensors")
        if network:
            require_onnx()
        self.device = device
        self.tensors = tensors
        self.folder = None if folder is None else Path(folder)
        self.network = network
        self.buffers: list[CapturedBuffer] = []
        self.written = Ranges()
        self.failure: Exception | None = None
        self._recorders: list[Recorder] = []
        self._count = 0

    def __enter__(self) -> Self:
        with self.device.commit_lock:
            if self.device.active_capture is not None:
                raise CaptureError(f"{self.device!r} is being captured already: leave that capture first")
            self.device.active_capture = self
        return self

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        with self.device.commit_lock:
            self.device.active_capture = None
        if kind is not None:  # a command may hang, and the error that tells of it must get through
            return
        for recorder in self._recorders:
            recorder.done.wait()
        if self.failure is not None:
            raise CaptureError(f"the capture is not complete: {first_line(self.failure)}") from self.failure

    def record(self, commands: CapturableCommands) -> Recorder:
        """Take a buffer in; its commit calls this, under the commit lock."""
        records, of = [], {}
        for record in commands.records:
            if isinstance(record, Dispatch):
                of[record] = _captured_dispatch(self._count, record)
                self._count += 1
            records.append(of[record] if isinstance(record, Dispatch) else _captured_barrier(record))
        self.buffers.append(CapturedBuffer(commands.label, records))
        self._recorders.append(Recorder(self, self.buffers[-1], commands, of))
        return self._recorders[-1]

    def snapshot(self, tensor: Tensor, number: str) -> Snapshot | None:
        """The tensor's content now, as far as this capture keeps it."""
        if self.tensors == "none":
            return None
        return take(content(tensor), Pictures(MOST_SLICES if self.folder else 3), self.folder,
                    _file(number, tensor.name))

    def value(self, index: int, array: np.ndarray, name: str, figures_only: bool) -> Snapshot | None:
        """What a node inside the network of command `index` wrote, as far as this capture keeps it."""
        if figures_only:
            return take(array, Pictures(0))
        return take(array, NODE_PICTURES, self.folder, _file(f"{index:04d}", name))


def _file(number: str, name: str) -> str:
    name = re.sub(r"[^\w.-]+", "_", name)[:60]
    return f"tensors/{number}.{name}.npy"


def _captured_dispatch(index: int, dispatch: Dispatch) -> CapturedDispatch:
    names = (dispatch.label, dispatch.command, dispatch.stage, dispatch.encoder, dispatch.model)
    dims: dict[str, int] = dict(dispatch.state.dims) if isinstance(dispatch.state, PipelineState) else {}
    return CapturedDispatch(index, *names, _captured(dispatch.reads), _captured(dispatch.writes), dims=dims)


def _captured(tensors: Iterable[Tensor]) -> list[CapturedTensor]:
    return [CapturedTensor(str(t.name), t.shape, t.dtype, t.nbytes, t.start, t.end) for t in tensors]


def _captured_barrier(record: Barrier) -> CapturedBarrier:
    if isinstance(record, EncoderBarrier):
        return CapturedBarrier("encoder", record.encoder)
    form = "consumer" if isinstance(record, ConsumerBarrier) else "producer"
    return CapturedBarrier(form, record.encoder, tuple(sorted(record.after)), tuple(sorted(record.before)))
