"""Results of both directions in time: what the frames before made of a frame, and what those after it made of it."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar, Never

from postfx.frame import FrameSpec, Role
from postfx.kernels.image import OVER
from postfx.passes.base import Pass, Reflection, ResidentFrame
from postfx.runtime import ArgumentTable, CommandBuffer, Device


class BothWays(Pass):
    """Mixes the plane `later` into the colour: later + (1 - weight) * colour, in scene-linear light.

    `postfx.Backwards` makes the plane, of the upscaler's output size. Its weight is how well a pixel is known from the
    frames after it, compared with those before: half of it in the middle of a shot, all of it where only they show
    the pixel well. The plane is gone then. It has no options.
    """

    name: ClassVar[str] = "both_ways"

    def __init__(self, **unknown: Never) -> None:
        super().__init__(**unknown)

    def reflect(self, spec: FrameSpec) -> Reflection:
        kept = tuple(plane for plane in spec.planes if plane[0] is not Role.LATER)
        return Reflection(reads=(Role.COLOUR, Role.LATER), writes=(Role.COLOUR,), output=replace(spec, planes=kept))

    def skip(self, spec: FrameSpec) -> str | None:
        if spec.encoding != "scene-linear":
            return f"colour is {spec.encoding}, and both directions are mixed in scene-linear light"
        return None if spec.has(Role.LATER) else "the frames after it were not looked at"

    def compile(self, device: Device, spec: FrameSpec) -> None:
        output = device.heap.transient("colour of both directions", (spec.height, spec.width, 3))
        self._table = ArgumentTable(device.compute_state(OVER), {"output": output})
        super().compile(device, spec)

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> None:
        super().encode(commands, frame)
        self._table["overlay"], self._table["colour"] = frame[Role.LATER], frame[Role.COLOUR]
        with commands.compute_encoder("mix") as encoder:
            encoder.barrier(after=("compute", "machine-learning"), before="compute")
            encoder.dispatch(self._table.state, self._table)
        frame.set(Role.COLOUR, self._table["output"])
