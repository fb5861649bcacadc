"""Offsets for tensors that share memory: two may share bytes when all uses of one come before all uses of the other."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

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
        bound: largest sum of sizes in use at once; no plan needs less.
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


def make_plan(sizes: Sequence[int], uses: Uses, kept: Iterable[int], records: Iterable[Record]) -> Plan:
    """Place tensors of these sizes. Those used by commands in no certain order never share a byte.

    Several orders of placing are tried, and the one that needs the least memory is taken.

    Args:
        kept: numbers of tensors whose content is to be there after the last dispatch.
        records: the dispatches of `uses`, and the barriers.
    """
    users = _users([*uses, tuple(kept)], len(sizes))
    before = _before(users, [*predecessors(records), (1 << len(uses)) - 1])
    apart = [[other for other in range(len(sizes)) if not _ordered(before, item, other)] for item in range(len(sizes))]
    spans = [(_first(mask), mask.bit_length()) for mask in users]
    orders = (
        sorted(range(len(sizes)), key=lambda i: -sizes[i]),
        sorted(range(len(sizes)), key=lambda i: (spans[i][0] - spans[i][1], -sizes[i])),
        sorted(range(len(sizes)), key=lambda i: -sizes[i] * (spans[i][1] - spans[i][0])),
        sorted(range(len(sizes)), key=lambda i: (spans[i][0], -sizes[i])),
    )
    offsets = min((_place(order, sizes, apart) for order in orders), key=lambda offsets: _end(offsets, sizes))
    by_time = sorted(range(len(sizes)), key=lambda i: spans[i])
    takers = tuple(next(_takers(i, by_time, offsets, sizes, before), None) for i in range(len(sizes)))
    return Plan(tuple(offsets), _end(offsets, sizes), _bound(spans, sizes), sum(sizes), takers)


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


def _place(order: Iterable[int], sizes: Sequence[int], apart: Sequence[Sequence[int]]) -> list[int]:
    """Put each tensor into the smallest gap that holds it, between those placed already that it must not touch."""
    offsets = [-1] * len(sizes)
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
    start, end = offsets[item], offsets[item] + sizes[item]
    later = (i for i in by_time if before[i] >> item & 1)
    return (i for i in later if offsets[i] < end and start < offsets[i] + sizes[i])


def _bound(spans: Sequence[tuple[int, int]], sizes: Sequence[int]) -> int:
    times = range(max(end for _, end in spans))
    return max(sum(size for size, (low, high) in zip(sizes, spans, strict=True) if low <= t < high) for t in times)


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
