"""Command buffers: record encoders, commit, wait."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, TypeVar

from postfx.runtime.encoders import ComputeEncoder, Encoder, MachineLearningEncoder
from postfx.runtime.errors import CommandError, CommandTimeout, EncodingError
from postfx.runtime.records import Dispatch, Record
from postfx.runtime.session import first_line

if TYPE_CHECKING:
    from postfx.runtime.device import Device

E = TypeVar("E", bound=Encoder)


class CommandBuffer:
    """Commands for one device, recorded by encoders one after the other. Made by `Device.command_buffer`.

    Attributes:
        label: name in messages, for example 'frame 12'.
        records: dispatches and barriers in order.
    """

    def __init__(self, device: Device, label: str) -> None:
        self.device = device
        self.label = label
        self.records: list[Record] = []
        self._groups: list[str] = []
        self._encoder: Encoder | None = None
        self._state = "open"
        self._done = threading.Event()
        self._error: CommandError | None = None
        self._timings: dict[int, tuple[str, float]] = {}
        device.hazards.opened(self)

    def compute_encoder(self, label: str) -> ComputeEncoder:
        """Begin to record kernels under a label."""
        return self._begin(ComputeEncoder(self, self._full(label), self.device.next_encoder()))

    def machine_learning_encoder(self, label: str) -> MachineLearningEncoder:
        """Begin to record networks under a label."""
        return self._begin(MachineLearningEncoder(self, self._full(label), self.device.next_encoder()))

    @contextmanager
    def group(self, name: str) -> Iterator[None]:
        """Labels of encoders begun inside are prefixed by 'name/': they are the keys of `timings`."""
        self._groups.append(name)
        try:
            yield
        finally:
            self._groups.pop()

    def commit(self) -> None:
        """Check all hazards and hand the commands to the device's queue. Nothing can be recorded afterwards.

        Raises HazardError (the buffer is then discarded), and EncodingError when an encoder is still open or the
        buffer was committed before.
        """
        self._require_open()
        if self._encoder is not None:
            raise EncodingError(f"'{self.label}' cannot be committed: encoder '{self._encoder.label}' is still open")
        self._close("discarded")
        with self.device.commit_lock:
            self.device.hazards.commit(self)
            self._state = "committed"
            self.device.queue.submit(self._run)

    def discard(self) -> None:
        """Drop everything that was recorded; a committed buffer is not affected."""
        if self._state == "open":
            self._close("discarded")

    def wait(self, timeout: float | None = None) -> None:
        """Block until all commands are done.

        Args:
            timeout: seconds; None waits without limit.

        Raises CommandTimeout when they are not done in time, CommandError when one failed, EncodingError before
        commit.
        """
        if self._state != "committed":
            raise EncodingError(f"'{self.label}' cannot be waited for: it is {self._state}, commit it first")
        if not self._done.wait(timeout):
            raise CommandTimeout(f"'{self.label}' was not done after {timeout:g} s")
        self.device.hazards.retire(self)
        if self._error is not None:
            raise self._error

    @property
    def timings(self) -> list[tuple[str, float]]:
        """(label, milliseconds) of every encoder that ran, in order; complete after `wait`."""
        return list(self._timings.values())

    def record(self, record: Record) -> None:
        """Append a command; encoders call this. Raises EncodingError after commit."""
        self._require_open()
        self.records.append(record)

    def encoder_ended(self) -> None:
        """The open encoder takes no more commands; encoders call this."""
        self._encoder = None

    def _begin(self, encoder: E) -> E:
        self._require_open()
        if self._encoder is not None:
            raise EncodingError(f"'{encoder.label}' cannot begin: encoder '{self._encoder.label}' is still open")
        self._encoder = encoder
        return encoder

    def _require_open(self) -> None:
        if self._state != "open":
            raise EncodingError(f"'{self.label}' is {self._state}: record into a new command buffer")

    def _close(self, state: str) -> None:
        self._state = state
        self.device.hazards.closed(self)

    def _full(self, label: str) -> str:
        return "/".join([*self._groups, label])

    def _run(self) -> None:
        dispatches = [record for record in self.records if isinstance(record, Dispatch)]
        for index, dispatch in enumerate(dispatches):
            try:
                self._execute(dispatch)
            except BaseException as error:  # whatever it is, the waiting host must learn of it
                self._error = CommandError(f"{dispatch} of '{self.label}' failed: {first_line(error)}", dispatch.label)
                self._error.__cause__ = error
                missing = [tensor for left in dispatches[index:] for tensor in left.writes]
                self.device.hazards.mark_undefined(missing)
                break
        self._done.set()

    def _execute(self, dispatch: Dispatch) -> None:
        undefined = [tensor.name for tensor in dispatch.reads if not tensor.is_written()]
        if undefined:
            raise RuntimeError(f"'{undefined[0]}' was to be written by a command that failed")
        begin = time.perf_counter()
        dispatch.execute()
        elapsed = 1e3 * (time.perf_counter() - begin)
        label, before = self._timings.get(dispatch.encoder, (dispatch.label, 0.0))
        self._timings[dispatch.encoder] = (label, before + elapsed)
        for tensor in dispatch.writes:
            self.device.hazards.mark_written(tensor)
