"""Threads that help with the rows of kernels.

To wake a thread takes longer than many kernels do. So a helper that is done looks for its next band for some
microseconds before it goes, without the interpreter's lock, and a thread that waits for helpers does the same.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from postfx.kernels import spinning

LOOK = 100e-6
"""Seconds that a thread looks before it goes or sleeps: more than there are between two kernels."""
DELAY = 5e-6
"""Seconds after which a helper asks for the interpreter's lock: until then who gave it a band has let go of it."""
NAP = 20e-6


class Band(NamedTuple):
    """Some rows of a kernel's work."""

    rows: Callable[..., None]
    first: int
    last: int
    arrays: Sequence[np.ndarray]

    def work(self) -> None:
        self.rows(self.first, self.last, *self.arrays)


class Helpers:
    """Up to `count` threads that work on bands beside the thread that calls, which is one at a time."""

    def __init__(self, count: int) -> None:
        self._pool = ThreadPoolExecutor(count, thread_name_prefix="postfx band")
        self._flags = np.full((count, spinning.LINE), spinning.AWAY, np.int64)
        self._bands: list[Band | None] = [None] * count
        self._failures: list[BaseException | None] = [None] * count
        self._looks, self._delay = spinning.pauses_in(LOOK), spinning.pauses_in(DELAY)

    def work(self, bands: Sequence[Band]) -> None:
        """Work on all bands, the first one in this thread; raises what one of them raised."""
        own, *others = bands
        handed = 0
        try:
            for i, band in enumerate(others):
                self._hand(i, band)
                handed += 1
            own.work()
        finally:
            # The tensors must not be handed on while a band still writes them, whatever this band did.
            failures = [self._failure(i) for i in range(handed)]
        for failure in failures:
            if failure is not None:
                raise failure

    def _hand(self, i: int, band: Band) -> None:
        self._bands[i], self._failures[i] = band, None
        if not spinning.is_taken(self._flags, i):
            self._flags[i, 0] = spinning.BUSY
            self._pool.submit(self._help, i)

    def _failure(self, i: int) -> BaseException | None:
        """What a helper's band raised, once it is done."""
        while not spinning.is_done(self._flags, i, self._looks):
            time.sleep(NAP)
        return self._failures[i]

    def _help(self, i: int) -> None:
        called = True
        while called:
            try:
                self._bands[i].work()
            except BaseException as error:  # whatever it is, the waiting thread must learn of it
                self._failures[i] = error
            self._bands[i] = None
            called = spinning.is_called(self._flags, i, self._looks, self._delay)
