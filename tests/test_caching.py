"""A cache of values, of which the one used longest ago goes first."""

import gc
import weakref

from postfx.caching import LRUCache


class Costly:
    """Something that can be seen to be gone."""


def test_the_one_used_longest_ago_goes_before_another_is_made():
    made, alive = [], weakref.WeakValueDictionary()
    cache: LRUCache[str, Costly] = LRUCache(2)

    def make(key):
        def now():
            made.append((key, sorted(alive)))
            alive[key] = value = Costly()
            return value
        return now

    gc.disable()  # memory must come back without it
    try:
        for key in "abaca":
            cache.get_or_make(key, make(key))
    finally:
        gc.enable()
    assert made == [("a", []), ("b", ["a"]), ("c", ["a"])] and sorted(alive) == ["a", "c"]
    assert "a" in cache and "b" not in cache and len(cache) == 2
    cache.clear()
    assert not alive and len(cache) == 0


def test_reading_and_setting_count_as_use():
    cache: LRUCache[str, int] = LRUCache(2)
    cache["a"], cache["b"] = 1, 2
    assert cache["a"] == 1
    cache["c"] = 3
    assert list(cache) == ["a", "c"]
    cache["a"] = 4
    cache["d"] = 5
    assert list(cache) == ["a", "d"] and cache["a"] == 4
