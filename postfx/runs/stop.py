"""Stopping cleanly: the frame in work is finished and written, then the run ends."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from types import FrameType

from postfx.errors import Interrupted

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Stop:
    """Turns SIGINT (Ctrl-C) and SIGTERM into a request to stop. Use as a context manager in the main thread; in another
    thread it changes nothing.

    The first signal calls `tell` with a line for the user; a second one raises Interrupted at once, wherever that is.
    """

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell
        self._asked: int | None = None
        self._before: dict[int, object] = {}

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
