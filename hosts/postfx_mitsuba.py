"""postfx in the place of Mitsuba's OptiX denoiser: the same interface, on any machine.

    import mitsuba as mi
    mi.set_variant("llvm_ad_rgb")
    from postfx_mitsuba import Denoiser                      # instead of mi.OptixDenoiser

    denoiser = Denoiser(input_size=[1280, 720], albedo=True, normals=True, temporal=True)
    previous = noisy
    for each frame:
        previous = denoiser(noisy, albedo, normals, flow=flow, previous_denoised=previous)

Set a variant of Mitsuba before the first call. Copy this file to where Python finds it; it needs
postfx.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mitsuba as mi
import numpy as np

from postfx import DenoiseUpscale, Device, Frame, Pipeline, Role
from postfx.errors import FrameError, OptionError

ROOT = "<root>"
"""Mitsuba's name for the layer without a name."""


class Denoiser:
    """Denoises renders of one size. Made and called like `mi.OptixDenoiser`.

    Args:
        input_size: width and height of the pictures.
        albedo, normals, temporal: which planes each call is given.
        denoise_alpha: whether alpha is denoised with the picture; else it stays as it is.
        model: the network, 's', 'm', 'l' or 'xl', which is the cleanest, above all where a pixel
            filter spreads the noise, as Mitsuba's own does.
        device: 'cpu', 'cuda' or 'auto'. Tensors pass through the host's memory.

    With `temporal` the history is that of the calls before, as long as `previous_denoised` is what
    the last one returned; anything else begins a sequence, as the noisy picture does that OptiX
    recommends for a first frame. `flow` is OptiX's: current minus previous position in pixels, x
    right, y down.

    Raises FrameError for planes that are missing or do not fit, and other `postfx.PostfxError`s for
    wrong options.
    """

    def __init__(
        self, input_size: Sequence[int], albedo: bool = False, normals: bool = False,
        temporal: bool = False,
        denoise_alpha: bool = False, *, model: str = "m", device: str = "auto"
    ) -> None:
        self._width, self._height = (int(side) for side in input_size)
        if min(self._width, self._height) < 1:
            raise OptionError(f"input_size {self._width}x{self._height}: both sides must be at "
                              "least 1 pixel")
        self._asked = {"albedo": albedo, "normals": normals, "flow": temporal,
                       "previous_denoised": temporal}
        self._denoise_alpha = denoise_alpha
        denoise = DenoiseUpscale(scale=1, model=model, alpha=denoise_alpha)
        self._pipeline = Pipeline([denoise], Device(device), cuts="none")
        self._last: np.ndarray | None = None

    def __repr__(self) -> str:
        given = ", ".join(f"{name}={asked}" for name, asked in self._asked.items())
        return (f"Denoiser({self._width}x{self._height}, {given}, "
                f"denoise_alpha={self._denoise_alpha})")

    def __call__(self, noisy: Any, *planes: Any, **named: Any) -> Any:
        """Denoise tensors or a bitmap, as `mi.OptixDenoiser` does:

        - `(noisy, albedo, normals, to_sensor, flow, previous_denoised)`: tensors (height, width, 3)
          or, with alpha, 4, the flow 2. Returns a tensor like `noisy`.
        - `(noisy, albedo_ch, normals_ch, to_sensor, flow_ch, previous_denoised_ch, noisy_ch)`: a
          bitmap of several layers, and the names of its layers. Returns a bitmap of the denoised
          one.

        Normals may be in any coordinates that stay the same over a sequence, so `to_sensor` changes
        nothing.
        """
        if isinstance(noisy, mi.Bitmap):
            return self._of_bitmap(noisy, *planes, **named)
        return self._of_tensors(noisy, *planes, **named)

    def _of_tensors(self, noisy: Any, albedo: Any = None, normals: Any = None,
                    to_sensor: Any = None, flow: Any = None, previous_denoised: Any = None) -> Any:
        given = {"albedo": albedo, "normals": normals, "flow": flow,
                 "previous_denoised": previous_denoised}
        arrays = {name: None if value is None else np.array(value) for name, value in given.items()}
        return mi.TensorXf(self._denoise(np.array(noisy), arrays))

    def _of_bitmap(self, noisy: Any, albedo_ch: str = "", normals_ch: str = "",
                   to_sensor: Any = None,
                   flow_ch: str = "", previous_denoised_ch: str = "", noisy_ch: str = ROOT) -> Any:
        layers = dict(noisy.split())
        named = {"noisy": noisy_ch, "albedo": albedo_ch, "normals": normals_ch, "flow": flow_ch,
                 "previous_denoised": previous_denoised_ch}
        unknown = [name for name in named.values() if name and name not in layers]
        if unknown:
            raise FrameError(f"the bitmap has no layer '{unknown[0]}': it has {', '.join(layers)}")
        noisy_picture = np.array(layers[named.pop("noisy")], np.float32)
        arrays = {key: np.array(layers[name], np.float32) if name else None
                  for key, name in named.items()}
        if (flow := arrays["flow"]) is not None:
            arrays["flow"] = flow[..., :2]  # layers of a bitmap may have three channels at least
        return mi.Bitmap(self._denoise(noisy_picture, arrays))

    def _denoise(self, noisy: np.ndarray, given: dict[str, np.ndarray | None]) -> np.ndarray:
        """The picture (height, width, 3 or 4) denoised; FrameError for planes that are missing or
        do not fit."""
        given = {name: None if plane is None or not plane.size else plane
                 for name, plane in given.items()}
        for name, asked in self._asked.items():
            if asked != (given[name] is not None):
                fix = "give it" if asked else "make the denoiser with it"
                raise FrameError(f"'{name}' is {'missing' if asked else 'not expected'}: {fix}")
        for name, plane in {"noisy": noisy, **given}.items():
            if plane is not None and plane.shape[:2] != (self._height, self._width):
                size = "x".join(map(str, plane.shape[1::-1]))
                raise FrameError(f"'{name}' is {size} pixels, the denoiser was made for "
                                 f"{self._width}x{self._height}")
        noisy = noisy.astype(np.float32, copy=False)
        has_alpha = noisy.ndim == 3 and noisy.shape[2] == 4
        flow, previous = given["flow"], given["previous_denoised"]
        planes = {Role.COLOUR: noisy[..., :3], Role.ALPHA: noisy[..., 3:] if has_alpha else None,
                  Role.DIFFUSE_ALBEDO: given["albedo"], Role.NORMAL: given["normals"],
                  Role.MOTION: None if flow is None else -flow}
        goes_on = (previous is not None and self._last is not None
                   and np.array_equal(previous, self._last))
        if not goes_on:
            self._pipeline.reset()
        frame = self._pipeline(Frame({role: plane
                                      for role, plane in planes.items() if plane is not None},
                                     reset=not goes_on))
        alpha = [frame[Role.ALPHA] if self._denoise_alpha else noisy[..., 3:]] if has_alpha else []
        self._last = np.concatenate([frame[Role.COLOUR], *alpha], axis=2)
        return self._last
