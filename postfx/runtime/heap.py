"""The heap: memory that all named tensors of a device share, and the arena in it for transient
tensors.

A transient tensor has no memory while commands are recorded. At commit the buffer's records tell
when each one is used, and a plan gives each an offset in the arena. Two tensors may share bytes
when all uses of one come before all uses of the other.
"""

from __future__ import annotations

import itertools
import threading
import weakref
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from postfx.caching import LRUCache
from postfx.runtime.encoders import Dispatch, EncoderBarrier, Record
from postfx.runtime.hazards import predecessors
from postfx.runtime.memory import ALIGNMENT, Chunk, Memory, Ranges
from postfx.runtime.tensor import Allocation, Tensor, TensorDevice, Transient, size_in_bytes

CHUNK_BYTES = 64 << 20
"""Bytes requested from the system at once, at least; on the host, untouched pages cost nothing."""


@dataclass
class _Block:
    """A chunk and the spans of it that are free, sorted and merged."""

    chunk: Chunk
    free: list[tuple[int, int]]

    def best_fit(self, nbytes: int) -> int | None:
        """Size of the smallest free span that holds `nbytes`."""
        return min((end - start for start, end in self.free if end - start >= nbytes), default=None)

    def take(self, nbytes: int, fit: int) -> int:
        """Cut `nbytes` off the front of a span of `fit` bytes; returns the address."""
        index = next(i for i, (start, end) in enumerate(self.free) if end - start == fit)
        start, end = self.free[index]
        self.free[index:index + 1] = [(start + nbytes, end)] if start + nbytes < end else []
        return start

    def put_back(self, start: int, end: int) -> None:
        """Make [start, end) free again and merge it with its free neighbours."""
        merged: list[tuple[int, int]] = []
        for span in sorted([*self.free, (start, end)]):
            if merged and merged[-1][1] == span[0]:
                merged[-1] = (merged[-1][0], span[1])
            else:
                merged.append(span)
        self.free = merged

    @property
    def idle(self) -> bool:
        """Whether no tensor uses the chunk."""
        return self.free == [(self.chunk.pointer, self.chunk.pointer + self.chunk.nbytes)]


