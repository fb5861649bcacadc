"""Hazards: how barriers order dispatches, which barriers commands need, and which buffers a commit
refuses.

Checks use the tensors bound at dispatch and the directions that the model file or the kernel
declares, and compare memory by address, so a caller cannot hide an access. From the same
declarations barriers are made, unless a device has `explicit_barriers`.
"""

from __future__ import annotations

import threading
import weakref
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from typing import NamedTuple, Protocol

from postfx.errors import CommandError, HazardError
from postfx.runtime.encoders import (
    STAGES,
    Barrier,
    ConsumerBarrier,
    Dispatch,
    EncoderBarrier,
    ProducerBarrier,
    Record,
)
from postfx.runtime.memory import Ranges
from postfx.runtime.tensor import (
    Allocation,
    Tensor,
    TensorState,
    Transient,
    Use,
    refuse_host_read,
    refuse_host_write,
)
from postfx.runtime.threads import Waitable


class RecordedCommands(Waitable, Protocol):
    """What hazard checks need of a command buffer."""

    records: list[Record]
    used: UsedMemory

    def footprint(self) -> Footprint: ...


class Hazards:
    """The buffers in flight on one device: from commit until the host has waited for them or a
    later one.

    `wait` retires a buffer, not its last command, so a missing barrier between two buffers is found
    whatever the timing.

    Attributes:
        explicit: whether commands come in the order of recorded barriers alone, so that a missing
            one is an error.
    """

    def __init__(self, explicit: bool = False) -> None:
        self.explicit = explicit
        self._flying: list[RecordedCommands] = []
        self._open: weakref.WeakSet[RecordedCommands] = weakref.WeakSet()
        self._lock = threading.RLock()

    def open(self, commands: RecordedCommands) -> None:
        """Note a buffer that takes commands from now on."""
        with self._lock:
            self._open.add(commands)

    def close(self, commands: RecordedCommands) -> None:
        """Note a buffer that was committed or discarded."""
        with self._lock:
            self._open.discard(commands)

    def commit(self, commands: RecordedCommands) -> bool:
        """Check a buffer against itself and all buffers in flight, then add it to them; whether it
        may run beside those that are not done. HazardError if a check fails."""
        with self._lock:
            footprint = commands.footprint()
            if not footprint.filled or any([allocation.released or allocation.lost
                                            for allocation in footprint.users]):
                self._check_content(footprint)
            # automatic barriers were made before transient tensors got the memory that they share
            footprint.ordered |= not self.explicit
            if self._flying or not footprint.ordered:
                self._check_order(commands, footprint)
            stands_apart = footprint.narrow and self._stands_apart(footprint)
            for allocation, ranges in footprint.writes.items():
                if allocation.transient:  # it holds nothing from other buffers
                    allocation.written.spans = ranges.spans
                elif not footprint.filled:
                    for span in ranges.spans:
                        allocation.written.add(*span)
            footprint.filled = True
            self._flying.append(commands)
            return stands_apart

    def retire(self, commands: RecordedCommands) -> None:
        """Retire a buffer that the host has waited for, and all that were committed before it and
        are done."""
        with self._lock:
            if commands in self._flying:
                place = self._flying.index(commands)
                self._flying = [other for other in self._flying[:place] if not other.is_done()] \
                    + self._flying[place + 1:]

    def in_flight(self) -> list[RecordedCommands]:
        """Buffers that are committed and not retired, in the order of commit."""
        with self._lock:
            return list(self._flying)

    def state(self, tensor: Tensor) -> TensorState:
        """What may be done with a tensor now."""
        with self._lock:
            writer = reader = recorded = None
            resident = tensor.resident()
            for commands, dispatch in _dispatches(self._flying):
                if _uses(dispatch.writes, resident):
                    writer = _use(commands, dispatch)
                if _uses(dispatch.reads, resident):
                    reader = _use(commands, dispatch)
            for commands, dispatch in _dispatches(self._open) if len(self._open) else ():
                if _uses(dispatch.writes, tensor) or _uses(dispatch.reads, tensor):
                    recorded = _use(commands, dispatch)
                    break
            needed = Ranges((tensor.span,) if tensor.nbytes else ())
            allocation = tensor.allocation
            lost = (tensor.device.heap.explain_loss(allocation) if isinstance(allocation, Transient)
                    else None)
            failed = self._failure(resident.allocation, needed)
            defined = (lost is None and failed is None
                       and resident.allocation.written.includes(needed))
            return TensorState(tensor.released, defined, writer, reader, recorded, failed, lost)

    def check_host_read(self, tensor: Tensor) -> None:
        """HazardError where the host may not read the tensor now. What nobody uses is told by a
        look; else `state` tells more."""
        with self._lock:
            own, allocation = tensor.allocation, tensor.resident().allocation
            gone = (own.released
                    or (isinstance(own, Transient) and tensor.device.heap.explain_loss(own)))
            is_settled = (not (gone or self._flying or allocation.lost)
                          and allocation.written.covers(*tensor.span))
        if not is_settled:
            refuse_host_read(tensor.name, self.state(tensor))

    def check_host_write(self, tensor: Tensor) -> None:
        """HazardError where the host may not write the tensor now, BindingError where it never may;
        likewise."""
        with self._lock:
            allocation = tensor.allocation
            is_free = (not (self._flying or allocation.released or allocation.transient)
                       and allocation.writable
                       and not any([commands.used.touches(commands.records, tensor)
                                    for commands in self._open]))
        if not is_free:
            refuse_host_write(tensor, self.state(tensor))

    def mark_written(self, tensor: Tensor) -> None:
        """Note that the tensor's content is now defined."""
        with self._lock:
            tensor.allocation.written.add(*tensor.span)
            if tensor.allocation.lost:
                self.mark_found(tensor)

    def mark_found(self, tensor: Tensor) -> None:
        """Note that a command wrote a tensor that an earlier one had failed to write."""
        with self._lock:
            for ranges, _ in tensor.allocation.lost:
                ranges.remove(*tensor.span)
            tensor.allocation.lost = [item for item in tensor.allocation.lost if item[0].spans]

    def mark_lost(self, tensors: Iterable[Tensor], cause: CommandError) -> None:
        """Note that a command failed and left these tensors unwritten."""
        with self._lock:
            for tensor in tensors:
                self.mark_found(tensor)
                if tensor.nbytes:
                    tensor.allocation.lost.append((Ranges((tensor.span,)), cause))

    def loss(self, tensor: Tensor) -> CommandError | None:
        """The error of the command that should have written the tensor, as far as commands have
        run."""
        needed = Ranges((tensor.span,))
        with self._lock:
            return next((cause for ranges, cause in tensor.allocation.lost
                         if ranges.touches(needed)), None)

    def _failure(self, allocation: Allocation, needed: Ranges) -> CommandError | None:
        """The error of the failed command because of which some of these bytes will never be
        written."""
        for ranges, cause in allocation.lost:
            left = ranges.copy()
            for commands in self._flying:
                left.subtract(commands.footprint().writes.get(allocation, Ranges()))
            if left.touches(needed):
                return cause
        return None

    def _stands_apart(self, footprint: Footprint) -> bool:
        """Whether all that is not done leaves threads, and no barrier puts any of it before these
        commands."""
        others = [buffer.footprint() for buffer in self._flying if not buffer.is_done()]
        if not all(other.narrow for other in others):
            return False
        before = predecessors(record for part in (*others, footprint) for record in part.records)
        count = sum(len(other.dispatches) for other in others)
        return bool(others) and not any(mask & (1 << count) - 1 for mask in before[count:])

    def _check_content(self, footprint: Footprint) -> None:
        for allocation, (tensor, dispatch) in footprint.users.items():
            if allocation.released:
                raise _released_error(tensor, dispatch)
        for need in footprint.needs.values():
            allocation = need.tensor.allocation
            if not footprint.filled and not allocation.written.includes(need.missing):
                raise _undefined_error(need, footprint.dispatches)
            if allocation.lost and (failed := self._failure(allocation, need.missing)):
                raise _lost_error(need, failed)

    def _check_order(self, commands: RecordedCommands, footprint: Footprint) -> None:
        earlier = [buffer.footprint() for buffer in self._flying]
        if not self.explicit:
            footprint.records = commands.records = with_barriers(footprint, earlier)
        conflict = find_conflict(earlier, footprint)
        if conflict is not None:
            dispatches = list(_dispatches([*self._flying, commands]))
            raise _conflict_error(conflict, dispatches[conflict.first], dispatches[conflict.second])
        footprint.ordered = True


