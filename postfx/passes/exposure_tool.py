"""Exposure tool: a grey checkerboard over the frame, to see whether later software applies the
given exposure."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar, Literal, Never

import numpy as np

from postfx.errors import ExposureError
from postfx.frame import KEY, FrameSpec, Role
from postfx.kernels.image import CHECKERBOARD, OVER, OVER_ALPHA, turns
from postfx.passes import Pass, Reflection, ResidentFrame
from postfx.runtime import CommandBuffer, Device

TOOL_VARIABLE = "POSTFX_EXPOSURE_TOOL"
CELLS = 9
"""Cells from top to bottom."""
STOPS = 0.25
"""Stops by which the greys of the board are darker and brighter than mid grey."""
GREYS = (KEY * 2**-STOPS, KEY * 2**STOPS)
"""The two greys, as exposed: mid grey is half way between them in stops."""


class ExposureTool(Pass):
    """Covers the frame, or a part of it, with a checkerboard of two greys around 0.18, divided by
    the exposure.

    Software that applies the frame's exposure shows a steady mid grey. If the board is too dark,
    too bright or changing, it applies another exposure. Alpha becomes 1 there; an overlay is
    removed.

    Options:
        reference: frame number -> multiplier to divide by; None: each frame's own exposure.
        part: whether it covers no more than the lower left, see `board_area`.
    """

    name: ClassVar[str] = "exposure_tool"

    def __init__(self, *, reference: Mapping[int, float] | None = None, part: bool = False,
                 **unknown: Never) -> None:
        super().__init__(reference=reference, part=part, **unknown)

    def reflect(self, spec: FrameSpec) -> Reflection:
        alpha = tuple(role for role in (Role.ALPHA,) if spec.has(role))
        kept = tuple(plane for plane in spec.planes if plane[0] is not Role.OVERLAY)
        return Reflection(reads=(Role.COLOUR,), may_read=alpha, writes=(Role.COLOUR, *alpha),
                          output=replace(spec, planes=kept))

    def skip(self, spec: FrameSpec) -> str | None:
        return (None if spec.encoding == "scene-linear"
                else f"colour is {spec.encoding}, exposed already")

    def remarks(self, spec: FrameSpec) -> tuple[str, ...]:
        covered = "a part of the picture" if self.options["part"] else "the picture"
        return (f"a checkerboard covers {covered}, unset {TOOL_VARIABLE} to see it",)

    def compile(self, device: Device, spec: FrameSpec) -> None:
        if self.options["part"]:
            self._compile_part(device, spec)
        else:
            self._compile_whole(device, spec)
        super().compile(device, spec)

    def _compile_whole(self, device: Device, spec: FrameSpec) -> None:
        self._greys = device.heap.tensor("greys", (2,))
        self._output = device.heap.transient("checkerboard", (spec.height, spec.width, 3))
        self._cells = {}
        for name, values in zip(("rows", "columns"), cells(spec.height, spec.width), strict=True):
            self._cells[name] = device.heap.tensor(f"checkerboard {name}", values.shape)
            self._cells[name].upload(values)
        device.make_ready(CHECKERBOARD)
        if spec.has(Role.ALPHA):
            self._opaque = device.heap.tensor("opaque", (spec.height, spec.width, 1))
            self._opaque.fill(1)

    def _compile_part(self, device: Device, spec: FrameSpec) -> None:
        size = spec.height, spec.width
        self._board = device.heap.tensor("checkerboard", (*size, 4))
        self._over = {Role.COLOUR: OVER} | ({Role.ALPHA: OVER_ALPHA} if spec.has(Role.ALPHA)
                                            else {})
        self._outputs = {role: device.heap.transient(f"{role} under the board",
                                                     (*size, spec.channels(role)))
                         for role in self._over}
        device.make_ready(*self._over.values())

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> None:
        super().encode(commands, frame)
        reference = self.options["reference"]
        factor = frame.exposure_factor if reference is None else reference[frame.number]
        if self.options["part"]:
            self._encode_part(commands, frame, factor)
            return
        self._greys.upload(np.array(GREYS) / factor)
        commands.run(CHECKERBOARD, "checkerboard", greys=self._greys, output=self._output,
                     **self._cells)
        frame.set(Role.COLOUR, self._output)
        if Role.ALPHA in frame:
            frame.set(Role.ALPHA, self._opaque)

    def _encode_part(self, commands: CommandBuffer, frame: ResidentFrame,
                     exposure_factor: float) -> None:
        board = np.zeros(self._board.shape, np.float32)
        area = board[board_area(board.shape[0], board.shape[1], part=True)]
        rows, columns = cells(area.shape[0], area.shape[1])
        area[..., :3] = np.where(rows[:, None] == columns[None, :],
                                 *GREYS)[..., None] / exposure_factor
        area[..., 3] = 1
        self._board.upload(board)
        for role, kernel in self._over.items():
            planes = {str(role): frame[role], "overlay": self._board, "output": self._outputs[role]}
            commands.run(kernel, "checkerboard", **planes)
            frame.set(role, self._outputs[role])


def board_area(height: int, width: int, part: bool) -> tuple[slice, slice]:
    """Rows and columns of a frame that the board covers: all, or the third of each that is at the
    lower left."""
    return ((slice(height - height // 3, height), slice(0, width // 3)) if part
            else (slice(0, height), slice(0, width)))


def cells(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """0 or 1 for each row and for each column; the darker grey is where both are the same."""
    side = max(height / CELLS, 1.0)
    return turns(height, side), turns(width, side)


def asked_form() -> Literal["whole", "part"] | None:
    """The board that the environment asks for. Raises ExposureError for a word that means none."""
    word = os.environ.get(TOOL_VARIABLE, "").strip().lower()
    if word in ("", "0", "false", "off", "no"):
        return None
    if word in ("1", "true", "on", "yes"):
        return "whole"
    if word != "part":
        raise ExposureError(f"{TOOL_VARIABLE}={word}: use 1, part (a board at the lower left, "
                            "beside the picture), or 0")
    return "part"


MIXERS = ("both_ways", "partner", "mix_partner")
"""Passes that add another result to the upscaler's."""


def with_tool(passes: tuple[Pass, ...]) -> tuple[Pass, ...]:
    """The passes, and the tool after the upscaler (first, without one) where the environment
    variable asks for it.

    Under a board that covers the whole frame nothing is denoised: the upscaler only gives the size.
    """
    form = asked_form()
    if form is None or any(isinstance(item, ExposureTool) for item in passes):
        return passes
    if form == "whole":
        passes = tuple(_plain(item) for item in passes if item.name not in MIXERS)
    makers = ("denoise_upscale", *MIXERS)
    after = max((index for index, item in enumerate(passes, 1) if item.name in makers), default=0)
    return (*passes[:after], ExposureTool(part=form == "part"), *passes[after:])


def _plain(item: Pass) -> Pass:
    """An upscaler that only resamples; other passes as they are."""
    if item.name != "denoise_upscale":
        return item
    return type(item)(**{**item.options, "strength": 0.0, "budget": None, "reactive": "none"})
