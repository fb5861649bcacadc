"""What recorded commands need and leave behind: worked out once, checked at every commit."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from postfx.runtime.memory import Ranges
from postfx.runtime.records import Dispatch, Record
from postfx.runtime.tensor import Allocation, Tensor


class Need(NamedTuple):
    """Bytes of an allocation that a dispatch reads and that none of the commands before it wrote."""

    dispatch: Dispatch
    tensor: Tensor
    missing: Ranges


class Span(NamedTuple):
    """A byte range of device memory, and which dispatches write it or access it at all: bit masks of their indices."""

    start: int
    end: int
    writers: int
    users: int


class Footprint:
    """The accesses of one command buffer's records.

    Attributes:
        records: dispatches and barriers, in order.
        dispatches: the dispatches, in order.
        users: every allocation, with the first tensor and dispatch that use it.
        needs: what has to hold data before the commands run, by allocation and byte range of the tensor.
        writes: what holds data afterwards.
        spans: the byte ranges that the dispatches' tensors take, each once.
        ordered: whether a search found every conflict among these commands ordered; that stays true.
    """

    def __init__(self, records: Sequence[Record]) -> None:
        self.records = records
        self.dispatches = [record for record in records if isinstance(record, Dispatch)]
        self.users: dict[Allocation, tuple[Tensor, Dispatch]] = {}
        self.needs: dict[tuple[Allocation, tuple[int, int]], Need] = {}
        self.writes: dict[Allocation, Ranges] = {}
        self.spans = _spans(self.dispatches)
        self.ordered = False
        for dispatch in self.dispatches:
            for tensor in dispatch.reads:
                self.users.setdefault(tensor.allocation, (tensor, dispatch))
                self._read(dispatch, tensor)
            for tensor in dispatch.writes:
                self.users.setdefault(tensor.allocation, (tensor, dispatch))
                self._write(tensor)

    def _read(self, dispatch: Dispatch, tensor: Tensor) -> None:
        allocation, span = tensor.allocation, tensor.span()
        written = self.writes.get(allocation)
        if not tensor.nbytes or (allocation, span) in self.needs or (written is not None and written.covers(*span)):
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
            self.writes[tensor.allocation] = Ranges((tensor.span(),))
        else:
            written.add(*tensor.span())


def _spans(dispatches: Iterable[Dispatch]) -> list[Span]:
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
    return [Span(start, end, writers.get((start, end), 0), mask) for (start, end), mask in users.items() if start < end]
