"""Byte ranges behave like sets of bytes."""

import random

from postfx.runtime.memory import Ranges


def test_random_operations_match_a_set_of_bytes():
    rng = random.Random(3)
    for _ in range(50):
        ranges, bytes_ = Ranges(), set()
        for _ in range(40):
            start = rng.randrange(30)
            end = start + rng.randint(1, 8)
            if rng.random() < 0.6:
                ranges.add(start, end)
                bytes_ |= set(range(start, end))
            else:
                ranges.remove(start, end)
                bytes_ -= set(range(start, end))
            probe = rng.randrange(30)
            assert ranges.covers(probe, probe + 4) == set(range(probe, probe + 4)).issubset(bytes_)
            assert {b for s, e in ranges.spans for b in range(s, e)} == bytes_


def test_neighbours_merge():
    ranges = Ranges()
    ranges.add(0, 4)
    ranges.add(8, 12)
    ranges.add(4, 8)
    assert ranges.spans == ((0, 12),)


def test_copy_is_independent():
    ranges = Ranges(((0, 4),))
    other = ranges.copy()
    other.remove(0, 4)
    assert ranges.covers(0, 4) and not other.covers(0, 1)
