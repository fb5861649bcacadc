"""Encoders: record dispatches and barriers of one stage into a command buffer."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Self

from postfx.errors import BindingError, EncodingError
from postfx.runtime.hazard_errors import check_dispatch
from postfx.runtime.records import STAGES, ConsumerBarrier, Dispatch, EncoderBarrier, ProducerBarrier, Record
from postfx.runtime.states import ArgumentTable, State

if TYPE_CHECKING:
    from postfx.runtime.commands import CommandBuffer

Stages = str | Iterable[str]

_STAGES_TEXT = " and ".join(f"'{stage}'" for stage in STAGES)


class Encoder:
    """Records commands of one stage. Use it as a context manager; leaving it ends the encoder."""

    stage: str

    def __init__(self, commands: CommandBuffer, label: str, number: int) -> None:
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
            self._commands.encoder_ended()

    def barrier(
        self, after: Stages | None = None, before: Stages | None = None, before_queue: Stages | None = None
    ) -> None:
        """Order commands. Three forms, as in Metal 4:

        - `barrier()`, inside an encoder: every dispatch recorded so far in this encoder comes before every later one
          in it.
        - `barrier(after=, before=)`, the consumer's: dispatches of the `after` stages in earlier encoders come before
          dispatches of the `before` stages that follow, in this encoder and all later ones.
        - `barrier(after=, before_queue=)`, the producer's: dispatches of the `after` stages recorded so far, in this
          encoder and earlier ones, come before dispatches of the `before_queue` stages in all later encoders, not in
          this one.

        Earlier and later encoders are those of the whole queue, also of other command buffers.

        Args:
            after: 'compute', 'machine-learning' or both.
            before, before_queue: the same.

        Raises EncodingError when a stage mask is empty or names an unknown stage, or when the masks given are those of
        no form.
        """
        if after is None and before is None and before_queue is None:
            self._record(EncoderBarrier(self._number))
        elif after is None or (before is None) == (before_queue is None):
            raise EncodingError(self._no_form(after, before, before_queue))
        elif before is not None:
            self._record(ConsumerBarrier(self._number, self._mask(after, "after"), self._mask(before, "before")))
        else:
            masks = self._mask(after, "after"), self._mask(before_queue, "before_queue")
            self._record(ProducerBarrier(self._number, *masks))

    def _dispatch(self, state: State, table: ArgumentTable) -> None:
        if state.stage != self.stage:
            mend = f"use commands.{state.stage.replace('-', '_')}_encoder()"
            message = f"'{self.label}' takes {self.stage} work, but {state.command} is {state.stage} work: {mend}"
            raise EncodingError(message)
        if state.device is not self._commands.device:
            raise EncodingError(f"'{self.label}': {state.command} was made for another device")
        if table.state is not state:
            made, mend = table.state.command, f"make one for {state.command}"
            raise BindingError(f"'{self.label}': the argument table was made for {made}: {mend}")
        try:
            arguments = table.arguments()
        except BindingError as error:
            raise BindingError(f"'{self.label}': {error}") from None
        accesses = arguments.reads, arguments.writes
        names = self.label, state.command, self.stage, self._number
        kept = None if arguments.execute else arguments  # for the commit, which places what is transient
        dispatch = Dispatch(*names, *accesses, arguments.execute, state.model, state, kept)
        check_dispatch(dispatch)
        self._record(dispatch)

    def _record(self, record: Record) -> None:
        if self._ended:
            raise EncodingError(f"encoder '{self.label}' has ended: open a new one")
        self._commands.record(record)

    def _no_form(self, after: Stages | None, before: Stages | None, before_queue: Stages | None) -> str:
        if before is not None and before_queue is not None:
            mend = "record one barrier with before= and another with before_queue="
        elif after is None:
            mend = f"give after= too, with {'before=' if before_queue is None else 'before_queue='}"
        else:
            mend = "give before= (this and later encoders) or before_queue= (later encoders) too"
        return f"barrier in '{self.label}': {mend}; for the commands of this encoder alone, barrier() takes no stages"

    def _mask(self, stages: Stages, side: str) -> frozenset[str]:
        try:
            mask = frozenset([stages] if isinstance(stages, str) else stages)
        except TypeError:
            mask = frozenset([stages])
        if not mask:
            raise EncodingError(f"barrier in '{self.label}': the {side}= stage mask is empty: name {_STAGES_TEXT}")
        unknown = sorted(str(stage) for stage in mask.difference(STAGES))
        if unknown:
            message = f"the {side}= stage mask names '{unknown[0]}', which is no stage: stages are {_STAGES_TEXT}"
            raise EncodingError(f"barrier in '{self.label}': {message}")
        return mask


class ComputeEncoder(Encoder):
    """Records kernels."""

    stage = "compute"

    def dispatch(self, state: State, table: ArgumentTable) -> None:
        """Record one run of a kernel on the tensors that are in the table now.

        Raises BindingError for unbound or unfitting arguments, HazardError for aliased ones.
        """
        self._dispatch(state, table)


class MachineLearningEncoder(Encoder):
    """Records networks."""

    stage = "machine-learning"

    def dispatch_network(self, state: State, table: ArgumentTable) -> None:
        """Record one run of a network on the tensors that are in the table now.

        Raises BindingError for unbound or unfitting arguments, HazardError for aliased ones.
        """
        self._dispatch(state, table)
