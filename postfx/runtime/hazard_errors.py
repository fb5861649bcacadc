"""What hazard errors say: both commands, the tensor and the mend."""

from __future__ import annotations

from typing import TYPE_CHECKING

from postfx.errors import CommandError, HazardError
from postfx.runtime.footprint import Need
from postfx.runtime.ordering import Conflict
from postfx.runtime.records import Dispatch
from postfx.runtime.tensor import Tensor

if TYPE_CHECKING:
    from postfx.runtime.commands import CommandBuffer


def check_dispatch(dispatch: Dispatch) -> None:
    """HazardError when one dispatch reads and writes, or writes twice, the same memory."""
    for index, written in enumerate(dispatch.writes):
        for other in (*dispatch.reads, *dispatch.writes[:index]):
            if written.overlaps(other):
                pair = f"'{other.name}' and '{written.name}'" if other.name != written.name else f"'{written.name}'"
                message = f"{dispatch} has {pair} on the same memory, one of them written: bind separate tensors"
                raise HazardError(message, "aliasing", written.name, None, dispatch.label)


def released(tensor: Tensor, dispatch: Dispatch) -> HazardError:
    """A dispatch uses a tensor whose memory was given back."""
    message = f"{dispatch} uses '{tensor.name}', which was released before commit: record it with a new tensor"
    return HazardError(message, "released", tensor.name, None, dispatch.label)


def undefined(need: Need, dispatches: list[Dispatch]) -> HazardError:
    """A dispatch reads what nothing wrote before, though perhaps one of `dispatches` does so later."""
    name, label = need.tensor.name, need.dispatch.label
    later = dispatches[dispatches.index(need.dispatch) + 1:]
    writer = next((item for item in later if any(need.tensor.overlaps(other) for other in item.writes)), None)
    mend = f"only {writer} writes it, later: record it first" if writer else "upload to it, or write it by a command"
    what = f"'{name}', which nothing wrote before"
    if need.tensor.allocation.transient:
        what = f"transient '{name}', which nothing in this command buffer wrote before"
        mend = mend if writer else "write it by a command, or make what is kept from buffer to buffer by heap.tensor"
    message = f"read before write: {need.dispatch} reads {what}: {mend}"
    return HazardError(message, "read before write", name, writer.label if writer else None, label)


def lost(need: Need, failed: CommandError) -> HazardError:
    """A dispatch reads what a failed command should have written."""
    name = need.tensor.name
    mend = f"commit that again, or upload to '{name}'"
    message = f"read before write: {need.dispatch} reads '{name}', but {failed}: {mend}"
    return HazardError(message, "read before write", name, failed.label, need.dispatch.label)


def conflict(
    found: Conflict, first: tuple[CommandBuffer, Dispatch], second: tuple[CommandBuffer, Dispatch]
) -> HazardError:
    """Two dispatches, each with its buffer, touch the same memory in no certain order."""
    (one_buffer, one), (two_buffer, two) = first, second
    same = one_buffer is two_buffer
    does, did = ("writes" if word == "write" else "reads" for word in found.kind.split(" after "))
    earlier = str(one) if same else f"{one} of '{one_buffer.label}'"
    later = str(two) if same else f"{two} of '{two_buffer.label}'"
    name = found.tensor.name
    what = f"{later} {does} '{name}', which {earlier} {did}, in no certain order"
    return HazardError(f"{found.kind}: {what}: record {_mend(one, two)}", found.kind, name, one.label, two.label)


def _mend(one: Dispatch, two: Dispatch) -> str:
    if one.encoder == two.encoder:
        return f"barrier() between them in '{two.label}'"
    consumer = f"barrier(after='{one.stage}', before='{two.stage}') in '{two.label}' before it"
    return f"{consumer}, or barrier(after='{one.stage}', before_queue='{two.stage}') in '{one.label}' after it"
