"""The history: what a frame and its layers leave to the next frame."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from postfx.caching import LRUCache
from postfx.frame import Part
from postfx.kernels.denoise import HIDDEN
from postfx.kernels.image import positions
from postfx.passes import MOST_SIZES
from postfx.passes.denoise.geometry import Rows, Shape, Size, Sizes
from postfx.passes.denoise.graph import RESIZED, Each, run_steps
from postfx.passes.denoise.kinds import KINDS
from postfx.runtime import CommandBuffer, Device, Tensor

NEXT = {"history": "next_history", "state": "next_state", "last_depth": "next_depth",
        "last_reactive": "next_reactive"}
"""Tensor of the last frame that kernels read -> tensor that they write for the next one."""
STATE_CHANNELS = {"state": 4 + HIDDEN, "last_depth": 1}
"""Channels of the tensors of render size."""


class Room:
    """Memory for tensors of render size. Frames of any size, up to a number of pixels, fit in."""

    def __init__(self, device: Device, pixels: int, channels: Mapping[str, int]) -> None:
        self.pixels, self._channels = pixels, channels
        self._memory = {name: make_zeros(device, name, (pixels * count,))
                        for name, count in channels.items()}
        self._views: LRUCache[Shape, dict[str, Tensor]] = LRUCache(MOST_SIZES)

    def of(self, size: Shape) -> dict[str, Tensor]:
        """The tensors of a frame's size, by the kernels' names; all sizes share the memory."""
        return self._views.get_or_make(size, partial(self._view, size))

    def _view(self, size: Shape) -> dict[str, Tensor]:
        return {name: memory.view(name, (*size, self._channels[name]))
                for name, memory in self._memory.items()}


class Turn(NamedTuple):
    """The tensors that a frame finds, and those that it leaves.

    Attributes:
        last: the tensors that the frame before left, by the kernels' names.
        next: those that this frame writes for the next one.
        rows: the rows of these to write: the frame's own, and those in which an earlier frame left
            something.
    """

    last: dict[str, Tensor]
    next: dict[str, Tensor]
    rows: Rows


class History:
    """The last output, accumulated state, depth and reactive mask.

    There is one set of tensors at first, which each frame replaces. Once a frame needs the last
    set until it is done, there are two sets that alternate.

    The output keeps its size. The rest has its frame's render size, and is resampled when the next
    frame has another.

    Attributes:
        model: name of the network that worked on the last frame; None before the first.
    """

    def __init__(self, device: Device, sizes: Sizes, reactive: bool) -> None:
        self._device = device
        self._size: Shape = sizes.render
        self._output = sizes.output
        self._channels = STATE_CHANNELS | ({"last_reactive": 1} if reactive else {})
        self._outputs = [self._make_output()]
        self._rooms = self._make_rooms()
        self._held = self._anywhere()
        self.model: str | None = None

    def use(self, model: str) -> None:
        """Between two frames: `model` works on the next one."""
        if self.model not in (None, model):
            self._forget_hidden()
        self.model = model

    def turn(self, commands: CommandBuffer, size: Shape, keep: bool, apart: bool,
             rows: Rows) -> Turn:
        """Begin a frame: the tensors that were written last become the history.

        Args:
            size: of the frame, render pixels.
            keep: whether the history goes on; else its tensors hold anything.
            apart: whether the frame needs the history until it is done, so that it must write to
                other tensors.
            rows: those in which the frame leaves something.
        """
        if len(self._outputs) == 1 and (apart or size != self._size):
            self._rooms = [*self._make_rooms(), *self._rooms]
            self._held *= 2
            self._outputs.insert(0, self._make_output())
        self._outputs.reverse()
        self._rooms.reverse()
        self._held.reverse()
        old, self._size = self._size, size
        if not keep or size != old:  # nor after a frame that failed
            self._held = self._anywhere()
        if size != old:
            self._change_size(commands, old, keep)
        before, self._held[-1] = self._held[-1], rows
        last = {"history": self._outputs[0], **self._rooms[0].of(size)}
        return Turn(last, self.next, (min(rows[0], before[0]), max(rows[1], before[1])))

    @property
    def next(self) -> dict[str, Tensor]:
        """The tensors that this frame writes for the next one; between two frames, the history."""
        tensors = {"history": self._outputs[-1], **self._rooms[-1].of(self._size)}
        return {NEXT[name]: tensor for name, tensor in tensors.items()}

    def snapshot(self) -> dict[str, np.ndarray]:
        """Between two frames: the history by the kernels' names, and its render size."""
        left = {name: tensor.content() for name, tensor in self.next.items()}
        return {"size": np.array(self._size, np.int64)} | left

    def recall(self, kept: Mapping[str, np.ndarray]) -> None:
        """Between two frames: replace the history by `kept`."""
        height, width = kept["size"]
        self._size = int(height), int(width)
        if self._size[0] * self._size[1] > self._rooms[-1].pixels:
            self._rooms = self._make_rooms()
        self._held = self._anywhere()
        for name, tensor in self.next.items():
            tensor.upload(kept[name])

    def _make_rooms(self) -> list[Room]:
        return [Room(self._device, self._size[0] * self._size[1], self._channels)
                for _ in self._outputs]

    def _make_output(self) -> Tensor:
        return make_zeros(self._device, "history", (*self._output, 3))

    def _anywhere(self) -> list[Rows]:
        """The rows in which each set may hold something: all."""
        return [(0, self._size[0])] * len(self._outputs)

    def _change_size(self, commands: CommandBuffer, old: Shape, keep: bool) -> None:
        """Make room for another size, and record the work that resizes a history that is kept."""
        before = self._rooms[0].of(old)
        if self._size[0] * self._size[1] > self._rooms[0].pixels:
            self._rooms = self._make_rooms()
        else:
            self._rooms.reverse()
        if keep:
            self._resize(commands, before)

    def _resize(self, commands: CommandBuffer, before: dict[str, Tensor]) -> None:
        after, (height, width) = self._rooms[0].of(self._size), before["last_depth"].shape[:2]
        rows, columns = (self._device.wrap(name, positions(old, new)) for name, old, new in
                         (("at_rows", height, self._size[0]), ("at_columns", width, self._size[1])))
        masks = [Each(buffers={"image": before[name], "output": after[name]})
                 for name in ("last_reactive",) if name in before]
        run_steps(commands, RESIZED, {
            "state": before["state"], "last_depth": before["last_depth"], "at_rows": rows,
            "at_columns": columns, "resized": after["state"],
            "resized_depth": after["last_depth"]}, frozenset({"state"}), {"planes": masks})

    def _forget_hidden(self) -> None:
        """Clear the hidden state, which another network cannot read. Zeros are what every network
        finds in a first frame."""
        state = self._rooms[-1].of(self._size)["state"]
        values = state.download()
        values[..., -HIDDEN:] = 0
        state.upload(values)


