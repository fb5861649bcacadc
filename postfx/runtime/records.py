"""What a command buffer records: dispatches and barriers, in order."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from postfx.runtime.states import Arguments, State
from postfx.runtime.tensor import Tensor

STAGES = ("compute", "machine-learning")
"""Stages of the queue: compute kernels and networks."""


@dataclass(frozen=True, eq=False)
class Dispatch:
    """One recorded kernel or network run.

    Attributes:
        label: label of the encoder, with its groups.
        command: its name in messages, for example "network 'denoise_upscale.m'".
        stage: one of `STAGES`.
        encoder: number of the encoder within the device; barriers refer to it.
        reads, writes: the tensors that were bound when it was recorded.
        execute: does the work; None until a commit gives transient tensors their memory.
        model: file of the network; None for a kernel.
        state: the kernel or network that runs.
        arguments: the tensors as bound, if some are transient.
    """

    label: str
    command: str
    stage: str
    encoder: int
    reads: tuple[Tensor, ...]
    writes: tuple[Tensor, ...]
    execute: Callable[[], None] | None
    model: Path | None = None
    state: State | None = None
    arguments: Arguments | None = None

    def __str__(self) -> str:
        return f"'{self.label}' ({self.command})"


@dataclass(frozen=True)
class EncoderBarrier:
    """Orders the dispatches of one encoder: all before it, then all after it.

    Metal 4's `barrierAfterEncoderStages:beforeEncoderStages:`; an encoder has one stage, so it needs no masks.
    """

    encoder: int


@dataclass(frozen=True)
class ConsumerBarrier:
    """Dispatches of `after` in earlier encoders come before later dispatches of `before`, here and in later encoders.

    Metal 4's `barrierAfterQueueStages:beforeStages:`.
    """

    encoder: int
    after: frozenset[str]
    before: frozenset[str]


@dataclass(frozen=True)
class ProducerBarrier:
    """Dispatches of `after` recorded so far, here and in earlier encoders, come before dispatches of `before` in later
    ones.

    Metal 4's `barrierAfterStages:beforeQueueStages:`.
    """

    encoder: int
    after: frozenset[str]
    before: frozenset[str]


Barrier = EncoderBarrier | ConsumerBarrier | ProducerBarrier
Record = Dispatch | Barrier
