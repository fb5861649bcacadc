"""The device's queue: one thread that runs committed work in order."""

from __future__ import annotations

import atexit
import queue
import threading
import weakref
from collections.abc import Callable

Work = queue.SimpleQueue[Callable[[], None] | None]


class CommandQueue:
    """Runs functions one after the other on a thread of its own. The thread ends with the queue object."""

    def __init__(self, name: str) -> None:
        self._work: Work = queue.SimpleQueue()
        thread = threading.Thread(target=_serve, args=(self._work,), name=name, daemon=True)
        thread.start()
        weakref.finalize(self, self._work.put, None).atexit = False
        _threads[thread] = self._work

    def submit(self, work: Callable[[], None]) -> None:
        """Run `work` after everything submitted before."""
        self._work.put(work)


def _serve(work: Work) -> None:
    while (item := work.get()) is not None:
        item()
        # A finished command buffer must not be kept alive until the next one arrives.
        del item


_threads: weakref.WeakKeyDictionary[threading.Thread, Work] = weakref.WeakKeyDictionary()


@atexit.register
def _end_all() -> None:
    """A thread that the interpreter stops while it is inside of a library would abort the process."""
    for thread, work in list(_threads.items()):
        work.put(None)
        thread.join()
