"""A cache of values, of which the one used longest ago goes first, and memory that is used
again."""

import gc
import weakref

import numpy as np

from postfx.caching import (
    MOST_IDLE_ARRAYS,
    LRUCache,
    SpareMemory,
    filled_array,
    new_array,
    reuse_memory,
)


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


def test_memory_serves_again_once_no_view_of_an_array_is_left():
    def place(array: np.ndarray) -> int:
        return array.__array_interface__["data"][0]

    spare = reuse_memory()
    one = filled_array((512, 512), 3)
    at, view = place(one), one[5:, 7:].T
    del one
    other = new_array((512, 512))
    assert place(other) != at and (view == 3).all(), "a view still shows the first one"
    del view
    assert (place(new_array((500, 512))) == at
            and place(new_array((9, 512))) != at), "the size decides"
    held = new_array((512, 512))
    assert (place(held) == at and held.flags.c_contiguous and held.flags.writeable
            and held.dtype == np.float32)
    del other
    for _ in range(2 * MOST_IDLE_ARRAYS):
        new_array((700, 700))
    assert [raw.nbytes for _, raw in spare._free] == [4 * 700 * 700], ("what serves nothing for "
                                                                       "long is given back")
    alive = weakref.ref(spare)
    del spare
    assert alive() is None, "an array that is still in use holds no other memory"
    held += 1


def test_no_more_memory_is_kept_than_is_allowed():
    spare = SpareMemory(least=0, most=2)
    arrays = [spare.empty((3, 5)) for _ in range(4)]
    assert not spare._free
    del arrays
    assert [raw.nbytes for _, raw in spare._free] == [60, 60]
    spare.empty((3, 5))
    assert len(spare._free) == 2, "one was taken, and came back"
    spare.clear()
    assert not spare._free
