"""Which recorded dispatches are certain to run before which: the meaning of barriers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

from postfx.runtime.records import STAGES, Dispatch, EncoderBarrier, QueueBarrier, Record
from postfx.runtime.tensor import Tensor


class Access(NamedTuple):
    """One dispatch's access to one byte range of device memory."""

    start: int
    end: int
    index: int
    write: bool
    tensor: Tensor


class Conflict(NamedTuple):
    """Two dispatches, by their index, that touch the same bytes in no certain order; at least one writes them."""

    first: int
    second: int
    kind: str
    tensor: Tensor


def predecessors(records: Iterable[Record]) -> list[int]:
    """For every dispatch, in order, the set of dispatches that barriers put before it, as a bit mask of indices.

    A barrier orders two dispatches when one lies in its first scope and the other in its second; the order is
    transitive.
    """
    result: list[int] = []
    finished = dict.fromkeys(STAGES, 0)   # dispatches of earlier encoders by stage, with all that comes before them
    waits = dict.fromkeys(STAGES, 0)      # what every later dispatch of the stage comes after
    encoder, current, inner, stage = -1, 0, 0, STAGES[0]
    for record in records:
        if record.encoder != encoder:
            finished[stage] |= current
            encoder, current, inner = record.encoder, 0, 0
        if isinstance(record, Dispatch):
            stage = record.stage
            before = waits[stage] | inner
            current |= before | 1 << len(result)
            result.append(before)
        elif isinstance(record, EncoderBarrier):
            inner |= current
        elif isinstance(record, QueueBarrier):
            done = 0
            for name in record.after:
                done |= finished[name]
            for name in record.before:
                waits[name] |= done
    return result


def find_conflict(records: Sequence[Record], first_new: int) -> Conflict | None:
    """The first conflict whose later dispatch has index `first_new` or higher; earlier ones were checked before."""
    dispatches = [record for record in records if isinstance(record, Dispatch)]
    before = predecessors(records)
    found = [
        conflict
        for group in _overlapping(_accesses(dispatches))
        for conflict in _unordered(group, before)
        if conflict.second >= first_new
    ]
    return min(found, key=lambda conflict: (conflict.second, conflict.first, conflict.kind), default=None)


def _accesses(dispatches: Iterable[Dispatch]) -> list[Access]:
    return [
        Access(tensor.start, tensor.end, index, write, tensor)
        for index, dispatch in enumerate(dispatches)
        for write, tensors in ((False, dispatch.reads), (True, dispatch.writes))
        for tensor in tensors
        if tensor.nbytes
    ]


def _overlapping(accesses: list[Access]) -> Iterator[list[Access]]:
    """Accesses in groups that share no byte with each other; most groups are one tensor's."""
    group: list[Access] = []
    end = 0
    for access in sorted(accesses, key=lambda item: item[:4]):
        if group and access.start >= end:
            yield group
            group = []
        end = max(end, access.end) if group else access.end
        group.append(access)
    if group:
        yield group


def _unordered(group: list[Access], before: list[int]) -> Iterator[Conflict]:
    group = sorted(group, key=lambda item: item.index)
    for position, later in enumerate(group):
        for earlier in group[:position]:
            overlaps = earlier.start < later.end and later.start < earlier.end
            writes = earlier.write or later.write
            if earlier.index != later.index and overlaps and writes and not before[later.index] >> earlier.index & 1:
                yield Conflict(earlier.index, later.index, _kind(earlier.write, later.write), later.tensor)


def _kind(first_writes: bool, second_writes: bool) -> str:
    return f"{'write' if second_writes else 'read'} after {'write' if first_writes else 'read'}"
