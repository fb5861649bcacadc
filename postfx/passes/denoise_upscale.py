"""Neural denoised upscaler: noisy planes at render size in, clean colour at output size out, steady over time."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from postfx.frame import ROLES, FrameSpec, Role
from postfx.passes._denoise_graph import Graph, Sizes
from postfx.passes.base import Pass, PassOptionError, Reflection, ResidentFrame
from postfx.runtime import CommandBuffer, Device, Tensor

GUIDES = (Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO, Role.NORMAL, Role.ROUGHNESS, Role.DEPTH, Role.MOTION)
# What stands in for a plane that a file lacks; networks are trained with the same values in its place.
ABSENT = {Role.DIFFUSE_ALBEDO: 0.0, Role.SPECULAR_ALBEDO: 0.0, Role.NORMAL: 0.0, Role.ROUGHNESS: 0.5, Role.DEPTH: 1.0,
          Role.MOTION: 0.0}


class DenoiseUpscale(Pass):
    """Denoise and enlarge, using the frames before by motion. Reads what guides there are, needs colour only.

    Options:
        scale: output size over render size, 1 to 3.
        model: tag of the network, as in ``denoise_upscale.<tag>``.

    Without a motion plane every frame stands alone. Raises PassOptionError for a scale outside 1 to 3.
    """

    name: ClassVar[str] = "denoise_upscale"
    defaults: ClassVar[Mapping[str, Any]] = MappingProxyType({"scale": 2.0, "model": "m"})

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.scale = float(self.options["scale"])
        if not 1 <= self.scale <= 3:
            raise PassOptionError(f"pass '{self.name}' scales by 1 to 3, not {self.scale:g}: give a scale in between")

    def reflect(self, spec: FrameSpec) -> Reflection:
        alpha = tuple(role for role in (Role.ALPHA,) if spec.has(role))
        output = FrameSpec(round(spec.width * self.scale), round(spec.height * self.scale), (Role.COLOUR, *alpha))
        return Reflection(reads=(Role.COLOUR,), may_read=(*GUIDES, Role.ALPHA), writes=(Role.COLOUR, *alpha),
                          output=output)

    def remarks(self, spec: FrameSpec) -> tuple[str, ...]:
        lost = [str(role) for role in GUIDES if not spec.has(role) and role != Role.MOTION]
        alone = () if spec.has(Role.MOTION) else ("no motion plane, so every frame is denoised alone and may flicker",)
        return (*alone, *((f"blurs more without the planes {', '.join(lost)}",) if lost else ()))

    def compile(self, device: Device, spec: FrameSpec) -> None:
        output = self.reflect(spec).output
        self._sizes = Sizes(spec.height, spec.width, output.height, output.width)
        self._graph = Graph(device, self._sizes, f"{self.name}.{self.options['model']}")
        self._absent = {role: self._constant(device, role, spec) for role in GUIDES if not spec.has(role)}
        super().compile(device, spec)

    def reset(self) -> None:
        self._fresh = False
        self._exposure = 1.0

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> None:
        super().encode(commands, frame)
        keep = self._fresh and not frame.reset and Role.MOTION in frame
        gain = frame.exposure / self._exposure if keep else 1.0
        planes = {role: frame.get(role) or self._absent[role] for role in GUIDES} | {Role.COLOUR: frame[Role.COLOUR]}
        params = np.array([frame.exposure, *frame.jitter, keep, gain], np.float32)
        frame.set(Role.COLOUR, self._graph.encode(commands, planes, params))
        if Role.ALPHA in frame:
            frame.set(Role.ALPHA, self._graph.encode_alpha(commands, frame[Role.ALPHA], frame.jitter))
        for role in GUIDES:
            frame.tensors.pop(role, None)
        frame.spec, frame.jitter = self.reflect(self._spec).output, (0.0, 0.0)
        self._fresh, self._exposure = True, frame.exposure

    @staticmethod
    def _constant(device: Device, role: Role, spec: FrameSpec) -> Tensor:
        shape = (spec.height, spec.width, ROLES[role].channels)
        return device.wrap(f"absent {role}", np.full(shape, ABSENT[role], np.float32))
