"""Threads of a device: one that runs committed work in order, and helpers for the rows of kernels.

Waking a thread takes longer than many kernels run. So a helper that is done spins for some
microseconds, without the interpreter's lock, before it goes to sleep, and a thread that waits for
helpers does the same. Compiled rows are begun and ended without that lock, too: with sixteen
threads they would wait for it longer than they run.

Each helper has a row of ``board`` (n, LINE) of int64, a cache line: its flag, and what to run: the
``ENTRY`` and the ``WORDS`` of compiled rows (`postfx.compiled.calls.BoundRows`), or ``PYTHON``. A
helper that is ``WAITING`` spins; then it is ``DOZING`` for a while, asleep where one call of Linux
wakes it; then ``AWAY``, for Python to start it again. That takes so long that, of sixteen threads,
the first would be away again before the last is back, kernel after kernel.
"""

from __future__ import annotations

import atexit
import queue
import threading
import time
import weakref
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future, wait
from contextlib import suppress
from functools import cache, partial
from typing import NamedTuple, Protocol

import numpy as np

from postfx.compiled.calls import BoundRows
from postfx.compiled.library import find_function
from postfx.errors import CommandError, CommandTimeout
from postfx.workers import Server, Workers, end_work

SPIN_SECONDS = 100e-6
"""Seconds that a thread spins before it sleeps: more than the gap between two kernels."""
DELAY = 5e-6
"""Seconds after which a helper takes the interpreter's lock: by then the thread that gave it a band
has released it."""
NAP = 20e-6
"""Seconds between two looks for helpers that are done."""
NANOSECONDS = 20_000_000
"""How long a helper dozes each of five times before it is away. A program that ends waits for
that."""
FLAG, ENTRY, WORDS, STATUS, TIMEOUT = range(5)
LINE = 8
"""Numbers of 64 bits in a cache line: a helper's row."""
PYTHON = -1
"""In place of an entry: a band that is a function of Python's."""
AWAY = 0
"""Flag of a helper that is to be started."""
ASLEEP = 2
"""Status of a band whose helper is away and to be started."""
SAMPLE = 2000
"""Pauses of which the time is measured."""

Work = queue.SimpleQueue[Callable[[], None] | None]


class CommandQueue:
    """Runs functions one after the other on a thread of its own, and others beside them. The thread
    ends with the queue object."""

    def __init__(self, name: str) -> None:
        self._work: Work = queue.SimpleQueue()
        self._apart: list[Future[None]] = []
        self._thread = Server(target=_serve, args=(self._work,), name=name)
        with suppress(RuntimeError):  # none can begin any more: who submits does the work
            self._thread.start()
            weakref.finalize(self, self._work.put, None).atexit = False
            _threads[self._thread] = self._work

    def submit(self, work: Callable[[], None], beside: Executor | None = None) -> None:
        """Run `work` after everything submitted before; at once on a thread of `beside`, if that is
        given. While the program ends the caller runs it."""
        self._apart = [other for other in self._apart if not other.done()]
        if not self._thread.is_alive():
            _run_after(self._apart, work)
        elif beside is not None:
            self._apart.append(beside.submit(work))
        elif self._apart:
            self._work.put(partial(_run_after, self._apart, work))
        else:
            self._work.put(work)


def _run_after(others: Sequence[Future[None]], work: Callable[[], None]) -> None:
    wait(others)
    work()


class Slots:
    """How many threads the commands that run side by side may still take."""

    def __init__(self, count: int) -> None:
        self._free, self._changed = count, threading.Condition()

    def take(self, count: int, patient: bool) -> bool:
        """Take `count`; whether there were so many. If `patient`, wait for them."""
        with self._changed:
            if patient:
                self._changed.wait_for(lambda: self._free >= count)
            taken = self._free >= count
            self._free -= count * taken
            return taken

    def give(self, count: int) -> None:
        """Give `count` back."""
        with self._changed:
            self._free += count
            self._changed.notify_all()


def _serve(work: Work) -> None:
    while (item := work.get()) is not None:
        item()
        # Do not keep a finished command buffer alive until the next one arrives.
        del item


_threads: weakref.WeakKeyDictionary[threading.Thread, Work] = weakref.WeakKeyDictionary()


@atexit.register
def _end_all() -> None:
    """End the threads: one that the interpreter stops inside a library would abort the process.
    Before that, those that wait for them are done."""
    end_work()
    for thread, work in list(_threads.items()):
        work.put(None)
        thread.join()


class Band(NamedTuple):
    """Some rows of a kernel's work."""

    rows: Callable[[int, int], None]
    first: int
    last: int

    def work(self) -> None:
        self.rows(self.first, self.last)


class Functions:
    """The functions of threads.cpp, which explains them. A helper is given by the address of its
    row."""

    def __init__(self) -> None:
        self.make_pauses = find_function("make_pauses", 1)
        self.run_entry = find_function("run_entry", 2)
        self.is_taken = find_function("is_taken", 3)
        self.hand_out = find_function("hand_out", 5)
        self.report_done = find_function("report_done", 1)
        self.is_called = find_function("is_called", 3)
        self.are_done = find_function("are_done", 3)


functions = cache(Functions)
"""The library is opened by who makes helpers first."""


