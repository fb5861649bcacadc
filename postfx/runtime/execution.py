"""Running the commands of one buffer: one by one, or as a whole where the device can."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from operator import attrgetter
from typing import Any, NamedTuple

from postfx.errors import CommandError
from postfx.runtime.capture import Recorder
from postfx.runtime.hazards import Hazards
from postfx.runtime.memory import Memory
from postfx.runtime.records import Dispatch
from postfx.runtime.session import first_line


class Span(NamedTuple):
    """When dispatches of an encoder ran, by the device's clock."""

    encoder: int
    label: str
    begin: Any
    end: Any


class Execution:
    """One run of a command buffer's dispatches.

    Attributes:
        running: the dispatch that runs now; None when none does, or all run as a whole.
        error: of the first dispatch that failed.
        timings: encoder -> its label and milliseconds.
    """

    def __init__(
        self, memory: Memory, hazards: Hazards, label: str, dispatches: Sequence[Dispatch],
        recorder: Recorder | None = None
    ) -> None:
        self.running: Dispatch | None = None
        self.error: CommandError | None = None
        self.timings: dict[int, tuple[str, float]] = {}
        self._memory = memory
        self._hazards = hazards
        self._label = label
        self._dispatches = dispatches
        self._recorder = recorder

    def run(self) -> None:
        """Run all, up to the first that fails, and wait until they are done."""
        spans = self._replay()
        if spans is None:
            spans = self._one_by_one()
        try:
            self._memory.synchronise()
            self.timings = _timings(self._memory, spans)
        except BaseException as error:  # what a GPU only began may fail later
            self.error = self.error or CommandError(f"'{self._label}' failed: {first_line(error)}", self._label)
            self.error.__cause__ = self.error.__cause__ or error
        self.running = None

    def _replay(self) -> list[Span] | None:
        """Run all as a whole; None where that cannot be, or something has to be seen to on the way."""
        dispatches, memory = self._dispatches, self._memory
        if not memory.replays or self._recorder is not None:
            return None
        if any(tensor.allocation.lost for dispatch in dispatches for tensor in (*dispatch.reads, *dispatch.writes)):
            return None
        states = [dispatch.state for dispatch in dispatches]
        # A capture that fails leaves ONNX Runtime's session broken.
        if not all(state and state.capturable for state in states):
            return None
        try:
            return memory.replay(_signature(dispatches), states, lambda: _enqueue(memory, dispatches))
        except BaseException as error:
            self._failed(dispatches, CommandError(f"'{self._label}' failed: {first_line(error)}", self._label), error)
            return []

    def _one_by_one(self) -> list[Span]:
        spans: list[Span] = []
        for index, dispatch in enumerate(self._dispatches):
            self.running = dispatch
            lost = self._lost_input(dispatch)
            if lost is not None:
                what = f"{dispatch} of '{self._label}' did not run: it reads {lost[0]}, but {lost[1]}"
                self._failed(self._dispatches[index:], CommandError(what, dispatch.label), lost[1], lost[1])
                break
            try:
                spans += self._execute(dispatch)
            except BaseException as error:  # whatever it is, the waiting host must learn of it
                what = f"{dispatch} of '{self._label}' failed: {first_line(error)}"
                self._failed(self._dispatches[index:], CommandError(what, dispatch.label), error)
                break
        return spans

    def _execute(self, dispatch: Dispatch) -> list[Span]:
        memory = self._memory
        spans = _enqueue(memory, [dispatch])
        memory.relax()
        for tensor in dispatch.writes:
            if tensor.allocation.lost:
                self._hazards.mark_found(tensor)
        if self._recorder is not None:
            memory.synchronise()
            self._recorder.ran(dispatch, memory.milliseconds(spans[0].begin, spans[0].end))
        return spans

    def _lost_input(self, dispatch: Dispatch) -> tuple[str, CommandError] | None:
        """Name and error of what the dispatch reads and a command should have written that failed."""
        for tensor in dispatch.reads:
            first = self._hazards.loss(tensor) if tensor.allocation.lost else None
            if first is not None:
                return f"'{tensor.name}'", first
        return None

    def _failed(self, dispatches: Sequence[Dispatch], error: CommandError, cause: BaseException,
                first: CommandError | None = None) -> None:
        """Note the error; what the dispatches should have written is lost, by it or by the `first` one."""
        self.error = error
        error.__cause__ = cause
        self._hazards.mark_lost([tensor for left in dispatches for tensor in left.writes], first or error)
        if self._recorder is not None:
            self._recorder.failed(dispatches[0], first or error, ran=first is None)


def _enqueue(memory: Memory, dispatches: Sequence[Dispatch]) -> list[Span]:
    """Run dispatches, or put them on a GPU's stream; returns when each encoder's began and ended."""
    spans = []
    for encoder, group in groupby(dispatches, attrgetter("encoder")):
        begin, label = memory.mark(), ""
        for dispatch in group:
            assert dispatch.execute is not None  # since commit
            dispatch.execute()
            label = dispatch.label
        spans.append(Span(encoder, label, begin, memory.mark()))
    return spans


def _signature(dispatches: Sequence[Dispatch]) -> tuple[object, ...]:
    """What dispatches do: the same whenever the states and the tensors' bytes are."""
    return tuple((id(dispatch.state), *((tensor.start, tensor.shape) for tensor in dispatch.reads + dispatch.writes))
                 for dispatch in dispatches)


def _timings(memory: Memory, spans: Sequence[Span]) -> dict[int, tuple[str, float]]:
    """Label and milliseconds of every encoder."""
    timings: dict[int, tuple[str, float]] = {}
    for span in spans:
        before = timings.get(span.encoder, (span.label, 0.0))[1]
        timings[span.encoder] = span.label, before + memory.milliseconds(span.begin, span.end)
    return timings
