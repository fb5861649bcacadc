"""Memory of a device: chunks to carve tensors from, copies between a chunk and the host, and sets of byte ranges."""

from __future__ import annotations

import ctypes
import math
import time
import weakref
from collections.abc import Callable, Hashable
from typing import Any, Protocol, TypeVar

import numpy as np

from postfx.system import Scratch

T = TypeVar("T")
TENSORS = 0.4
"""Share of the memory budget for tensors; the rest is for networks."""
ALIGNMENT = 256
"""Byte alignment of every tensor: a multiple of the cache line and of efficient GPU copies."""


class Chunk(Protocol):
    """One piece of device memory of `nbytes` bytes, at `pointer` in the device's address space."""

    pointer: int
    nbytes: int


class Memory(Protocol):
    """Where a device's tensors live. `host_visible`: NumPy can access it without a copy; `replays`: `replay`
    can run commands as one CUDA graph."""

    host_visible: bool
    replays: bool

    def allocate(self, nbytes: int) -> Chunk:
        """A new chunk of at least `nbytes` bytes, aligned to `ALIGNMENT` on the host."""
        ...

    def write(self, pointer: int, array: np.ndarray) -> None:
        """Copy a C-contiguous host array to `pointer`."""
        ...

    def read(self, pointer: int, array: np.ndarray) -> None:
        """Copy from `pointer` into a C-contiguous host array."""
        ...

    def copy(self, target: int, source: int, nbytes: int) -> None:
        """Copy within the device's memory, in the order of its commands."""
        ...

    def synchronise(self) -> None:
        """Wait until all started work is done."""
        ...

    def relax(self) -> None:
        """After a dispatch: drop pages that need not stay in memory."""
        ...

    def mark(self) -> Any:
        """A mark at this point of the device's work."""
        ...

    def milliseconds(self, begin: Any, end: Any) -> float:
        """Time between two marks; call it after `synchronise`."""
        ...

    def replay(self, key: Hashable, kept: object, enqueue: Callable[[], T]) -> T | None:
        """Run the work of `enqueue` again as one graph and return its result.

        None if it has to run command by command; nothing has run then. `key` identifies unchanged work; `kept` is kept
        alive as long as the graph.
        """
        ...


class Immediate:
    """Memory whose commands are done when their call returns."""

    replays = False

    def relax(self) -> None:
        """Does nothing."""

    def synchronise(self) -> None:
        """Does nothing: no work is pending."""

    def mark(self) -> float:
        """The time in seconds."""
        return time.perf_counter()

    def milliseconds(self, begin: float, end: float) -> float:
        """Time between two marks."""
        return 1e3 * (end - begin)

    def replay(self, key: Hashable, kept: object, enqueue: Callable[[], T]) -> T | None:
        """None: commands always run one by one."""
        return None


class HostChunk:
    """A chunk of host memory; pages that are never touched cost nothing."""

    def __init__(self, nbytes: int) -> None:
        self._storage = np.empty(nbytes + ALIGNMENT, np.uint8)
        start = -address(self._storage) % ALIGNMENT
        self.pointer = address(self._storage) + start
        self.nbytes = nbytes


class MappedChunk:
    """A chunk in a temporary file."""

    def __init__(self, scratch: Scratch, nbytes: int) -> None:
        self._storage = np.frombuffer(scratch.map_file(nbytes), np.uint8)
        self.pointer = address(self._storage)
        self.nbytes = nbytes


class HostMemory(Immediate):
    """Memory that NumPy, compiled kernels and CPU sessions share. With a budget, large chunks beyond its share for
    tensors lie in temporary files."""

    host_visible = True

    def __init__(self, scratch: Scratch | None = None) -> None:
        self._scratch = scratch
        self._held: weakref.WeakSet[HostChunk] = weakref.WeakSet()

    def allocate(self, nbytes: int) -> HostChunk | MappedChunk:
        """A new chunk of host memory."""
        if self._scratch is not None:
            held = sum(chunk.nbytes for chunk in self._held)
            if held + nbytes > TENSORS * self._scratch.left:
                return MappedChunk(self._scratch, nbytes)
        chunk = HostChunk(nbytes)
        self._held.add(chunk)
        return chunk

    def relax(self) -> None:
        """Drop the pages of temporary files from memory."""
        if self._scratch is not None:
            self._scratch.relax()

    def write(self, pointer: int, array: np.ndarray) -> None:
        """Copy a C-contiguous array to `pointer`."""
        ctypes.memmove(pointer, address(array), array.nbytes)

    def read(self, pointer: int, array: np.ndarray) -> None:
        """Copy from `pointer` into a C-contiguous array."""
        ctypes.memmove(address(array), pointer, array.nbytes)

    def copy(self, target: int, source: int, nbytes: int) -> None:
        """Copy bytes that do not overlap."""
        ctypes.memmove(target, source, nbytes)


def address(array: np.ndarray) -> int:
    """Address of an array's first element."""
    return int(array.__array_interface__["data"][0])


def byte_span(array: np.ndarray) -> tuple[int, int]:
    """Addresses of an array's first byte and of the one after its last, whatever its strides."""
    reach = [(size - 1) * stride for size, stride in zip(array.shape, array.strides, strict=True) if array.size]
    first, last = (address(array) + sum(pick(0, step) for step in reach) for pick in (min, max))
    return first, last + array.itemsize * bool(array.size)


def view_at(pointer: int, shape: tuple[int, ...], dtype: np.dtype[Any], owner: object) -> np.ndarray:
    """A writable array over host memory; it keeps `owner`, which holds the memory, alive."""
    nbytes = math.prod(shape) * dtype.itemsize
    buffer: Any = (ctypes.c_char * nbytes).from_address(pointer)
    buffer.owner = owner
    view: np.ndarray = np.frombuffer(buffer, dtype)
    return view.reshape(shape)


class Ranges:
    """A set of half-open byte ranges [start, end), kept sorted and merged."""

    def __init__(self, spans: tuple[tuple[int, int], ...] = ()) -> None:
        self.spans = spans

    def copy(self) -> Ranges:
        """An independent copy."""
        return Ranges(self.spans)

    def add(self, start: int, end: int) -> None:
        """Include [start, end)."""
        if self.covers(start, end):
            return
        apart = [span for span in self.spans if span[1] < start or span[0] > end]
        joined = [span for span in self.spans if not (span[1] < start or span[0] > end)]
        merged = (min([start, *(s for s, _ in joined)]), max([end, *(e for _, e in joined)]))
        self.spans = tuple(sorted([*apart, merged]))

    def remove(self, start: int, end: int) -> None:
        """Exclude [start, end)."""
        left = [(s, min(e, start)) for s, e in self.spans if s < start]
        right = [(max(s, end), e) for s, e in self.spans if e > end]
        self.spans = tuple(sorted({*left, *right}))

    def subtract(self, other: Ranges) -> None:
        """Exclude all of another set."""
        for span in other.spans:
            self.remove(*span)

    def covers(self, start: int, end: int) -> bool:
        """Whether every byte of [start, end) is included."""
        return any(s <= start and end <= e for s, e in self.spans)

    def includes(self, other: Ranges) -> bool:
        """Whether every byte of another set is included."""
        return all(self.covers(*span) for span in other.spans)

    def touches(self, other: Ranges) -> bool:
        """Whether any byte of another set is included."""
        return any(s < end and start < e for s, e in self.spans for start, end in other.spans)
