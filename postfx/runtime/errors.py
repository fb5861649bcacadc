"""Errors of the runtime; each message is one line that names the command, the tensor and the mend."""

from __future__ import annotations

from postfx.errors import PostfxError


class DeviceError(PostfxError):
    """A device is not available, or an option does not fit it."""


class ModelError(PostfxError):
    """A model file is missing, damaged, not the one its card describes, or cannot be specialised."""


class BindingError(PostfxError):
    """A tensor does not fit the argument it is bound to, or an argument has no tensor."""


class EncodingError(PostfxError):
    """Commands are recorded, committed or waited for in the wrong order."""


class HazardError(PostfxError):
    """Two accesses to the same memory are not ordered, or memory is read that nothing wrote.

    Attributes:
        kind: 'read after write', 'write after write', 'write after read', 'read before write', 'aliasing',
            'released' or 'host access'.
        tensor: name of the tensor.
        first, second: labels of the commands concerned, earlier one first; `first` is None when there is only one.
    """

    def __init__(self, message: str, kind: str, tensor: str, first: str | None, second: str) -> None:
        super().__init__(message)
        self.kind = kind
        self.tensor = tensor
        self.first = first
        self.second = second


class CaptureError(PostfxError):
    """A capture is asked for what it cannot do, or could not keep all of what happened."""


class CommandError(PostfxError):
    """A command failed while it ran, or did not run because what it reads was lost by one that failed.

    The cause is chained: the error that the command raised, or the first command's CommandError.

    Attributes:
        label: the command's label.
    """

    def __init__(self, message: str, label: str) -> None:
        super().__init__(message)
        self.label = label


class CommandTimeout(PostfxError):
    """Commands were not done in time; they go on running and can be waited for again.

    Attributes:
        running: label of the command that is running; None when the next buffer has not begun.
        waiting: labels of the command buffers that wait behind it, in order.
    """

    def __init__(self, message: str, running: str | None, waiting: tuple[str, ...]) -> None:
        super().__init__(message)
        self.running = running
        self.waiting = waiting
