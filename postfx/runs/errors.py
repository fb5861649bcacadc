"""Errors of runs and of what they leave."""

from __future__ import annotations

from postfx.errors import PostfxError, WriteError


class RunError(PostfxError):
    """Another run works on the same files."""


class ManifestError(PostfxError):
    """A manifest is missing or cannot be understood."""


class BooksError(WriteError):
    """A manifest is there and cannot be read now: no rights, or a disk that fails. It may well be whole."""


class CheckpointError(PostfxError):
    """A checkpoint is damaged, or of something else."""


class Interrupted(KeyboardInterrupt):
    """A run was told to stop by a signal, and did so.

    Attributes:
        exit_code: 128 plus the signal's number, as shells have it: 130 after Ctrl-C, 143 after SIGTERM.
    """

    def __init__(self, signal_number: int) -> None:
        super().__init__("interrupted")
        self.exit_code = 128 + signal_number
