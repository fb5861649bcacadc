"""Hazard checks at commit, and what commands do with memory now.

The accesses checked are those of the tensors bound at dispatch, by the names and directions that the model file or
the kernel itself declares, and memory is compared by address: nothing a caller says can hide an access.
"""

from __future__ import annotations

import threading
import weakref
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

from postfx.errors import CommandError
from postfx.runtime import hazard_errors
from postfx.runtime.footprint import Footprint, Need
from postfx.runtime.memory import Ranges
from postfx.runtime.ordering import find_conflict
from postfx.runtime.records import Dispatch
from postfx.runtime.tensor import Allocation, Tensor, TensorState, Use

if TYPE_CHECKING:
    from postfx.runtime.commands import CommandBuffer


class Hazards:
    """What is in flight on one device. A buffer is in flight from commit until the host waited for it or a later one.

    It is retired by `wait`, not when it happens to finish, so that a missing barrier between two buffers is found
    whatever the timing.
    """

    def __init__(self) -> None:
        self._flying: list[CommandBuffer] = []
        self._open: weakref.WeakSet[CommandBuffer] = weakref.WeakSet()
        self._lock = threading.RLock()

    def opened(self, commands: CommandBuffer) -> None:
        """A buffer takes commands from now on."""
        with self._lock:
            self._open.add(commands)

    def closed(self, commands: CommandBuffer) -> None:
        """A buffer was committed or discarded."""
        with self._lock:
            self._open.discard(commands)

    def commit(self, commands: CommandBuffer) -> None:
        """Check a buffer against itself and everything in flight, and put it in flight; HazardError leaves it out."""
        with self._lock:
            footprint = commands.footprint()
            self._check_content(footprint)
            self._check_order(commands, footprint)
            for allocation, ranges in footprint.writes.items():
                for span in ranges.spans:
                    allocation.written.add(*span)
            self._flying.append(commands)

    def retire(self, commands: CommandBuffer) -> None:
        """The host waited for this buffer: it and everything committed before it are done."""
        with self._lock:
            if commands in self._flying:
                del self._flying[: self._flying.index(commands) + 1]

    def in_flight(self) -> list[CommandBuffer]:
        """Buffers that were committed and not retired, in the order of commit."""
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
            for commands, dispatch in _dispatches(self._open):
                if _uses(dispatch.writes, tensor) or _uses(dispatch.reads, tensor):
                    recorded = _use(commands, dispatch)
                    break
            needed = Ranges((tensor.span(),) if tensor.nbytes else ())
            gone = tensor.device.heap.arena.gone(tensor.allocation) if tensor.allocation.transient else None
            failed = self._failure(resident.allocation, needed)
            defined = gone is None and failed is None and resident.allocation.written.includes(needed)
            return TensorState(tensor.released, defined, writer, reader, recorded, failed, gone)

    def mark_written(self, tensor: Tensor) -> None:
        """The tensor's content is defined now."""
        with self._lock:
            tensor.allocation.written.add(*tensor.span())
            self.mark_found(tensor)

    def mark_found(self, tensor: Tensor) -> None:
        """A command wrote the tensor, which an earlier one had failed to write."""
        with self._lock:
            for ranges, _ in tensor.allocation.lost:
                ranges.remove(*tensor.span())
            tensor.allocation.lost = [item for item in tensor.allocation.lost if item[0].spans]

    def mark_lost(self, tensors: Iterable[Tensor], cause: CommandError) -> None:
        """A command failed, and so nothing wrote these tensors."""
        with self._lock:
            for tensor in tensors:
                self.mark_found(tensor)
                if tensor.nbytes:
                    tensor.allocation.lost.append((Ranges((tensor.span(),)), cause))

    def loss(self, tensor: Tensor) -> CommandError | None:
        """The error of the command that should have written the tensor, as far as commands have run."""
        needed = Ranges((tensor.span(),))
        with self._lock:
            return next((cause for ranges, cause in tensor.allocation.lost if ranges.touches(needed)), None)

    def _failure(self, allocation: Allocation, needed: Ranges) -> CommandError | None:
        """Why some of these bytes will never be written: a failed command should have, and none in flight will."""
        for ranges, cause in allocation.lost:
            left = ranges.copy()
            for commands in self._flying:
                left.subtract(commands.footprint().writes.get(allocation, Ranges()))
            if left.touches(needed):
                return cause
        return None

    def _check_content(self, footprint: Footprint) -> None:
        for allocation, (tensor, dispatch) in footprint.users.items():
            if allocation.released:
                raise hazard_errors.released(tensor, dispatch)
        for need in footprint.needs.values():
            self._check_need(need, footprint)

    def _check_need(self, need: Need, footprint: Footprint) -> None:
        allocation = need.tensor.allocation
        if not allocation.written.includes(need.missing):
            raise hazard_errors.undefined(need, footprint.dispatches)
        if allocation.lost and (failed := self._failure(allocation, need.missing)):
            raise hazard_errors.lost(need, failed)

    def _check_order(self, commands: CommandBuffer, footprint: Footprint) -> None:
        if footprint.ordered and not self._flying:
            return
        conflict = find_conflict([buffer.footprint() for buffer in self._flying], footprint)
        if conflict is not None:
            dispatches = list(_dispatches([*self._flying, commands]))
            raise hazard_errors.conflict(conflict, dispatches[conflict.first], dispatches[conflict.second])
        footprint.ordered = True


def _dispatches(buffers: Iterable[CommandBuffer]) -> Iterator[tuple[CommandBuffer, Dispatch]]:
    return ((buffer, record) for buffer in buffers for record in buffer.records if isinstance(record, Dispatch))


def _uses(tensors: Iterable[Tensor], tensor: Tensor) -> bool:
    return any(other.overlaps(tensor) for other in tensors)


def _use(commands: CommandBuffer, dispatch: Dispatch) -> Use:
    return Use(dispatch.label, dispatch.command, commands.label)
