"""The arena: bytes that transient tensors share, placed by what a command buffer recorded.

A transient tensor has no memory while commands are recorded. At commit, the buffer's records tell when each is used,
the plan for such records gives each an offset, and the records are handed on with tensors in the arena's memory.
"""

from __future__ import annotations

import itertools
import threading
import weakref
from collections.abc import Collection, Iterable, Sequence
from typing import TYPE_CHECKING, NamedTuple

from postfx.caching import LRUCache
from postfx.runtime.memory import ALIGNMENT, Ranges
from postfx.runtime.memory_plan import Plan, Present, Uses, make_plan
from postfx.runtime.records import Dispatch, EncoderBarrier, Record
from postfx.runtime.tensor import Allocation, Tensor, size_in_bytes

if TYPE_CHECKING:
    from postfx.runtime.device import Device

_NOWHERE = 1 << 62
"""Transient tensors have addresses that are multiples of this until they are placed: no memory has them."""

MOST_PLANS = 64
"""Plans that are remembered; the one used longest ago goes first."""


class Transient(Allocation):
    """Stands for memory that a tensor will have when a buffer that uses it is committed.

    Attributes:
        placed: the memory that it had in the last such buffer.
        taken: name of the tensor that the memory went to within that buffer, if it did.
        turn: which of the arena's placements that was.
        needs: bytes of the largest plan that placed it.
    """

    unplaced = True

    def __init__(self, name: str, pointer: int, nbytes: int) -> None:
        super().__init__(name, pointer, nbytes, owner=None, transient=True)
        self.taken: str | None = None
        self.turn = self.needs = 0

    def at(self, memory: Tensor, offset: int) -> Allocation:
        """It, placed; the same object as the last time when the place is the same."""
        pointer = memory.start + offset
        if self.placed is None or self.placed.owner is not memory or self.placed.pointer != pointer:
            return Allocation(self.name, pointer, self.nbytes, owner=memory, transient=True)
        return self.placed


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

    def __init__(self, device: Device) -> None:
        self._device = device
        self._plans: LRUCache[tuple, Plan] = LRUCache(MOST_PLANS)
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


def _order(records: Sequence[Record]) -> tuple:
    """What tells the order of dispatches: encoders, numbered as they come, with stages and barriers."""
    numbers: dict[int, int] = {}
    return tuple((numbers.setdefault(record.encoder, len(numbers)), *_ordering(record)) for record in records)


def _ordering(record: Record) -> tuple:
    if isinstance(record, Dispatch):
        return (record.stage,)
    return (type(record),) if isinstance(record, EncoderBarrier) else (type(record), record.after, record.before)


def _placed(record: Record) -> Record:
    if not isinstance(record, Dispatch) or record.arguments is None:
        return record
    placed = record.arguments.placed()
    names = (record.label, record.command, record.stage, record.encoder)
    return Dispatch(*names, placed.reads, placed.writes, placed.execute, record.model, record.state, record.arguments)
