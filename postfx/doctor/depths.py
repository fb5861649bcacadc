"""What stored depth could be: normals that follow from it agree with the stored normals only if it is read rightly."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from postfx.doctor.geometry import LIKELY_FOV, Fit, fit_rotation, is_hit, rays
from postfx.frame import DEPTH_MISS, Frame, Role


@dataclass(frozen=True)
class DepthKind:
    """A reading of stored depth: how depth along the view axis follows from it.

    `planar` takes stored values (height, width) and the cosine between ray and axis, and gives depth; `in_unit` says
    that it makes sense for values within 0..1 only.
    """

    code: str
    name: str
    cause: str
    mend: str
    planar: Callable[[np.ndarray, np.ndarray], np.ndarray]
    in_unit: bool = False


KINDS = (
    DepthKind("", "depth along the view axis", "", "", lambda d, cosine: d),
    DepthKind("depth-ray", "distance from the eye", "ray distance was written instead of depth along the view axis",
              "multiply by the cosine between ray and axis, or give --depth ray,fov=DEGREES (in a profile "
              "kind = \"ray\" and fov_x)", lambda d, cosine: d * cosine),
    DepthKind("depth-reversed", "1 / depth (near large, far 0)", "reversed depth buffer or disparity",
              "write linear depth: near / value of a reversed buffer, or give --depth reversed,near=DISTANCE",
              lambda d, cosine: 1 / d),
    DepthKind("depth-hyperbolic", "a depth buffer 0..1", "the depth buffer was written as it is",
              "write linear depth: near far / (far - value (far - near)), or give --depth device,near=...,far=...",
              lambda d, cosine: 1 / (1 - d), True),
    DepthKind("depth-reversed", "1 - depth / far (near 1, far 0)", "depth scaled to 0..1 with near white",
              "write depth in scene units: (1 - value) far, or give --depth normalised-reversed,near=0,far=...",
              lambda d, cosine: 1 - d, True),
)


def fit_kinds(frame: Frame) -> dict[DepthKind, Fit]:
    """How well normals agree under each reading that can be tried; empty without normals or enough surfaces."""
    if Role.DEPTH not in frame or Role.NORMAL not in frame:
        return {}
    kinds = [kind for kind in KINDS if not kind.in_unit or _within_one(frame)]
    fits = {kind: _fit(frame, kind) for kind in kinds}
    return {kind: fit for kind, fit in fits.items() if fit}


def _within_one(frame: Frame) -> bool:
    hit = is_hit(frame[Role.DEPTH])
    return bool(hit.any()) and float(frame[Role.DEPTH][hit].max()) <= 1


def _fit(frame: Frame, kind: DepthKind) -> Fit | None:
    if not kind.code:
        return fit_rotation(frame)
    views = (frame.fov_x,) if frame.fov_x else LIKELY_FOV if kind.code == "depth-ray" else (None,)
    fits = [fit_rotation(_reread(frame, kind, view)) for view in views]
    return min(filter(None, fits), key=lambda fit: fit.angle, default=None)


def _reread(frame: Frame, kind: DepthKind, fov_x: float | None) -> Frame:
    depth = frame[Role.DEPTH]
    hit = is_hit(depth)
    cosine = np.ones(())
    if fov_x is not None:
        cosine = 1 / np.linalg.norm(rays(frame, fov_x, *np.indices(hit.shape)), axis=-1)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        planar = kind.planar(np.where(hit, depth[..., 0], 0.5).astype(np.float64), cosine)
    planar = np.where(hit & np.isfinite(planar) & (planar > 0), planar, DEPTH_MISS)
    return replace(frame, planes={Role.DEPTH: planar[..., None].astype(np.float32), Role.NORMAL: frame[Role.NORMAL]},
                   fov_x=fov_x, guides={}, guide_size=None)
