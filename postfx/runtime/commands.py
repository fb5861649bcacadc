"""Command buffers: commands are recorded, committed, run and waited for."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future
from concurrent.futures import wait as wait_for_futures
from contextlib import contextmanager
from itertools import groupby
from typing import Any, NamedTuple, Protocol, TypeVar

from postfx.errors import BindingError, CommandError, CommandTimeout, EncodingError
from postfx.frame import LOG
from postfx.kernels import Kernel
from postfx.runtime.capture import CapturableDevice, Recorder
from postfx.runtime.encoders import (
    ComputeEncoder,
    Dispatch,
    Encoder,
    KnownCommands,
    MachineLearningEncoder,
    Passage,
    Record,
    Recordings,
    Tables,
)
from postfx.runtime.hazards import (
    Accesses,
    Footprint,
    Hazards,
    UsedMemory,
    predecessors,
    with_barriers,
)
from postfx.runtime.heap import Placement
from postfx.runtime.session import first_line
from postfx.runtime.states import State
from postfx.runtime.tensor import Allocation, Tensor
from postfx.runtime.threads import CommandQueue, Slots, timeout_error
from postfx.workers import finished_before_the_end

E = TypeVar("E", bound="Encoder")
R = TypeVar("R")

_STATES = {
    "committed": "it was committed, call wait() first",
    "done": "it is done, call begin() to record again",
    "discarded": "it was discarded, call begin() to record again",
}


class CommandDevice(CapturableDevice, Protocol):
    """What a command buffer needs of its device."""

    @property
    def hazards(self) -> Hazards: ...

    @property
    def queue(self) -> CommandQueue: ...

    @property
    def lanes(self) -> Executor: ...

    @property
    def coordinators(self) -> Executor: ...

    @property
    def slots(self) -> Slots: ...

    def compute_state(self, kernel: Kernel) -> State: ...

    def next_encoder(self) -> int: ...

    def require_process(self) -> None: ...


class CommandBuffer:
    """Commands for one device, recorded by encoders one after the other. Made by
    `Device.command_buffer`.

    It is open at first, then committed, and done once `wait` returns. Then it can be committed
    again unchanged, or recorded again after `begin`.

    Attributes:
        label: name in messages, for example 'frame 12'.
        captured: whether an active capture records it.
        known: recordings that it may be one of, and is among after its first commit.
        records: dispatches and barriers in order.
        used: the memory that they use.
        timings: (label, milliseconds) of every encoder that ran, in order; complete after `wait`.
            Where the commands ran as one CUDA graph, those of a group are one, 'GROUP/*'.
    """

    def __init__(self, device: CommandDevice, label: str, captured: bool = True,
                 known: Recordings | None = None) -> None:
        self.device, self.label, self.captured, self.known = device, label, captured, known
        self.records: list[Record] = []
        self._kept: set[Allocation] = set()
        self._placement: Placement | None = None
        self._footprint: Footprint | None = None
        self.used = UsedMemory()
        self._groups: list[str] = []
        self._passages: list[Passage] = []
        self._encoder: Encoder | None = None
        # the encoder of the last `run`, which another one may go on with
        self._running: Encoder | None = None
        self._tables = Tables() if known is None else known.tables
        self._runs: Counter[tuple[State, str]] = Counter()
        self._state = "open"
        self._done = threading.Event()
        self._handled: threading.Event | None = None  # of this commit, where there are handlers
        self._handling = 0  # the thread that runs them
        self._error: CommandError | None = None
        self.timings: list[tuple[str, float]] = []
        self._recorder: Recorder | None = None
        self._execution: Execution | None = None
        self._handlers: list[Callable[[CommandBuffer], None]] = []
        device.hazards.open(self)

    def begin(self, label: str | None = None) -> None:
        """Drop all records and timings and start recording again, under a new label if one is
        given.

        Like Metal 4's `beginCommandBuffer`, except that the buffer owns its records, so a committed
        buffer must be waited for first. Raises EncodingError before that, or while an encoder is
        open.
        """
        if self._state == "committed":
            raise EncodingError(f"'{self.label}' cannot begin again: {_STATES['committed']}")
        self._require_no_encoder(self.label, "begin again")
        self._runs.clear()
        self.label = self.label if label is None else label
        self.records, self._kept, self._placement, self._footprint = [], set(), None, None
        self.used = UsedMemory()
        self._error, self.timings, self._handlers, self._passages = None, [], [], []
        self._state = "open"
        self.device.hazards.open(self)

    def compute_encoder(self, label: str) -> ComputeEncoder:
        """Begin to record kernels under a label."""
        return self._start(ComputeEncoder(self, self._full(label), self.device.next_encoder()))

    def machine_learning_encoder(self, label: str) -> MachineLearningEncoder:
        """Begin to record networks under a label."""
        return self._start(MachineLearningEncoder(self, self._full(label),
                                                  self.device.next_encoder()))

    def run(self, kernel: Kernel | State, label: str = "", /, **tensors: Tensor) -> None:
        """Record one run of a kernel, or of a network, on tensors by the names of its bindings.

            commands.run(LOWRES, "prepare", colour=colour, params=params, matrix=matrix,
                         lowres=small)

        Encoders and argument tables are made inside. It runs after what it depends on, by what all
        commands read and write. Runs in a row under one label are one entry of `timings`.

        Args:
            kernel: a `Kernel`, or what `Device.pipeline_state`, `compute_state` or `host_state`
                made.
            label: default: the name of the kernel or network.

        Raises BindingError for tensors that are missing, unknown or do not fit, HazardError for
        aliased ones, EncodingError after commit or while an encoder is open.
        """
        state = self.device.compute_state(kernel) if isinstance(kernel, Kernel) else kernel
        label = label or state.name
        full = self._full(label)
        table = self._tables.table(state, full, self._runs[state, full])
        self._runs[state, full] += 1
        try:
            table.bind(tensors)
        except BindingError as error:
            raise BindingError(f"'{full}': {error}") from None
        if (self._running is None
            or (self._running.label, self._running.stage) != (full, state.stage)):
            kind = (MachineLearningEncoder if state.stage == MachineLearningEncoder.stage
                    else ComputeEncoder)
            self._running = self._start(kind(self, full, self.device.next_encoder()))
        self._running.dispatch(state, table)

    @contextmanager
    def group(self, name: str) -> Iterator[None]:
        """Labels of encoders begun inside are prefixed by 'name/': they are the keys of
        `timings`."""
        self._groups.append(name)
        try:
            yield
        finally:
            self._groups.pop()

    def keep(self, *tensors: Tensor) -> None:
        """Keep transient tensors for the host to read: their memory stays theirs until another
        buffer with transient tensors is committed. Raises EncodingError after commit."""
        self._require_open()
        self._kept.update(tensor.allocation for tensor in tensors)

    def repeat(self, key: tuple[object, ...], record: Callable[[], R]) -> R:
        """Let `record` record some commands, or repeat what it recorded for an equal `key` in a
        buffer before; returns what it returned. The key holds all tensors that the commands use and
        the caller may change, and whatever else they depend on. `record` touches nothing but this
        buffer."""
        if self.known is None:
            return record()
        self._require_open()
        self._require_no_encoder(self.label, "repeat commands")
        key = (*self._groups, *key)
        passage = self.known.passages.find(key)
        if passage is None:
            first, result = len(self.records), record()
            self._require_no_encoder(self.label, "keep commands")
            passage = Passage(self.records[first:], result)
            self.known.passages[key] = passage
        else:
            self.records += passage.records
        self._passages.append(passage)
        known: R = passage.result
        return known

    def add_completed_handler(self, handler: Callable[[CommandBuffer], None]) -> None:
        """Call `handler(buffer)` whenever the commands are done or one has failed, on a thread of
        the device.

        Keep it short: `wait` of other threads returns after it. It may `wait` itself, which then
        returns or raises at once, and read results. What it raises goes to the log. Metal's
        `addCompletedHandler:`; `begin` drops it. Raises EncodingError after commit.
        """
        self._require_open()
        self._handlers.append(handler)

    @finished_before_the_end()
    def commit(self) -> None:
        """Order commands, give transient tensors their memory, check all hazards and hand all to
        the device's queue.

        Commands that read or write what others write come after them as they were recorded, unless
        the device has explicit barriers; recorded barriers add to that.

        Nothing can be recorded until `begin`.

        After `wait`, a buffer can be committed again without recording: the same dispatches run on
        the same tensors, whose content may have been replaced by `upload`.

        Raises HazardError, which discards the buffer; EncodingError if an encoder is still open or
        the buffer is in flight or discarded; DeviceError in a forked process.
        """
        self._require_no_encoder(self.label, "be committed")
        self.device.require_process()
        if self._state not in ("open", "done"):
            raise EncodingError(f"'{self.label}' cannot be committed: {_STATES[self._state]}")
        self._state = "discarded"
        self.device.hazards.close(self)
        self._error, self.timings = None, []
        self._done.clear()
        self._handled = threading.Event() if self._handlers else None
        with self.device.commit_lock:
            key = self._recognise()
            # before transient tensors get their memory, by the barriers between commands
            if not (self.device.hazards.explicit or self._footprint):
                self.records = with_barriers(Accesses(self.records))
            placement = self.device.heap.arena.place(self.records, self._kept, self._placement,
                                                     self.label)
            if placement is not None and placement is not self._placement:
                self.records, self._placement, self._footprint = placement.records, placement, None
            stands_apart = self.device.hazards.commit(self)
            if self.known and key:
                self.known.keep(key, KnownCommands(self.records, self._placement, self.footprint(),
                                                   self._passages))
            self.device.heap.arena.give_back()
            self._state = "committed"
            capture = self.device.active_capture if self.captured else None
            self._recorder = None if capture is None else capture.record(self)
            beside = stands_apart and self._recorder is None and runs_side_by_side(self.device)
            self.device.queue.submit(self._run, self.device.coordinators if beside else None)

    def discard(self) -> None:
        """Close the buffer without running it. A committed buffer is not affected."""
        if self._state == "open":
            if self._encoder is not None:
                self._encoder.end()
            self._state = "discarded"
            self.device.hazards.close(self)

    def wait(self, timeout: float | None = None) -> None:
        """Block until all commands are done and their handlers have run, or for `timeout` seconds
        (None: no limit).

        Raises CommandTimeout when they are not done in time, CommandError when one failed,
        EncodingError before commit.
        """
        if self._state not in ("committed", "done"):
            raise EncodingError(f"'{self.label}' cannot be waited for: it is {self._state}, commit "
                                "it first")
        begin, handled = time.monotonic(), self._handled
        if not self._done.wait(timeout):
            raise timeout_error(f"'{self.label}' was not done after {timeout:g} s",
                                self.device.hazards.in_flight())
        left = None if timeout is None else max(0.0, timeout - (time.monotonic() - begin))
        if (handled is not None and threading.get_ident() != self._handling
            and not handled.wait(left)):
            raise CommandTimeout(f"a handler of '{self.label}' was not done after {timeout:g} s",
                                 None, ())
        if self._state == "committed":
            self._state = "done"
            self.device.hazards.retire(self)
        if self._error is not None:
            raise self._error

    def is_done(self, timeout: float | None = 0.0) -> bool:
        """Whether all commands are done within `timeout` seconds (None: no limit). The buffer still
        counts as in flight until `wait`."""
        return self._done.wait(timeout)

    @property
    def running(self) -> Dispatch | None:
        """The dispatch that runs now; None when the buffer runs as one CUDA graph."""
        return None if self._execution is None else self._execution.running

    def footprint(self) -> Footprint:
        """The memory that the recorded commands access; computed at the first commit."""
        if self._footprint is None:
            self._footprint = Footprint(self.records)
        return self._footprint

    def record(self, record: Record) -> None:
        """Append a command; encoders call this. Raises EncodingError after commit."""
        self._require_open()
        self.records.append(record)

    def end_encoder(self) -> None:
        """Forget the open encoder, which takes no more commands; encoders call this."""
        self._encoder = None

    def _start(self, encoder: E) -> E:
        self._require_open()
        self._require_no_encoder(encoder.label, "begin")
        self._encoder = encoder
        return encoder

    def _require_open(self) -> None:
        if self._state != "open":
            raise EncodingError(f"nothing can be recorded into '{self.label}': "
                                f"{_STATES[self._state]}")

    def _require_no_encoder(self, label: str, what: str) -> None:
        """End the encoder of the last `run`; EncodingError where the user's own is open."""
        if self._running is not None:
            self._running.end()
            self._running = None
        if self._encoder is not None:
            raise EncodingError(f"'{label}' cannot {what}: encoder '{self._encoder.label}' is "
                                "still open: end it")

    def _recognise(self) -> tuple[object, ...] | None:
        """Take the placement and the accesses of the same commands, if they are known; else the key
        to keep them by. Nothing may be in flight, as barriers of equal encoders cannot be told
        apart."""
        if (self.known is None or self._placement or self._footprint
            or self.device.hazards.in_flight()):
            return None
        key = self.known.key(self.records, self._kept, self._passages)
        again = self.known.commands.find(key)
        if again is None:
            return key
        self.records, self._placement, self._footprint, _ = again
        return None

    def _full(self, label: str) -> str:
        return "/".join([*self._groups, label])

    def _run(self) -> None:
        execution = self._execution = Execution(self.device, self.label, self.footprint(),
                                                self._recorder)
        execution.run()
        self._error, self.timings = execution.error, execution.timings
        self._execution = None
        if self._recorder is not None:
            self._recorder.finish()
        handlers, handled = list(self._handlers), self._handled  # a handler may begin anew
        self._handling = threading.get_ident()
        self._done.set()
        for handler in handlers:
            try:
                handler(self)
            except Exception:
                LOG.exception("a handler of '%s' failed", self.label)
        if handled is not None:
            handled.set()


