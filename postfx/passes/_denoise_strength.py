"""How strongly the denoised upscaler works: a blend of its result with the input, resampled to the same size."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from postfx.frame import FrameSpec, Role
from postfx.kernels.denoise_strength import STRENGTH
from postfx.passes._denoise_layout import REACH
from postfx.passes._denoise_planes import Resampler
from postfx.passes._denoise_size import Size
from postfx.passes._denoise_window import Rows, rows_of
from postfx.passes.base import ResidentFrame
from postfx.runtime import ArgumentTable, CommandBuffer, ComputeEncoder, Device, Tensor

FEW = 0.5
"""Of the rows that have strength, the part up to which those that are blended are put back among the others."""


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
        self._size, self._render = output, Size(spec.height, spec.width)
        self._output = device.heap.transient("strength output", (*output, 3))
        self._back = Resampler(device, "blended", Role.COLOUR, output, output, self._output)
        self._is_whole = amount == 1
        self._amount = device.heap.tensor("amount", (1,))
        self._amount.upload([amount])
        self._table = ArgumentTable(device.compute_state(STRENGTH), {"amount": self._amount})
        self._plane: Resampler | None = None
        if spec.has(Role.STRENGTH):
            self._plane = Resampler(device, "strength", Role.STRENGTH, self._render, output)
            self._strength = self._plane.output
        else:
            self._strength = device.wrap("full strength", np.ones((*output, 1), np.float32))

    def encode(self, commands: CommandBuffer, frame: ResidentFrame, denoised: Tensor, rows: Rows,
               unblended: Callable[[], None]) -> Tensor:
        """Record the blend of the frame's own colour with the denoised one in `rows`, all others have no strength;
        returns the colour. Where the strength is 1 everywhere that is the denoised one: `unblended` is told. Where few
        rows have a strength below 1, the others stay where they are: the returned tensor is the denoised one, too."""
        below = self._below(frame)
        if not below.any():
            unblended()
            return denoised
        blended = self._blended(below, rows)
        in_place = blended[1] - blended[0] <= FEW * (rows[1] - rows[0])
        blended, result = (blended, denoised) if in_place else (rows, self._output)
        others = (0, rows[0]), (rows[1], self._size.height)
        self.plain.encode(commands, frame, [(self.plain.output, blended), *((result, some) for some in others)])
        with commands.compute_encoder("strength") as encoder:
            encoder.barrier(after="compute", before="compute")
            self._blend(encoder, frame, denoised, blended)
            if in_place:
                encoder.barrier()
                self._put_back(encoder, denoised, blended)
        return result

    def _blend(self, encoder: ComputeEncoder, frame: ResidentFrame, denoised: Tensor, rows: Rows) -> None:
        if self._plane:
            self._plane.encode(encoder, frame[Role.STRENGTH], frame.jitter, (0.0, 0.0), [(self._strength, rows)])
            encoder.barrier()
        tensors = {"plain": self.plain.output, "denoised": denoised, "strength": self._strength, "output": self._output}
        for name, tensor in tensors.items():
            self._table[name] = rows_of(tensor, rows)
        encoder.dispatch(self._table.state, self._table)

    def _put_back(self, encoder: ComputeEncoder, denoised: Tensor, rows: Rows) -> None:
        """Resampling at whole pixels copies."""
        part = rows_of(denoised, rows), (0, rows[1] - rows[0])
        self._back.encode(encoder, rows_of(self._output, rows), (0.0, 0.0), (0.0, 0.0), [part])

    def _below(self, frame: ResidentFrame) -> np.ndarray:
        """Which render rows hold a strength that may be below 1."""
        if not (self._is_whole and Role.STRENGTH in frame.given):
            return np.ones(self._render.height, bool)
        return ~(frame.given[Role.STRENGTH] >= 1).all((1, 2))  # NaN counts as 0

    def _blended(self, below: np.ndarray, rows: Rows) -> Rows:
        """Those of the output `rows` that one with less strength than 1 reaches, and what lies between them."""
        size, out_size = self._render.height, self._size.height
        first, last = max(rows[0] * size // out_size - REACH, 0), -(-rows[1] * size // out_size) + REACH
        found = first + np.flatnonzero(below[first:last])
        if not found.size:
            return rows
        top, end = (int(found[0]) - REACH) * out_size // size, -(-(int(found[-1]) + 1 + REACH) * out_size // size)
        return max(top, rows[0]), min(end, rows[1])