def _dispatches(buffers: Iterable[RecordedCommands]) -> Iterator[tuple[RecordedCommands, Dispatch]]:
    return ((buffer, record) for buffer in buffers
            for record in buffer.records if isinstance(record, Dispatch))


def _uses(tensors: Iterable[Tensor], tensor: Tensor) -> bool:
    start, end = tensor.start, tensor.end
    if start == end:
        return False
    return any(other.start < end and start < other.end and other.start < other.end
               for other in tensors)


def _use(commands: RecordedCommands, dispatch: Dispatch) -> Use:
    return Use(dispatch.label, dispatch.command, commands.label)


class UsedMemory:
    """The addresses that records use, looked up as they grow: each upload asks for its own, and
    large frames record thousands of commands."""

    def __init__(self) -> None:
        self._starts: list[int] = []
        self._ends: list[int] = []
        self._known: set[tuple[int, int]] = set()
        self._count = 0

    def touches(self, records: Sequence[Record], tensor: Tensor) -> bool:
        """Whether one of these records, which are those of the last call and perhaps more, uses a
        byte of a tensor."""
        new = {(other.start, other.end)
               for record in records[self._count:] if isinstance(record, Dispatch)
               for tensors in (record.reads, record.writes) for other in tensors}
        # Each new range is merged with all that it touches: so they stay apart and sorted.
        for start, end in new - self._known:
            if start == end:
                continue
            first, last = bisect_left(self._ends, start), bisect_right(self._starts, end)
            if first < last:
                start, end = min(start, self._starts[first]), max(end, self._ends[last - 1])
            self._starts[first:last], self._ends[first:last] = [start], [end]
        self._known |= new
        self._count = len(records)
        after = bisect_right(self._ends, tensor.start)
        return (tensor.start < tensor.end and after < len(self._starts)
                and self._starts[after] < tensor.end)


