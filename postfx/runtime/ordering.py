"""Which recorded dispatches are certain to run before which: the meaning of barriers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

from postfx.runtime.records import STAGES, ConsumerBarrier, Dispatch, EncoderBarrier, ProducerBarrier, Record
from postfx.runtime.tensor import Tensor


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
    waits = dict.fromkeys(STAGES, 0)      # what every dispatch of the stage comes after from here on
    later = dict.fromkeys(STAGES, 0)      # what it comes after from the next encoder on
    encoder, current, inner, stage = -1, 0, 0, STAGES[0]
    for record in records:
        if record.encoder != encoder:
            finished[stage] |= current
            waits = {name: waits[name] | later[name] for name in STAGES}
            encoder, current, inner = record.encoder, 0, 0
        if isinstance(record, Dispatch):
            stage = record.stage
            before = waits[stage] | inner
            current |= before | 1 << len(result)
            result.append(before)
        elif isinstance(record, EncoderBarrier):
            inner |= current
        elif isinstance(record, ConsumerBarrier):
            _order(finished, record, waits)
        elif isinstance(record, ProducerBarrier):
            _order(finished | {stage: finished[stage] | current}, record, later)
    return result


def _order(done: dict[str, int], barrier: ConsumerBarrier | ProducerBarrier, waits: dict[str, int]) -> None:
    """Let the barrier's second scope wait for what is done of its first."""
    mask = 0
    for name in barrier.after:
        mask |= done[name]
    for name in barrier.before:
        waits[name] |= mask


def find_conflict(records: Iterable[Record], first_new: int, across: bool = False) -> Conflict | None:
    """The first conflict whose later dispatch has index `first_new` or higher; earlier ones were checked before.

    Args:
        across: look only for conflicts of a new dispatch with an earlier one; the new ones were checked among
            themselves. Barriers recorded elsewhere do not order them, so that holds whatever comes before.
    """
    records = list(records)
    dispatches = [record for record in records if isinstance(record, Dispatch)]
    touched, before = _touched(dispatches), predecessors(records)
    for index in range(first_new, len(dispatches)):
        others = 0
        for tensor in dispatches[index].reads:
            others |= touched.get((tensor.start, tensor.end), _NOBODY).writes
        for tensor in dispatches[index].writes:
            others |= touched.get((tensor.start, tensor.end), _NOBODY).all
        unordered = others & ~before[index] & (1 << (first_new if across else index)) - 1
        if unordered:
            return _conflict(dispatches, _lowest(unordered), index)
    return None


class _Users(NamedTuple):
    """Which dispatches write a byte range, and which access it at all: bit masks of their indices."""

    writes: int
    all: int


_NOBODY = _Users(0, 0)


def _touched(dispatches: Iterable[Dispatch]) -> dict[tuple[int, int], _Users]:
    """For every byte range that a tensor takes, the dispatches that access any byte of it."""
    writes: dict[tuple[int, int], int] = {}
    every: dict[tuple[int, int], int] = {}
    for index, dispatch in enumerate(dispatches):
        bit = 1 << index
        for tensor in dispatch.reads:
            span = tensor.start, tensor.end
            every[span] = every.get(span, 0) | bit
        for tensor in dispatch.writes:
            span = tensor.start, tensor.end
            every[span] = every.get(span, 0) | bit
            writes[span] = writes.get(span, 0) | bit
    result = {}
    for group in _overlapping(span for span in every if span[0] < span[1]):
        for start, end in group:
            near = [other for other in group if other[0] < end and start < other[1]]
            result[start, end] = _Users(_union(writes, near), _union(every, near))
    return result


def _overlapping(spans: Iterable[tuple[int, int]]) -> Iterator[list[tuple[int, int]]]:
    """Byte ranges in groups that share no byte with each other; most groups are one tensor's."""
    group: list[tuple[int, int]] = []
    end = 0
    for span in sorted(spans):
        if group and span[0] >= end:
            yield group
            group = []
        end = max(end, span[1]) if group else span[1]
        group.append(span)
    if group:
        yield group


def _union(masks: dict[tuple[int, int], int], spans: Iterable[tuple[int, int]]) -> int:
    result = 0
    for span in spans:
        result |= masks.get(span, 0)
    return result


def _lowest(mask: int) -> int:
    return (mask & -mask).bit_length() - 1


def _conflict(dispatches: Sequence[Dispatch], first: int, second: int) -> Conflict:
    """What two unordered dispatches do to the same bytes."""
    one, two = dispatches[first], dispatches[second]
    kinds = (
        ("read after write", one.writes, two.reads),
        ("write after read", one.reads, two.writes),
        ("write after write", one.writes, two.writes),
    )
    return next(
        Conflict(first, second, kind, tensor)
        for kind, earlier, later in kinds
        for tensor in later
        if any(tensor.overlaps(other) for other in earlier)
    )
