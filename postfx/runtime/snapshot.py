"""The content of a capture: command buffers, their dispatches and barriers, and snapshots of
tensors they wrote."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np

from postfx.files import write_atomically
from postfx.runtime.tensor import Tensor


@dataclass
class CapturedValue:
    """An output of a node inside a network; `snapshot` is None if it has no elements."""

    name: str
    shape: tuple[int, ...]
    dtype: str
    nbytes: int
    snapshot: Snapshot | None = field(default=None, kw_only=True)


@dataclass
class CapturedTensor(CapturedValue):
    """A tensor that a command read or wrote; `start` and `end` are its addresses on the device.

    Outputs have a `snapshot`, and so do inputs that no command in the capture wrote.
    """

    start: int
    end: int


@dataclass
class CapturedNode:
    """A node of a network, run by itself after the command; see `capture.NodeRun`.

    Attributes:
        outputs: in the node's order; constants have figures only.
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
    """The nodes of a network that ran.

    Attributes:
        nodes: in the order of the file, up to the first that failed.
        difference: the largest relative error (`capture.largest_error`) of the command's outputs
            against those of its nodes run one by one: the effect of optimising and fusing. None if
            unknown.
    """

    nodes: list[CapturedNode] = field(default_factory=list)
    difference: float | None = None


@dataclass
class CapturedDispatch:
    """One kernel or network run; see `postfx.runtime.encoders.Dispatch`.

    Attributes:
        index: its number in the capture, from 0 in the order of commit.
        milliseconds: its own time; None when it failed or did not run.
        error: why it failed or did not run; None as well after an earlier command failed.
        dims: sizes of a network's free dimensions.
        network: its nodes, if they were captured.
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
    """A barrier; `form` is 'encoder', 'consumer' or 'producer', `after` and `before` its stage
    masks, sorted."""

    form: str
    encoder: int
    after: tuple[str, ...] = ()
    before: tuple[str, ...] = ()


@dataclass
class CapturedBuffer:
    """One committed command buffer.

    Attributes:
        records: dispatches and barriers in order.
        heap_used, heap_peak, heap_size: the device's heap when the buffer was done, bytes; see
            `Heap`.
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


# Pixels of a tensor's pictures, at most; slices that are shown of it, and of a node's output; and
# elements up to which all values are kept.
PICTURE_WIDTH = 192
PICTURE_HEIGHT = 384
MOST_SLICES = 64
NODE_SLICES = 8
MOST_KEPT_VALUES = 64

_BLOCK_VALUES = 1 << 20


class Pictures(NamedTuple):
    """How many slices to keep as pictures, and their largest width and height."""

    most: int
    width: int = PICTURE_WIDTH
    height: int = PICTURE_HEIGHT


NODE_PICTURES = Pictures(NODE_SLICES, 64, 96)
"""For outputs of nodes inside networks, of which there are many."""


@dataclass(frozen=True)
class Statistics:
    """Figures of a tensor. `minimum`, `maximum` and `mean` are over its finite elements, None if it
    has none.

    Attributes:
        zeros: share of all elements that are exactly 0, from 0 to 1.
        nans, infinities: counts of elements.
    """

    minimum: float | None
    maximum: float | None
    mean: float | None
    zeros: float
    nans: int
    infinities: int


@dataclass(frozen=True)
class Snapshot:
    """A tensor's content at one moment.

    Attributes:
        channels: count of (height, width) slices that the tensor has; 0 when it is no picture.
        pictures: the first of them, float32 (height, width), every n-th pixel so that they are at
            most `PICTURE_WIDTH` wide and `PICTURE_HEIGHT` high: three of them, or `MOST_SLICES` in
            a capture of all; of nodes inside networks as `NODE_PICTURES`.
        values: all elements, if there are at most `MOST_KEPT_VALUES`.
        file: the content as .npy, relative to the capture's folder; None unless all was captured.
    """

    statistics: Statistics
    channels: int = 0
    pictures: list[np.ndarray] = field(default_factory=list)
    values: list[float] | None = None
    file: str | None = None


def take(array: np.ndarray, wanted: Pictures, folder: Path | None = None,
         file: str = "") -> Snapshot | None:
    """A snapshot of an array, None if it has no elements; its content also goes to `folder / file`
    if given."""
    if not array.size:
        return None
    if folder is not None:
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        # NumPy sees `write` alone: into a file it would write by itself, and hide a full disk's
        # error
        write_atomically(folder / file,
                         lambda output: np.save(SimpleNamespace(write=output.write), array))
    planes = as_planes(array)
    values = array.ravel().tolist() if array.size <= MOST_KEPT_VALUES else None
    pictures = [] if planes is None else [_small(plane, wanted) for plane in planes[: wanted.most]]
    return Snapshot(statistics(array), 0 if planes is None else len(planes), pictures, values,
                    file if folder else None)


def statistics(array: np.ndarray) -> Statistics:
    """Figures of a non-empty array of any shape; works in blocks, so it takes little memory."""
    flat = array.reshape(-1)
    low, high, total, finite, zeros, nans = math.inf, -math.inf, 0.0, 0, 0, 0
    for start in range(0, flat.size, _BLOCK_VALUES):
        block = flat[start : start + _BLOCK_VALUES].astype(np.float64)
        nans += int(np.isnan(block).sum())
        zeros += int((block == 0).sum())
        kept = block[np.isfinite(block)]
        if kept.size:
            low, high = min(low, float(kept.min())), max(high, float(kept.max()))
            total, finite = total + float(kept.sum()), finite + kept.size
    infinities = flat.size - finite - nans
    if not finite:
        return Statistics(None, None, None, zeros / flat.size, nans, infinities)
    return Statistics(low, high, total / finite, zeros / flat.size, nans, infinities)


def as_planes(array: np.ndarray) -> np.ndarray | None:
    """An array's pictures as a view or copy (channels, height, width); None when it has fewer than
    two dimensions.

    The last of three dimensions is the channels if it is the smallest, as in (height, width, 3);
    otherwise the last two dimensions are a picture's. Leading dimensions of 1 do not count.
    """
    while array.ndim > 3 and array.shape[0] == 1:
        array = array[0]
    if array.ndim < 2:
        return None
    if array.ndim == 3 and array.shape[2] < min(array.shape[:2]):
        return np.moveaxis(array, 2, 0)
    return array.reshape(-1, *array.shape[-2:])


def content(tensor: Tensor) -> np.ndarray:
    """A tensor's content now: its own memory if the host can see it, else a copy.

    Checks no hazards: the caller stands between two commands of the queue.
    """
    if tensor.device.memory.host_visible:
        return tensor.host_view()
    copy = np.empty(tensor.shape, tensor.dtype)
    tensor.device.memory.read(tensor.start, copy)
    return copy


def _small(plane: np.ndarray, wanted: Pictures) -> np.ndarray:
    step = max(1, -(-plane.shape[0] // wanted.height), -(-plane.shape[1] // wanted.width))
    return plane[::step, ::step].astype(np.float32)