class Need(NamedTuple):
    """Bytes of an allocation that a dispatch reads and that none of the commands before it
    wrote."""

    dispatch: Dispatch
    tensor: Tensor
    missing: Ranges


class Span(NamedTuple):
    """A byte range of device memory, and which dispatches write it or access it at all: bit masks
    of their indices."""

    start: int
    end: int
    writers: int
    users: int


class Signature(tuple[object, ...]):
    """A long tuple to look things up by, whose hash is computed once."""

    def __hash__(self) -> int:
        return self._hash

    @cached_property
    def _hash(self) -> int:
        return super().__hash__()


class Accesses:
    """What commands access, as far as their order is concerned.

    Attributes:
        records: dispatches and barriers, in order.
        dispatches: the dispatches, in order.
        spans: the byte ranges of the dispatches' tensors, without repeats.
        ordered: whether it is known that barriers order all these commands; that stays true.
        narrow: whether some take fewer than all threads of their device, so that others may run
            beside them.
    """

    def __init__(self, records: Sequence[Record]) -> None:
        self.records = records
        self.dispatches = [record for record in records if isinstance(record, Dispatch)]
        self.spans = _spans(self.dispatches)
        self.ordered = False
        self.narrow = any([item.state is not None and item.state.narrow
                           for item in self.dispatches])


