"""Undoes the renderer's pixel filter, which spreads noise over pixels so that some networks take it
for detail, and applies it again to the pictures that they make."""

from __future__ import annotations

from functools import partial

import numpy as np

from postfx.compiled.calls import whole
from postfx.frame import FrameSpec, Role
from postfx.passes import ResidentFrame
from postfx.passes.denoise.geometry import Rows, Size, rows_of
from postfx.pixel_filter import FILTERED_ROLES, NORMALS, PixelFilter
from postfx.runtime import CommandBuffer, Device, Tensor

SPREAD_MARGIN_PX = 4
"""Render pixels around active ones that are denoised, too: the filter spreads them into these."""
WORK = {"undo": (("plane",), ("output",)), "undo_light": (("light",), ("output", "between")),
        "spread": (("plane",), ("output",)),
        "finish": (("light", "undone", "denoised"), ("output",))}
"""Methods of a `PixelFilter`, with what they read and write."""


class Unfiltered:
    """Undoes the pixel filter in frames of one spec, and applies it again. This runs on the host;
    planes on a GPU are copied there and back."""

    def __init__(self, device: Device, spec: FrameSpec, output: Size) -> None:
        self._device, self._is_render_size = device, output == (spec.height, spec.width)
        self._filter = PixelFilter(0.0)
        self._states = {method: device.host_state(f"pixel filter: {method}", *names,
                                                  partial(self._work, method))
                        for method, names in WORK.items()}
        self._made: dict[str, Tensor] = {}

    def undo(self, commands: CommandBuffer, frame: ResidentFrame,
             stddev: float) -> dict[Role, Tensor]:
        """Record the work that undoes a filter of this standard deviation, in pixels, and put the
        results into the frame. Returns the planes as they came."""
        self._filter = PixelFilter(stddev, self._device.divide_planes)
        given = {role: frame[role] for role in FILTERED_ROLES if role in frame}
        for role, plane in given.items():
            undone = frame.tensors[role] = self._tensor(f"{role} before its filter", plane.shape)
            if role in NORMALS:
                commands.run(self._states["undo"], "undo", plane=plane, output=undone)
                continue
            between = self._tensor(f"{role} nearly before its filter", plane.shape)
            commands.run(self._states["undo_light"], "undo", light=plane, output=undone,
                         between=between)
        return given

    def spread(self, commands: CommandBuffer, name: str, lights: tuple[Tensor, Tensor],
               denoised: Tensor, rows: Rows) -> Tensor:
        """Record the work that applies the filter to `rows` of a picture; returns the result.

        Args:
            name: of the tensor that is returned.
            lights: the frame's light as it came, and without the filter.
            denoised: the picture that was made of the latter.
        """
        output = self._tensor(name, denoised.shape)
        to, picture = rows_of(output, rows), rows_of(denoised, rows)
        if self._is_render_size:
            light, undone = (rows_of(tensor, rows) for tensor in lights)
            commands.run(self._states["finish"], "spread", light=light, undone=undone,
                         denoised=picture, output=to)
        else:
            commands.run(self._states["spread"], "spread", plane=picture, output=to)
        return output

    def _tensor(self, name: str, shape: tuple[int, ...]) -> Tensor:
        if name not in self._made:
            self._made[name] = self._device.heap.transient(name, shape)
        return self._made[name]

    def _work(self, method: str, *arrays: np.ndarray) -> None:
        reads = len(WORK[method][0])
        given = [whole(array, np.float32) for array in arrays[:reads]]
        getattr(self._filter, method)(*given, *arrays[reads:])
