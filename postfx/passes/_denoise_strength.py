"""How strongly the denoised upscaler works: a blend of its result with the input, resampled to the same size."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from postfx.frame import FrameSpec, Role
from postfx.kernels.denoise_strength import STRENGTH
from postfx.passes._denoise_planes import Resampler
from postfx.passes._denoise_size import Size
from postfx.passes._denoise_window import Rows, rows_of
from postfx.passes.base import ResidentFrame
from postfx.runtime import ArgumentTable, CommandBuffer, Device, Tensor


class Plain:
    """The input resampled to output size: light is interpolated as it is, within its samples, at pixel centres."""

    def __init__(self, device: Device, spec: FrameSpec, output: Size) -> None:
        self._resampler = Resampler(device, "plain", Role.COLOUR, Size(spec.height, spec.width), output)
        self.output = self._resampler.output

    def encode(self, commands: CommandBuffer, frame: ResidentFrame,
               parts: Sequence[tuple[Tensor, Rows]] = ()) -> Tensor:
        """Record the work, for some rows of some tensors if `parts` are given; returns the colour at output size."""
        with commands.compute_encoder("plain") as encoder:
            encoder.barrier(after=("compute", "machine-learning"), before="compute")
            self._resampler.encode(encoder, frame[Role.COLOUR], frame.jitter, (0.0, 0.0), parts)
        return self.output


class Strength:
    """Goes from the input to the result by `amount` times the plane `strength`, if the frame has one."""

    def __init__(self, device: Device, spec: FrameSpec, output: Size, amount: float) -> None:
        self.plain = Plain(device, spec, output)
        self._output = device.heap.transient("strength output", (*output, 3))
        self._is_whole = amount == 1
        self._amount = device.heap.tensor("amount", (1,))
        self._amount.upload([amount])
        self._table = ArgumentTable(device.compute_state(STRENGTH), {"amount": self._amount})
        self._plane: Resampler | None = None
        if spec.has(Role.STRENGTH):
            self._plane = Resampler(device, "strength", Role.STRENGTH, Size(spec.height, spec.width), output)
            self._strength = self._plane.output
        else:
            self._strength = device.wrap("full strength", np.ones((*output, 1), np.float32))

    def encode(self, commands: CommandBuffer, frame: ResidentFrame, denoised: Tensor, rows: Rows,
               unblended: Callable[[], None]) -> Tensor:
        """Record the blend of the frame's own colour with the denoised one in `rows`, all others have no strength;
        returns the colour. Where the strength is 1 everywhere that is the denoised one: `unblended` is told."""
        if self._is_full(frame):
            unblended()
            return denoised
        others = (0, rows[0]), (rows[1], self._output.shape[0])
        self.plain.encode(commands, frame, [(self.plain.output, rows), *((self._output, some) for some in others)])
        blended = {"plain": self.plain.output, "denoised": denoised, "strength": self._strength, "output": self._output}
        for name, tensor in blended.items():
            self._table[name] = rows_of(tensor, rows)
        with commands.compute_encoder("strength") as encoder:
            encoder.barrier(after="compute", before="compute")
            if self._plane:
                self._plane.encode(encoder, frame[Role.STRENGTH], frame.jitter, (0.0, 0.0), [(self._strength, rows)])
                encoder.barrier()
            encoder.dispatch(self._table.state, self._table)
        return self._output

    def _is_full(self, frame: ResidentFrame) -> bool:
        return self._is_whole and Role.STRENGTH in frame.given and bool((frame.given[Role.STRENGTH] >= 1).all())