class Footprint(Accesses):
    """The accesses of one command buffer's records.

    Attributes:
        users: every allocation, with the first tensor and dispatch that use it.
        needs: the data that must exist before the commands run, by allocation and byte range of the
            tensor.
        writes: the data that exists afterwards.
        filled: whether they were committed before, so that what they need and write exists; that
            stays true.
    """

    def __init__(self, records: Sequence[Record]) -> None:
        super().__init__(records)
        self.users: dict[Allocation, tuple[Tensor, Dispatch]] = {}
        self.needs: dict[tuple[Allocation, tuple[int, int]], Need] = {}
        self.writes: dict[Allocation, Ranges] = {}
        self.filled = False
        for dispatch in self.dispatches:
            for tensor in dispatch.reads:
                self.users.setdefault(tensor.allocation, (tensor, dispatch))
                self._read(dispatch, tensor)
            for tensor in dispatch.writes:
                self.users.setdefault(tensor.allocation, (tensor, dispatch))
                self._write(tensor)

    @cached_property
    def signature(self) -> Signature:
        """Identifies the dispatches by their states and their tensors' addresses and shapes."""
        return Signature((id(item.state),
                          *((tensor.start, tensor.shape) for tensor in item.reads + item.writes))
                         for item in self.dispatches)

    def _read(self, dispatch: Dispatch, tensor: Tensor) -> None:
        allocation, span = tensor.allocation, tensor.span
        written = self.writes.get(allocation)
        if (not tensor.nbytes or (allocation, span) in self.needs
            or (written is not None and written.covers(*span))):
            return
        missing = Ranges((span,))
        if written is not None:
            missing.subtract(written)
        self.needs[allocation, span] = Need(dispatch, tensor, missing)

    def _write(self, tensor: Tensor) -> None:
        if not tensor.nbytes:
            return
        written = self.writes.get(tensor.allocation)
        if written is None:
            self.writes[tensor.allocation] = Ranges((tensor.span,))
        else:
            written.add(*tensor.span)


def _spans(dispatches: Iterable[Dispatch]) -> list[Span]:
    """Bytes that dispatches use, with those that use and that write them as bits."""
    writers: dict[tuple[int, int], int] = {}
    users: dict[tuple[int, int], int] = {}
    for index, dispatch in enumerate(dispatches):
        bit = 1 << index
        for tensor in dispatch.reads:
            span = tensor.start, tensor.end
            users[span] = users.get(span, 0) | bit
        for tensor in dispatch.writes:
            span = tensor.start, tensor.end
            users[span] = users.get(span, 0) | bit
            writers[span] = writers.get(span, 0) | bit
    return [Span(start, end, writers.get((start, end), 0), mask)
            for (start, end), mask in users.items() if start < end]


class Conflict(NamedTuple):
    """Two dispatches, by their index, that touch the same bytes in no certain order; at least one
    writes them."""

    first: int
    second: int
    kind: str
    tensor: Tensor


