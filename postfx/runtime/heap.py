"""The heap: one arena from which all named tensors of a device are carved."""

from __future__ import annotations

import threading
import weakref
from collections import deque
from dataclasses import dataclass

from postfx.runtime.arena import Arena
from postfx.runtime.memory import ALIGNMENT, Chunk, Memory
from postfx.runtime.tensor import Allocation, Tensor, TensorDevice, Transient, size_in_bytes

CHUNK = 64 << 20
"""Smallest amount of memory asked from the system at once, bytes; untouched pages of it cost nothing on the host."""


@dataclass
class _Block:
    """A chunk and the spans of it that are free, sorted and merged."""

    chunk: Chunk
    free: list[tuple[int, int]]

    def best_fit(self, nbytes: int) -> int | None:
        """Size of the smallest free span that holds `nbytes`."""
        return min((end - start for start, end in self.free if end - start >= nbytes), default=None)

    def take(self, nbytes: int, fit: int) -> int:
        """Cut `nbytes` off the front of a span of `fit` bytes; returns the address."""
        index = next(i for i, (start, end) in enumerate(self.free) if end - start == fit)
        start, end = self.free[index]
        self.free[index:index + 1] = [(start + nbytes, end)] if start + nbytes < end else []
        return start

    def put_back(self, start: int, end: int) -> None:
        """Make [start, end) free again and merge it with its free neighbours."""
        merged: list[tuple[int, int]] = []
        for span in sorted([*self.free, (start, end)]):
            if merged and merged[-1][1] == span[0]:
                merged[-1] = (merged[-1][0], span[1])
            else:
                merged.append(span)
        self.free = merged

    @property
    def idle(self) -> bool:
        """Whether nothing is carved from the chunk."""
        return self.free == [(self.chunk.pointer, self.chunk.pointer + self.chunk.nbytes)]


class Heap:
    """The device's memory. A tensor's memory returns to it on `release()` or when the last view of it is dropped.

    Memory is zeroed by nobody: reading a tensor before it is written or uploaded is a HazardError.

    Attributes:
        arena: memory that transient tensors share.
        allocations: how many times memory was carved from chunks so far.
    """

    def __init__(self, device: TensorDevice, memory: Memory) -> None:
        self._device = device
        self._memory = memory
        self._blocks: list[_Block] = []
        self._returned: deque[tuple[int, int]] = deque()
        self._live: weakref.WeakSet[Allocation] = weakref.WeakSet()
        self._lock = threading.Lock()
        self._used = 0
        self._peak = 0
        self.arena = Arena(device)
        self.allocations = 0

    def tensor(self, name: str, shape: tuple[int, ...], dtype: str = "float32") -> Tensor:
        """A new tensor of undefined content. `name` is what messages call it and need not be unique."""
        nbytes = -(-max(1, size_in_bytes(shape, dtype)) // ALIGNMENT) * ALIGNMENT
        with self._lock:
            chunk, start = self._carve(nbytes)
        allocation = Allocation(name, start, nbytes, owner=chunk)
        # Finalizers may run in any thread and in the middle of anything, so they only leave a note.
        allocation.on_release(self._returned.append, (start, start + nbytes))
        self._live.add(allocation)
        return Tensor(self._device, name, shape, dtype, allocation)

    def transient(self, name: str, shape: tuple[int, ...], dtype: str = "float32") -> Tensor:
        """A new tensor for commands of one command buffer: memory is shared with others that are used at other times.

        In every buffer that uses it a command must write it before one reads it: HazardError at commit otherwise. It
        has memory from commit on, and content until its bytes go to another tensor or another buffer with transient
        tensors is committed. The host may look at it until then, and never writes it.
        """
        if self._device.scratch:  # the arena is one piece, which as a whole would lie in a file
            return self.tensor(name, shape, dtype)
        return self.arena.tensor(name, shape, dtype)

    def gone(self, transient: Transient) -> str | None:
        """Why a transient tensor holds nothing any more, as a clause; None while its content is there."""
        return self.arena.gone(transient)

    @property
    def size(self) -> int:
        """Bytes held from the system, used or free."""
        with self._lock:
            return sum(block.chunk.nbytes for block in self._blocks)

    @property
    def used(self) -> int:
        """Bytes of the tensors that live now."""
        with self._lock:
            self._collect()
            return self._used

    @property
    def peak(self) -> int:
        """Most bytes that were in use at once."""
        return self._peak

    def tensors(self) -> list[tuple[str, int]]:
        """Name and bytes of every tensor that lives now, largest first."""
        held = [(allocation.name, allocation.nbytes) for allocation in self._live if not allocation.released]
        return sorted(held, key=lambda item: (-item[1], item[0]))

    def trim(self) -> None:
        """Give chunks in which no tensor lives back to the system."""
        with self._lock:
            self._collect()
            self._drop_idle()

    def _carve(self, nbytes: int) -> tuple[Chunk, int]:
        self._collect()
        self.allocations += 1
        fits = [(block.best_fit(nbytes), index) for index, block in enumerate(self._blocks)]
        found = min(((fit, index) for fit, index in fits if fit is not None), default=None)
        block = self._blocks[found[1]] if found else self._grow(nbytes)
        self._used += nbytes
        self._peak = max(self._peak, self._used)
        return block.chunk, block.take(nbytes, found[0] if found else block.chunk.nbytes)

    def _grow(self, nbytes: int) -> _Block:
        self._drop_idle()  # too small for this tensor; keeping them would hold the sum of all sizes ever used
        chunk = self._memory.allocate(max(nbytes, CHUNK))
        self._blocks.append(_Block(chunk, [(chunk.pointer, chunk.pointer + chunk.nbytes)]))
        return self._blocks[-1]

    def _drop_idle(self) -> None:
        self._blocks = [block for block in self._blocks if not block.idle]

    def _collect(self) -> None:
        while self._returned:
            start, end = self._returned.popleft()
            for block in self._blocks:
                if block.chunk.pointer <= start < block.chunk.pointer + block.chunk.nbytes:
                    block.put_back(start, end)
            self._used -= end - start
