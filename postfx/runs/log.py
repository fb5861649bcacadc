"""Logs as JSON lines: one object for each event, for programs that watch runs."""

from __future__ import annotations

import json
import os
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from postfx.errors import WriteError


class Log:
    """Appends events to a file; without a file it does nothing.

    Each line is written by one call, so lines of several runs that share a file do not mix. docs/reliability.md has the
    events. Raises WriteError when the file cannot be written.
    """

    def __init__(self, path: str | None, run: str) -> None:
        self._run, self._path, self._file = run, path, -1
        if path is not None:
            try:
                Path(path).parent.mkdir(parents=True, exist_ok=True)
                self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
            except OSError as error:
                raise WriteError(f"{path}: cannot be written: {error.strerror}: give --log another file") from error

    def __call__(self, event: str, **facts: Any) -> None:
        """Write one event."""
        if self._file >= 0:
            line = json.dumps({"time": now(), "run": self._run, "event": event, **facts}, default=str)
            try:
                os.write(self._file, f"{line}\n".encode())
            except OSError as error:
                raise WriteError(f"{self._path}: cannot be written: {error.strerror}") from error

    def close(self) -> None:
        """No more events."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1


def now() -> str:
    """The time as in ISO 8601, UTC, to the millisecond."""
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
