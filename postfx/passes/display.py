"""Plain display encoding: exposure, clip and the sRGB curve; for pictures without a tone mapper."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from postfx.frame import FrameSpec, Role
from postfx.kernels.encode_srgb import ENCODE_SRGB
from postfx.passes.base import Pass, Reflection, ResidentFrame
from postfx.runtime import ArgumentTable, CommandBuffer, Device


class Display(Pass):
    """Linear colour to sRGB-encoded [0, 1]. Scene-linear colour is exposed first; what is brighter than 1 is cut."""

    name: ClassVar[str] = "display"

    def reflect(self, spec: FrameSpec) -> Reflection:
        output = FrameSpec(spec.width, spec.height, {Role.COLOUR: 3, **dict(spec.planes)}, "srgb")
        return Reflection(reads=(Role.COLOUR,), writes=(Role.COLOUR,), output=output)

    def skip(self, spec: FrameSpec) -> str | None:
        return "colour is srgb already" if spec.encoding == "srgb" else None

    def compile(self, device: Device, spec: FrameSpec) -> None:
        self._exposure = device.heap.tensor("display exposure", (1,))
        self._output = device.heap.transient("display colour", (spec.height, spec.width, 3))
        tensors = {"exposure": self._exposure, "output": self._output}
        self._table = ArgumentTable(device.compute_state(ENCODE_SRGB), tensors)
        self._exposed = spec.encoding == "scene-linear"
        super().compile(device, spec)

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> None:
        super().encode(commands, frame)
        self._exposure.upload(np.array([frame.exposure if self._exposed else 1.0], np.float32))
        self._table["colour"] = frame[Role.COLOUR]
        with commands.compute_encoder("encode") as encoder:
            encoder.barrier(after=("compute", "machine-learning"), before="compute")
            encoder.dispatch(self._table.state, self._table)
        frame.set(Role.COLOUR, self._output)
