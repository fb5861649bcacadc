"""The device's queue: one thread that runs committed work in order."""

from __future__ import annotations

import queue
import threading
import weakref
from collections.abc import Callable


class CommandQueue:
    """Runs functions one after the other on a thread of its own. The thread ends with the queue object."""

    def __init__(self, name: str) -> None:
        self._work: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=_serve, args=(self._work,), name=name, daemon=True)
        self._thread.start()
        weakref.finalize(self, self._work.put, None)

    def submit(self, work: Callable[[], None]) -> None:
        """Run `work` after everything submitted before."""
        self._work.put(work)


def _serve(work: queue.SimpleQueue[Callable[[], None] | None]) -> None:
    while (item := work.get()) is not None:
        item()
        # A finished command buffer must not be kept alive until the next one arrives.
        del item
