"""What a frame leaves to the next, and where reflections were in the frame before."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import NamedTuple

import numpy as np

from postfx.caching import LRUCache
from postfx.frame import DEPTH_MISS, FrameSpec, Role, pixel_aspect
from postfx.kernels.denoise.layout import HIDDEN
from postfx.kernels.denoise.prepare import RESIZE
from postfx.kernels.denoise.reflections import CAMERA, REFLECTIONS
from postfx.kernels.image import RESAMPLE, positions
from postfx.passes.base import MOST_SIZES, ResidentFrame
from postfx.passes.denoise.tiling import Rows, Shape, Sizes
from postfx.runtime import ArgumentTable, CommandBuffer, Device, Tensor

NEXT = {"history": "next_history", "state": "next_state", "last_depth": "next_depth", "last_reactive": "next_reactive"}
"""Tensor of the last frame that kernels read -> tensor that they write for the next one."""
CHANNELS = {"state": 4 + HIDDEN, "last_depth": 1}
"""For tensors of render size."""



class Room:
    """Memory for tensors of render size, for frames of any size up to a number of pixels."""

    def __init__(self, device: Device, pixels: int, channels: Mapping[str, int]) -> None:
        self.pixels, self._channels = pixels, channels
        self._memory = {name: _zeros(device, name, (pixels * count,)) for name, count in channels.items()}
        self._views: LRUCache[Shape, dict[str, Tensor]] = LRUCache(MOST_SIZES)

    def of(self, size: Shape) -> dict[str, Tensor]:
        """The tensors of a frame's size, by the kernels' names; all sizes share the memory."""
        return self._views.get_or_make(size, partial(self._view, size))

    def _view(self, size: Shape) -> dict[str, Tensor]:
        return {name: memory.view(name, (*size, self._channels[name])) for name, memory in self._memory.items()}


class History:
    """The last output, accumulated state, depth and reactive mask, in two sets that alternate.

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

    def turn(self, commands: CommandBuffer, size: Shape, keep: bool) -> None:
        """Begin a frame of this render size: the tensors written last become the history. Their content is only defined
        if the history is not kept."""
        self._outputs.reverse()
        self._rooms.reverse()
        self._held.reverse()
        if not keep or size != self._size:  # nor after a frame that failed
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
        """Call once a frame, which leaves something in these rows only. Returns the rows to write: also those in which
        an earlier frame left something."""
        before, self._held[1] = self._held[1], rows
        return min(rows[0], before[0]), max(rows[1], before[1])

    @property
    def last(self) -> dict[str, Tensor]:
        """The tensors that the frame before left, by the kernels' names."""
        return {"history": self._outputs[0], **self._rooms[0].of(self._size)}

    @property
    def next(self) -> dict[str, Tensor]:
        """The tensors that this frame writes for the next, by the kernels' names."""
        tensors = {"history": self._outputs[1], **self._rooms[1].of(self._size)}
        return {NEXT[name]: tensor for name, tensor in tensors.items()}

    def kept(self) -> dict[str, np.ndarray]:
        """Between two frames: the history by the kernels' names, and its render size."""
        return {"size": np.array(self._size, np.int64)} | {name: tensor.content() for name, tensor in self.next.items()}

    def recall(self, kept: Mapping[str, np.ndarray]) -> None:
        """Between two frames: replace the history by `kept`."""
        height, width = kept["size"]
        self._size = int(height), int(width)
        if self._size[0] * self._size[1] > self._rooms[1].pixels:
            self._rooms = self._make_rooms()
        self._held = _anywhere(self._size)
        for name, tensor in self.next.items():
            tensor.upload(kept[name])

    def _make_rooms(self) -> list[Room]:
        return [Room(self._device, self._size[0] * self._size[1], self._channels) for _ in range(2)]

    def _resize(self, commands: CommandBuffer, before: dict[str, Tensor]) -> None:
        """Record the work that resizes the history to this frame's size."""
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
        """Another network cannot read the hidden state. Zeros in its place are what every network knows from first
        frames."""
        state = self._rooms[1].of(self._size)["state"]
        values = state.download()
        values[..., -HIDDEN:] = 0
        state.upload(values)


def _anywhere(size: Shape) -> list[Rows]:
    """The rows in which each of the two sets may hold something: all."""
    return [(0, size[0])] * 2


def _zeros(device: Device, name: str, shape: tuple[int, ...]) -> Tensor:
    """A tensor of zeros: before the first frame it is not used, it only has to be defined."""
    tensor = device.heap.tensor(name, shape)
    tensor.fill(0)
    return tensor


NEEDS = (Role.MOTION, Role.DEPTH, Role.NORMAL, Role.ROUGHNESS, Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO)
"""Without one of these the hit distance is of no use."""

AXES = ((-1, -1, 1), (1, -1, -1), (1, -1, 1))
"""Signs that turn x, y and z of cameras into the picture's (x right, y down, z forward): for Mitsuba, OpenGL, pbrt."""

SAMPLES = 24
"""Pixels along a side whose motion tells which axes a camera has."""
MOST_OFF, PART_OFF = 0.25, 0.05
"""Pixels, and share of the motion, by which half of those pixels may be off."""

NO_CAMERA = "no worldToCamera and field of view (postfx:fovX) in the headers"
NO_FIT = "worldToCamera, field of view and depth do not give the motion that the frame has"


class Camera(NamedTuple):
    """A frame's camera: world to camera (4, 4), row vectors; horizontal field of view in degrees."""

    matrix: np.ndarray
    fov_x: float

    @classmethod
    def of(cls, frame: ResidentFrame) -> Camera | None:
        """None where the frame does not know it."""
        if frame.world_to_camera is None or not frame.fov_x or abs(np.linalg.det(frame.world_to_camera)) < 1e-12:
            return None
        return cls(frame.world_to_camera, frame.fov_x)


