"""Values kept for when they are needed again."""

import gc
import weakref

from postfx.recent import Recent


class Costly:
    """Something that can be seen to be gone."""


def test_the_one_used_longest_ago_goes_before_another_is_made():
    made, alive = [], weakref.WeakValueDictionary()
    recent: Recent[Costly] = Recent(2)

    def make(key):
        def now():
            made.append((key, sorted(alive)))
            alive[key] = value = Costly()
            return value
        return now

    gc.disable()  # memory must come back without it
    try:
        for key in "abaca":
            recent.get(key, make(key))
    finally:
        gc.enable()
    assert made == [("a", []), ("b", ["a"]), ("c", ["a"])] and sorted(alive) == ["a", "c"]
    assert "a" in recent and "b" not in recent and len(recent) == 2
    recent.clear()
    assert not alive and len(recent) == 0
