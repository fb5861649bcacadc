"""Pools of threads, without anything that takes time to import."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import Any


class Workers(ThreadPoolExecutor):
    """A pool of threads that also serves the program's own threads while the interpreter waits for
    them to end: pools of Python refuse work from the moment that the main thread is done."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Start a function; its result or error is in the future."""
        try:
            return super().submit(fn, *args, **kwargs)
        except RuntimeError as error:
            if "interpreter shutdown" not in str(error):
                raise
        future: Future[Any] = Future()
        threading.Thread(target=_fulfil, args=(future, partial(fn, *args, **kwargs))).start()
        return future


def _fulfil(future: Future[Any], task: Callable[[], Any]) -> None:
    try:
        future.set_result(task())
    except BaseException as error:
        future.set_exception(error)
