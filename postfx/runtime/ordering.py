"""Which recorded dispatches are certain to run before which: the meaning of barriers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

from postfx.runtime.footprint import Footprint, Span
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


def find_conflict(earlier: Sequence[Footprint], new: Footprint) -> Conflict | None:
    """The first conflict of new commands with each other or with earlier ones, which were checked before.

    Commands that are `ordered` are not compared with each other again: barriers recorded elsewhere change nothing
    among them. Indices in the result count the dispatches of all earlier commands, then those of the new ones.
    """
    first_new = sum(len(part.dispatches) for part in earlier)
    suspects = _suspects(earlier, new, first_new)
    if not any(suspects):
        return None
    parts = (*earlier, new)
    before = predecessors(record for part in parts for record in part.records)
    for index, others in enumerate(suspects, first_new):
        if unordered := others & ~before[index]:
            return _conflict([item for part in parts for item in part.dispatches], _lowest(unordered), index)
    return None


def _suspects(earlier: Sequence[Footprint], new: Footprint, first_new: int) -> list[int]:
    """For each new dispatch, the dispatches before it that share a byte with it which one of the two writes."""
    near = _near(earlier, new, first_new)
    result = []
    for index, dispatch in enumerate(new.dispatches, first_new):
        others = 0
        for tensor in dispatch.reads:
            others |= near.get((tensor.start, tensor.end), _NOBODY)[0]
        for tensor in dispatch.writes:
            others |= near.get((tensor.start, tensor.end), _NOBODY)[1]
        result.append(others & (1 << index) - 1)
    return result


_NOBODY = (0, 0)


def _near(earlier: Sequence[Footprint], new: Footprint, first_new: int) -> dict[tuple[int, int], tuple[int, int]]:
    """For the byte ranges of new commands, who writes and who uses any byte of them, as far as it is to be compared."""
    spans: list[tuple[Span, bool]] = []
    shift = 0
    for part in earlier:
        spans += [(_shifted(span, shift), False) for span in part.spans]
        shift += len(part.dispatches)
    for span in new.spans:
        spans.append((Span(span.start, span.end, 0, 0) if new.ordered else _shifted(span, first_new), True))
    result = {}
    for group in _overlapping(spans):
        for target, is_new in group:
            if is_new:
                result[target[:2]] = _union([s for s, _ in group if s.start < target.end and target.start < s.end])
    return result


def _shifted(span: Span, count: int) -> Span:
    return Span(span.start, span.end, span.writers << count, span.users << count)


def _overlapping(spans: list[tuple[Span, bool]]) -> Iterator[list[tuple[Span, bool]]]:
    """Byte ranges in groups that share no byte with each other; most groups are one tensor's."""
    group: list[tuple[Span, bool]] = []
    end = 0
    for item in sorted(spans):
        if group and item[0].start >= end:
            yield group
            group = []
        end = max(end, item[0].end) if group else item[0].end
        group.append(item)
    if group:
        yield group


def _union(spans: Iterable[Span]) -> tuple[int, int]:
    writers = users = 0
    for span in spans:
        writers |= span.writers
        users |= span.users
    return writers, users


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
