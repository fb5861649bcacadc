"""Pools of threads, without anything that takes time to import."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
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
        fulfil = partial(_fulfil, future, partial(fn, *args, **kwargs))
        try:
            threading.Thread(target=fulfil).start()
        except RuntimeError:  # from Python 3.12 on, exit functions can start no thread
            fulfil()
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the pool: it takes no more work."""
        self._is_over = True
        super().shutdown(wait, cancel_futures=cancel_futures)


def _fulfil(future: Future[Any], task: Callable[[], Any]) -> None:
    if not future.set_running_or_notify_cancel():
        return
    try:
        future.set_result(task())
    except BaseException as error:
        future.set_exception(error)
