"""The capture of one frame of `postfx run`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from postfx.errors import CommandError, SequenceError
from postfx.io.writer import check_folder
from postfx.report.page import write_capture
from postfx.runtime import Capture, Device


class FrameCapture:
    """What --capture asks for: one frame is captured, the rest run as they would.

    Args:
        folder: where to write.
        number: of the frame; None for the second one that is processed.
        tensors, network: as for `Device.capture`.
        check: whether the folder must be one that can be written.

    Raises WriteError when the folder cannot be written; CaptureError when options do not fit together, or a package
    that they need is missing.

    Attributes:
        page: the page that was written; None before.
        warnings: why there is none, if the frame failed.
    """

    def __init__(self, device: Device, folder: str, number: int | None = None,
                 tensors: str = "thumbnails", network: bool = False, check: bool = True) -> None:
        self.page: str | None = None
        self.warnings: list[str] = []
        self._following: list[int] = []  # frames to capture instead of one that fails
        self._device, self._number, self._tensors, self._network = device, number, tensors, network
        self._folder = Path(folder)
        self._made()  # what it cannot do must not be found out after the first frames
        if check:
            check_folder(self._folder, "capture")

    def choose(self, numbers: Sequence[int]) -> None:
        """Choose among the frames that will be processed, in their order. Raises SequenceError when it is none of them.

        Without --capture-frame it is the second, which has a history, or the first if there is no other.
        """
        if not numbers:
            return
        if self._number is None:
            self._number, *self._following = numbers[min(1, len(numbers) - 1):]
        if self._number not in numbers:
            raise SequenceError(f"frame {self._number} of --capture-frame is not processed: take one that is")

    @contextmanager
    def around(self, number: int) -> Iterator[None]:
        """Process a frame inside: if it is the one to capture, this writes the capture at the end, also when a command
        fails. If the frame failed before any command, the next one is captured, unless --capture-frame names it."""
        if self.page or number != self._number:
            yield
            return
        capture = self._made()
        try:
            with capture:
                yield
        except CommandError:  # then the capture is wanted most
            self._write(capture, number)
            raise
        if capture.buffers:
            self._write(capture, number)
        elif self._following:
            self._number = self._following.pop(0)
        else:
            self.warnings = [f"frame {number} could not be processed: nothing was captured"]

    def _made(self) -> Capture:
        return self._device.capture(self._tensors, self._folder if self._tensors == "all" else None, self._network)

    def _write(self, capture: Capture, number: int) -> None:
        self.page = str(write_capture(capture, self._folder, f"postfx capture: frame {number}"))