class Heap:
    """The device's memory. A tensor's memory returns to it on `release()` or when the last view of
    it is dropped.

    Memory is not zeroed: reading a tensor before it is written or uploaded raises HazardError.

    Attributes:
        arena: memory that transient tensors share.
        explain_loss: why a transient tensor lost its content, as a clause; None while it still has
            it.
        allocations: how many tensors were allocated so far.
    """

    def __init__(self, device: TensorDevice, memory: Memory) -> None:
        self._device = device
        self._memory = memory
        self._blocks: list[_Block] = []
        self._returned: deque[tuple[int, int]] = deque()
        self._live: weakref.WeakSet[Allocation] = weakref.WeakSet()
        self._lock = threading.Lock()
        self._used = 0
        self._peak = 0
        self._networks = 0
        self.arena = Arena(device)
        self.explain_loss = self.arena.explain_loss
        self.allocations = 0

    def tensor(self, name: str, shape: tuple[int, ...], dtype: str = "float32") -> Tensor:
        """A new tensor of undefined content. `name` is what messages call it and need not be
        unique."""
        nbytes = -(-max(1, size_in_bytes(shape, dtype)) // ALIGNMENT) * ALIGNMENT
        with self._lock:
            chunk, start = self._carve(nbytes)
        allocation = Allocation(name, start, nbytes, owner=chunk)
        # Finalizers may run in any thread at any point, so they only append to a queue.
        allocation.on_release(self._returned.append, (start, start + nbytes))
        self._live.add(allocation)
        return Tensor(self._device, name, shape, dtype, allocation)

    def transient(self, name: str, shape: tuple[int, ...], dtype: str = "float32") -> Tensor:
        """A new tensor for use within one command buffer; it shares memory with tensors that are
        used at other times.

        In every buffer, a command must write it before one reads it; otherwise commit raises
        HazardError. It has memory from commit on, and keeps its content until another tensor takes
        its bytes or another buffer with transient tensors is committed. Until then the host may
        read it. The host can never write it.
        """
        if self._device.scratch:  # the arena is one allocation, all of which would end up in a file
            return self.tensor(name, shape, dtype)
        return self.arena.tensor(name, shape, dtype)

    @property
    def size(self) -> int:
        """Bytes allocated from the system, used or free, those of `networks` included."""
        with self._lock:
            return sum(block.chunk.nbytes for block in self._blocks) + self._networks

    @property
    def networks(self) -> int:
        """Bytes that ONNX Runtime's arena has touched for the intermediates of this device's
        networks. All devices of the process share the arena, which keeps what it has. 0 on a GPU
        and where the system does not tell.
        """
        return self._networks

    def note_arena(self, nbytes: int) -> None:
        """Count bytes that ONNX Runtime's arena took for a network of this device."""
        with self._lock:
            self._networks += nbytes
            self._peak = max(self._peak, self._used + self._networks)

    @property
    def used(self) -> int:
        """Bytes of all live tensors."""
        with self._lock:
            self._collect()
            return self._used

    @property
    def peak(self) -> int:
        """Most bytes that were in use at once, by tensors and by `networks`."""
        return self._peak

    def tensors(self) -> list[tuple[str, int]]:
        """Name and bytes of every live tensor, largest first."""
        held = [(allocation.name, allocation.nbytes)
                for allocation in self._live if not allocation.released]
        return sorted(held, key=lambda item: (-item[1], item[0]))

    def trim(self) -> None:
        """Return unused chunks to the system."""
        with self._lock:
            self._collect()
            self._drop_idle()

    def _carve(self, nbytes: int) -> tuple[Chunk, int]:
        self._collect()
        self.allocations += 1
        fits = [(block.best_fit(nbytes), index) for index, block in enumerate(self._blocks)]
        found = min(((fit, index) for fit, index in fits if fit is not None), default=None)
        block = self._blocks[found[1]] if found else self._grow(nbytes)
        self._used += nbytes
        self._peak = max(self._peak, self._used + self._networks)
        return block.chunk, block.take(nbytes, found[0] if found else block.chunk.nbytes)

    def _grow(self, nbytes: int) -> _Block:
        # too small for this tensor; keeping them would add up all sizes ever used
        self._drop_idle()
        chunk = self._memory.allocate(max(nbytes, CHUNK_BYTES))
        self._blocks.append(_Block(chunk, [(chunk.pointer, chunk.pointer + chunk.nbytes)]))
        return self._blocks[-1]

    def _drop_idle(self) -> None:
        self._blocks = [block for block in self._blocks if not block.idle]

    def _collect(self) -> None:
        while self._returned:
            start, end = self._returned.popleft()
            for block in self._blocks:
                if block.chunk.pointer <= start < block.chunk.pointer + block.chunk.nbytes:
                    block.put_back(start, end)
            self._used -= end - start


_NOWHERE = 1 << 62
"""Until a transient tensor is placed its address is a multiple of this, which no real memory
has."""

MOST_CACHED_PLANS = 64
"""How many plans are cached; the least recently used is dropped first."""


@dataclass(eq=False, slots=True, weakref_slot=True)
class Placement:
    """A buffer's records with all transient tensors placed, and the memory of each."""

    records: list[Record]
    plan: Plan
    memory: Tensor
    places: list[tuple[Transient, Allocation]]


class Arena:
    """Memory that the transient tensors of all command buffers share, one buffer after the other.

    The memory lives as long as any tensor placed in it. It is replaced when a plan needs more, or
    when the remaining tensors need less after others are dropped; the old memory then returns to
    the system.

    Attributes:
        plan: the plan of the last placement, None before the first.
        plans: how many plans were made so far.
    """

    def __init__(self, device: TensorDevice) -> None:
        self._device = device
        self._plans: LRUCache[tuple[object, ...], Plan] = LRUCache(MOST_CACHED_PLANS)
        # References, to the memory now and to that before.
        self._memory: Callable[[], Tensor | None] = _no_memory
        self._replaced: Callable[[], Tensor | None] | None = None
        self._live: weakref.WeakSet[Transient] = weakref.WeakSet()
        self._live_lock = threading.Lock()
        self._count = 0
        self._numbers = itertools.count(1)
        self._turn = 0
        self._last: weakref.ref[Placement] | None = None
        self._label = ""
        self.plan: Plan | None = None
        self.plans = 0

    def tensor(self, name: str, shape: tuple[int, ...], dtype: str) -> Tensor:
        """See `Heap.transient`."""
        nbytes = -(-max(1, size_in_bytes(shape, dtype)) // ALIGNMENT) * ALIGNMENT
        transient = Transient(name, next(self._numbers) * _NOWHERE, nbytes)
        with self._live_lock:
            self._live.add(transient)
        return Tensor(self._device, name, shape, dtype, transient)

    def place(
        self, records: Sequence[Record], kept: Collection[Allocation], before: Placement | None,
        label: str
    ) -> Placement | None:
        """Place the transient tensors of a buffer that is being committed; None if it has none.

        Args:
            records: as recorded, or as placed before.
            kept: allocations that the host reads when the buffer is done.
            before: the placement of the same records at their last commit, reused if possible.
            label: what messages call the buffer.
        """
        if not any(isinstance(item, Dispatch) and item.arguments and item.arguments.transients
                   for item in records):
            return None
        if before is None or before.memory is not self._memory():
            before = self._new(records, kept)
        self._label, self.plan = label, before.plan
        if self._last and self._last() is before:  # all are where they were
            for transient, allocation in before.places:
                allocation.released = transient.released
            return before
        self._turn, self._last = self._turn + 1, weakref.ref(before)
        for (transient, allocation), taker in zip(before.places, before.plan.takers, strict=True):
            allocation.released = transient.released
            transient.place, transient.turn = allocation, self._turn
            transient.successor = None if taker is None else before.places[taker][0].name
        return before

    def give_back(self) -> None:
        """Give memory that was replaced back to the system, if nothing lies in it any more."""
        if self._replaced is not None and self._replaced() is None:
            self._replaced = None
            self._device.heap.trim()

    def explain_loss(self, transient: Transient) -> str | None:
        """Why a transient tensor lost its content, as a clause; None while it still has it."""
        if transient.turn and transient.turn < self._turn:
            return (f"'{self._label}' was committed since: read it earlier, or make it with "
                    "heap.tensor")
        fix = "pass it to commands.keep"
        return (transient.successor and f"'{transient.successor}' took its memory later in "
                f"'{self._label}': {fix}")

    def _new(self, records: Sequence[Record], kept: Collection[Allocation]) -> Placement:
        uses, transients = _uses(records)
        plan = self._plan(records, uses,
                          [number for number, item in enumerate(transients) if item in kept],
                          transients)
        for transient in transients:
            transient.needs = max(transient.needs, plan.nbytes)
        memory = self._memory_for(plan)
        places = [(item, item.at(memory, start))
                  for item, start in zip(transients, plan.offsets, strict=True)]
        for transient, allocation in places:
            transient.place, allocation.written = allocation, Ranges()
        return Placement([_with_memory(record) for record in records], plan, memory, places)

    def _plan(self, records: Sequence[Record], uses: Uses, kept: list[int],
              transients: list[Transient]) -> Plan:
        """The plan for all buffers with records like these; made once."""
        sizes = tuple(transient.nbytes for transient in transients)
        key = (sizes, uses, tuple(kept), _order(records))

        def make() -> Plan:
            self.plans += 1
            return make_plan(sizes, uses, kept, records, self._present(transients))

        return self._plans.get_or_make(key, make)

    def _present(self, transients: Iterable[Transient]) -> Present | None:
        """Where the tensors are now, so that as few addresses as possible change."""
        memory = self._memory()
        if memory is None:
            return None
        places = (item.place for item in transients)
        return Present(memory.nbytes, [p.pointer - memory.start if p and p.owner is memory else -1
                                       for p in places])

    def _memory_for(self, plan: Plan) -> Tensor:
        """The current memory; new memory if the plan needs more, or if all live tensors need
        less."""
        memory, count = self._memory(), len(self._live)
        if memory is None or memory.nbytes < plan.nbytes or self._count != count:
            with self._live_lock:
                needed = max(item.needs for item in self._live)
            if memory is None or memory.nbytes != needed:
                self._replaced = None if self._memory is _no_memory else self._memory
                memory = self._device.heap.tensor("arena", (needed,), "uint8")
        self._memory, self._count = weakref.ref(memory), count
        return memory


def _no_memory() -> Tensor | None:
    """In place of a reference, before the first buffer."""
    return None


def _uses(records: Iterable[Record]) -> tuple[Uses, list[Transient]]:
    """The transient tensors in the order of their first use, and for every dispatch the numbers of
    those it uses."""
    numbers: dict[Transient, int] = {}
    dispatches = [record for record in records if isinstance(record, Dispatch)]
    used = (dispatch.arguments.transients if dispatch.arguments else () for dispatch in dispatches)
    uses = tuple([tuple([numbers.setdefault(item, len(numbers)) for item in items])
                  for items in used])
    return uses, list(numbers)


def _order(records: Sequence[Record]) -> tuple[object, ...]:
    """A key for the order of dispatches: encoders in order of appearance, with stages and
    barriers."""
    numbers: dict[int, int] = {}
    return tuple((numbers.setdefault(record.encoder, len(numbers)), *_order_key(record))
                 for record in records)


def _order_key(record: Record) -> tuple[object, ...]:
    if isinstance(record, Dispatch):
        return (record.stage,)
    return ((type(record),) if isinstance(record, EncoderBarrier)
            else (type(record), record.after, record.before))


def _with_memory(record: Record) -> Record:
    if not isinstance(record, Dispatch) or not record.arguments or not record.arguments.transients:
        return record
    placed = record.arguments.with_memory()
    names = (record.label, record.command, record.stage, record.encoder)
    return Dispatch(*names, placed.reads, placed.writes, placed.execute, record.model, record.state,
                    record.arguments)


Uses = Sequence[tuple[int, ...]]
"""For every dispatch, in order, the numbers of the tensors it uses."""


@dataclass(frozen=True)
class Plan:
    """Where the transient tensors of a command buffer lie.

    Attributes:
        offsets: of each tensor, bytes.
        nbytes: memory that they need together.
        bound: the largest sum of sizes in use at once, given which commands may overlap; no plan
            needs less.
        total: what they would need without sharing.
        takers: for each tensor, the number of one that later takes some of its bytes, or None.
    """

    offsets: tuple[int, ...]
    nbytes: int
    bound: int
    total: int
    takers: tuple[int | None, ...]

    def __str__(self) -> str:
        over = 100 * (self.nbytes / self.bound - 1) if self.bound else 0.0
        sizes = (f"{_megabytes(self.nbytes)} for {_megabytes(self.total)} in {len(self.offsets)} "
                 "tensors")
        return f"{sizes}, {over:.1f} % over the bound {_megabytes(self.bound)}"


class Present(NamedTuple):
    """Existing memory, and the tensors' current offsets in it, or -1."""

    nbytes: int
    offsets: Sequence[int]


def make_plan(
    sizes: Sequence[int], uses: Uses, kept: Iterable[int], records: Iterable[Record],
    present: Present | None = None
) -> Plan:
    """Place tensors of these sizes. Those used by commands in no certain order never share a byte.

    The largest are placed first: that reached the bound for every shipped network, where orders by
    length or first use took up to 45 % more.

    Args:
        kept: numbers of tensors whose content must survive the last dispatch.
        records: the dispatches of `uses`, and the barriers.
        present: tensors stay where they are if that is allowed and the memory has room for the
            others.
    """
    users = _users([*uses, tuple(kept)], len(sizes))
    earlier = [*predecessors(records), (1 << len(uses)) - 1]
    before = _before(users, earlier)
    apart = [[other for other in range(len(sizes)) if not _are_ordered(before, item, other)]
             for item in range(len(sizes))]
    spans = [(_first(mask), mask.bit_length()) for mask in users]
    offsets = _keep_places(present, sizes, apart) if present else None
    if offsets is None:
        offsets = _place(_largest_first(range(len(sizes)), sizes), sizes, apart, [-1] * len(sizes))
    by_time = sorted(range(len(sizes)), key=lambda i: spans[i])
    takers = tuple(next(_takers(i, by_time, offsets, sizes, before), None)
                   for i in range(len(sizes)))
    return Plan(tuple(offsets), _end(offsets, sizes), _bound(spans, sizes, earlier), sum(sizes),
                takers)


def _users(uses: Uses, count: int) -> list[int]:
    """For every tensor, the dispatches that use it, as a bit mask."""
    users = [0] * count
    for index, numbers in enumerate(uses):
        for number in numbers:
            users[number] |= 1 << index
    return users


def _before(users: Sequence[int], earlier: Sequence[int]) -> list[int]:
    """For every tensor, the tensors whose last use comes before its first use, as a bit mask."""
    result = []
    for mask in users:
        common = -1
        for index in _bits(mask):
            common &= earlier[index]
        result.append(sum(1 << other for other, used in enumerate(users) if used & ~common == 0))
    return result


def _are_ordered(before: Sequence[int], one: int, other: int) -> bool:
    return one == other or bool(before[one] >> other & 1 or before[other] >> one & 1)


def _keep_places(present: Present, sizes: Sequence[int],
                 apart: Sequence[Sequence[int]]) -> list[int] | None:
    """Offsets that leave tensors where they are; None if no tensor can stay, or the others do not
    fit."""
    lying = [item for item, offset in enumerate(present.offsets) if offset >= 0]
    if not lying or any(_touch(item, other, present.offsets, sizes) for item in lying
                        for other in apart[item]):
        return None
    others = set(range(len(sizes))).difference(lying)
    offsets = _place(_largest_first(others, sizes), sizes, apart, list(present.offsets))
    return offsets if _end(offsets, sizes) <= present.nbytes else None


def _largest_first(items: Iterable[int], sizes: Sequence[int]) -> list[int]:
    return sorted(items, key=lambda i: (-sizes[i], i))


def _place(
    order: Iterable[int], sizes: Sequence[int], apart: Sequence[Sequence[int]], offsets: list[int]
) -> list[int]:
    """Put each tensor into the smallest gap that holds it between the placed tensors that it must
    not overlap."""
    for item in order:
        taken = sorted((offsets[other], offsets[other] + sizes[other])
                       for other in apart[item] if offsets[other] >= 0)
        gaps, end = [], 0
        for low, high in taken:
            if low - end >= sizes[item]:
                gaps.append((low - end, end))
            end = max(end, high)
        offsets[item] = min(gaps)[1] if gaps else end
    return offsets


def _takers(
    item: int, by_time: Iterable[int], offsets: Sequence[int], sizes: Sequence[int],
    before: Sequence[int]
) -> Iterator[int]:
    return (i for i in by_time if before[i] >> item & 1 and _touch(item, i, offsets, sizes))


def _touch(one: int, other: int, offsets: Sequence[int], sizes: Sequence[int]) -> bool:
    """Whether two tensors share a byte; those with no place share none."""
    first, second = offsets[one], offsets[other]
    return min(first, second) >= 0 and first < second + sizes[other] and second < first + sizes[one]


def _bound(spans: Sequence[tuple[int, int]], sizes: Sequence[int], earlier: Sequence[int]) -> int:
    """The largest sum of sizes of tensors that dispatches which may overlap use at once."""
    most = last = 0
    for first in range(len(earlier)):
        while last < len(earlier) and earlier[last] >> first == 0:
            last += 1
        most = max(most, sum(n for n, (low, end) in zip(sizes, spans, strict=True)
                             if low < last and first < end))
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
