"""Pools of threads, and work that a program waits for before it ends, without anything that takes
time to import."""

from __future__ import annotations

import atexit
import os
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from typing import Any


class Workers(ThreadPoolExecutor):
    """A pool of threads that serves the program to its end: pools of Python refuse work from the
    moment that the main thread is done, while the program's own threads still run, and in its exit
    functions."""

    _is_over = False

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Start a function; its result or error is in the future."""
        try:
            return super().submit(fn, *args, **kwargs)
        except RuntimeError:
            if self._is_over:
                raise
        future: Future[Any] = Future()
        begun = threading.Event()
        fulfil = partial(_fulfil, future, partial(fn, *args, **kwargs), begun)
        with finished_before_the_end():  # until the thread has begun its own work
            try:
                Server(target=fulfil).start()
            except RuntimeError:  # none can begin any more
                fulfil()
            begun.wait()
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the pool: it takes no more work."""
        self._is_over = True
        super().shutdown(wait, cancel_futures=cancel_futures)


class Server(threading.Thread):
    """A thread that works for others while the program ends, which waits for its work by
    `end_work`. Python itself does not: it would wait for as long as other threads begin some."""

    def __init__(self, target: Callable[..., Any], args: tuple[Any, ...] = (),
                 name: str | None = None) -> None:
        super().__init__(target=target, args=args, name=name, daemon=True)


def can_begin_threads() -> bool:
    """Whether a thread can begin: from Python 3.12 on none can once the main thread is done."""
    try:
        Server(target=int).start()
    except RuntimeError:
        return False
    return True


class _UnderWay:
    """How often each thread is in work that is finished before the program ends. Python waits for
    none of its daemon threads, and stops them wherever they are."""

    def __init__(self) -> None:
        self.reset()
        atexit.register(self.end)
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(after_in_child=self.reset)  # which has none of the other threads

    def reset(self) -> None:
        self._changed, self._threads = threading.Condition(), Counter[int]()
        self._is_ending = False

    def begin(self) -> None:
        """This thread begins such work. Once the program ends, a daemon thread that is at none
        stays here for good, unless it is a server."""
        thread = threading.current_thread()
        is_stopped = thread.daemon and not isinstance(thread, Server)
        with self._changed:
            if self._is_ending and is_stopped and thread.ident not in self._threads:
                self._changed.wait_for(lambda: False)
            self._threads[threading.get_ident()] += 1

    def finish(self) -> None:
        """This thread is done with it."""
        with self._changed:
            self._threads[ident := threading.get_ident()] -= 1
            if not self._threads[ident]:
                del self._threads[ident]
            self._changed.notify_all()

    def end(self) -> None:
        """Let no daemon thread begin, and wait for all other threads that are at such work."""
        own = {threading.get_ident()}
        with self._changed:
            self._is_ending = True
            self._changed.wait_for(lambda: self._threads.keys() <= own)


_under_way = _UnderWay()


@contextmanager
def finished_before_the_end() -> Iterator[None]:
    """The program does not end while a thread of any kind is inside: to stop one there could leave
    half a file, or abort the process inside of a library."""
    _under_way.begin()
    try:
        yield
    finally:
        _under_way.finish()


def end_work() -> None:
    """The program ends: wait for other threads that are at work, and let no daemon thread begin."""
    _under_way.end()


@finished_before_the_end()
def _fulfil(future: Future[Any], task: Callable[[], Any], begun: threading.Event) -> None:
    begun.set()
    if not future.set_running_or_notify_cancel():
        return
    try:
        future.set_result(task())
    except BaseException as error:
        future.set_exception(error)
