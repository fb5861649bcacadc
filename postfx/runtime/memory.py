"""Memory of a device: chunks to carve tensors from, and copies between a chunk and the host."""

from __future__ import annotations

import ctypes
import math
from typing import Protocol

import numpy as np

ALIGNMENT = 256
"""Byte alignment of every tensor: a multiple of the cache line and of what GPU copies like."""


class Chunk(Protocol):
    """One piece of device memory of `nbytes` bytes, at `pointer` in the device's address space."""

    pointer: int
    nbytes: int


class Memory(Protocol):
    """Where a device's tensors live. `host_visible` tells whether NumPy can look at it without a copy."""

    host_visible: bool

    def allocate(self, nbytes: int) -> Chunk:
        """A new chunk of at least `nbytes` bytes, aligned to `ALIGNMENT` on the host."""
        ...

    def write(self, pointer: int, array: np.ndarray) -> None:
        """Copy a C-contiguous host array to `pointer`."""
        ...

    def read(self, pointer: int, array: np.ndarray) -> None:
        """Copy from `pointer` into a C-contiguous host array."""
        ...

    def synchronise(self) -> None:
        """Wait until all that was begun is done."""
        ...


class HostChunk:
    """A chunk of host memory; pages that are never touched cost nothing."""

    def __init__(self, nbytes: int) -> None:
        self._storage = np.empty(nbytes + ALIGNMENT, np.uint8)
        start = -address(self._storage) % ALIGNMENT
        self.pointer = address(self._storage) + start
        self.nbytes = nbytes


class HostMemory:
    """Memory that NumPy, compiled kernels and CPU sessions share."""

    host_visible = True

    def allocate(self, nbytes: int) -> HostChunk:
        """A new chunk of host memory."""
        return HostChunk(nbytes)

    def write(self, pointer: int, array: np.ndarray) -> None:
        """Copy a C-contiguous array to `pointer`."""
        ctypes.memmove(pointer, address(array), array.nbytes)

    def read(self, pointer: int, array: np.ndarray) -> None:
        """Copy from `pointer` into a C-contiguous array."""
        ctypes.memmove(address(array), pointer, array.nbytes)

    def synchronise(self) -> None:
        """Nothing to wait for: work is done when its call returns."""


def address(array: np.ndarray) -> int:
    """Address of an array's first element."""
    return array.__array_interface__["data"][0]


def view_at(pointer: int, shape: tuple[int, ...], dtype: str, owner: object) -> np.ndarray:
    """A writable array over host memory; it keeps `owner`, which holds the memory, alive."""
    nbytes = math.prod(shape) * np.dtype(dtype).itemsize
    buffer = (ctypes.c_char * nbytes).from_address(pointer)
    buffer.owner = owner
    return np.frombuffer(buffer, dtype).reshape(shape)
