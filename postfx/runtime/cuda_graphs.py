"""CUDA graphs: commands that were put on a stream before with the same tensors are launched as one."""

from __future__ import annotations

import sys
from collections.abc import Callable, Hashable
from typing import Any

from postfx.caching import LRUCache
from postfx.runtime.cuda_driver import checked, driver

MOST = 16
"""Graphs that are kept; with history kept in turns, a pipeline needs two."""


class Event:
    """A moment on a stream; part of a graph where it is recorded while one is captured."""

    def __init__(self, stream: int, captured: bool) -> None:
        self.handle = checked(driver().cuEventCreate(0))
        external = driver().CUevent_record_flags.CU_EVENT_RECORD_EXTERNAL if captured else 0
        checked(driver().cuEventRecordWithFlags(self.handle, stream, int(external)))

    def until(self, end: Event) -> float:
        """Milliseconds from this event to another; both have to have happened."""
        return checked(driver().cuEventElapsedTime(self.handle, end.handle))

    def __del__(self) -> None:
        if hasattr(self, "handle") and not sys.is_finalizing():
            driver().cuEventDestroy(self.handle)


class Graph:
    """A captured graph, with what the capturing function returned and what has to live as long as it."""

    def __init__(self, captured: Any, result: Any, kept: Any) -> None:
        self.result = result
        self._kept = kept
        try:
            self._executable = checked(driver().cuGraphInstantiate(captured, 0))
        finally:
            driver().cuGraphDestroy(captured)

    def launch(self, stream: int) -> None:
        """Put the graph on a stream."""
        checked(driver().cuGraphLaunch(self._executable, stream))

    def __del__(self) -> None:
        if hasattr(self, "_executable") and not sys.is_finalizing():
            driver().cuGraphExecDestroy(self._executable)


class CudaGraphs:
    """Graphs of one stream, by what identifies their commands.

    Commands run one by one at first, since libraries choose their algorithms and take their memory then; the second
    time they are captured. What cannot be captured runs one by one for ever.
    """

    def __init__(self, stream: int) -> None:
        self._stream = stream
        self._known: LRUCache[Hashable, Graph | None] = LRUCache(MOST)  # None: ran, but was not captured
        self._refused: LRUCache[Hashable, None] = LRUCache(MOST)
        self.capturing = False

    def replay(self, key: Hashable, kept: Any, enqueue: Callable[[], Any]) -> Any:
        """Launch what `enqueue` puts on the stream; returns what it returned, None when it has to run one by one."""
        if key in self._refused:
            return None
        if key not in self._known:
            self._known[key] = None
            return None
        graph = self._known[key] or self._capture(enqueue, kept)
        if graph is None:
            self._refused[key] = None
            return None
        self._known[key] = graph
        graph.launch(self._stream)
        return graph.result

    def _capture(self, enqueue: Callable[[], Any], kept: Any) -> Graph | None:
        mode = driver().CUstreamCaptureMode.CU_STREAM_CAPTURE_MODE_RELAXED
        checked(driver().cuStreamBeginCapture(self._stream, mode))
        self.capturing, result = True, None
        try:
            result = enqueue()
        except Exception:  # a command that may not be captured; it runs one by one, where its error counts
            result = None
        finally:
            self.capturing = False
            status, captured = driver().cuStreamEndCapture(self._stream)
        if int(status):
            return None
        graph = Graph(captured, result, kept)
        return graph if result is not None else None
