"""Open Image Denoise as a pass: it denoises each frame alone, at the render's size."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Never

import numpy as np

from postfx import oidn
from postfx.compiled.calls import whole
from postfx.errors import PassOptionError, offer
from postfx.frame import ALBEDOS, FrameSpec, Role
from postfx.oidn import QUALITIES, OpenImageDenoise, total_albedo
from postfx.passes import Pass, Reflection, ResidentFrame
from postfx.pixel_filter import PixelFilter, find_stddev, parse_stddev
from postfx.runtime import CommandBuffer, Device

PREFERRED_ALBEDOS = (Role.DENOISING_ALBEDO, *ALBEDOS)
NORMALS = (Role.DENOISING_NORMAL, Role.NORMAL)


class Oidn(Pass):
    """Denoises with Open Image Denoise, at the render's size and each frame alone; needs the
    package pyoidn.

    The albedo and the normal are filtered alone first and then help with the picture. The albedo is
    the plane `denoising_albedo`, or without it diffuse and specular albedo, added up. The normal is
    the plane `denoising_normal` beside a `denoising_albedo`, as Blender takes both, else `normal`.
    Without an albedo the colour is denoised alone. What is not finite counts as 0, as does light
    below 0.

    Options:
        quality: 'high', 'balanced' or 'fast'.
        alpha: whether alpha is denoised, too, in frames where it is neither 0 nor 1 somewhere.
        pixel_filter: as for `postfx.DenoiseUpscale`, but 'auto' looks at each frame: noise that a
            pixel filter spread over several pixels stays otherwise.

    Parts of the picture stay as they are. Raises PassOptionError for another quality, DeviceError
    without the package.
    """

    name: ClassVar[str] = "oidn"

    def __init__(self, quality: str = "high", *, alpha: bool = True,
                 pixel_filter: float | str = "auto", **unknown: Never) -> None:
        super().__init__(quality=quality, alpha=alpha, pixel_filter=pixel_filter, **unknown)
        self._given_stddev = parse_stddev(pixel_filter)
        if quality not in QUALITIES:
            raise PassOptionError(f"pass 'oidn' has no quality '{quality}'"
                                  f"{offer(quality, QUALITIES, 'give')}")
        oidn.require()
        self._quality, self._alpha = quality, bool(alpha)

    def reflect(self, spec: FrameSpec) -> Reflection:
        written = (Role.COLOUR, Role.ALPHA) if self._denoises_alpha(spec) else (Role.COLOUR,)
        albedos = self._albedos(spec) or PREFERRED_ALBEDOS
        return Reflection(reads=(Role.COLOUR,),
                          may_read=(*albedos, *self._normals(spec), *written[1:]), writes=written,
                          output=spec)

    def skip(self, spec: FrameSpec) -> str | None:
        if spec.encoding != "scene-linear":
            return f"colour is {spec.encoding}, and Open Image Denoise gets scene-linear light"
        return None

    def remarks(self, spec: FrameSpec) -> tuple[str, ...]:
        found = [] if self._albedos(spec) else ["no albedo, so Open Image Denoise blurs more"]
        found += ([f"light groups and passes stay noisy: {', '.join(spec.part_names)}"]
                  if spec.part_names else [])
        return tuple(found)

    def packages(self) -> Mapping[str, str]:
        return {oidn.OIDN_PACKAGE: oidn.version()}

    def compile(self, device: Device, spec: FrameSpec) -> None:
        kind = "cuda" if device.name.startswith("cuda") and oidn.finds_cuda() else "cpu"
        self._denoise = OpenImageDenoise(self._quality, kind, device.threads)
        taken = (Role.COLOUR, *self._albedos(spec), *self._normals(spec))
        self._roles = tuple(role for role in taken if spec.has(role))
        names = tuple(map(str, self._roles))
        size = spec.height, spec.width
        self._colour = device.host_state("oidn", names, ("output",), self._denoise_colour)
        self._output = device.heap.transient("colour by oidn", (*size, 3))
        self._coverage = device.host_state("oidn alpha", ("alpha",), ("output",),
                                           self._denoise_alpha_plane)
        self._covered = (device.heap.transient("alpha by oidn", (*size, 1))
                         if self._denoises_alpha(spec) else None)
        super().compile(device, spec)

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> None:
        super().encode(commands, frame)
        commands.run(self._colour, "filters", output=self._output,
                     **{str(role): frame[role] for role in self._roles})
        frame.set(Role.COLOUR, self._output)
        if self._covered:
            commands.run(self._coverage, "filters", alpha=frame[Role.ALPHA], output=self._covered)
            frame.set(Role.ALPHA, self._covered)

    def _denoise_colour(self, colour: np.ndarray, *others: np.ndarray) -> None:
        *planes, output = others
        known = dict(zip(self._roles, (colour, *planes), strict=True))
        stddev = self._given_stddev
        if stddev is None:
            stddev = find_stddev(colour, known)
        if not stddev:
            self._denoise(colour, self._aids(known), output)
            return
        pixel_filter, denoised = PixelFilter(stddev), np.empty_like(output)
        undone = pixel_filter.without(known)
        self._denoise(undone[Role.COLOUR], self._aids(undone), denoised)
        pixel_filter.finish(whole(colour, np.float32), undone[Role.COLOUR], denoised, output)

    def _aids(self, known: Mapping[Role, np.ndarray]) -> dict[str, np.ndarray]:
        """The planes that help, by the filters' names."""
        albedos = [known[role] for role in PREFERRED_ALBEDOS if role in known]
        aids = {"albedo": total_albedo(*albedos)} if albedos else {}
        for role in NORMALS:
            if role in known:
                aids["normal"] = known[role]
        return aids

    def _denoise_alpha_plane(self, alpha: np.ndarray, output: np.ndarray) -> None:
        if not ((alpha > 0) & (alpha < 1)).any():
            output[...] = alpha
            return
        grey = np.empty((*alpha.shape[:2], 3), np.float32)
        self._denoise(np.clip(alpha, 0, 1).repeat(3, axis=2), {}, grey, hdr=False)
        output[...] = np.clip(grey[..., :1], 0, 1)

    def _denoises_alpha(self, spec: FrameSpec) -> bool:
        return self._alpha and spec.has(Role.ALPHA)

    def _albedos(self, spec: FrameSpec) -> tuple[Role, ...]:
        """The albedos that are added up: one of what is seen in mirrors and glass, too, is
        enough."""
        found = tuple(role for role in PREFERRED_ALBEDOS if spec.has(role))
        return found[:1] if Role.DENOISING_ALBEDO in found else found

    def _normals(self, spec: FrameSpec) -> tuple[Role, ...]:
        """The normal that is taken: one of what is seen in mirrors and glass goes with such an
        albedo."""
        follows = spec.has(Role.DENOISING_ALBEDO) and spec.has(Role.DENOISING_NORMAL)
        return (Role.DENOISING_NORMAL,) if follows else (Role.NORMAL,)