class Order:
    """How barriers order dispatches, record by record.

    A barrier orders two dispatches when one lies in its first scope and the other in its second;
    the order is transitive.

    Attributes:
        before: for every dispatch so far, the set of dispatches that come before it, as a bit mask
            of indices.
    """

    def __init__(self) -> None:
        self.before: list[int] = []
        # dispatches of earlier encoders, with all that comes before them
        self._finished = dict.fromkeys(STAGES, 0)
        # dispatches that every later one of the stage comes after
        self._waits = dict.fromkeys(STAGES, 0)
        self._later = dict.fromkeys(STAGES, 0)     # the same, from the next encoder on
        self._encoder, self._current, self._inner, self._stage = -1, 0, 0, STAGES[0]

    def add(self, record: Record) -> None:
        """Go on by a dispatch or a barrier."""
        self._enter(record)
        if isinstance(record, Dispatch):
            self._stage = record.stage
            before = self._waits[record.stage] | self._inner
            self._current |= before | 1 << len(self.before)
            self.before.append(before)
        elif isinstance(record, EncoderBarrier):
            self._inner |= self._current
        elif isinstance(record, ConsumerBarrier):
            _order(self._finished, record, self._waits)
        else:
            done = self._finished | {self._stage: self._finished[self._stage] | self._current}
            _order(done, record, self._later)

    def missing(self, dispatch: Dispatch, needed: int) -> list[Barrier]:
        """The barriers to record before the next dispatch so that it comes after all that is
        `needed`."""
        self._enter(dispatch)
        left = needed & ~(self._waits[dispatch.stage] | self._inner)
        found: list[Barrier] = []
        if left & self._current:
            found.append(EncoderBarrier(dispatch.encoder))
            left &= ~self._current
        after = []
        for stage in STAGES:
            if left & self._finished[stage]:
                after.append(stage)
                left &= ~self._finished[stage]
        if after:
            found.append(ConsumerBarrier(dispatch.encoder, frozenset(after),
                                         frozenset((dispatch.stage,))))
        return found

    def _enter(self, record: Record) -> None:
        if record.encoder != self._encoder:
            self._finished[self._stage] |= self._current
            self._waits = {name: self._waits[name] | self._later[name] for name in STAGES}
            self._encoder, self._current, self._inner = record.encoder, 0, 0


def predecessors(records: Iterable[Record]) -> list[int]:
    """For every dispatch, in order, the set of dispatches that barriers put before it, as a bit
    mask of indices."""
    order = Order()
    for record in records:
        order.add(record)
    return order.before


def _order(done: dict[str, int], barrier: ConsumerBarrier | ProducerBarrier,
           waits: dict[str, int]) -> None:
    """Make the barrier's second scope wait for its first."""
    mask = 0
    for name in barrier.after:
        mask |= done[name]
    for name in barrier.before:
        waits[name] |= mask


def with_barriers(new: Accesses, earlier: Sequence[Accesses] = ()) -> list[Record]:
    """The records of new commands, with the barriers that what they read and write needs: among
    themselves, or after `earlier` commands if there are some. Recorded barriers stay.

    Where all commands take their whole device, so that they run one by one anyway, encoders come
    one after the other: transient tensors of different encoders then share memory.
    """
    order, first_new = Order(), sum(len(part.dispatches) for part in earlier)
    needed = iter(_suspects(earlier, new, first_new))
    for part in earlier:
        for record in part.records:
            order.add(record)
    known = (1 << first_new) - 1
    one_by_one, encoder, records = not (earlier or new.narrow), -1, list[Record]()
    for record in new.records:
        if isinstance(record, Dispatch):
            others = next(needed) & known if earlier else next(needed)
            if one_by_one and record.encoder != encoder:
                others, encoder = (1 << len(order.before)) - 1, record.encoder
            for barrier in order.missing(record, others):
                order.add(barrier)
                records.append(barrier)
        order.add(record)
        records.append(record)
    return records


def find_conflict(earlier: Sequence[Footprint], new: Footprint) -> Conflict | None:
    """The first conflict of new commands with each other or with earlier ones, which are already
    checked.

    `ordered` commands are not compared with each other again: barriers in other buffers do not
    affect them. Indices in the result count the dispatches of all earlier commands, then those of
    the new ones.
    """
    first_new = sum(len(part.dispatches) for part in earlier)
    suspects = _suspects(earlier, new, first_new)
    if not any(suspects):
        return None
    parts = (*earlier, new)
    before = predecessors(record for part in parts for record in part.records)
    for index, others in enumerate(suspects, first_new):
        if unordered := others & ~before[index]:
            first = (unordered & -unordered).bit_length() - 1
            return _conflict([item for part in parts for item in part.dispatches], first, index)
    return None


def _suspects(earlier: Sequence[Accesses], new: Accesses, first_new: int) -> list[int]:
    """For each new dispatch, the earlier ones that share a byte with it that one of the two
    writes."""
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


