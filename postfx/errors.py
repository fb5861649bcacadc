"""Errors a user can mend. Each message is one line that names the file, the plane and the mend."""


from __future__ import annotations

from typing import Any


class PostfxError(Exception):
    """Base of every error that postfx raises on purpose; the command line prints it as ``error: ...`` and exits 2."""

    def __reduce__(self) -> tuple[Any, ...]:
        # as it is pickled by default, an error whose constructor takes more than a message cannot be made again
        return _restored, (type(self), self.args, self.__dict__)


def _restored(kind: type[PostfxError], args: tuple[Any, ...], attributes: dict[str, Any]) -> PostfxError:
    """An error that came from another process."""
    error = kind.__new__(kind, *args)
    error.__dict__.update(attributes)
    return error


class FrameError(PostfxError):
    """A frame's planes do not fit together: size, channels or data type."""


class GuideError(FrameError):
    """Planes at output size do not fit the frame or the output: role or size."""


class SequenceError(PostfxError):
    """A frame pattern or frame range cannot be understood, or matches no file."""


class MissingFrameError(SequenceError):
    """A frame of the range has no file."""


class ReadError(PostfxError):
    """A file cannot be read: broken, deep, or of an unknown format."""


class MissingPlaneError(PostfxError):
    """A plane that a pass needs is in none of the frame's files."""


class ProfileError(PostfxError):
    """A renderer profile is unknown, malformed or does not fit the file."""


class ColourError(PostfxError):
    """A display, view, look-up table or colour space is unknown or cannot be had as asked for."""


class WriteError(PostfxError):
    """An output file cannot be written."""


class OutputExistsError(WriteError):
    """An output file is already there and neither overwriting nor skipping was asked for."""
