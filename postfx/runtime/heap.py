"""The heap: memory that all named tensors of a device share, and the arena in it for transient tensors.

A transient tensor has no memory while commands are recorded. At commit the buffer's records tell when each one is used,
and a plan gives each an offset in the arena. Two tensors may share bytes when all uses of one come before all uses of
the other.
"""

from __future__ import annotations

import itertools
import threading
import weakref
from collections import deque
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from postfx.caching import LRUCache
from postfx.runtime.hazards import predecessors
from postfx.runtime.memory import ALIGNMENT, Chunk, Memory, Ranges
from postfx.runtime.records import Dispatch, EncoderBarrier, Record
from postfx.runtime.tensor import Allocation, Tensor, TensorDevice, Transient, size_in_bytes

CHUNK = 64 << 20
"""Smallest amount of memory asked from the system at once, bytes; untouched pages of it cost nothing on the host."""


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
        """Whether nothing is carved from the chunk."""
        return self.free == [(self.chunk.pointer, self.chunk.pointer + self.chunk.nbytes)]


class Heap:
    """The device's memory. A tensor's memory returns to it on `release()` or when the last view of it is dropped.

    Memory is zeroed by nobody: reading a tensor before it is written or uploaded is a HazardError.

    Attributes:
        arena: memory that transient tensors share.
        allocations: how many times memory was carved from chunks so far.
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
        self.arena = Arena(device)
        self.allocations = 0

    def tensor(self, name: str, shape: tuple[int, ...], dtype: str = "float32") -> Tensor:
        """A new tensor of undefined content. `name` is what messages call it and need not be unique."""
        nbytes = -(-max(1, size_in_bytes(shape, dtype)) // ALIGNMENT) * ALIGNMENT
        with self._lock:
            chunk, start = self._carve(nbytes)
        allocation = Allocation(name, start, nbytes, owner=chunk)
        # Finalizers may run in any thread and in the middle of anything, so they only leave a note.
        allocation.on_release(self._returned.append, (start, start + nbytes))
        self._live.add(allocation)
        return Tensor(self._device, name, shape, dtype, allocation)

    def transient(self, name: str, shape: tuple[int, ...], dtype: str = "float32") -> Tensor:
        """A new tensor for commands of one command buffer: memory is shared with others that are used at other times.

        In every buffer that uses it a command must write it before one reads it: HazardError at commit otherwise. It
        has memory from commit on, and content until its bytes go to another tensor or another buffer with transient
        tensors is committed. The host may look at it until then, and never writes it.
        """
        if self._device.scratch:  # the arena is one piece, which as a whole would lie in a file
            return self.tensor(name, shape, dtype)
        return self.arena.tensor(name, shape, dtype)

    def gone(self, transient: Transient) -> str | None:
        """Why a transient tensor holds nothing any more, as a clause; None while its content is there."""
        return self.arena.gone(transient)

    @property
    def size(self) -> int:
        """Bytes held from the system, used or free."""
        with self._lock:
            return sum(block.chunk.nbytes for block in self._blocks)

    @property
    def used(self) -> int:
        """Bytes of the tensors that live now."""
        with self._lock:
            self._collect()
            return self._used

    @property
    def peak(self) -> int:
        """Most bytes that were in use at once."""
        return self._peak

    def tensors(self) -> list[tuple[str, int]]:
        """Name and bytes of every tensor that lives now, largest first."""
        held = [(allocation.name, allocation.nbytes) for allocation in self._live if not allocation.released]
        return sorted(held, key=lambda item: (-item[1], item[0]))

    def trim(self) -> None:
        """Give chunks in which no tensor lives back to the system."""
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
        self._peak = max(self._peak, self._used)
        return block.chunk, block.take(nbytes, found[0] if found else block.chunk.nbytes)

    def _grow(self, nbytes: int) -> _Block:
        self._drop_idle()  # too small for this tensor; keeping them would hold the sum of all sizes ever used
        chunk = self._memory.allocate(max(nbytes, CHUNK))
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
"""Transient tensors have addresses that are multiples of this until they are placed: no memory has them."""

MOST_PLANS = 64
"""Plans that are remembered; the one used longest ago goes first."""


class Placement(NamedTuple):
    """A buffer's records with every transient tensor in its place, and which memory each of them has there."""

    records: list[Record]
    plan: Plan
    memory: Tensor
    places: list[tuple[Transient, Allocation]]


