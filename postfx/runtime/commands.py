"""Command buffers: record encoders, commit, wait."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, TypeVar

from postfx.errors import CommandError, EncodingError
from postfx.runtime.arena import Placement
from postfx.runtime.capture import Recorder
from postfx.runtime.encoders import ComputeEncoder, Encoder, MachineLearningEncoder
from postfx.runtime.execution import Execution
from postfx.runtime.footprint import Footprint
from postfx.runtime.records import Dispatch, Record
from postfx.runtime.tensor import Allocation, Tensor
from postfx.runtime.waiting import timed_out

if TYPE_CHECKING:
    from postfx.runtime.device import Device

E = TypeVar("E", bound=Encoder)

_STATES = {
    "committed": "it was committed and not waited for, call wait() first",
    "done": "it is done, call begin() to record anew",
    "discarded": "it was discarded, call begin() to record anew",
}


class CommandBuffer:
    """Commands for one device, recorded by encoders one after the other. Made by `Device.command_buffer`.

    It is open, then committed, then done when it was waited for; then it may be committed again as it is, or begun
    again.

    Attributes:
        label: name in messages, for example 'frame 12'.
        captured: whether a capture that is on records it.
        records: dispatches and barriers in order.
    """

    def __init__(self, device: Device, label: str, captured: bool = True) -> None:
        self.device = device
        self.label = label
        self.captured = captured
        self.records: list[Record] = []
        self._kept: set[Allocation] = set()
        self._placement: Placement | None = None
        self._footprint: Footprint | None = None
        self._groups: list[str] = []
        self._encoder: Encoder | None = None
        self._state = "open"
        self._done = threading.Event()
        self._error: CommandError | None = None
        self._timings: dict[int, tuple[str, float]] = {}
        self._recorder: Recorder | None = None
        self._execution: Execution | None = None
        device.hazards.opened(self)

    def begin(self, label: str | None = None) -> None:
        """Drop what was recorded, as well as timings, and record anew, under another label if one is given.

        As Metal 4's `beginCommandBuffer`, but the records are the buffer's own memory, so a committed buffer has to be
        waited for before. Raises EncodingError while it is not, or while an encoder is open.
        """
        if self._state == "committed":
            raise EncodingError(f"'{self.label}' cannot begin again: {_STATES['committed']}")
        self._require_no_encoder("begin again")
        self.label = self.label if label is None else label
        self.records, self._kept, self._placement, self._footprint = [], set(), None, None
        self._error, self._timings = None, {}
        self._state = "open"
        self.device.hazards.opened(self)

    def compute_encoder(self, label: str) -> ComputeEncoder:
        """Begin to record kernels under a label."""
        return self._start(ComputeEncoder(self, self._full(label), self.device.next_encoder()))

    def machine_learning_encoder(self, label: str) -> MachineLearningEncoder:
        """Begin to record networks under a label."""
        return self._start(MachineLearningEncoder(self, self._full(label), self.device.next_encoder()))

    @contextmanager
    def group(self, name: str) -> Iterator[None]:
        """Labels of encoders begun inside are prefixed by 'name/': they are the keys of `timings`."""
        self._groups.append(name)
        try:
            yield
        finally:
            self._groups.pop()

    def keep(self, *tensors: Tensor) -> None:
        """The host reads these tensors when the buffer is done: those that are transient among them keep their memory
        to its end, and until another buffer with transient tensors is committed. Raises EncodingError after commit."""
        self._require_open()
        self._kept.update(tensor.allocation for tensor in tensors)

    def commit(self) -> None:
        """Give transient tensors their memory, check all hazards and hand the commands to the device's queue.

        Nothing can be recorded until `begin`.

        A buffer that was waited for may be committed again without recording: the same dispatches run on the same
        tensors, which may have been uploaded to in the meantime.

        Raises HazardError (the buffer is then discarded), EncodingError when an encoder is still open, when the
        buffer was committed and not waited for, or when it was discarded, and DeviceError in a forked process.
        """
        self._require_no_encoder("be committed")
        self.device.require_process()
        if self._state not in ("open", "done"):
            raise EncodingError(f"'{self.label}' cannot be committed: {_STATES[self._state]}")
        self._close("discarded")
        self._error, self._timings = None, {}
        self._done.clear()
        with self.device.commit_lock:
            self._place()
            self.device.hazards.commit(self)
            self._state = "committed"
            capture = self.device.active_capture if self.captured else None
            self._recorder = None if capture is None else capture.record(self)
            self.device.queue.submit(self._run)

    def discard(self) -> None:
        """Take no more commands and never run those recorded; a committed buffer is not affected."""
        if self._state == "open":
            if self._encoder is not None:
                self._encoder.end()
            self._close("discarded")

    def wait(self, timeout: float | None = None) -> None:
        """Block until all commands are done.

        Args:
            timeout: seconds; None waits without limit.

        Raises CommandTimeout when they are not done in time, CommandError when one failed, EncodingError before
        commit.
        """
        if self._state not in ("committed", "done"):
            raise EncodingError(f"'{self.label}' cannot be waited for: it is {self._state}, commit it first")
        if not self.finished(timeout):
            raise timed_out(f"'{self.label}' was not done after {timeout:g} s", self.device.hazards.in_flight())
        if self._state == "committed":
            self._state = "done"
            self.device.hazards.retire(self)
        if self._error is not None:
            raise self._error

    def finished(self, timeout: float | None = 0.0) -> bool:
        """Whether all commands are done within `timeout` seconds, None without limit. That alone does not count as
        waiting for them: `wait` does."""
        return self._done.wait(timeout)

    @property
    def running(self) -> Dispatch | None:
        """The dispatch that runs now; None where all run as a whole."""
        return None if self._execution is None else self._execution.running

    @property
    def timings(self) -> list[tuple[str, float]]:
        """(label, milliseconds) of every encoder that ran, in order; complete after `wait`."""
        return list(self._timings.values())

    def footprint(self) -> Footprint:
        """What the recorded commands access; worked out at the first commit."""
        if self._footprint is None:
            self._footprint = Footprint(self.records)
        return self._footprint

    def record(self, record: Record) -> None:
        """Append a command; encoders call this. Raises EncodingError after commit."""
        self._require_open()
        self.records.append(record)

    def encoder_ended(self) -> None:
        """The open encoder takes no more commands; encoders call this."""
        self._encoder = None

    def _start(self, encoder: E) -> E:
        self._require_open()
        if self._encoder is not None:
            raise EncodingError(f"'{encoder.label}' cannot begin: encoder '{self._encoder.label}' is still open")
        self._encoder = encoder
        return encoder

    def _require_open(self) -> None:
        if self._state != "open":
            raise EncodingError(f"nothing can be recorded into '{self.label}': {_STATES[self._state]}")

    def _require_no_encoder(self, what: str) -> None:
        if self._encoder is not None:
            raise EncodingError(f"'{self.label}' cannot {what}: encoder '{self._encoder.label}' is still open: end it")

    def _close(self, state: str) -> None:
        self._state = state
        self.device.hazards.closed(self)

    def _place(self) -> None:
        placement = self.device.heap.arena.place(self.records, self._kept, self._placement, self.label)
        if placement is not None and placement is not self._placement:
            self.records, self._placement, self._footprint = placement.records, placement, None

    def _full(self, label: str) -> str:
        return "/".join([*self._groups, label])

    def _run(self) -> None:
        execution = self._execution = Execution(self.device, self.label, self.footprint().dispatches, self._recorder)
        execution.run()
        self._error, self._timings = execution.error, execution.timings
        self._execution = None
        if self._recorder is not None:
            self._recorder.ended()
        self._done.set()
