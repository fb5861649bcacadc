"""What a command buffer records: dispatches and barriers, in order."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from postfx.runtime.tensor import Tensor

STAGES = ("compute", "machine-learning")
"""Stages of the queue: compute kernels and networks."""


@dataclass(frozen=True, eq=False)
class Dispatch:
    """One recorded kernel or network run.

    Attributes:
        label: label of the encoder, with its groups.
        command: what runs, for example "network 'denoise_upscale.m'".
        stage: one of `STAGES`.
        encoder: number of the encoder within the device; barriers refer to it.
        reads, writes: the tensors that were bound when it was recorded.
        execute: does the work.
    """

    label: str
    command: str
    stage: str
    encoder: int
    reads: tuple[Tensor, ...]
    writes: tuple[Tensor, ...]
    execute: Callable[[], None]

    def __str__(self) -> str:
        return f"'{self.label}' ({self.command})"


@dataclass(frozen=True)
class EncoderBarrier:
    """Orders the dispatches of one encoder: all before it, then all after it."""

    encoder: int


@dataclass(frozen=True)
class QueueBarrier:
    """Orders stages across encoders: dispatches of `after` in earlier encoders, then `before` in this and later ones.

    This is Metal 4's consumer barrier, `barrierAfterQueueStages:beforeStages:`.
    """

    encoder: int
    after: frozenset[str]
    before: frozenset[str]


Record = Dispatch | EncoderBarrier | QueueBarrier