class Helpers:
    """Up to `count` threads that work on bands beside the thread that calls; others that call wait
    for it."""

    def __init__(self, count: int) -> None:
        self._pool = Workers(count, thread_name_prefix="postfx band")
        self._native = functions()
        self._board = np.zeros((count, LINE), np.int64)
        self._board[:, TIMEOUT + 1] = NANOSECONDS
        self._rows = [self._board[i:].ctypes.data for i in range(count)]
        self._bands: list[Band | None] = [None] * count
        self._failures: list[BaseException | None] = [None] * count
        self._looks, self._delay = pauses_in(SPIN_SECONDS), pauses_in(DELAY)
        self._lock = threading.Lock()

    def work(self, bands: Sequence[Band]) -> None:
        """Work on all bands, the first one in this thread; raises what one of them raised."""
        own, *others = bands
        with self._lock:
            handed = 0
            try:
                for i, band in enumerate(others):
                    self._bands[i], self._failures[i] = band, None
                    is_awake = self._native.is_taken(self._rows[i], PYTHON, 0)
                    handed += 1
                    if not is_awake:
                        self._pool.submit(self._help, i)
                own.work()
            finally:
                # Wait even after an error: no one else may use the tensors while a band still
                # writes them.
                self._wait(handed)
            failures = self._failures[:handed]
        for failure in failures:
            if failure is not None:
                raise failure

    def run(self, rows: BoundRows, blocks: np.ndarray) -> None:
        """Run compiled rows in these blocks of theirs, the first one in this thread."""
        words, (bands, size) = blocks.ctypes.data, blocks.shape
        with self._lock:
            if self._native.hand_out(self._rows[0], rows.entry, words, size, bands):
                for i in np.flatnonzero(self._board[:bands - 1, STATUS] == ASLEEP).tolist():
                    self._pool.submit(self._help, i)
            failed = self._native.run_entry(rows.entry, words)
            self._wait(bands - 1)
            failed |= int(self._board[:bands - 1, STATUS].any())
        if failed:
            rows.explain(blocks)

    def _wait(self, count: int) -> None:
        """Until the first helpers are done with their bands."""
        while not self._native.are_done(self._rows[0], count, self._looks):
            time.sleep(NAP)

    def _help(self, i: int) -> None:
        while self._native.is_called(self._rows[i], self._looks, self._delay):
            try:
                band = self._bands[i]
                assert band is not None
                band.work()
            except BaseException as error:  # of any kind: the thread that waits must see it
                self._failures[i] = error
            self._bands[i] = None
            self._native.report_done(self._rows[i])


@cache
def pauses_in(seconds: float) -> int:
    """About how many pauses this processor makes in that time, at least 1."""
    functions().make_pauses(1)
    least = min(_time_pauses(SAMPLE) for _ in range(3))
    return max(1, int(seconds * SAMPLE / least))


def _time_pauses(count: int) -> float:
    make_pauses = functions().make_pauses
    begin = time.perf_counter()
    make_pauses(count)
    return time.perf_counter() - begin


class HasLabel(Protocol):
    """Something that messages name by its label."""

    label: str


class Waitable(Protocol):
    """Commands that can be waited for."""

    label: str

    @property
    def running(self) -> HasLabel | None: ...

    def is_done(self, timeout: float | None = 0.0) -> bool: ...

    def wait(self, timeout: float | None = None) -> None: ...


MOST_NAMED_BUFFERS = 4
"""How many waiting command buffers a message names at most."""


def wait_for_all(name: str, flying: Sequence[Waitable], timeout: float | None) -> None:
    """Wait for all buffers, in order; then raise the first error, if any failed.

    Args:
        name: what the message calls the device.
        timeout: seconds for all together; None waits without limit.
    """
    deadline = None if timeout is None else time.monotonic() + timeout
    first: CommandError | None = None
    for commands in flying:
        left = None if deadline is None else max(0.0, deadline - time.monotonic())
        if not commands.is_done(left):
            raise timeout_error(f"{name} was not idle after {timeout:g} s", flying)
        try:
            commands.wait()
        except CommandError as error:
            first = first or error
    if first is not None:
        raise first


def timeout_error(what: str, flying: Sequence[Waitable]) -> CommandTimeout:
    """An error that names the command that runs now and the buffers that wait behind it."""
    buffers = [commands for commands in flying if not commands.is_done()]
    if not buffers:
        return CommandTimeout(f"{what}, but it is done now", None, ())
    dispatch, labels = buffers[0].running, tuple(commands.label for commands in buffers[1:])
    running = (f"{dispatch} of '{buffers[0].label}' is running" if dispatch
               else f"'{buffers[0].label}' is about to run")
    return CommandTimeout(f"{what}: {running}{_text_behind(labels)}",
                          dispatch.label if dispatch else None, labels)


def _text_behind(labels: tuple[str, ...]) -> str:
    if not labels:
        return ""
    named = ", ".join(f"'{label}'" for label in labels[:MOST_NAMED_BUFFERS])
    more = (f" and {len(labels) - MOST_NAMED_BUFFERS} more" if len(labels) > MOST_NAMED_BUFFERS
            else "")
    return f"; behind it wait {named}{more}"
