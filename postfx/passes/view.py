"""View: tone mapping without a network, by OpenColorIO, a look-up table or a formula."""

from __future__ import annotations

from typing import ClassVar, Never

import numpy as np

from postfx.colour.displays import parse_display
from postfx.colour.primaries import REC709, matrix_between
from postfx.colour.views import SCALE, TOE, bake
from postfx.frame import FrameSpec, Role
from postfx.kernels.colour import APPLY_CUBE
from postfx.passes.base import Pass, Reflection, ResidentFrame
from postfx.runtime import ArgumentTable, CommandBuffer, Device


class View(Pass):
    """Exposed scene-linear colour to code values of a display, colour by colour, through a cube of 65x65x65.

    Options:
        view: 'neutral' (Khronos PBR Neutral), 'reinhard', 'ocio:VIEW' of the config $OCIO or the built-in ACES 2
            config, 'ocio:VIEW@DISPLAY', or 'FILE.cube,input=SPACE', see `postfx.colour.views.find_view`.
        display: the display to make the picture for, see `postfx.passes.display`. What comes out is for another one
            where the view knows no other: 'neutral' gives srgb, a table what it is made for.

    Raises ColourError when there is no such view.
    """

    name: ClassVar[str] = "view"

    def __init__(self, *, view: str = "neutral", display: str = "srgb", **unknown: Never) -> None:
        super().__init__(view=view, display=display, **unknown)
        self._view, self._cube = bake(view, parse_display(display))

    @property
    def output(self) -> str:
        """Encoding of the colour that comes out."""
        return str(self._view.display)

    def reflect(self, spec: FrameSpec) -> Reflection:
        output = FrameSpec(spec.width, spec.height, {Role.COLOUR: 3, **dict(spec.planes)}, self.output)
        return Reflection(reads=(Role.COLOUR,), writes=(Role.COLOUR,), output=output)

    def skip(self, spec: FrameSpec) -> str | None:
        return None if spec.encoding == "scene-linear" else f"colour is {spec.encoding} already"

    def chosen(self) -> str | None:
        return self._view.title

    def compile(self, device: Device, spec: FrameSpec) -> None:
        new = device.heap.tensor
        self._params, matrix, cube = new("view params", (3,)), new("view matrix", (9,)), new("cube", self._cube.shape)
        matrix.upload(matrix_between(REC709, self._view.primaries).ravel())
        cube.upload(self._cube)
        self._output = device.heap.transient("display colour", (spec.height, spec.width, 3))
        tensors = {"params": self._params, "matrix": matrix, "cube": cube, "output": self._output}
        self._table = ArgumentTable(device.compute_state(APPLY_CUBE), tensors)
        super().compile(device, spec)

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> None:
        super().encode(commands, frame)
        self._params.upload(np.array([frame.exposure, TOE, SCALE], np.float32))
        self._table["colour"] = frame[Role.COLOUR]
        with commands.compute_encoder("cube") as encoder:
            encoder.barrier(after=("compute", "machine-learning"), before="compute")
            encoder.dispatch(self._table.state, self._table)
        frame.set(Role.COLOUR, self._output)
