"""A cache of things that are costly to make: the one used longest ago goes first."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator
from typing import Generic, TypeVar

Key = TypeVar("Key", bound=Hashable)
Value = TypeVar("Value")


class LRUCache(Generic[Key, Value]):
    """At most `most` values by key. To read or set a value is to use it; to iterate over the keys is not."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._values: OrderedDict[Key, Value] = OrderedDict()

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

    def get_or_make(self, key: Key, make: Callable[[], Value]) -> Value:
        """The key's value, made if there is none. The oldest one goes before that, so that its memory is free."""
        if key not in self._values:
            self._make_room()
            self._values[key] = make()
        return self[key]

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
