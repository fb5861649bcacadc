"""The first of two stages, for frames that are enlarged: a network for the render's size removes
most of the noise before another network enlarges."""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from postfx.frame import FrameSpec, Role
from postfx.passes import Pass, ResidentFrame
from postfx.passes.denoise.activity import grown
from postfx.passes.denoise.geometry import CELL
from postfx.passes.denoise.planes import ABSENT, MIRRORED_ROLES
from postfx.passes.denoise.window import FrameWork
from postfx.runtime import CommandBuffer, Device, Tensor

DENOISED_SHARE = 0.75
"""Share of the denoised picture in the mixture with the noisy one. What stays noisy shows detail
that the first network lost, and where its picture is not to be trusted."""
FIRST_STAGE_PLANES = (Role.COLOUR, *ABSENT, *MIRRORED_ROLES, Role.STRENGTH, Role.REACTIVE,
               Role.OPAQUE_COLOUR, Role.SPECULAR_HIT_DISTANCE)
"""Planes that the first network may read."""


class FirstStage:
    """Denoises frames of one spec at their own size, for a network that then enlarges a mixture of
    the denoised and the noisy picture as if it were the frame.

    Args:
        stage: a denoiser of the render's size that mixes by its strength, `DENOISED_SHARE`.
        halo: render pixels that it sees around active ones.

    Attributes:
        runs: whether the frame that was looked at last is denoised first.
        is_jittered: whether there was time for it, but its samples are jittered.
    """

    def __init__(self, device: Device, spec: FrameSpec, stage: Pass, halo: int) -> None:
        self._stage, self._halo = stage, halo
        planes = tuple(plane for plane in spec.planes if plane[0] in FIRST_STAGE_PLANES)
        self._spec = replace(spec, planes=planes, guides=None, parts=())
        self._strength = (device.heap.tensor("strength of the first stage",
                                             (spec.height, spec.width, 1))
                          if spec.has(Role.STRENGTH) else None)
        self.runs = self.is_jittered = False
        stage.compile(device, self._spec)

    def look(self, frame: ResidentFrame, has_time: bool) -> bool:
        """Decide whether a frame is denoised first; returns it. It is if there is time and it has
        no jitter: jittered samples hold more detail than a picture of the render's size does."""
        self.is_jittered = has_time and frame.jitter != (0.0, 0.0)
        self.runs = has_time and not self.is_jittered
        return self.runs

    def encode(self, commands: CommandBuffer, frame: ResidentFrame,
               work: FrameWork) -> Tensor | None:
        """Record the work on the frame that was looked at; returns the mixture, or None where the
        frame is enlarged as it is."""
        if not (self.runs and work.keep):
            self._stage.reset()
        if not self.runs:
            return None
        own = self._copy(frame, work)
        self._stage.encode(commands, own)
        return own[Role.COLOUR]

    def _copy(self, frame: ResidentFrame, work: FrameWork) -> ResidentFrame:
        """The frame as the first network sees it: active wherever the second one looks."""
        held, own = {role: frame[role] for role in self._spec.roles}, {}
        if self._strength:
            own[Role.STRENGTH] = _strength_of(work.cells, self._halo, self._strength.shape[:2])
            self._strength.upload(own[Role.STRENGTH])
            held[Role.STRENGTH] = self._strength
        return replace(frame, spec=self._spec, tensors=held, guides={}, host_guides={}, parts={},
                       host_planes=ChainMap(own, frame.host_planes), host_parts={},
                       blank=set(frame.blank))

    def reset(self) -> None:
        """Drop the history."""
        self._stage.reset()

    def history(self) -> Mapping[str, np.ndarray]:
        """Between two frames: the history of the first network."""
        return self._stage.history() or {}

    def recall(self, history: Mapping[str, np.ndarray]) -> None:
        """Between two frames: replace the history, unless it is one of another size."""
        fits = tuple(history.get("size", ())) == (self._spec.height, self._spec.width)
        self._stage.recall(history if fits else {})


def _strength_of(cells: np.ndarray | None, halo: int, size: tuple[int, ...]) -> np.ndarray:
    """Strength (h, w, 1): 1 in active cells and their halo, 0 elsewhere; 1 everywhere without
    cells."""
    if cells is None:
        return np.ones((*size, 1), np.float32)
    whole = grown(cells, halo).repeat(CELL, 0).repeat(CELL, 1)
    return whole[:size[0], :size[1], None].astype(np.float32)
