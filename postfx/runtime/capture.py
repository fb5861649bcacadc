"""Captures: what command buffers did, command by command, with what each of them wrote."""

from __future__ import annotations

import re
import threading
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Self

from postfx.runtime.errors import CaptureError, CommandError
from postfx.runtime.ranges import Ranges
from postfx.runtime.records import ConsumerBarrier, Dispatch, EncoderBarrier, Record
from postfx.runtime.session import first_line
from postfx.runtime.snapshot import MOST_SLICES, Snapshot, take
from postfx.runtime.tensor import Tensor

if TYPE_CHECKING:
    from postfx.runtime.commands import CommandBuffer
    from postfx.runtime.device import Device

TENSORS = ("thumbnails", "none", "all")
"""What a capture keeps of tensors: figures and small pictures, nothing, or also the whole content in files."""


@dataclass
class CapturedTensor:
    """A tensor that a command read or wrote; `start` and `end` are its addresses on the device.

    `snapshot` is there for what the command wrote, and for what it read if no command in the capture wrote that.
    """

    name: str
    shape: tuple[int, ...]
    dtype: str
    nbytes: int
    start: int
    end: int
    snapshot: Snapshot | None = None


@dataclass
class CapturedDispatch:
    """One kernel or network run; see `postfx.runtime.records.Dispatch`.

    Attributes:
        index: its number in the capture, from 0 in the order of commit.
        milliseconds: its own time; None when it failed or did not run.
        error: why it failed or did not run; None also behind a command that failed.
    """

    index: int
    label: str
    command: str
    stage: str
    encoder: int
    model: Path | None
    reads: list[CapturedTensor]
    writes: list[CapturedTensor]
    milliseconds: float | None = None
    error: str | None = None


@dataclass(frozen=True)
class CapturedBarrier:
    """A barrier; `form` is 'encoder', 'consumer' or 'producer', `after` and `before` its stage masks, sorted."""

    form: str
    encoder: int
    after: tuple[str, ...] = ()
    before: tuple[str, ...] = ()


@dataclass
class CapturedBuffer:
    """One committed command buffer.

    Attributes:
        records: dispatches and barriers in order.
        heap_used, heap_peak, heap_size: the device's heap when the buffer was done, bytes; see `Heap`.
    """

    label: str
    records: list[CapturedDispatch | CapturedBarrier]
    heap_used: int = 0
    heap_peak: int = 0
    heap_size: int = 0

    @property
    def dispatches(self) -> list[CapturedDispatch]:
        """The dispatches among the records."""
        return [record for record in self.records if isinstance(record, CapturedDispatch)]


@dataclass
class Recorder:
    """Fills a captured buffer while its commands run; the command buffer calls it on the queue's thread."""

    capture: Capture
    buffer: CapturedBuffer
    _commands: CommandBuffer
    _of: dict[Dispatch, CapturedDispatch]
    _inputs: dict[tuple, Snapshot | None] = field(default_factory=dict)
    done: threading.Event = field(default_factory=threading.Event)

    def ran(self, dispatch: Dispatch, milliseconds: float) -> None:
        """A dispatch is done, and no later one has begun."""
        captured = self._of[dispatch]
        captured.milliseconds = milliseconds
        try:
            self._look_at(dispatch, captured)
        except Exception as error:  # the queue's thread must go on: `Capture.__exit__` raises it
            self.capture.failure = self.capture.failure or error

    def failed(self, dispatch: Dispatch, error: CommandError) -> None:
        """A dispatch failed, or what it reads was lost."""
        self._of[dispatch].error = str(error)

    def ended(self) -> None:
        """No more commands of the buffer will run; lets go of its tensors."""
        heap = self._commands.device.heap
        self.buffer.heap_used, self.buffer.heap_peak, self.buffer.heap_size = heap.used, heap.peak, heap.size
        self._of = {}
        self.done.set()

    def _look_at(self, dispatch: Dispatch, captured: CapturedDispatch) -> None:
        written = self.capture.written
        for tensor, kept in zip(dispatch.reads, captured.reads, strict=True):
            if not written.covers(tensor.start, tensor.end):
                kept.snapshot = self._input(tensor, captured.index)
        for number, (tensor, kept) in enumerate(zip(dispatch.writes, captured.writes, strict=True)):
            kept.snapshot = self.capture.snapshot(tensor, f"{captured.index:04d}.{number}")
            written.add(tensor.start, tensor.end)

    def _input(self, tensor: Tensor, index: int) -> Snapshot | None:
        key = (tensor.start, tensor.end, tensor.shape, tensor.dtype)
        if key not in self._inputs:
            self._inputs[key] = self.capture.snapshot(tensor, f"{index:04d}.in{len(self._inputs)}")
        return self._inputs[key]


class Capture:
    """Records every command buffer that is committed while it is on. Made by `Device.capture`; a context manager.

    Leaving it waits until the recorded buffers are done, which does not count as waiting for them.

    Attributes:
        buffers: the buffers in the order of commit.
        tensors, folder: what is kept of tensors, see `Device.capture`.
    """

    def __init__(self, device: Device, tensors: str, folder: str | Path | None) -> None:
        if tensors not in TENSORS:
            raise CaptureError(f"a capture cannot keep '{tensors}' of tensors: use one of {', '.join(TENSORS)}")
        if (tensors == "all") != (folder is not None):
            raise CaptureError("a capture with tensors='all' needs a folder=, any other has none")
        self.device = device
        self.tensors = tensors
        self.folder = None if folder is None else Path(folder)
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

    def record(self, commands: CommandBuffer) -> Recorder:
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
        name = re.sub(r"[^\w.-]+", "_", tensor.name)[:60]
        return take(tensor, MOST_SLICES if self.folder else 3, self.folder, f"tensors/{number}.{name}.npy")


def _captured_dispatch(index: int, dispatch: Dispatch) -> CapturedDispatch:
    names = (dispatch.label, dispatch.command, dispatch.stage, dispatch.encoder, dispatch.model)
    return CapturedDispatch(index, *names, _captured(dispatch.reads), _captured(dispatch.writes))


def _captured(tensors: Iterable[Tensor]) -> list[CapturedTensor]:
    return [CapturedTensor(str(t.name), t.shape, t.dtype, t.nbytes, t.start, t.end) for t in tensors]


def _captured_barrier(record: Record) -> CapturedBarrier:
    if isinstance(record, EncoderBarrier):
        return CapturedBarrier("encoder", record.encoder)
    form = "consumer" if isinstance(record, ConsumerBarrier) else "producer"
    return CapturedBarrier(form, record.encoder, tuple(sorted(record.after)), tuple(sorted(record.before)))