class Span(NamedTuple):
    """When dispatches of an encoder ran, by the device's clock."""

    encoder: int
    label: str
    begin: Any
    end: Any


class Execution:
    """One run of a command buffer's dispatches.

    Attributes:
        running: the dispatch that runs now; None when none does, or when all run as one CUDA graph.
        error: the error of the first dispatch that failed.
        timings: label and milliseconds of every encoder.
    """

    def __init__(self, device: CommandDevice, label: str, footprint: Footprint,
                 recorder: Recorder | None = None) -> None:
        self.running: Dispatch | None = None
        self.error: CommandError | None = None
        self.timings: list[tuple[str, float]] = []
        self._device, self._memory, self._hazards = device, device.memory, device.hazards
        self._label, self._footprint, self._dispatches = label, footprint, footprint.dispatches
        self._recorder = recorder

    def run(self) -> None:
        """Run the dispatches up to the first that fails, and wait until they are done."""
        try:
            spans = None
            if (self._dispatches and self._recorder is None
                    and (self._memory.replays or self._footprint.narrow)):
                spans = self._at_once()
            if spans is None:
                beside = (self._footprint.narrow and self._recorder is None
                          and runs_side_by_side(self._device))
                spans = self._side_by_side() if beside else self._one_by_one()
            self._memory.synchronise()
            timings: dict[int, tuple[str, float]] = {}
            for encoder, label, begin, end in spans:
                before = timings.get(encoder, (label, 0.0))[1]
                timings[encoder] = label, before + self._memory.milliseconds(begin, end)
            self.timings = list(timings.values())
        except BaseException as error:  # work that a GPU has only started may fail later
            self.error = self.error or CommandError(f"'{self._label}' failed: {first_line(error)}",
                                                    self._label)
            self.error.__cause__ = self.error.__cause__ or error
        self.running = None

    def _at_once(self) -> list[Span] | None:
        """Put all on a GPU's streams, as one CUDA graph if it can be; None if each command has to
        be looked at."""
        dispatches, memory, footprint = self._dispatches, self._memory, self._footprint
        forks = footprint.narrow and any(map(_stream, dispatches))
        if not (memory.replays or forks):
            return None
        if any(allocation.lost for allocation in footprint.users):
            return None
        states = [dispatch.state for dispatch in dispatches]
        spans: list[Span] | None = None
        try:
            # A capture that fails leaves ONNX Runtime's session broken.
            if memory.replays and all(state and state.capturable for state in states):
                spans = memory.replay(footprint.signature, states, self._enqueue_all)
            return self._enqueue_all() if spans is None and forks else spans
        except BaseException as error:
            self._fail(dispatches,
                       CommandError(f"'{self._label}' failed: {first_line(error)}", self._label),
                       error)
            return []

    def _enqueue_all(self) -> list[Span]:
        return self._enqueue(self._dispatches, predecessors(self._footprint.records)
                             if self._footprint.narrow else ())

    def _enqueue(self, dispatches: Sequence[Dispatch], before: Sequence[int] = (0,)) -> list[Span]:
        """Run dispatches, or put them on a GPU's streams; returns the start and end of each
        encoder's.

        Those with streams of their own wait for the ones `before` them, and what comes later for
        all of them.
        """
        fork = (self._memory.fork([*map(_stream, dispatches)], before) if self._footprint.narrow
                else None)
        if fork is not None:
            with fork:
                return [Span(dispatch.encoder, dispatch.label, *fork.run(index, dispatch.execute))
                        for index, dispatch in enumerate(dispatches)]
        spans, begin = [], self._memory.mark()
        for (label, _), group in groupby(dispatches, self._measured_with):
            for dispatch in group:
                dispatch.execute()
            # where the next one begins: a mark takes a GPU as long as a small kernel
            end = self._memory.mark()
            spans.append(Span(dispatch.encoder, label, begin, end))
            begin = end
        return spans

    def _measured_with(self, dispatch: Dispatch) -> tuple[str, int]:
        """Label and number of what is measured together: an encoder; on a GPU all of a group,
        without number."""
        group = dispatch.label.rpartition("/")[0]
        return ((f"{group}/*", -1) if group and self._memory.replays
                else (dispatch.label, dispatch.encoder))

    def _one_by_one(self) -> list[Span]:
        spans: list[Span] = []
        # only commands before these have failed: the first of these that fails is the last to run
        may_lack = any([allocation.lost for allocation in self._footprint.users])
        for index, dispatch in enumerate(self._dispatches):
            self.running = dispatch
            if may_lack and self._cannot_run(dispatch, self._dispatches[index:]):
                break
            try:
                spans += self._execute(dispatch)
            except BaseException as error:  # of any kind: the host that waits must see it
                self._fail(self._dispatches[index:], self._failure(dispatch, error), error)
                break
        return spans

    def _side_by_side(self) -> list[Span]:
        """Run commands beside each other that no barrier orders, as far as the device has threads
        for them."""
        earlier, slots = predecessors(self._footprint.records), self._device.slots
        done, spans = 0, []
        waiting, running = dict(enumerate(self._dispatches)), dict[Future[list[Span]], int]()
        while waiting or running:
            for index, dispatch in list(waiting.items()):
                if (earlier[index] & ~done
                    or not slots.take(_threads(dispatch), patient=not running)):
                    continue
                if self._cannot_run(dispatch, list(waiting.values())):
                    slots.give(_threads(dispatch))
                    waiting = {}
                    break
                running[self._device.lanes.submit(self._execute, waiting.pop(index))] = index
            self.running = self._dispatches[min(running.values())] if running else None
            for future in wait_for_futures(running, return_when=FIRST_COMPLETED).done:
                dispatch = self._dispatches[index := running.pop(future)]
                slots.give(_threads(dispatch))
                done |= 1 << index
                try:
                    spans += future.result()
                except BaseException as error:  # what runs beside it goes on to its end
                    self._fail([dispatch, *waiting.values()], self._failure(dispatch, error), error)
                    waiting = {}
        return spans

    def _cannot_run(self, dispatch: Dispatch, left: Sequence[Dispatch]) -> bool:
        """Whether a command failed to write what a dispatch reads; then it and all that is left
        count as failed."""
        lost = self._lost_input(dispatch)
        if lost is not None:
            what = f"{dispatch} of '{self._label}' did not run: it reads {lost[0]}, but {lost[1]}"
            self._fail(left, CommandError(what, dispatch.label), lost[1], lost[1])
        return lost is not None

    def _failure(self, dispatch: Dispatch, error: BaseException) -> CommandError:
        return CommandError(f"{dispatch} of '{self._label}' failed: {first_line(error)}",
                            dispatch.label)

    def _execute(self, dispatch: Dispatch) -> list[Span]:
        memory = self._memory
        if self._footprint.narrow:
            spans = self._enqueue([dispatch])
        else:
            begin = memory.mark()
            dispatch.execute()
            spans = [Span(dispatch.encoder, dispatch.label, begin, memory.mark())]
        if memory.relax:
            memory.relax()
        for tensor in dispatch.writes:
            if tensor.allocation.lost:
                self._hazards.mark_found(tensor)
        if self._recorder is not None:
            memory.synchronise()
            self._recorder.note_run(dispatch, memory.milliseconds(spans[0].begin, spans[0].end))
        return spans

    def _lost_input(self, dispatch: Dispatch) -> tuple[str, CommandError] | None:
        """Name of a tensor that the dispatch reads but a failed command did not write, and that
        command's error."""
        for tensor in dispatch.reads:
            first = self._hazards.loss(tensor) if tensor.allocation.lost else None
            if first is not None:
                return f"'{tensor.name}'", first
        return None

    def _fail(self, dispatches: Sequence[Dispatch], error: CommandError, cause: BaseException,
                first: CommandError | None = None) -> None:
        """Note the error. The outputs of the dispatches are lost, because of it or of the `first`
        error."""
        self.error = error
        error.__cause__ = cause
        self._hazards.mark_lost([tensor for left in dispatches for tensor in left.writes],
                                first or error)
        if self._recorder is not None:
            self._recorder.note_failure(dispatches[0], first or error, ran=first is None)


def runs_side_by_side(device: CommandDevice) -> bool:
    """Whether threads of a device may run commands side by side: not those of a GPU's streams, and
    not within a memory budget."""
    return device.memory.host_visible and device.scratch is None


def _threads(dispatch: Dispatch) -> int:
    """How many of its device's threads a dispatch takes."""
    assert dispatch.state is not None  # as recorded by an encoder
    return dispatch.state.threads


def _stream(dispatch: Dispatch) -> int:
    """A GPU's stream of its own, 0 for the device's."""
    return dispatch.state.stream if dispatch.state else 0
