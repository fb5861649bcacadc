"""Encoders: record dispatches and barriers of one stage into a command buffer."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Self

from postfx.runtime.arguments import ArgumentTable
from postfx.runtime.errors import BindingError, EncodingError
from postfx.runtime.hazards import check_dispatch
from postfx.runtime.records import STAGES, Dispatch, EncoderBarrier, QueueBarrier
from postfx.runtime.states import State

if TYPE_CHECKING:
    from postfx.runtime.commands import CommandBuffer

Stages = str | Iterable[str]


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

    def barrier(self, after: Stages | None = None, before: Stages | None = None) -> None:
        """Order commands.

        Without stages: every dispatch recorded so far in this encoder comes before every later one in it.
        With stages: dispatches of the `after` stages in earlier encoders of the queue, also of earlier command
        buffers, come before dispatches of the `before` stages that follow, in this encoder and all later ones.

        Args:
            after: 'compute', 'machine-learning' or both.
            before: the same.

        Raises EncodingError when a stage mask is empty or names an unknown stage, or when only one is given.
        """
        if after is None and before is None:
            self._record(EncoderBarrier(self._number))
            return
        if after is None or before is None:
            raise EncodingError(f"barrier in '{self.label}': give both after= and before=, or neither")
        self._record(QueueBarrier(self._number, self._mask(after, "after"), self._mask(before, "before")))

    def _dispatch(self, state: State, table: ArgumentTable) -> None:
        if state.stage != self.stage:
            raise EncodingError(f"'{self.label}' takes {self.stage} work, but {state.command} is {state.stage} work")
        if state.device is not self._commands.device:
            raise EncodingError(f"'{self.label}': {state.command} was made for another device")
        if table.state is not state:
            raise BindingError(f"'{self.label}': the argument table was made for {table.state.command}")
        arguments = table.arguments()
        dispatch = Dispatch(
            self.label, state.command, self.stage, self._number, arguments.reads, arguments.writes, arguments.execute
        )
        check_dispatch(dispatch)
        self._record(dispatch)

    def _record(self, record: Dispatch | EncoderBarrier | QueueBarrier) -> None:
        if self._ended:
            raise EncodingError(f"encoder '{self.label}' has ended: open a new one")
        self._commands.record(record)

    def _mask(self, stages: Stages, side: str) -> frozenset[str]:
        mask = frozenset([stages] if isinstance(stages, str) else stages)
        if not mask:
            raise EncodingError(f"barrier in '{self.label}': the {side}= stage mask is empty")
        unknown = sorted(mask.difference(STAGES))
        if unknown:
            raise EncodingError(f"barrier in '{self.label}': no stage '{unknown[0]}': stages are {', '.join(STAGES)}")
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
