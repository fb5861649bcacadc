"""Reading ahead, writing behind and retrying reads, so that disks and file servers do not hold up the passes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

from postfx.errors import ReadError

Result = TypeVar("Result")

PAUSES = (0.1, 0.4)
"""Seconds before the second and the third try."""


def read_patiently(read: Callable[[], Result], failed: Callable[[ReadError], None] = lambda error: None) -> Result:
    """What `read` gives. A ReadError is told to `failed` and `read` called again, twice at most; then it is raised."""
    for pause in PAUSES:
        try:
            return read()
        except ReadError as error:
            failed(error)
            time.sleep(pause)
    return read()


Item = TypeVar("Item")
Content = TypeVar("Content")


def read_ahead(items: Iterable[Item], read: Callable[[Item], Content]) -> Iterator[tuple[Item, Content]]:
    """Each item with what `read` makes of it, in order; at most one more is read meanwhile, by a thread of its own.

    An error of `read` is raised when it is the item's turn, so what comes before it is not lost.
    """
    with ThreadPoolExecutor(1, "postfx read") as reader:
        coming: tuple[Item, Future[Content]] | None = None
        for item in items:
            ready, coming = coming, (item, reader.submit(read, item))
            if ready is not None:
                yield ready[0], ready[1].result()
        if coming is not None:
            yield coming[0], coming[1].result()


class WriteBehind:
    """Runs one task at a time in a thread of its own. Use it as a context manager: leaving it waits for the last one.

    An error of a task is raised by the next `put` or `wait`, or on leaving, where no other error is on its way.
    """

    def __init__(self) -> None:
        self._writer = ThreadPoolExecutor(1, "postfx write")
        self._last: Future[None] | None = None

    def put(self, task: Callable[[], None]) -> None:
        """Wait for the task before, then begin this one; so at most one result waits to be written."""
        self.wait()
        self._last = self._writer.submit(task)

    def __enter__(self) -> WriteBehind:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._writer.shutdown(wait=True)
        if kind is None:
            self.wait()

    def wait(self) -> None:
        """Wait for the last task."""
        last, self._last = self._last, None
        if last is not None:
            last.result()
