"""Frames between frames on a GPU: planes lie in its memory from the first command to the last.

    between = postfx.DeviceInterpolator(postfx.Device("cuda"))
    between.push({"colour": colour, "depth": depth, "motion": motion})  # arrays of any library
    between.push({"colour": colour, "depth": depth, "motion": motion})
    picture = torch.from_dlpack(between.frame(0.5)["colour"])

The kernels lie beside the modules that they are the CUDA form of: paths.cu, choose.cu and blend.cu.
`PUSH`, `PAIR` and `FRAME_STEPS` list them in the order in which they run: what each frame, each two
frames and each time needs. A step names a kernel and the buffer of each of its bindings.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from postfx.errors import DeviceError, FrameError
from postfx.frame import ROLES, Role
from postfx.interpolate.choose import MARGIN
from postfx.interpolate.pictures import scale_of
from postfx.kernels import Blocks, Kernel
from postfx.passes import share_planes, spec_of
from postfx.runtime import ArgumentTable, CommandBuffer, Device
from postfx.runtime.memory import CUDA
from postfx.runtime.tensor import Tensor

NEEDED_PLANES = (Role.COLOUR, Role.DEPTH, Role.MOTION)
TAKEN = (Role.NORMAL,)
"""Planes beside these that new frames may have."""
SUMMING_BLOCKS = 132
"""Blocks that sum up light: as many as an H100 has multiprocessors."""
FACT_COUNT = 9
"""Numbers of `facts`: whether motion of the frame before is known, four that its jitter adds to the
ends of a frame's paths, and four that both frames' jitter takes off them."""


def _no_rows(*_: Any) -> None:
    raise DeviceError("kernels of the interpolation on a device are written for CUDA: on the CPU "
                      "use Interpolator")


_IMAGE = ("height", "width")
_CELLS = ("rows", "columns")
_SHAPES_BY_KIND: dict[str, tuple[int | str, ...]] = {
    "picture": (*_IMAGE, 3), "held": (*_IMAGE, 4), "colour": (*_IMAGE, 3),
    "pixel_motion": (*_IMAGE, 2), "pixel_depth": (*_IMAGE, 1), "paths": (*_IMAGE, 4),
    "led": (*_IMAGE, 1), "plane": (*_IMAGE, "channels"), "toned": ("tall", "wide", 1),
    "misfits": ("few_rows", "few_columns", 1), "sums": (SUMMING_BLOCKS,), "number": (1,),
    "two": (2,), "facts": (FACT_COUNT,), "motion": (*_CELLS, 2), "depth": (*_CELLS, 1),
    "ends": (*_CELLS, 4), "cells": (*_CELLS, 8), "nearest": ("both_rows", "columns", 1),
    "arrived": ("both_rows", "columns", 8)}
"""Shapes by kind."""


def _kernel(name: str, reads: str, writes: str, blocks: Blocks | None = None) -> Kernel:
    """A kernel of `binding:kind` words. A thread makes one element of what it writes last."""
    pairs = {word.split(":")[0]: word.split(":")[1] for word in f"{reads} {writes}".split()}
    names = [tuple(word.split(":")[0] for word in words.split()) for words in (reads, writes)]
    return Kernel(f"interpolate_{name}", names[0], names[1], _no_rows, (names[1][-1], 0),
                  {name: _SHAPES_BY_KIND[kind] for name, kind in pairs.items()}, blocks=blocks)


_SUMMING = Blocks(1, 256)
_TILES = Blocks(8, 256, columns=32)
HOLD = _kernel("hold", "picture:picture depth:pixel_depth", "held:held")
GATHER_KERNEL = _kernel("gather", "motion:pixel_motion depth:pixel_depth scale:number",
                        "cells:motion keys:motion cell_depth:depth")
LIGHTS_KERNEL = _kernel("lights", "before:held after:held", "sums:sums", _SUMMING)
LOGS_KERNEL = _kernel("logs", "before:held after:held lights:sums", "sums:sums", _SUMMING)
LEVEL_KERNEL = _kernel("level", "sums:sums", "level:number")
TONE = _kernel("tone", "before:held after:held level:number",
               "toned_before:toned toned_after:toned")
ARRIVE = _kernel("arrive", "motion:motion depth:depth keys:motion", "keys:motion")
INVERT = _kernel("invert", "keys:motion motion:motion depth:depth", "inverse:motion")
REFINE = _kernel("refine", "inverse:motion motion:motion depth:depth", "ahead:motion")
LEAD_BACK = _kernel("lead_back",
                    "motion:motion ahead:motion depth_before:depth depth_after:depth came:motion "
                    "facts:facts", "ends:ends bend:motion seen:depth")
LEAD_AHEAD = _kernel("lead_ahead",
                     "ahead:motion motion:motion depth_before:depth depth_after:depth came:motion "
                     "facts:facts bend_after:motion", "ends:ends bend:motion seen:depth")
MISFITS = _kernel("misfits", "before:toned after:toned ends:ends seen:depth scale:number",
                  "found:misfits", Blocks(1, 256, columns=32))
NOISE_KERNEL = _kernel("noise", "found:misfits", "noise:number", Blocks(1, 1024))
CLEAR = _kernel("clear", "", "nearest:nearest count:number sums:arrived")
NEAREST_KERNEL = _kernel("nearest",
                         "ends_before:ends bend_before:motion depth_before:depth ends_after:ends "
                         "bend_after:motion depth_after:depth time:number nearest:nearest",
                         "nearest:nearest")
MEANS_KERNEL = _kernel("means",
                       "ends_before:ends bend_before:motion depth_before:depth seen_before:depth "
                       "ends_after:ends bend_after:motion depth_after:depth seen_after:depth "
                       "time:number nearest:nearest sums:arrived",
                       "sums:arrived", Blocks(16, 256, columns=32))
MERGE_KERNEL = _kernel("merge", "nearest:nearest sums:arrived facts:facts scale:number",
                       "sides:cells depths:motion own:cells")
FILL = _kernel("fill", "depths:motion own:cells", "own:cells")
LIST = _kernel("list", "own:cells scale:number count:number", "count:number list:depth cells:cells",
               _TILES)
CHOOSE = _kernel("choose",
                 "before:toned after:toned own:cells sides:cells depths:motion noise:number "
                 "scale:number count:number list:depth cells:cells", "cells:cells",
                 Blocks(1, 256, most=4 * SUMMING_BLOCKS))
DETAIL_KERNEL = _kernel("detail", "before:toned after:toned noise:number scale:number cells:cells",
                        "cells:cells", _TILES)
_COMPOSED = "cells:cells before:held after:held time:number level:number scale:number shares:two"
COMPOSE = _kernel("compose", _COMPOSED, "motion:pixel_motion depth:pixel_depth colour:colour",
                  _TILES)
COMPOSE_ALL = _kernel("compose_all", _COMPOSED,
                      "motion:pixel_motion depth:pixel_depth paths:paths led:led colour:colour",
                      _TILES)
TAKE = _kernel("take", "before:plane after:plane paths:paths led:led", "data:plane")

Step = tuple[Kernel, dict[str, str]]
"""A kernel, and its buffers by binding."""
Steps = tuple[Step, ...]
"""Steps in their order. What they read and write tells which of them wait for others."""


def _step(kernel: Kernel, buffers: str) -> Step:
    """Buffers in the order of the bindings."""
    return kernel, dict(zip(dict.fromkeys(kernel.reads + kernel.writes), buffers.split(),
                            strict=True))


PUSH: Steps = (
    _step(HOLD, "after.colour after.depth after.held"),
    _step(GATHER_KERNEL, "after.motion after.depth scale after.cells keys after.cell_depth"))
PAIR: Steps = (
    _step(LIGHTS_KERNEL, "before.held after.held lights"),
    _step(ARRIVE, "after.cells after.cell_depth keys"),
    _step(LOGS_KERNEL, "before.held after.held lights logs"),
    _step(LEVEL_KERNEL, "logs level"),
    _step(INVERT, "keys after.cells before.cell_depth inverse"),
    _step(TONE, "before.held after.held level toned_before toned_after"),
    _step(REFINE, "inverse after.cells before.cell_depth ahead"),
    _step(LEAD_BACK,
          "after.cells ahead before.cell_depth after.cell_depth before.cells facts_after "
          "ends_after bend_after seen_after"),
    _step(LEAD_AHEAD,
          "ahead after.cells before.cell_depth after.cell_depth before.cells facts_before "
          "bend_after ends_before bend_before seen_before"),
    _step(MISFITS, "toned_before toned_after ends_after seen_after scale misfits"),
    _step(NOISE_KERNEL, "misfits noise"))
_COMPOSED_OF = "chosen before.held after.held time level scale shares new.motion new.depth"
_SIDES = ("ends_before bend_before before.cell_depth", "ends_after bend_after after.cell_depth")
FRAME_STEPS: Steps = (
    _step(CLEAR, "nearest listed arrived"),
    _step(NEAREST_KERNEL, f"{_SIDES[0]} {_SIDES[1]} time nearest"),
    _step(MEANS_KERNEL, f"{_SIDES[0]} seen_before {_SIDES[1]} seen_after time nearest arrived"),
    _step(MERGE_KERNEL, "nearest arrived facts_after scale sides depths own"),
    _step(FILL, "depths own"),
    _step(LIST, "own scale listed list chosen"),
    _step(CHOOSE, "toned_before toned_after own sides depths noise scale listed list chosen"),
    _step(DETAIL_KERNEL, "toned_before toned_after noise scale chosen"))
PICTURE_STEPS: Steps = (_step(COMPOSE, f"{_COMPOSED_OF} new.colour"),)
WITH_PLANES: Steps = (_step(COMPOSE_ALL, f"{_COMPOSED_OF} paths led new.colour"),)
"""The last step of a time, without planes that are taken along the paths of the picture, and with
them."""
TAKE_ALL: Steps = tuple(_step(TAKE, f"before.{role} after.{role} paths led new.{role}")
                        for role in TAKEN)


def sizes_of(height: int, width: int) -> dict[str, int]:
    """Values of the symbols in shapes, for a picture of this size."""
    scale = scale_of(height, width)
    rows, columns = -(-height // scale), -(-width // scale)
    return {"height": height, "width": width, "rows": rows, "columns": columns,
            "tall": height + 2 * MARGIN, "wide": width + 2 * MARGIN, "few_rows": rows // 4,
            "few_columns": columns // 4, "both_rows": 2 * rows}


def shapes_of(steps: Iterable[Step], sizes: Mapping[str, int]) -> dict[str, tuple[int, ...]]:
    """Shapes of all buffers that steps name; planes that may have any number of channels have
    three."""
    symbols = {"channels": 3, **sizes}
    return {buffer: tuple(size if isinstance(size, int) else symbols[size]
                          for size in kernel.shapes[binding])
            for kernel, buffers in steps for binding, buffer in buffers.items()}


def facts_of(jitter: tuple[float, float], both: tuple[float, ...], comes: bool,
             scale: int) -> list[float]:
    """`facts` of a frame's paths. jitter: its own. both: that of the frame before and of the one
    after. comes: whether motion of the frame before is known."""
    return [float(comes), *(offset / scale for offset in (*jitter * 2, *both))]


class DeviceInterpolator:
    """Frames between the last two frames of a stream, on a GPU. Stateful: push frames in order.

    What `Interpolator` makes with flow=False, of colour, depth, motion and normals: nothing looks
    for cuts, overlays or frames that are alike, hit distances are not used, and pixels that are not
    finite count as black. Frames are of one size.

    Args:
        device: a GPU with CUDA.

    Attributes:
        milliseconds: what the last calls of `push` and `frame` took on the GPU.

    Raises DeviceError for another device.
    """

    def __init__(self, device: Device) -> None:
        if device.memory.place[0] != CUDA:
            raise DeviceError(f"{device!r} is no GPU with CUDA: on the CPU use Interpolator")
        self._device = device
        self._size: tuple[int, int] | None = None
        self._buffers: dict[str, Tensor] = {}
        self._frames: list[dict[Role, Tensor]] = []
        self._jitters: list[tuple[float, float]] = []
        self._commands: dict[tuple[object, ...], CommandBuffer] = {}
        self._numbers: dict[str, tuple[float, ...]] = {}
        self._resets: list[bool] = []
        self._count, self._made = 0, 0
        self.milliseconds = {"push": 0.0, "frame": 0.0}

    @property
    def ready(self) -> bool:
        """Whether two frames of one shot were pushed."""
        return len(self._frames) == 2 and not self._resets[1]

    def push(self, planes: Mapping[Role | str, Any], *, reset: bool = False,
             jitter: tuple[float, float] = (0.0, 0.0)) -> None:
        """Take the next frame.

        Args:
            planes: colour, depth and motion, (height, width, channels) float32, and normals if the
                new frames need them. Normals must stay as they are until the second push after; the
                others are held here.
            reset: whether another shot begins with it; its motion then counts for nothing.
            jitter: as in `Frame`.

        Raises FrameError for planes that are missing or do not fit, BindingError for arrays that
        cannot be read.
        """
        tensors = share_planes(self._device, "plane", planes)
        spec = spec_of(tensors, {}, "scene-linear")
        missing = [role for role in NEEDED_PLANES if role not in tensors]
        if missing:
            raise FrameError(f"frames between on a device need {', '.join(missing)}, too: give the "
                             "planes")
        size = spec.height, spec.width
        if size != self._size:
            self._allocate(size)
        self._frames, self._jitters = [*self._frames, tensors][-2:], [*self._jitters, jitter][-2:]
        self._resets = [*self._resets, reset][-2:]
        self._count += 1
        commands = [self._record("push", PUSH)]
        if self.ready:
            both = (*self._jitters[0], *self._jitters[1])
            for name, own in (("facts_before", self._jitters[0]),
                              ("facts_after", self._jitters[1])):
                self._tell(name, *facts_of(own, both, not self._resets[0], scale_of(*size)))
            commands.append(self._known("pair", PAIR, self._count % 2))
        self.milliseconds["push"] = self._run(commands)

    def frame(self, t: float, previous: float = 0.0) -> dict[Role, Tensor]:
        """Colour, motion, depth, and normals where both frames have them, at a time t between 0
        and 1. They stay as they are until the second call after.

        previous: the time to which the motion leads, -1 to t.

        Raises FrameError for another time, or where there are no two frames of one shot.
        """
        if not self.ready:
            raise FrameError("nothing to interpolate: push two frames of one shot first")
        if not (0 < t < 1 and -1 <= previous <= t):
            raise FrameError(f"time {t} with motion to {previous}: give 0 < t < 1 and -1 <= "
                             "previous <= t")
        self._made += 1
        back = (previous - t) * (previous - 1) / t, previous * (previous - t) / (1 - t)
        self._tell("time", t)
        self._tell("shares", *back)
        roles = [role for role in (*NEEDED_PLANES, *TAKEN)
                 if all(role in frame for frame in self._frames)]
        sets = self._count % 2, self._made % 2
        if len(roles) > len(NEEDED_PLANES):
            commands = [self._known("frame with planes", (*FRAME_STEPS, *WITH_PLANES), *sets),
                        self._record("planes", TAKE_ALL)]
        else:
            commands = [self._known("frame", (*FRAME_STEPS, *PICTURE_STEPS), *sets)]
        self.milliseconds["frame"] = self._run(commands)
        return {role: self._buffer(f"new.{role}") for role in roles}

    def _allocate(self, size: tuple[int, int]) -> None:
        """Buffers for a size of frames: those of the frames themselves and of results are there
        twice."""
        for tensor in self._buffers.values():
            tensor.release()
        self._size, self._frames, self._jitters, self._resets = size, [], [], []
        self._buffers, self._commands, self._numbers = {}, {}, {}
        for name, shape in shapes_of((*PUSH, *PAIR, *FRAME_STEPS, *WITH_PLANES, *TAKE_ALL),
                                     sizes_of(*size)).items():
            side, _, plane = name.rpartition(".")
            if side == "before" or (side == "after" and plane in ROLES):
                continue
            for index in range(2 if side else 1):
                place = f"{index}.{side}.{plane}" if side else name
                self._buffers[place] = self._device.heap.tensor(f"interpolate {place}", shape)
        self._tell("scale", scale_of(*size))

    def _tell(self, name: str, *numbers: float) -> None:
        """Upload parameters that are others than before."""
        if self._numbers.get(name) != numbers:
            self._buffers[name].upload(np.array(numbers, np.float32))
            self._numbers[name] = numbers

    def _buffer(self, name: str) -> Tensor:
        side, _, plane = name.rpartition(".")
        if side == "new":
            return self._buffers[f"{self._made % 2}.new.{plane}"]
        if not side:
            return self._buffers[name]
        age = 0 if side == "after" else 1
        if plane in ROLES:
            return self._frames[-1 - age][Role(plane)]
        return self._buffers[f"{(self._count - age) % 2}.after.{plane}"]

    def _record(self, label: str, steps: Steps) -> CommandBuffer:
        """Commands of steps on the buffers that these mean now."""
        commands = self._device.command_buffer(f"interpolate {label}")
        with commands.compute_encoder(label) as encoder:
            for kernel, buffers in steps:
                state = self._device.compute_state(kernel)
                tensors = {binding: self._buffer(name) for binding, name in buffers.items()}
                encoder.dispatch(state, ArgumentTable(state, tensors))
        return commands

    def _known(self, label: str, steps: Steps, *sets: int) -> CommandBuffer:
        """`_record`, once for each set of buffers."""
        if (label, *sets) not in self._commands:
            self._commands[label, *sets] = self._record(label, steps)
        return self._commands[label, *sets]

    def _run(self, parts: list[CommandBuffer]) -> float:
        """Run commands, the first ones first; milliseconds on the GPU."""
        try:
            for commands in parts:
                commands.commit()
            for commands in parts:
                commands.wait()
        except BaseException:
            self._commands.clear()  # some may not have been waited for
            raise
        return sum(milliseconds for commands in parts for _, milliseconds in commands.timings)