class Arena:
    """Memory that the transient tensors of all command buffers share, one buffer after the other.

    The memory lives as long as a tensor that was placed in it. It is replaced when a plan needs more, and when tensors
    are gone and the others need less; what it took goes back to the system.

    Attributes:
        plan: the plan of the last placement, None before the first.
        plans: how many plans were made so far.
    """

    def __init__(self, device: TensorDevice) -> None:
        self._device = device
        self._plans: LRUCache[tuple[object, ...], Plan] = LRUCache(MOST_PLANS)
        self._memory: weakref.ref[Tensor] | None = None
        self._replaced: weakref.ref[Tensor] | None = None
        self._live: weakref.WeakSet[Transient] = weakref.WeakSet()
        self._live_lock = threading.Lock()
        self._count = 0
        self._numbers = itertools.count(1)
        self._turn = 0
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
        self, records: Sequence[Record], kept: Collection[Allocation], before: Placement | None, label: str
    ) -> Placement | None:
        """Give the transient tensors of a buffer that is committed their memory; None when it has none.

        Args:
            records: as recorded, or as placed before.
            kept: what the host reads when the buffer is done.
            before: the placement of the same records at their last commit; it is used again where it can be.
            label: what messages call the buffer.
        """
        if not any(isinstance(record, Dispatch) and record.arguments for record in records):
            return None
        if before is None or before.memory is not self._held():
            before = self._new(records, kept)
        if self._replaced is not None and self._replaced() is None:
            self._replaced = None
            self._device.heap.trim()
        self._turn, self._label, self.plan = self._turn + 1, label, before.plan
        for (transient, allocation), taker in zip(before.places, before.plan.takers, strict=True):
            allocation.written, allocation.released = Ranges(), transient.released
            transient.placed, transient.turn = allocation, self._turn
            transient.taken = None if taker is None else before.places[taker][0].name
        return before

    def gone(self, transient: Transient) -> str | None:
        """Why a transient tensor holds nothing any more, as a clause; None while its content is there."""
        if transient.turn and transient.turn < self._turn:
            return f"'{self._label}' was committed since: read it before, or make it by heap.tensor"
        mend = "name it to commands.keep"
        return transient.taken and f"'{transient.taken}' took its memory later in '{self._label}': {mend}"

    def _new(self, records: Sequence[Record], kept: Collection[Allocation]) -> Placement:
        uses, transients = _uses(records)
        plan = self._plan(records, uses, [number for number, item in enumerate(transients) if item in kept], transients)
        for transient in transients:
            transient.needs = max(transient.needs, plan.nbytes)
        memory = self._memory_for(plan)
        places = [(item, item.at(memory, start)) for item, start in zip(transients, plan.offsets, strict=True)]
        for transient, allocation in places:
            transient.placed = allocation
        return Placement([_placed(record) for record in records], plan, memory, places)

    def _plan(self, records: Sequence[Record], uses: Uses, kept: list[int], transients: list[Transient]) -> Plan:
        """The plan of all buffers with such records: made for the first of them."""
        sizes = tuple(transient.nbytes for transient in transients)
        key = (sizes, uses, tuple(kept), _order(records))

        def make() -> Plan:
            self.plans += 1
            return make_plan(sizes, uses, kept, records, self._present(transients))

        return self._plans.get_or_make(key, make)

    def _present(self, transients: Iterable[Transient]) -> Present | None:
        """Where the tensors lie now, so that addresses change as little as they can."""
        memory = self._held()
        if memory is None:
            return None
        places = (item.placed for item in transients)
        return Present(memory.nbytes, [p.pointer - memory.start if p and p.owner is memory else -1 for p in places])

    def _memory_for(self, plan: Plan) -> Tensor:
        """The memory that there is, or other if the plan needs more, or all tensors that live need less."""
        memory, count = self._held(), len(self._live)
        if memory is None or memory.nbytes < plan.nbytes or self._count != count:
            with self._live_lock:
                needed = max(item.needs for item in self._live)
            if memory is None or memory.nbytes != needed:
                self._replaced = self._memory
                memory = self._device.heap.tensor("arena", (needed,), "uint8")
        self._memory, self._count = weakref.ref(memory), count
        return memory

    def _held(self) -> Tensor | None:
        return None if self._memory is None else self._memory()


def _uses(records: Iterable[Record]) -> tuple[Uses, list[Transient]]:
    """The transient tensors in the order of their first use, and for every dispatch the numbers of those it uses."""
    numbers: dict[Transient, int] = {}
    dispatches = [record for record in records if isinstance(record, Dispatch)]
    used = (dispatch.arguments.transients if dispatch.arguments else () for dispatch in dispatches)
    uses = tuple([tuple([numbers.setdefault(item, len(numbers)) for item in items]) for items in used])
    return uses, list(numbers)


def _order(records: Sequence[Record]) -> tuple[object, ...]:
    """What tells the order of dispatches: encoders, numbered as they come, with stages and barriers."""
    numbers: dict[int, int] = {}
    return tuple((numbers.setdefault(record.encoder, len(numbers)), *_ordering(record)) for record in records)


def _ordering(record: Record) -> tuple[object, ...]:
    if isinstance(record, Dispatch):
        return (record.stage,)
    return (type(record),) if isinstance(record, EncoderBarrier) else (type(record), record.after, record.before)


def _placed(record: Record) -> Record:
    if not isinstance(record, Dispatch) or record.arguments is None:
        return record
    placed = record.arguments.placed()
    names = (record.label, record.command, record.stage, record.encoder)
    return Dispatch(*names, placed.reads, placed.writes, placed.execute, record.model, record.state, record.arguments)


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

    The largest are placed first: that reached the bound for every shipped network, where orders by length or first use
    took up to 45 % more.

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
    offsets = _settled(present, sizes, apart) if present else None
    if offsets is None:
        offsets = _place(_largest_first(range(len(sizes)), sizes), sizes, apart, [-1] * len(sizes))
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
    others = set(range(len(sizes))).difference(lying)
    offsets = _place(_largest_first(others, sizes), sizes, apart, list(present.offsets))
    return offsets if _end(offsets, sizes) <= present.nbytes else None


def _largest_first(items: Iterable[int], sizes: Sequence[int]) -> list[int]:
    return sorted(items, key=lambda i: (-sizes[i], i))


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
