"""Encoders and what they record: dispatches and the barriers that order them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Protocol, Self

from postfx.caching import LRUCache
from postfx.errors import BindingError, EncodingError, HazardError
from postfx.runtime.states import Arguments, ArgumentTable, Intermediates, PipelineState, State
from postfx.runtime.tensor import Allocation, Tensor, TensorDevice, Transient

STAGES = ("compute", "machine-learning")
"""Stages of the queue: compute kernels and networks."""


@dataclass(eq=False, slots=True)
class Dispatch:
    """One recorded kernel or network run.

    Attributes:
        label: label of the encoder, with its groups.
        command: its name in messages, for example "network 'denoise_upscale.m'".
        stage: one of `STAGES`.
        encoder: number of the encoder within the device; barriers refer to it.
        reads, writes: the tensors that were bound when it was recorded.
        execute: does the work, once a commit has given transient tensors their memory.
        model: file of the network; None for a kernel.
        state: the kernel or network that runs.
        arguments: the tensors as bound.
    """

    label: str
    command: str
    stage: str
    encoder: int
    reads: tuple[Tensor, ...]
    writes: tuple[Tensor, ...]
    execute: Callable[[], None]
    model: Path | None = None
    state: State | None = None
    arguments: Arguments | None = None

    def __str__(self) -> str:
        return f"'{self.label}' ({self.command})"


@dataclass(frozen=True)
class EncoderBarrier:
    """Orders the dispatches of one encoder: all before it, then all after it.

    Metal 4's `barrierAfterEncoderStages:beforeEncoderStages:`; an encoder has one stage, so it
    needs no masks.
    """

    encoder: int


@dataclass(frozen=True)
class ConsumerBarrier:
    """Dispatches of `after` in earlier encoders come before later dispatches of `before`, here and
    in later encoders.

    Metal 4's `barrierAfterQueueStages:beforeStages:`.
    """

    encoder: int
    after: frozenset[str]
    before: frozenset[str]


@dataclass(frozen=True)
class ProducerBarrier:
    """Dispatches of `after` recorded so far, here and in earlier encoders, come before dispatches
    of `before` in later ones.

    Metal 4's `barrierAfterStages:beforeQueueStages:`.
    """

    encoder: int
    after: frozenset[str]
    before: frozenset[str]


Barrier = EncoderBarrier | ConsumerBarrier | ProducerBarrier
Record = Dispatch | Barrier

Stages = str | Iterable[str]
"""What a barrier orders: one stage or several of them."""

MOST_RECORDINGS = 4
"""Recordings that are known again: histories swap from frame to frame, and some frames are unlike
others."""


MOST_PASSAGES = 4 * MOST_RECORDINGS
"""Passages that are known again: a pass has one or two in a recording."""


@dataclass(eq=False, slots=True)
class Passage:
    """Commands in a row that are recorded once and then repeated, and what recording them
    returned."""

    records: list[Record]
    result: Any


class KnownCommands(NamedTuple):
    """Commands that were committed before, the heap's `Placement` of their transient tensors or
    None, the `Footprint` of what they access, and the passages in them; the first two types belong
    to modules above this one."""

    records: list[Record]
    placement: Any
    footprint: Any
    passages: Sequence[Passage]


MOST_TABLES = 1024
"""Argument tables of `CommandBuffer.run` that are kept: a frame has about a hundred commands."""


class Tables:
    """Argument tables of commands that need none of the caller's, by state, label, and how many of
    them came before: so each finds the tensors of the frame before in its table, which are mostly
    the same."""

    def __init__(self) -> None:
        self._tables: LRUCache[tuple[State, str, int], ArgumentTable] = LRUCache(MOST_TABLES)

    def table(self, state: State, label: str, number: int) -> ArgumentTable:
        """The table of such a command."""
        return self._tables.get_or_make((state, label, number), lambda: ArgumentTable(state))

    def clear(self) -> None:
        """Forget all tables."""
        self._tables.clear()


class Recordings:
    """Knows commands again that were recorded before, on the same tensors, so that they need not be
    recorded, placed and searched for hazards anew. It keeps what they use alive.

    Attributes:
        tables: argument tables of commands that need none of the caller's.
        passages: by the keys of `CommandBuffer.repeat`.
        commands: by what `key` makes of them.
    """

    def __init__(self) -> None:
        self.tables = Tables()
        self.passages: LRUCache[tuple[object, ...], Passage] = LRUCache(MOST_PASSAGES)
        self.commands: LRUCache[tuple[object, ...], KnownCommands] = LRUCache(MOST_RECORDINGS)

    def key(self, records: Sequence[Record], kept: Iterable[Allocation],
            passages: Sequence[Passage] = ()) -> tuple[object, ...]:
        """A key that is equal for recordings of the same work: the passages, if there is nothing
        else in them."""
        parts: list[object] = [frozenset(item for item in kept if isinstance(item, Transient))]
        if sum([len(passage.records) for passage in passages]) == len(records):
            return (*parts, *passages)
        encoders = dict[int, int]()
        for record in records:
            # by their order: those of a passage keep the numbers of its first recording
            parts.append(encoders.setdefault(record.encoder, len(encoders)))
            if isinstance(record, Dispatch):
                parts += (record.label, record.arguments)
            elif isinstance(record, EncoderBarrier):
                parts.append(EncoderBarrier)
            else:
                parts += (type(record), record.after, record.before)
        return tuple(parts)

    def keep(self, key: tuple[object, ...], recorded: KnownCommands) -> None:
        """Know these commands from now on. Forgets those in other transient memory, with released
        tensors, and with wrapped arrays that these do not use."""
        memory, users = recorded.placement and recorded.placement.memory, recorded.footprint.users
        for other in list(self.commands):
            old = self.commands.peek(other)
            if ((old.placement and old.placement.memory) is not memory or any(
                    item.released or (item.borrowed and item not in users)
                    for item in old.footprint.users)):
                self.commands.drop(other)
        self.commands[key] = recorded
        alive = {passage for one in self.commands for passage in self.commands.peek(one).passages}
        for name in list(self.passages):
            if self.passages.peek(name) not in alive:
                self.passages.drop(name)

    def clear(self) -> None:
        """Forget all commands."""
        self.commands.clear()
        self.passages.clear()
        self.tables.clear()


_STAGES_TEXT = " and ".join(f"'{stage}'" for stage in STAGES)


class Recording(Protocol):
    """What an encoder needs of the command buffer that it records into."""

    @property
    def device(self) -> TensorDevice: ...

    def record(self, record: Record) -> None: ...

    def end_encoder(self) -> None: ...


class Encoder:
    """Records commands of one stage. Use it as a context manager; leaving it ends the encoder."""

    stage: str

    def __init__(self, commands: Recording, label: str, number: int) -> None:
        self._commands = commands
        self._number = number
        self._ended = False
        self.label = label

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.end()

    def end(self) -> None:
        """No more commands are taken. Ending twice does nothing."""
        if not self._ended:
            self._ended = True
            self._commands.end_encoder()

    def dispatch(self, state: State, table: ArgumentTable) -> None:
        """Record one run on the tensors that are in the table now.

        Raises BindingError for unbound or unfitting arguments, HazardError for aliased ones.
        """
        self._dispatch(state, table)

    def barrier(
        self, after: Stages | None = None, before: Stages | None = None,
        before_queue: Stages | None = None
    ) -> None:
        """Order commands. Three forms, as in Metal 4:

        - `barrier()`, inside an encoder: every dispatch recorded so far in this encoder comes
          before every later one in it.
        - `barrier(after=, before=)`, the consumer's: dispatches of the `after` stages in earlier
          encoders come before dispatches of the `before` stages that follow, in this encoder and
          all later ones.
        - `barrier(after=, before_queue=)`, the producer's: dispatches of the `after` stages
          recorded so far, in this encoder and earlier ones, come before dispatches of the
          `before_queue` stages in all later encoders, not in this one.

        "Earlier" and "later" refer to the whole queue, including other command buffers.

        Args:
            after: 'compute', 'machine-learning' or both.
            before, before_queue: the same.

        Raises EncodingError if a stage mask is empty or names an unknown stage, or if the masks fit
        none of the forms.
        """
        if after is None and before is None and before_queue is None:
            self._record(EncoderBarrier(self._number))
        elif after is not None and before is not None and before_queue is None:
            self._record(ConsumerBarrier(self._number, self._mask(after, "after"),
                                         self._mask(before, "before")))
        elif after is not None and before is None and before_queue is not None:
            masks = self._mask(after, "after"), self._mask(before_queue, "before_queue")
            self._record(ProducerBarrier(self._number, *masks))
        else:
            raise EncodingError(self._no_form(after, before, before_queue))

    def _dispatch(self, state: State, table: ArgumentTable,
                  heap: Intermediates | None = None) -> None:
        if state.stage != self.stage:
            fix = f"use commands.{state.stage.replace('-', '_')}_encoder()"
            message = (f"'{self.label}' takes {self.stage} work, but {state.command} is "
                       f"{state.stage} work: {fix}")
            raise EncodingError(message)
        if state.device is not self._commands.device:
            raise EncodingError(f"'{self.label}': {state.command} was made for another device")
        if table.state is not state:
            made, fix = table.state.command, f"make one for {state.command}"
            raise BindingError(f"'{self.label}': the argument table was made for {made}: {fix}")
        try:
            memory = (heap.memory_for(state)
                      if heap is not None and isinstance(state, PipelineState) else None)
            arguments = table.arguments(memory)
        except BindingError as error:
            raise BindingError(f"'{self.label}': {error}") from None
        accesses = arguments.reads, arguments.writes
        names = self.label, state.command, self.stage, self._number
        dispatch = Dispatch(*names, *accesses, arguments.execute, state.model, state, arguments)
        if arguments.aliases:
            raise _aliasing_error(dispatch, *arguments.aliases)
        self._record(dispatch)

    def _record(self, record: Record) -> None:
        if self._ended:
            raise EncodingError(f"encoder '{self.label}' has ended: open a new one")
        self._commands.record(record)

    def _no_form(self, after: Stages | None, before: Stages | None,
                 before_queue: Stages | None) -> str:
        if before is not None and before_queue is not None:
            fix = "record one barrier with before= and another with before_queue="
        elif after is None:
            fix = f"give after= too, with {'before=' if before_queue is None else 'before_queue='}"
        else:
            fix = "give before= (this and later encoders) or before_queue= (later encoders) too"
        return (f"barrier in '{self.label}': {fix}; for the commands of this encoder alone, "
                "barrier() takes no stages")

    def _mask(self, stages: Stages, side: str) -> frozenset[str]:
        """The stages of a barrier's side; EncodingError for none or unknown ones."""
        try:
            mask = frozenset((stages,) if isinstance(stages, str) else stages)
        except TypeError:  # not iterable: named below
            mask = frozenset((str(stages),))
        if not mask:
            raise EncodingError(f"barrier in '{self.label}': the {side}= stage mask is empty: name "
                                f"{_STAGES_TEXT}")
        unknown = sorted(str(stage) for stage in mask.difference(STAGES))
        if unknown:
            message = (f"the {side}= stage mask names '{unknown[0]}', which is not a stage: stages "
                       f"are {_STAGES_TEXT}")
            raise EncodingError(f"barrier in '{self.label}': {message}")
        return mask


class ComputeEncoder(Encoder):
    """Records kernels."""

    stage = "compute"


class MachineLearningEncoder(Encoder):
    """Records networks."""

    stage = "machine-learning"

    def dispatch_network(self, state: State, table: ArgumentTable,
                         heap: Intermediates | None = None) -> None:
        """Record one run of a network on the tensors that are in the table now.

        Args:
            heap: memory for its intermediates, which other networks may share; default: its own.

        Raises BindingError for unbound or unfitting arguments and a heap that is too small,
        HazardError for aliased arguments.
        """
        self._dispatch(state, table, heap)


def _aliasing_error(dispatch: Dispatch, other: Tensor, written: Tensor) -> HazardError:
    pair = (f"'{other.name}' and '{written.name}'" if other.name != written.name
            else f"'{written.name}'")
    message = (f"{dispatch} has {pair} on the same memory, one of them written: bind separate "
               "tensors")
    return HazardError(message, "aliasing", written.name, None, dispatch.label)