def make_zeros(device: Device, name: str, shape: tuple[int, ...]) -> Tensor:
    """A tensor of zeros. Nothing uses its content before it is written, but it must be defined."""
    tensor = device.heap.tensor(name, shape)
    tensor.fill(0)
    return tensor


WHOLE = "whole picture"
"""Name of a layer: the picture filtered like its parts, beside parts that are not all of it."""
ALPHA_LAYER = "alpha of the picture"
"""Name of the layer of alpha, beside those of parts."""
FILTERED_PICTURE = "filtered picture"
"""Name of the history of a network that runs for parts and alpha alone."""
ALPHA_CHANNELS = {"samples": 4, "doubt": 1}
"""Channels of what alpha leaves to the next frame: means of its samples in the quarters of each
pixel, and their variance."""


class LayerHistory:
    """The last output of a layer and its accumulated values, in two sets used in turn.

    Attributes:
        frames: for how many frames the layer has had a history; 0 if the last frame left nothing.
        resized: whether the frame before had another size. Then only the output and the accumulated
            values go on.
    """

    def __init__(self, device: Device, name: str, output: Size, outputs: Sequence[Tensor] = (),
                 channels: Mapping[str, int] = MappingProxyType({})) -> None:
        """`channels`: tensor -> channels, of what a frame leaves to the next at render size, if it
        is not the output and the accumulated values."""
        self._device, self._channels = device, dict(channels) or {"last_part": 3}
        size = (1, 1, 1) if channels else (*output, 3)
        self._outputs = list(outputs) or [make_zeros(device, f"last {name}", size)
                                          for _ in range(2)]
        self._rooms: list[Room] = []
        self._size: Shape = (0, 0)
        self.frames, self.resized = 0, False

    def turn(self, commands: CommandBuffer, size: Shape, keep: bool) -> bool:
        """Begin a frame of a render size; returns whether the layer has a history in it."""
        keep = keep and self.frames > 0
        self.frames = self.frames + 1 if keep else 1
        self._outputs.reverse()
        self._rooms.reverse()
        before, old = self._rooms[0].of(self._size) if self._rooms else {}, self._size
        self._size, self.resized = size, size != old
        if not self._rooms or size[0] * size[1] > self._rooms[0].pixels:
            self._rooms = self._make_rooms()
        elif self.resized:
            self._rooms.reverse()
        if keep and self.resized and "last_part" in before:
            self._resize(commands, before["last_part"])
        return keep

    def follow(self) -> None:
        """Other layers that share the memory of the outputs have begun a frame."""
        self._outputs.reverse()

    def skip(self, shared: bool) -> None:
        """Begin a frame without the layer; `shared`: whether others share its memory."""
        self.frames = 0
        if shared:
            self.follow()

    @property
    def output(self) -> Tensor:
        """Where this frame leaves its output."""
        return self._outputs[1]

    @property
    def last(self) -> dict[str, Tensor]:
        """The tensors that the frame before left, by the kernels' names."""
        return {"history": self._outputs[0], **self._rooms[0].of(self._size)}

    @property
    def next(self) -> dict[str, Tensor]:
        """The tensors that this frame leaves, by the same names."""
        return {"history": self._outputs[1], **self._rooms[1].of(self._size)}

    def snapshot(self) -> dict[str, np.ndarray]:
        """Between two frames: the values that the last one left; empty if it left none."""
        if not self.frames or not self._rooms:
            return {}
        return {name: tensor.content() for name, tensor in self.next.items()} | {
            "frames": np.array(self.frames, np.int64)}

    def recall(self, kept: Mapping[str, np.ndarray]) -> None:
        """Between two frames: replace the values that the last one left by those `kept`."""
        self.frames = int(kept["frames"]) if kept else 0
        if self.frames:
            height, width, _ = kept[next(iter(self._channels))].shape
            self._size = height, width
            self._rooms = self._make_rooms()
            for name, tensor in self.next.items():
                tensor.upload(kept[name])

    def _make_rooms(self) -> list[Room]:
        return [Room(self._device, self._size[0] * self._size[1], self._channels) for _ in range(2)]

    def _resize(self, commands: CommandBuffer, before: Tensor) -> None:
        rows, columns = (self._device.wrap(name, positions(old, new)) for name, old, new in
                         zip(("at_rows", "at_columns"), before.shape, self._size, strict=False))
        values = Each(buffers={"image": before, "output": self.last["last_part"]})
        run_steps(commands, RESIZED, {"at_rows": rows, "at_columns": columns},
                  over={"planes": [values]})


