"""Exposure tool: a grey checkerboard over the frame, to see whether later software applies the given exposure."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar, Never

import numpy as np

from postfx.exposure import KEY
from postfx.frame import FrameSpec, Role
from postfx.kernels.image import CHECKERBOARD, turns
from postfx.passes.base import Pass, Reflection, ResidentFrame
from postfx.runtime import ArgumentTable, CommandBuffer, Device

VARIABLE = "POSTFX_EXPOSURE_TOOL"
CELLS = 9
"""Cells from top to bottom."""
STOPS = 0.25
GREYS = (KEY * 2**-STOPS, KEY * 2**STOPS)
"""The two greys, as exposed: mid grey is half way between them in stops."""


class ExposureTool(Pass):
    """Covers the frame with a checkerboard of two greys around 0.18, divided by the exposure.

    Software that applies the frame's exposure shows a steady mid grey. If the board is too dark, too bright or
    changing, it applies another exposure. Alpha becomes 1; an overlay is removed.

    Options:
        reference: frame number -> multiplier to divide by; None: each frame's own exposure.
    """

    name: ClassVar[str] = "exposure_tool"

    def __init__(self, *, reference: Mapping[int, float] | None = None, **unknown: Never) -> None:
        super().__init__(reference=reference, **unknown)

    def reflect(self, spec: FrameSpec) -> Reflection:
        alpha = tuple(role for role in (Role.ALPHA,) if spec.has(role))
        kept = tuple(plane for plane in spec.planes if plane[0] is not Role.OVERLAY)
        return Reflection(reads=(Role.COLOUR,), may_read=alpha, writes=(Role.COLOUR, *alpha),
                          output=replace(spec, planes=kept))

    def skip(self, spec: FrameSpec) -> str | None:
        return None if spec.encoding == "scene-linear" else f"colour is {spec.encoding}, exposed already"

    def remarks(self, spec: FrameSpec) -> tuple[str, ...]:
        return (f"a checkerboard covers the picture, unset {VARIABLE} to see it",)

    def compile(self, device: Device, spec: FrameSpec) -> None:
        self._greys = device.heap.tensor("greys", (2,))
        self._output = device.heap.transient("checkerboard", (spec.height, spec.width, 3))
        tensors = {"greys": self._greys, "output": self._output}
        for name, values in zip(("rows", "columns"), cells(spec.height, spec.width), strict=True):
            tensors[name] = device.heap.tensor(f"checkerboard {name}", values.shape)
            tensors[name].upload(values)
        self._table = ArgumentTable(device.compute_state(CHECKERBOARD), tensors)
        if spec.has(Role.ALPHA):
            self._opaque = device.heap.tensor("opaque", (spec.height, spec.width, 1))
            self._opaque.fill(1)
        super().compile(device, spec)

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> None:
        super().encode(commands, frame)
        reference = self.options["reference"]
        exposure = frame.exposure if reference is None else reference[frame.number]
        self._greys.upload(np.array(GREYS) / exposure)
        with commands.compute_encoder("checkerboard") as encoder:
            encoder.barrier(after=("compute", "machine-learning"), before="compute")
            encoder.dispatch(self._table.state, self._table)
        frame.set(Role.COLOUR, self._output)
        if Role.ALPHA in frame:
            frame.set(Role.ALPHA, self._opaque)


def cells(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Of each row and of each column 0 or 1; the darker grey is where both are the same."""
    side = max(height / CELLS, 1.0)
    return turns(height, side), turns(width, side)


def with_tool(passes: tuple[Pass, ...]) -> tuple[Pass, ...]:
    """The passes, and the tool after the upscaler (first, without one) where the environment variable asks for it."""
    asked = os.environ.get(VARIABLE, "0") not in ("", "0")
    if not asked or any(isinstance(item, ExposureTool) for item in passes):
        return passes
    after = max((index for index, item in enumerate(passes, 1) if item.name == "denoise_upscale"), default=0)
    return (*passes[:after], ExposureTool(), *passes[after:])
