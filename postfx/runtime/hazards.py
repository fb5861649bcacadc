"""Hazard checks: at commit, and when the host touches memory that commands use.

The accesses checked are those of the tensors bound at dispatch, by the names and directions that the model file or
the kernel itself declares, and memory is compared by address: nothing a caller says can hide an access.
"""

from __future__ import annotations

import threading
import weakref
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from postfx.runtime.errors import HazardError
from postfx.runtime.ordering import Conflict, find_conflict
from postfx.runtime.ranges import Ranges
from postfx.runtime.records import Dispatch, Record
from postfx.runtime.tensor import Allocation, Tensor

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
            flying = [record for buffer in self._flying for record in buffer.records]
            new = _dispatches(commands.records)
            written = _check_content(new)
            conflict = find_conflict([*flying, *commands.records], len(_dispatches(flying)))
            if conflict is not None:
                raise _conflict_error(conflict, _dispatches([*flying, *commands.records]))
            for allocation, ranges in written.items():
                allocation.written = ranges
            self._flying.append(commands)

    def retire(self, commands: CommandBuffer) -> None:
        """The host waited for this buffer: it and everything committed before it are done."""
        with self._lock:
            if commands in self._flying:
                del self._flying[: self._flying.index(commands) + 1]

    def mark_written(self, tensor: Tensor) -> None:
        """The tensor's content is defined now."""
        with self._lock:
            tensor.allocation.written.add(*tensor.span())

    def mark_undefined(self, tensors: Iterable[Tensor]) -> None:
        """A command that should have written these tensors failed."""
        with self._lock:
            for tensor in tensors:
                tensor.allocation.written.remove(*tensor.span())

    def check_host_read(self, tensor: Tensor) -> None:
        """HazardError when a committed command that was not waited for writes the tensor."""
        self._check_host(tensor, "reads", self._flying, lambda dispatch: dispatch.writes, "call wait() first")

    def check_host_write(self, tensor: Tensor) -> None:
        """HazardError when a recorded command, or a committed one that was not waited for, uses the tensor."""
        used = lambda dispatch: (*dispatch.reads, *dispatch.writes)  # noqa: E731
        self._check_host(tensor, "writes", self._flying, used, "call wait() first")
        mend = "it runs after commit and would see the new values, so upload before recording, to a tensor of its own"
        self._check_host(tensor, "writes", list(self._open), used, mend)

    def _check_host(
        self,
        tensor: Tensor,
        verb: str,
        buffers: Iterable[CommandBuffer],
        accessed: Callable[[Dispatch], tuple[Tensor, ...]],
        mend: str,
    ) -> None:
        with self._lock:
            for dispatch in (item for buffer in buffers for item in _dispatches(buffer.records)):
                if any(_overlap(tensor, other) for other in accessed(dispatch)):
                    message = f"the host {verb} '{tensor.name}' while {dispatch} uses it: {mend}"
                    raise HazardError(message, "host access", tensor.name, dispatch.label, "host")


def check_dispatch(dispatch: Dispatch) -> None:
    """HazardError when one dispatch reads and writes, or writes twice, the same memory."""
    for index, written in enumerate(dispatch.writes):
        for other in (*dispatch.reads, *dispatch.writes[:index]):
            if _overlap(written, other):
                pair = f"'{other.name}' and '{written.name}'" if other.name != written.name else f"'{written.name}'"
                message = f"{dispatch} has {pair} on the same memory, one of them written: bind separate tensors"
                raise HazardError(message, "aliasing", written.name, None, dispatch.label)


def _check_content(dispatches: list[Dispatch]) -> dict[Allocation, Ranges]:
    """What each allocation holds after the dispatches; HazardError when one reads what nothing wrote."""
    written: dict[Allocation, Ranges] = {}
    for index, dispatch in enumerate(dispatches):
        for tensor in (*dispatch.reads, *dispatch.writes):
            if tensor.released:
                message = f"{dispatch} uses '{tensor.name}', which was released before commit"
                raise HazardError(message, "released", tensor.name, None, dispatch.label)
            if tensor.allocation not in written:
                written[tensor.allocation] = tensor.allocation.written.copy()
        for tensor in dispatch.reads:
            if tensor.nbytes and not written[tensor.allocation].covers(*tensor.span()):
                raise _undefined_error(tensor, dispatch, dispatches[index + 1:])
        for tensor in dispatch.writes:
            written[tensor.allocation].add(*tensor.span())
    return written


def _undefined_error(tensor: Tensor, reader: Dispatch, later: list[Dispatch]) -> HazardError:
    writer = next((item for item in later if any(_overlap(tensor, other) for other in item.writes)), None)
    mend = f"only {writer} writes it, later: record it first" if writer else "upload to it, or write it by a command"
    message = f"read before write: {reader} reads '{tensor.name}', which nothing wrote before: {mend}"
    return HazardError(message, "read before write", tensor.name, writer.label if writer else None, reader.label)


def _conflict_error(conflict: Conflict, dispatches: list[Dispatch]) -> HazardError:
    first, second = dispatches[conflict.first], dispatches[conflict.second]
    did, does = ("writes" if word == "write" else "reads" for word in reversed(conflict.kind.split(" after ")))
    if first.encoder == second.encoder:
        mend = f"barrier() between them in '{second.label}'"
    else:
        mend = f"barrier(after='{first.stage}', before='{second.stage}') in '{second.label}' before it"
    name = conflict.tensor.name
    message = f"{conflict.kind}: {second} {does} '{name}', which {first} {did}, in no certain order: record {mend}"
    return HazardError(message, conflict.kind, name, first.label, second.label)


def _dispatches(records: Iterable[Record]) -> list[Dispatch]:
    return [record for record in records if isinstance(record, Dispatch)]


def _overlap(one: Tensor, other: Tensor) -> bool:
    return one.start < other.end and other.start < one.end and one.nbytes > 0 and other.nbytes > 0
