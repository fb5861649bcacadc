"""Offsets for tensors that share memory: two may share bytes when all uses of one come before all uses of the other."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from postfx.runtime.ordering import predecessors
from postfx.runtime.records import Record

Uses = Sequence[tuple[int, ...]]
"""For every dispatch, in order, the numbers of the tensors it uses."""


@dataclass(frozen=True)
class Plan:
    """Where the transient tensors of a command buffer lie.

    Attributes:
        offsets: of each tensor, bytes.
        nbytes: memory that they need together.
        bound: largest sum of sizes in use at once, as far as commands recorded one after the other may run at once; no
            plan needs less.
        total: what they would need without sharing.
        takers: of each tensor, the number of one that takes some of its bytes later, or None.
    """

    offsets: tuple[int, ...]
    nbytes: int
    bound: int
    total: int
    takers: tuple[int | None, ...]

    def __str__(self) -> str:
        over = 100 * (self.nbytes / self.bound - 1) if self.bound else 0.0
        sizes = f"{_megabytes(self.nbytes)} for {_megabytes(self.total)} in {len(self.offsets)} tensors"
        return f"{sizes}, {over:.1f} % over the bound {_megabytes(self.bound)}"


class Present(NamedTuple):
    """Memory that there is, and where in it the tensors lie already: offsets, or -1."""

    nbytes: int
    offsets: Sequence[int]


def make_plan(
    sizes: Sequence[int], uses: Uses, kept: Iterable[int], records: Iterable[Record], present: Present | None = None
) -> Plan:
    """Place tensors of these sizes. Those used by commands in no certain order never share a byte.

    Several orders of placing are tried, and the one that needs the least memory is taken.

    Args:
        kept: numbers of tensors whose content is to be there after the last dispatch.
        records: the dispatches of `uses`, and the barriers.
        present: tensors stay where they are if that is allowed and the memory holds the others, too.
    """
    users = _users([*uses, tuple(kept)], len(sizes))
    earlier = [*predecessors(records), (1 << len(uses)) - 1]
    before = _before(users, earlier)
    apart = [[other for other in range(len(sizes)) if not _ordered(before, item, other)] for item in range(len(sizes))]
    spans = [(_first(mask), mask.bit_length()) for mask in users]
    orders = (
        sorted(range(len(sizes)), key=lambda i: -sizes[i]),
        sorted(range(len(sizes)), key=lambda i: (spans[i][0] - spans[i][1], -sizes[i])),
        sorted(range(len(sizes)), key=lambda i: -sizes[i] * (spans[i][1] - spans[i][0])),
        sorted(range(len(sizes)), key=lambda i: (spans[i][0], -sizes[i])),
    )
    offsets = _settled(present, sizes, apart) if present else None
    if offsets is None:
        tried = [_place(order, sizes, apart, [-1] * len(sizes)) for order in orders]
        offsets = min(tried, key=lambda offsets: _end(offsets, sizes))
    by_time = sorted(range(len(sizes)), key=lambda i: spans[i])
    takers = tuple(next(_takers(i, by_time, offsets, sizes, before), None) for i in range(len(sizes)))
    return Plan(tuple(offsets), _end(offsets, sizes), _bound(spans, sizes, earlier), sum(sizes), takers)


def _users(uses: Uses, count: int) -> list[int]:
    """For every tensor, the dispatches that use it, as a bit mask."""
    users = [0] * count
    for index, numbers in enumerate(uses):
        for number in numbers:
            users[number] |= 1 << index
    return users


def _before(users: Sequence[int], earlier: Sequence[int]) -> list[int]:
    """For every tensor, the tensors that are done with before its first use, as a bit mask."""
    result = []
    for mask in users:
        common = -1
        for index in _bits(mask):
            common &= earlier[index]
        result.append(sum(1 << other for other, used in enumerate(users) if used & ~common == 0))
    return result


def _ordered(before: Sequence[int], one: int, other: int) -> bool:
    return one == other or bool(before[one] >> other & 1 or before[other] >> one & 1)


def _settled(present: Present, sizes: Sequence[int], apart: Sequence[Sequence[int]]) -> list[int] | None:
    """Offsets that leave tensors where they are; None when none lies there or may, or the others find no room."""
    lying = [item for item, offset in enumerate(present.offsets) if offset >= 0]
    if not lying or any(_touch(item, other, present.offsets, sizes) for item in lying for other in apart[item]):
        return None
    others = sorted(set(range(len(sizes))).difference(lying), key=lambda i: -sizes[i])
    offsets = _place(others, sizes, apart, list(present.offsets))
    return offsets if _end(offsets, sizes) <= present.nbytes else None


def _place(
    order: Iterable[int], sizes: Sequence[int], apart: Sequence[Sequence[int]], offsets: list[int]
) -> list[int]:
    """Put each tensor into the smallest gap that holds it, between those placed already that it must not touch."""
    for item in order:
        taken = sorted((offsets[other], offsets[other] + sizes[other]) for other in apart[item] if offsets[other] >= 0)
        gaps, end = [], 0
        for low, high in taken:
            if low - end >= sizes[item]:
                gaps.append((low - end, end))
            end = max(end, high)
        offsets[item] = min(gaps)[1] if gaps else end
    return offsets


def _takers(
    item: int, by_time: Iterable[int], offsets: Sequence[int], sizes: Sequence[int], before: Sequence[int]
) -> Iterator[int]:
    return (i for i in by_time if before[i] >> item & 1 and _touch(item, i, offsets, sizes))


def _touch(one: int, other: int, offsets: Sequence[int], sizes: Sequence[int]) -> bool:
    """Whether two tensors share a byte; those with no place share none."""
    first, second = offsets[one], offsets[other]
    return min(first, second) >= 0 and first < second + sizes[other] and second < first + sizes[one]


def _bound(spans: Sequence[tuple[int, int]], sizes: Sequence[int], earlier: Sequence[int]) -> int:
    """Tensors in use during dispatches that may run at once are in use at once: none is done with before another."""
    most = last = 0
    for first in range(len(earlier)):
        while last < len(earlier) and earlier[last] >> first == 0:
            last += 1
        most = max(most, sum(n for n, (low, end) in zip(sizes, spans, strict=True) if low < last and first < end))
    return most


def _end(offsets: Sequence[int], sizes: Sequence[int]) -> int:
    return max(offset + size for offset, size in zip(offsets, sizes, strict=True))


def _first(mask: int) -> int:
    return (mask & -mask).bit_length() - 1


def _bits(mask: int) -> Iterable[int]:
    while mask:
        yield _first(mask)
        mask &= mask - 1


def _megabytes(nbytes: int) -> str:
    return f"{nbytes / (1 << 20):.1f} MiB"