def places_of(parts: Sequence[Part]) -> dict[str, int]:
    """Places of layers in a stack: the whole picture if any part is light, then light group by
    group, then other planes."""
    lights = [part.name for part in parts if part.is_light]
    planes = [part.name
              for part in parts if not part.is_light and KINDS[part.kind].is_filtered]
    return {name: i for i, name in enumerate([WHOLE, *lights, *planes] if lights else planes)}


class PartHistory:
    """The histories of all layers, which go on where frames change their size.

    The outputs are in one tensor, in the order of `places_of`; alpha's is by itself.

    Attributes:
        stacks: that tensor of the last frame, then that of this one.
        own: histories of networks that run on single parts, by the parts' names, and of the one
            that runs for parts and alpha alone.
        ran: names of those networks that ran in the last frame.
        stops: by how many stops each of them is exposed more than the picture.
    """

    def __init__(self, device: Device, output: Size, parts: Sequence[Part],
                 own: Mapping[str, History] = MappingProxyType({})) -> None:
        self._device = device
        self._output = output
        self.own = own
        self.stops = dict.fromkeys(own, 0.0)
        self.ran: tuple[str, ...] = ()
        places = places_of(parts)
        self.stacks = ([make_zeros(device, "parts", (len(places), *output, 3)) for _ in range(2)]
                       if places else [])
        self.layers = {name: LayerHistory(device, name, output,
                                          [one_of(stack, i) for stack in self.stacks])
                       for name, i in places.items()}

    def layer(self, name: str) -> LayerHistory:
        """The history of a layer, made when it is first asked for."""
        if name not in self.layers:
            further = ALPHA_CHANNELS if name == ALPHA_LAYER else {}
            self.layers[name] = LayerHistory(self._device, name, self._output, channels=further)
        return self.layers[name]

    def turn(self) -> None:
        """Begin a frame."""
        self.ran = ()
        self.stacks.reverse()

    def forget(self) -> None:
        """Between two frames: forget the last one."""
        self.ran = ()
        for layer in self.layers.values():
            layer.frames = 0

    def snapshot(self) -> dict[str, np.ndarray]:
        """Between two frames: the values that the last one left, by 'part NAME of a layer'."""
        kept = {name: layer.snapshot()
                for name, layer in self.layers.items() if name not in self.own}
        kept |= {name: self.own[name].snapshot() | {"stops": np.array(self.stops[name])}
                 for name in self.ran}
        return {f"part {key} of {name}": array for name, arrays in kept.items()
                for key, array in arrays.items()}

    def recall(self, kept: Mapping[str, np.ndarray]) -> None:
        """Between two frames: replace the values that the last one left by those `kept`."""
        self.forget()
        found: dict[str, dict[str, np.ndarray]] = {}
        for key, array in kept.items():
            if key.startswith("part "):
                kind, _, name = key.removeprefix("part ").partition(" of ")
                found.setdefault(name, {})[kind] = array
        for name, arrays in found.items():
            if name in self.own:
                self.ran += (name,)
                self.stops[name] = float(arrays["stops"])
                self.own[name].recall(arrays)
            else:
                self.layer(name).recall(arrays)


def some_of(stack: Tensor, first: int, count: int) -> Tensor:
    """Pictures of a stack (n, height, width, 3), or planes of one (n, height, width); no copy."""
    return stack.view(f"{stack.name} from {first}", (count, *stack.shape[1:]),
                      first * math.prod(stack.shape[1:]))


def one_of(stack: Tensor, i: int) -> Tensor:
    """A picture of a stack; no copy."""
    return stack.view(f"{stack.name} {i}", stack.shape[1:], i * math.prod(stack.shape[1:]))


def alone(picture: Tensor) -> Tensor:
    """A stack of one picture; no copy."""
    return picture.view(picture.name, (1, *picture.shape))
