"""What a capture holds: command buffers, their dispatches and barriers, and what these wrote."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from postfx.runtime.snapshot import Snapshot


@dataclass
class CapturedValue:
    """What a node inside a network wrote; `snapshot` is None where it has no elements."""

    name: str
    shape: tuple[int, ...]
    dtype: str
    nbytes: int
    snapshot: Snapshot | None = field(default=None, kw_only=True)


@dataclass
class CapturedTensor(CapturedValue):
    """A tensor that a command read or wrote; `start` and `end` are its addresses on the device.

    `snapshot` is there for what the command wrote, and for what it read if no command in the capture wrote that.
    """

    start: int
    end: int


@dataclass
class CapturedNode:
    """A node of a network, run by itself after the command; see `postfx.runtime.nodes.NodeRun`.

    Attributes:
        outputs: what it wrote, in the node's order; of constants, figures only.
    """

    index: int
    op: str
    name: str
    constant: bool
    milliseconds: float | None
    error: str | None
    outputs: list[CapturedValue]


@dataclass
class CapturedNetwork:
    """A network looked into.

    Attributes:
        nodes: in the order of the file, up to the first that failed.
        difference: the largest relative error (`postfx.runtime.difference`) of what the command wrote against what
            the nodes wrote one by one: what optimising and fusing changed. None when that is not known.
    """

    nodes: list[CapturedNode] = field(default_factory=list)
    difference: float | None = None


@dataclass
class CapturedDispatch:
    """One kernel or network run; see `postfx.runtime.records.Dispatch`.

    Attributes:
        index: its number in the capture, from 0 in the order of commit.
        milliseconds: its own time; None when it failed or did not run.
        error: why it failed or did not run; None also behind a command that failed.
        dims: sizes that a network's free dimensions were fixed to.
        network: its nodes, where they were asked for.
    """

    index: int
    label: str
    command: str
    stage: str
    encoder: int
    model: Path | None
    reads: list[CapturedTensor]
    writes: list[CapturedTensor]
    milliseconds: float | None = None
    error: str | None = None
    dims: dict[str, int] = field(default_factory=dict)
    network: CapturedNetwork | None = None


@dataclass(frozen=True)
class CapturedBarrier:
    """A barrier; `form` is 'encoder', 'consumer' or 'producer', `after` and `before` its stage masks, sorted."""

    form: str
    encoder: int
    after: tuple[str, ...] = ()
    before: tuple[str, ...] = ()


@dataclass
class CapturedBuffer:
    """One committed command buffer.

    Attributes:
        records: dispatches and barriers in order.
        heap_used, heap_peak, heap_size: the device's heap when the buffer was done, bytes; see `Heap`.
    """

    label: str
    records: list[CapturedDispatch | CapturedBarrier]
    heap_used: int = 0
    heap_peak: int = 0
    heap_size: int = 0

    @property
    def dispatches(self) -> list[CapturedDispatch]:
        """The dispatches among the records."""
        return [record for record in self.records if isinstance(record, CapturedDispatch)]
