"""Depth: misses, sign, and what kind of distance it is."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from postfx.doctor.depths import KINDS, DepthKind, fit_kinds
from postfx.doctor.findings import Finding, error, info, warning
from postfx.doctor.geometry import Fit, fit_rotation, is_hit, is_unsigned
from postfx.doctor.material import Material
from postfx.doctor.statistics import percent
from postfx.frame import DEPTH_MISS, Role

CLEARLY_OFF, WELL = 1.5, 5.0  # degrees between the normals of depth and the stored ones
MUCH_BETTER = 0.4
FAR_AWAY = 50.0
ANY_FOV = tuple(range(20, 122, 2))


def depth_misses(material: Material) -> Iterator[Finding]:
    """Misses marked with something else than 1e10, and negative depth."""
    if Role.DEPTH not in material.middle:
        return
    depth = np.nan_to_num(material.middle[Role.DEPTH][..., 0], nan=DEPTH_MISS)
    below = depth < 0
    if percent(below) > 0.1:
        evidence = f"{percent(below):.3g} % of the pixels negative, least {depth.min():.4g}"
        yield error(Role.DEPTH, "depth-negative", evidence, "camera space that looks along -z, or -1 for misses",
                    "negate it; misses are 1e10 (in a profile scale = [-1], miss = VALUE)")
    share = percent(depth == 0)
    if share > 0.1:
        yield warning(Role.DEPTH, "depth-miss-zero", f"{share:.3g} % of the pixels exactly 0", "misses stored as 0",
                    "store 1e10 where nothing was hit, or give --depth planar,miss=0 (in a profile miss = 0.0)")
    hit = depth[is_hit(depth[..., None])]
    if hit.size < 100:
        return
    largest = float(hit.max())
    same = hit == largest
    others = hit[~same]
    if others.size and percent(same) > 0.5 and largest > FAR_AWAY * np.percentile(others, 95):
        evidence = f"{percent(same):.3g} % of the hits are exactly {largest:.6g}, the others below {others.max():.4g}"
        yield warning(Role.DEPTH, "depth-miss-far", evidence, "misses stored as the far plane or the largest half "
                      "float", f"store 1e10 where nothing was hit, or in a profile miss = {largest:.6g}")


def depth_kind(material: Material) -> Iterator[Finding]:
    """Ray distance, reversed or buffer depth, and a wrong field of view, by the normals that follow from depth."""
    frame = material.middle
    if Role.DEPTH not in frame or is_unsigned(frame):
        return
    fits = fit_kinds(frame)
    if KINDS[0] not in fits:
        yield info(Role.DEPTH, "depth-untested", "whether depth is planar, ray distance or reversed cannot be told",
                   "it needs normals and some hundred pixels of smooth surfaces", "look at its picture (--pictures)")
        return
    stored = fits[KINDS[0]].angle
    kind = min(fits, key=lambda kind: fits[kind].angle)
    other = fit_rotation(frame, ANY_FOV) if frame.fov_x and stored >= CLEARLY_OFF else None
    best = min(filter(None, (fits[kind], other)), key=lambda fit: fit.angle)
    if stored < CLEARLY_OFF or best.angle >= min(MUCH_BETTER * stored, WELL):
        return
    if best is other:
        yield warning("sequence", "fov-mismatch", _facing(best, stored) + f"; the header says {frame.fov_x:.4g}",
                      "vertical field of view, or another camera's", "write the horizontal field of view in degrees to "
                      "postfx:fovX")
    else:
        yield error(Role.DEPTH, kind.code, _facing(best, stored, kind), kind.cause, kind.mend)


def _facing(fit: Fit, stored: float, kind: DepthKind = KINDS[0]) -> str:
    return (f"surfaces face within {fit.angle:.2g} degrees of their normals if depth is {kind.name} and the field of "
            f"view {fit.fov_x:.4g} degrees; {stored:.3g} degrees as it is")