def _near(earlier: Sequence[Accesses], new: Accesses,
          first_new: int) -> dict[tuple[int, int], tuple[int, int]]:
    """For each byte range of new commands, the dispatches to compare: those that write and those
    that use a byte."""
    spans: list[tuple[Span, bool]] = []
    shift = 0
    for part in earlier:
        spans += [(_shift(span, shift), False) for span in part.spans]
        shift += len(part.dispatches)
    for span in new.spans:
        spans.append((Span(span.start, span.end, 0, 0) if new.ordered else _shift(span, first_new),
                      True))
    result = {}
    for group in _group_overlapping(spans):
        for target, is_new in group:
            if is_new:
                result[target[:2]] = _union([s for s, _ in group
                                             if s.start < target.end and target.start < s.end])
    return result


def _shift(span: Span, count: int) -> Span:
    return Span(span.start, span.end, span.writers << count, span.users << count)


def _group_overlapping(spans: list[tuple[Span, bool]]) -> Iterator[list[tuple[Span, bool]]]:
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


def _conflict(dispatches: Sequence[Dispatch], first: int, second: int) -> Conflict:
    """The conflict of two unordered dispatches that use the same bytes."""
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


def _released_error(tensor: Tensor, dispatch: Dispatch) -> HazardError:
    """The error for a dispatch that uses a released tensor."""
    message = (f"{dispatch} uses '{tensor.name}', which was released before commit: record it with "
               "a new tensor")
    return HazardError(message, "released", tensor.name, None, dispatch.label)


def _undefined_error(need: Need, dispatches: list[Dispatch]) -> HazardError:
    """The error for a dispatch that reads an unwritten tensor, which one of `dispatches` may write
    later."""
    name, label = need.tensor.name, need.dispatch.label
    later = dispatches[dispatches.index(need.dispatch) + 1:]
    writer = next((item for item in later
                   if any(need.tensor.overlaps(other) for other in item.writes)), None)
    fix = (f"only {writer} writes it, later: record it first" if writer
           else "upload to it, or write it by a command")
    what = f"'{name}', which nothing wrote before"
    if need.tensor.allocation.transient:
        what = f"transient '{name}', which nothing in this command buffer wrote before"
        fix = (fix if writer
               else "write it by a command, or use heap.tensor for data that outlives a buffer")
    message = f"read before write: {need.dispatch} reads {what}: {fix}"
    return HazardError(message, "read before write", name, writer.label if writer else None, label)


def _lost_error(need: Need, failed: CommandError) -> HazardError:
    """The error for a dispatch that reads a tensor that a failed command did not write."""
    name = need.tensor.name
    fix = f"commit that again, or upload to '{name}'"
    message = f"read before write: {need.dispatch} reads '{name}', but {failed}: {fix}"
    return HazardError(message, "read before write", name, failed.label, need.dispatch.label)


def _conflict_error(
    found: Conflict, first: tuple[RecordedCommands, Dispatch],
    second: tuple[RecordedCommands, Dispatch]
) -> HazardError:
    """The error for two dispatches, each with its buffer, that use the same memory in no certain
    order."""
    (one_buffer, one), (two_buffer, two) = first, second
    same = one_buffer is two_buffer
    does, did = ("writes" if word == "write" else "reads" for word in found.kind.split(" after "))
    earlier = str(one) if same else f"{one} of '{one_buffer.label}'"
    later = str(two) if same else f"{two} of '{two_buffer.label}'"
    name = found.tensor.name
    what = f"{later} {does} '{name}', which {earlier} {did}, in no certain order"
    message = f"{found.kind}: {what}: record {_suggest_barrier(one, two)}"
    return HazardError(message, found.kind, name, one.label, two.label)


def _suggest_barrier(one: Dispatch, two: Dispatch) -> str:
    if one.encoder == two.encoder:
        return f"barrier() between them in '{two.label}'"
    consumer = f"barrier(after='{one.stage}', before='{two.stage}') in '{two.label}' before it"
    return (f"{consumer}, or barrier(after='{one.stage}', before_queue='{two.stage}') in "
            f"'{one.label}' after it")
