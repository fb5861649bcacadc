"""What the denoised upscaler's frames leave to the next, which may have another render size."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np

from postfx.caching import LRUCache
from postfx.kernels import denoise_layout
from postfx.kernels.denoise_resize import RESIZE
from postfx.kernels.resample import RESAMPLE, positions
from postfx.passes._denoise_window import Rows, Sizes
from postfx.passes.base import MOST_SIZES
from postfx.runtime import ArgumentTable, CommandBuffer, Device, Tensor

NEXT = {"history": "next_history", "state": "next_state", "last_depth": "next_depth", "last_reactive": "next_reactive"}
"""What kernels read of the frame before -> what they write for the next one."""
CHANNELS = {"state": 4 + denoise_layout.HIDDEN, "last_depth": 1}
"""Of what has render size."""

Size = tuple[int, int]


class Room:
    """Memory for what has render size, of frames of any size up to so many pixels."""

    def __init__(self, device: Device, pixels: int, channels: Mapping[str, int]) -> None:
        self.pixels, self._channels = pixels, channels
        self._memory = {name: _zeros(device, name, (pixels * count,)) for name, count in channels.items()}
        self._views: LRUCache[Size, dict[str, Tensor]] = LRUCache(MOST_SIZES)

    def of(self, size: Size) -> dict[str, Tensor]:
        """The tensors of a frame's size, by the kernels' names; all sizes share the memory."""
        return self._views.get_or_make(size, partial(self._view, size))

    def _view(self, size: Size) -> dict[str, Tensor]:
        return {name: memory.view(name, (*size, self._channels[name])) for name, memory in self._memory.items()}


class History:
    """The last output, what was accumulated, the depth, and the mask of reactive frames, in two sets used in turn.

    The output keeps its size. The rest has its frame's render size, and is resampled when the next frame has another.
    """

    def __init__(self, device: Device, sizes: Sizes, reactive: bool) -> None:
        self._device, self._size = device, (sizes.h, sizes.w)
        self._channels = CHANNELS | ({"last_reactive": 1} if reactive else {})
        self._outputs = [_zeros(device, "history", (sizes.height, sizes.width, 3)) for _ in range(2)]
        self._rooms = self._make_rooms()
        self._held = _anywhere(self._size)
        self._model: str | None = None

    def use(self, model: str) -> None:
        """Between two frames: `model` works on the next one."""
        if self._model not in (None, model):
            self._forget_hidden()
        self._model = model

    def turn(self, commands: CommandBuffer, size: Size, keep: bool) -> None:
        """Begin a frame of a render size: what was written is now the last. It is only defined if it is not kept."""
        self._outputs.reverse()
        self._rooms.reverse()
        self._held.reverse()
        if not keep or size != self._size:  # what a frame that failed left is not known, either
            self._held = _anywhere(size)
        if size == self._size:
            return
        before, self._size = self._rooms[0].of(self._size), size
        if size[0] * size[1] > self._rooms[0].pixels:
            self._rooms = self._make_rooms()
        else:
            self._rooms.reverse()
        if keep:
            self._resize(commands, before)

    def cover(self, rows: Rows) -> Rows:
        """Once a frame: it leaves something in these rows only. Returns the rows to write, which are more where an
        earlier frame left something in others."""
        before, self._held[1] = self._held[1], rows
        return min(rows[0], before[0]), max(rows[1], before[1])

    @property
    def last(self) -> dict[str, Tensor]:
        """What the frame before left, by the kernels' names."""
        return {"history": self._outputs[0], **self._rooms[0].of(self._size)}

    @property
    def next(self) -> dict[str, Tensor]:
        """Where this frame leaves it, by the kernels' names."""
        tensors = {"history": self._outputs[1], **self._rooms[1].of(self._size)}
        return {NEXT[name]: tensor for name, tensor in tensors.items()}

    def kept(self) -> dict[str, np.ndarray]:
        """Between two frames: what the last one left, by the kernels' names, and its render size."""
        return {"size": np.int64(self._size)} | {name: tensor.content() for name, tensor in self.next.items()}

    def recall(self, kept: Mapping[str, np.ndarray]) -> None:
        """Between two frames: take what was `kept` for what the last one left."""
        self._size = tuple(map(int, kept["size"]))
        if self._size[0] * self._size[1] > self._rooms[1].pixels:
            self._rooms = self._make_rooms()
        self._held = _anywhere(self._size)
        for name, tensor in self.next.items():
            tensor.upload(kept[name])

    def _make_rooms(self) -> list[Room]:
        return [Room(self._device, self._size[0] * self._size[1], self._channels) for _ in range(2)]

    def _resize(self, commands: CommandBuffer, before: dict[str, Tensor]) -> None:
        """Record the work that brings what the frame before left to this one's size."""
        after, (height, width) = self._rooms[0].of(self._size), before["last_depth"].shape[:2]
        rows, columns = (self._device.wrap(name, positions(old, new)) for name, old, new in
                         (("at_rows", height, self._size[0]), ("at_columns", width, self._size[1])))
        table = ArgumentTable(self._device.compute_state(RESIZE), {
            "state": before["state"], "last_depth": before["last_depth"], "at_rows": rows, "at_columns": columns,
            "resized": after["state"], "resized_depth": after["last_depth"]})
        with commands.compute_encoder("resize") as encoder:
            encoder.barrier(after=("compute", "machine-learning"), before="compute")
            encoder.dispatch(table.state, table)
            if "last_reactive" in before:
                mask = ArgumentTable(self._device.compute_state(RESAMPLE), {
                    "image": before["last_reactive"], "rows": rows, "columns": columns,
                    "output": after["last_reactive"]})
                encoder.dispatch(mask.state, mask)

    def _forget_hidden(self) -> None:
        """Another network cannot read the hidden state; nothing in its place is what all know from first frames."""
        state = self._rooms[1].of(self._size)["state"]
        values = state.download()
        values[..., -denoise_layout.HIDDEN:] = 0
        state.upload(values)


def _anywhere(size: Size) -> list[Rows]:
    """The rows in which each of the two sets may hold something: all."""
    return [(0, size[0])] * 2


def _zeros(device: Device, name: str, shape: tuple[int, ...]) -> Tensor:
    """A tensor of zeros: before the first frame nothing of it is used, it only has to be defined."""
    tensor = device.heap.tensor(name, shape)
    tensor.fill(0)
    return tensor
