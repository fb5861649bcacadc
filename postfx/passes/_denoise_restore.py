"""Gives back the detail that the denoised upscaler's network took for noise, so that clean input stays as it is."""

from __future__ import annotations

from postfx.frame import Role
from postfx.kernels.denoise_restore import DETAIL, JUDGE, RESTORE, SUMS, TILE
from postfx.kernels.kernel import Kernel
from postfx.passes._denoise_size import Size
from postfx.passes.base import ResidentFrame
from postfx.runtime import ArgumentTable, CommandBuffer, Device, Tensor

FEW, MANY, MOST = 16, 64, 96


class Restore:
    """For results of the input's size. Leaves frames alone that are known to have at most 16 samples a pixel, and
    jittered ones, whose samples do not lie where the result's pixels do."""

    def __init__(self, device: Device, size: Size) -> None:
        new, between = device.heap.tensor, device.heap.transient
        tiles = -(-size.height // TILE), -(-size.width // TILE)
        self._params, self._evidence = new("restore params", (4,)), new("evidence", (1,))
        self._output = between("restored", (*size, 3))
        self._tensors = {"params": self._params, "evidence": self._evidence, "sums": between("sums", (*tiles, SUMS)),
                         "detail": between("detail", (*tiles, 1)), "output": self._output}
        self._tables = [self._table(device, kernel) for kernel in (JUDGE, DETAIL, RESTORE)]

    def acts_on(self, frame: ResidentFrame) -> bool:
        """Whether a frame may get detail back."""
        return frame.jitter == (0.0, 0.0) and (frame.samples or MANY) > FEW

    def encode(self, commands: CommandBuffer, frame: ResidentFrame, denoised: Tensor) -> Tensor:
        """Record the work on the frame's own colour and the denoised one; returns the colour."""
        if not self.acts_on(frame):
            return denoised
        self._params.upload([frame.exposure, 0.0, 0.0, 0.0])
        self._evidence.upload([min(frame.samples or MANY, MOST) / MANY])
        planes = {"colour": frame[Role.COLOUR], "denoised": denoised}
        with commands.compute_encoder("restore") as encoder:
            encoder.barrier(after="compute", before="compute")
            for table in self._tables:
                for name in planes.keys() & {binding.name for binding in table.state.bindings}:
                    table[name] = planes[name]
                encoder.dispatch(table.state, table)
                encoder.barrier()
        return self._output

    def _table(self, device: Device, kernel: Kernel) -> ArgumentTable:
        names = kernel.reads + kernel.writes
        return ArgumentTable(device.compute_state(kernel), {k: v for k, v in self._tensors.items() if k in names})
