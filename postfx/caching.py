"""What is costly to make is kept: things, of which the one used longest ago goes first, and memory
of arrays."""

from __future__ import annotations

import math
import threading
import weakref
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator
from typing import Generic, TypeVar

import numpy as np

Key = TypeVar("Key", bound=Hashable)
Value = TypeVar("Value")
LEAST_REUSED = 1 << 18
"""Bytes of an array whose memory is worth keeping."""
LARGER = 1.25
"""How many times as large as an array the memory may be that it gets."""
MOST_IDLE_ARRAYS = 256
"""Arrays that are made before memory that served none of them goes back to the system."""


class LRUCache(Generic[Key, Value]):
    """At most `most` values by key. To read or set a value is to use it; to iterate over the keys
    is not. Several threads may `find` and `keep`."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._values: OrderedDict[Key, Value] = OrderedDict()
        self._lock = threading.Lock()

    def __contains__(self, key: object) -> bool:
        return key in self._values

    def __iter__(self) -> Iterator[Key]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __getitem__(self, key: Key) -> Value:
        """The key's value; KeyError if there is none."""
        self._values.move_to_end(key)
        return self._values[key]

    def __setitem__(self, key: Key, value: Value) -> None:
        if key not in self._values:
            self._make_room()
        self._values[key] = value
        self._values.move_to_end(key)

    def find(self, key: Key) -> Value | None:
        """The key's value, which this uses; None if there is none."""
        with self._lock:
            found = self._values.get(key)
            if found is not None:
                self._values.move_to_end(key)
        return found

    def keep(self, key: Key, value: Value) -> Value:
        """Keep a value in the place of one with the same key; returns it."""
        with self._lock:
            self[key] = value
        return value

    def get_or_make(self, key: Key, make: Callable[[], Value]) -> Value:
        """The key's value, made if there is none. The oldest one goes before that, so that its
        memory is free."""
        if key not in self._values:
            self._make_room()
            self._values[key] = make()
        self._values.move_to_end(key)
        return self._values[key]

    def peek(self, key: Key) -> Value:
        """The key's value, which does not count as used; KeyError if there is none."""
        return self._values[key]

    def drop(self, key: Key) -> None:
        """Forget a key; KeyError if there is none."""
        del self._values[key]

    def clear(self) -> None:
        """Drop all values."""
        self._values.clear()

    def _make_room(self) -> None:
        while len(self._values) >= self._most:
            self._values.popitem(last=False)


class SpareMemory:
    """Memory of arrays that are gone, for new ones: pages that are new from the system must be
    cleared first. That costs five to ten percent of an interpolated frame's time.

    Args:
        least: bytes of an array whose memory is worth keeping.
        most: pieces of memory that are kept; None: all.
    """

    def __init__(self, least: int = LEAST_REUSED, most: int | None = None) -> None:
        self._least, self._most = least, most
        self._free: list[tuple[int, np.ndarray]] = []
        self._made, self._lock = 0, threading.Lock()

    def empty(self, shape: tuple[int, ...], dtype: np.typing.DTypeLike = "float32") -> np.ndarray:
        """An array of any content."""
        count = math.prod(shape)
        nbytes = count * np.dtype(dtype).itemsize
        if nbytes < max(self._least, 1):
            return np.empty(shape, dtype)
        with self._lock:
            self._made += 1
            self._free[:] = [one for one in self._free if one[0] > self._made - MOST_IDLE_ARRAYS]
            fitting = [(raw.nbytes, -place) for place, (_, raw) in enumerate(self._free)
                       if nbytes <= raw.nbytes <= LARGER * nbytes]
            # the newest of the smallest
            raw = (self._free.pop(-min(fitting)[1])[1] if fitting
                   else np.empty(nbytes, np.uint8))
        # all views of it refer to this array, not to the memory
        found = np.frombuffer(raw.data, dtype, count)
        weakref.finalize(found, self._take_back, weakref.ref(self), raw).atexit = False
        return found.reshape(shape)

    @staticmethod
    def _take_back(to: weakref.ref[SpareMemory], raw: np.ndarray) -> None:
        """Take back the memory of an array that is gone. One that outlives the others' memory does
        not hold it.

        This may run at any time, even within `empty`. It only appends, so that places in the list
        stay.
        """
        spare = to()
        if spare is not None and (spare._most is None or len(spare._free) < spare._most):
            spare._free.append((spare._made, raw))

    def clear(self) -> None:
        """Let go of the memory that waits."""
        with self._lock:
            self._free.clear()


_spare: weakref.WeakSet[SpareMemory] = weakref.WeakSet()


def reuse_memory() -> SpareMemory:
    """The memory that `new_array` takes arrays from, for as long as somebody holds it."""
    found = next(iter(_spare), None) or SpareMemory()
    _spare.add(found)
    return found


def new_array(shape: tuple[int, ...], dtype: np.typing.DTypeLike = "float32") -> np.ndarray:
    """An array of any content, in memory of one that is gone where that is kept."""
    spare = next(iter(_spare), None)
    return np.empty(shape, dtype) if spare is None else spare.empty(shape, dtype)


def filled_array(shape: tuple[int, ...], value: float | np.float32) -> np.ndarray:
    """An array of float32 that holds one value, in memory of one that is gone where that is
    kept."""
    found = new_array(shape)
    found.fill(value)
    return found