def can_follow(spec: FrameSpec) -> bool:
    """Whether frames of a spec have the planes for the motion of reflections, some possibly as guides."""
    return spec.has(Role.SPECULAR_HIT_DISTANCE) and all(spec.has(role) for role in NEEDS)


class Reflections:
    """Replaces the motion of smooth surfaces with a hit distance by the motion of their virtual image."""

    def __init__(self, device: Device, spec: FrameSpec) -> None:
        self._camera = device.heap.tensor("camera", (CAMERA,))
        self._output = device.heap.transient("motion of reflections", (spec.height, spec.width, 2))
        self._table = ArgumentTable(device.compute_state(REFLECTIONS),
                                    {"camera": self._camera, "reflected": self._output})

    def encode(self, commands: CommandBuffer, frame: ResidentFrame, params: np.ndarray | None,
               planes: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        """Record the work, unless `params` are None; returns the planes, with this motion for the frame's own."""
        if params is None:
            return planes
        self._camera.upload(params)
        self._table["hit_distance"] = frame[Role.SPECULAR_HIT_DISTANCE]
        for role in NEEDS:
            self._table[role] = planes[role]
        with commands.compute_encoder("reflections") as encoder:
            encoder.barrier(after=("compute", "machine-learning"), before="compute")
            encoder.dispatch(self._table.state, self._table)
        return {**planes, "motion": self._output}


class Cameras:
    """Follows the camera from frame to frame."""

    def __init__(self) -> None:
        self._last: Camera | None = None

    def reset(self) -> None:
        """Forget the frame before."""
        self._last = None

    def kept(self) -> dict[str, np.ndarray]:
        """Between two frames: the last camera and its facts."""
        return {"camera": self._last.matrix, "fov_x": np.array(self._last.fov_x, np.float64)} if self._last else {}

    def recall(self, kept: Mapping[str, np.ndarray]) -> None:
        """Between two frames: replace these facts by `kept`."""
        self._last = Camera(kept["camera"], float(kept["fov_x"])) if "camera" in kept else None

    def step(self, frame: ResidentFrame, moves: bool, tell: Callable[[str], None]) -> np.ndarray | None:
        """The kernel's parameters for a frame, float32 (27,); None if it has nothing to do.

        Args:
            moves: whether the frame has a history, and something moves.
            tell: called with the reason if reflections cannot be followed.
        """
        then, self._last = self._last, Camera.of(frame)
        if not moves or {Role.MOTION, Role.DEPTH} - frame.host_planes.keys():
            return None
        if not (then and self._last):
            tell(NO_CAMERA)
            return None
        if not _is_moving(self._last, then):
            return None
        params = _best_params(frame, self._last, then)
        if params is None:
            tell(NO_FIT)
        return params


def _is_moving(now: Camera, then: Camera) -> bool:
    """Whether a camera differs from the last one; if not, everything at rest is where it was."""
    return not (np.allclose(now.matrix, then.matrix, rtol=0, atol=1e-9) and now.fov_x == then.fov_x)


def _best_params(frame: ResidentFrame, now: Camera, then: Camera) -> np.ndarray | None:
    """None if no camera axes explain the frame's motion."""
    tried = [_params(frame, now, then, axes) for axes in AXES]
    errors = [_misfit(frame, params) for params in tried]
    best = int(np.argmin(errors))
    return tried[best].astype(np.float32) if errors[best] <= 1 else None


def _params(frame: ResidentFrame, now: Camera, then: Camera, axes: tuple[int, int, int]) -> np.ndarray:
    signs, change = np.diag(axes).astype(float), np.linalg.inv(now.matrix) @ then.matrix
    aspect = pixel_aspect(frame.metadata)
    focal = [side / 2 / math.tan(math.radians(camera.fov_x) / 2) for camera in (now, then)
             for side in (frame.spec.width, frame.spec.width * aspect)]
    turn, shift = signs @ change[:3, :3] @ signs, change[3, :3] @ signs
    return np.concatenate([focal, frame.jitter, turn.ravel(), shift, (now.matrix[:3, :3] @ signs).ravel()])


def _misfit(frame: ResidentFrame, params: np.ndarray) -> float:
    """Median over some pixels of the difference from the motion of surfaces at rest, in units of the tolerance."""
    depth, motion = frame.host_planes[Role.DEPTH], frame.host_planes[Role.MOTION]
    height, width = depth.shape[:2]
    rows = np.linspace(0, height - 1, min(height, SAMPLES)).astype(int)[:, None]
    columns = np.linspace(0, width - 1, min(width, SAMPLES)).astype(int)[None]
    z, moved = depth[rows, columns, 0].astype(float), motion[rows, columns].astype(float)
    hit = (z > 0) & (z < DEPTH_MISS) & np.isfinite(moved).all(-1)
    if not hit.any():
        return math.inf
    at = np.stack(np.broadcast_arrays(columns, rows), -1) + 0.5 + params[4:6] - (width / 2, height / 2)
    ray = np.concatenate([at / params[:2], np.ones((*z.shape, 1))], -1)[hit]
    place = ray @ params[6:15].reshape(3, 3) + params[15:18] / z[hit][:, None]
    error = np.abs(place[:, :2] / np.maximum(place[:, 2:], 1e-6) * params[2:4] - at[hit] - moved[hit]).max(-1)
    return float(np.median(error / (MOST_OFF + PART_OFF * np.abs(moved[hit]).max(-1))))
