"""What the denoised upscaler only brings to output size, beside the colour: alpha, and a transparency overlay; and what
it hands on, as the plane has that size."""

from __future__ import annotations

import numpy as np

from postfx.frame import ROLES, FrameSpec, Role
from postfx.passes._denoise_planes import Resampler, Size
from postfx.passes.base import ResidentFrame
from postfx.runtime import CommandBuffer, Device, Tensor

CENTRED = (0.0, 0.0)


def carried_roles(spec: FrameSpec) -> tuple[Role, ...]:
    """Those of them that a frame has; an overlay may come at output size."""
    kept = tuple(role for role in (Role.ALPHA, Role.OVERLAY) if spec.has(role) or role in spec.guide_roles)
    return (*kept, Role.LATER) if Role.LATER in spec.guide_roles else kept


class Carried:
    """Resamples alpha and overlay, from the frame's jittered samples to pixel centres.

    An overlay that is 0 everywhere, or whose pixels lie where the output's do, is left alone.
    """

    def __init__(self, device: Device, spec: FrameSpec, output: Size) -> None:
        self._device, self._output, self._render = device, output, Size(spec.height, spec.width)
        self._overlay_is_guide = Role.OVERLAY in spec.guide_roles
        self._resamplers = {role: Resampler(device, str(role), role, self._size(role), output)
                            for role in carried_roles(spec) if role is not Role.LATER}
        self._nothing: Tensor | None = None

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> None:
        """Record the work; the frame's planes are then those of the output's size."""
        given = frame.given_guides if self._overlay_is_guide else frame.given
        if Role.LATER in frame.guides:
            frame.set(Role.LATER, frame.guides[Role.LATER])
        blank = Role.OVERLAY in given and not given[Role.OVERLAY].any()
        for role, resampler in self._resamplers.items():
            plane, jitter = self._source(role, frame)
            if role is Role.OVERLAY and blank:
                frame.set(role, self._zeros(), blank=True)
            elif role is Role.OVERLAY and self._size(role) == self._output and jitter == CENTRED:
                frame.set(role, plane)
            else:
                frame.set(role, _resampled(commands, str(role), resampler, plane, jitter))

    def _source(self, role: Role, frame: ResidentFrame) -> tuple[Tensor, tuple[float, float]]:
        """A plane, and where its samples lie."""
        if role is Role.OVERLAY and self._overlay_is_guide:
            return frame.guides[role], frame.guide_jitter
        return frame[role], frame.jitter

    def _size(self, role: Role) -> Size:
        return self._output if role is Role.OVERLAY and self._overlay_is_guide else self._render

    def _zeros(self) -> Tensor:
        if self._nothing is None:
            zeros = np.zeros((*self._output, ROLES[Role.OVERLAY].channels), np.float32)
            self._nothing = self._device.wrap("no overlay", zeros)
        return self._nothing


def _resampled(
    commands: CommandBuffer, name: str, resampler: Resampler, plane: Tensor, jitter: tuple[float, float]
) -> Tensor:
    with commands.compute_encoder(name) as encoder:
        encoder.barrier(after=("compute", "machine-learning"), before="compute")
        resampler.encode(encoder, plane, jitter, CENTRED)
    return resampler.output
