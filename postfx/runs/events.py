"""What a run tells and is told: its log as JSON lines, and signals that stop it cleanly."""

from __future__ import annotations

import json
import os
import signal
import threading
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from types import FrameType
from typing import Any

from postfx.errors import Interrupted, WriteError


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


SIGNALS = (signal.SIGINT, signal.SIGTERM)
Handler = Callable[[int, FrameType | None], Any] | int | signal.Handlers | None


class Stop:
    """Turns SIGINT (Ctrl-C) and SIGTERM into a request to stop. Use as a context manager in the main thread; in another
    thread it changes nothing.

    The first signal calls `tell` with a line for the user; a second one raises Interrupted at once, wherever that is.
    """

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell
        self._asked: int | None = None
        self._before: dict[int, Handler] = {}

    @property
    def asked(self) -> bool:
        """Whether the run shall end after this frame."""
        return self._asked is not None

    def check(self) -> None:
        """Between two frames: raises Interrupted when the run shall end."""
        if self._asked is not None:
            raise Interrupted(self._asked)

    def __enter__(self) -> Stop:
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._signalled) for number in SIGNALS}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _signalled(self, number: int, _: FrameType | None) -> None:
        if self.asked:
            raise Interrupted(number)
        self._asked = number
        self._tell("stopping when this frame is finished; once more stops at once")
