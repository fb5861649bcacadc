"""Denoising a picture that is in arrays, in one call."""

from __future__ import annotations

import os
import threading
from functools import lru_cache
from typing import Any, Protocol

import numpy as np

from postfx.frame import Frame, Role
from postfx.passes.denoise import DenoiseUpscale
from postfx.pipeline import Pipeline
from postfx.runtime import Device
from postfx.system import host_floats


class SupportsDLPack(Protocol):
    """An array of any library that can be shared by DLPack, such as NumPy, PyTorch or JAX."""

    def __dlpack__(self, *, stream: Any = ...) -> Any: ...

    def __dlpack_device__(self) -> Any: ...


def denoise(
    color: SupportsDLPack,
    *,
    albedo: SupportsDLPack | None = None,
    specular_albedo: SupportsDLPack | None = None,
    normal: SupportsDLPack | None = None,
    roughness: SupportsDLPack | None = None,
    depth: SupportsDLPack | None = None,
    scale: float = 1.0,
    model: str = "m",
    strength: float = 1.0,
    exposure: str | float = "auto",
    device: str | None = None,
) -> np.ndarray:
    """Denoise one picture, and enlarge it by `scale`.

    The arrays are of any library with DLPack and in the host's memory; meanings, units and ranges are those of
    `postfx.ROLES`. Each picture is denoised alone: for sequences, in which the frames before help, there is
    `postfx.Pipeline`. Networks stay loaded between calls with the same options. Calls from several threads take turns.

    Args:
        color: (height, width, 3) scene-linear radiance, or with alpha (height, width, 4), premultiplied.
        albedo, specular_albedo: (height, width, 3) reflectance.
        normal: (height, width, 3) in world space.
        roughness: (height, width) or (height, width, 1).
        depth: likewise, along the view axis.
        scale, model, strength: as for `postfx.DenoiseUpscale`.
        exposure: 'auto', or stops: what the picture is exposed by before the network sees it; the result is not.
        device: 'cpu', 'cuda', 'cuda:1' or 'auto'; None for the default device.

    Returns a float32 array (scale * height, scale * width, 3), or 4 where there is alpha; other libraries take it
    without a copy, as in `torch.from_dlpack(result)`.

    Raises FrameError for arrays that do not fit together, and other `postfx.PostfxError`s for options that cannot be.
    """
    picture = host_floats(color, "color")
    has_alpha = picture.ndim == 3 and picture.shape[2] == 4
    given = {Role.COLOUR: picture[..., :3] if has_alpha else picture,
             Role.ALPHA: picture[..., 3:] if has_alpha else None,
             Role.DIFFUSE_ALBEDO: albedo, Role.SPECULAR_ALBEDO: specular_albedo, Role.NORMAL: normal,
             Role.ROUGHNESS: roughness, Role.DEPTH: depth}
    planes: dict[Role, Any] = {role: plane for role, plane in given.items() if plane is not None}
    with _ONE_AT_A_TIME:
        pipeline = _pipeline(scale, model, strength, exposure, device, os.getpid())
        pipeline.reset()
        result = pipeline(Frame(planes))
    return np.concatenate([result[Role.COLOUR], result[Role.ALPHA]], -1) if has_alpha else result[Role.COLOUR]


@lru_cache(maxsize=4)
def _pipeline(scale: float, model: str, strength: float, exposure: str | float, device: str | None,
              process: int) -> Pipeline:
    """A pipeline with these options, of this process: threads do not survive a fork."""
    return Pipeline([DenoiseUpscale(scale=scale, model=model, strength=strength)],
                    None if device is None else Device(device), exposure)


_ONE_AT_A_TIME = threading.Lock()
