"""Work on the network's result: detail is given back, and the result is blended with the input by strength."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from postfx.frame import FrameSpec, Role
from postfx.kernels import Kernel
from postfx.kernels.denoise.output import DETAIL, JUDGE, RESTORE, STRENGTH, SUMS, TILE
from postfx.passes import ResidentFrame
from postfx.passes.denoise.inputs import Resampler
from postfx.passes.denoise.options import Size
from postfx.passes.denoise.tiling import Rows, rows_of
from postfx.runtime import ArgumentTable, CommandBuffer, Device, Tensor

FEW, MANY, MOST = 16, 64, 96


class Restore:
    """For results of the input's size. Leaves frames alone that are known to have at most 16 samples a pixel, and
    jittered ones, whose samples do not lie where the result's pixels do."""

    def __init__(self, device: Device, size: Size) -> None:
        self._device = device
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

    def encode_part(self, commands: CommandBuffer, noisy: Tensor, denoised: Tensor, output: Tensor) -> Tensor:
        """Record the same work on a part of the picture, after the picture itself: the part gets back the same
        share."""
        tensors = {"colour": noisy, "denoised": denoised, "detail": self._tensors["detail"], "output": output}
        table = ArgumentTable(self._device.compute_state(RESTORE), tensors)
        with commands.compute_encoder("restore") as encoder:
            encoder.barrier(after="compute", before="compute")
            encoder.dispatch(table.state, table)
        return output

    def _table(self, device: Device, kernel: Kernel) -> ArgumentTable:
        names = kernel.reads + kernel.writes
        return ArgumentTable(device.compute_state(kernel), {k: v for k, v in self._tensors.items() if k in names})


class Plain:
    """The input resampled to output size, at pixel centres, in linear light, without overshooting its samples."""

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
    """Blends from the input to the result by `amount`, times the plane `strength` if the frame has one."""

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
        returns the colour. If the strength is 1 everywhere, that is the denoised one, and `unblended` is told."""
        if self.is_full(frame):
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

    def encode_part(self, commands: CommandBuffer, noisy: Tensor, denoised: Tensor,
                    rows: Rows, plain: Resampler, output: Tensor) -> Tensor:
        """Record the same work on a part of the picture, after the picture itself; `plain` resamples parts."""
        others = (0, rows[0]), (rows[1], output.shape[0])
        blended = {"plain": plain.output, "denoised": denoised, "strength": self._strength, "output": output}
        table = ArgumentTable(self._table.state, {"amount": self._amount})
        for name, tensor in blended.items():
            table[name] = rows_of(tensor, rows)
        with commands.compute_encoder("strength") as encoder:
            encoder.barrier(after="compute", before="compute")
            plain.run(encoder, noisy, [(plain.output, rows), *((output, some) for some in others)])
            encoder.barrier()
            encoder.dispatch(table.state, table)
        return output

    def is_full(self, frame: ResidentFrame) -> bool:
        """Whether a frame is denoised fully everywhere, although it has a plane that could say otherwise."""
        strength = frame.host_planes.get(Role.STRENGTH) if self._is_whole else None
        return strength is not None and bool((strength >= 1).all())
