"""Transparency overlays."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from postfx.colour.primaries import luminance
from postfx.doctor.findings import Finding, info, warning
from postfx.doctor.material import Material
from postfx.doctor.statistics import correlation, finite, percent
from postfx.frame import Role
from postfx.sampling import local_mean

LEAST_COVERAGE, LEAST_CHANGE, FEW = 0.02, 0.02, 200
STRAIGHT = 0.3
NARROW, WIDE, TWICE = 2, 16, 0.4


def overlay_alpha(material: Material) -> Iterator[Finding]:
    """Coverage that is none, or that hides everything."""
    if Role.OVERLAY not in material.middle:
        return
    alpha = finite(material.middle[Role.OVERLAY])[..., 3]
    if (share := percent((alpha < -0.001) | (alpha > 1.001))) > 0:
        evidence = f"{share:.3g} % of the pixels outside of 0..1, from {alpha.min():.3g} to {alpha.max():.3g}"
        yield warning(Role.OVERLAY, "overlay-alpha", evidence, "stored in percent or 0..255, or layers that were added",
                      "write coverage 0..1, layers composited over each other; other values are cut off")
    if (share := percent(alpha > 0.999)) > 99:
        yield warning(Role.OVERLAY, "overlay-opaque", f"alpha is 1 at {share:.4g} % of the pixels", "rendered with its "
                      "background", "render the transparents alone, on a transparent background")


def overlay_straight(material: Material) -> Iterator[Finding]:
    """Colour that does not fall with its coverage."""
    if Role.OVERLAY not in material.middle:
        return
    slope, pairs = _slope(finite(material.middle[Role.OVERLAY]))
    if pairs >= FEW and slope < STRAIGHT:
        evidence = (f"where coverage doubles, colour becomes {2**slope:.2f} times as bright, not 2 times ({pairs} "
                    "pairs of neighbours)")
        yield warning(Role.OVERLAY, "overlay-straight", evidence, "colour that is not multiplied by alpha",
                      "write premultiplied colour, or multiply it by alpha; else edges are too bright")


def overlay_twice(material: Material) -> Iterator[Finding]:
    """Colour that holds the overlay already."""
    frame = material.middle
    if not all(role in frame for role in (Role.COLOUR, Role.OVERLAY)):
        return
    overlay, light = finite(frame[Role.OVERLAY]), luminance(finite(frame[Role.COLOUR]))
    change = _detail(luminance(overlay[..., :3]) - overlay[..., 3] * np.median(light))
    used = np.abs(change) > np.percentile(np.abs(change), 80)
    shared = correlation(_detail(np.minimum(light, np.percentile(light, 90)))[used], change[used])
    if used.sum() >= FEW and shared > TWICE:
        yield warning(Role.OVERLAY, "overlay-twice", f"detail of the colour is {shared:.2f} correlated with what the "
                      "overlay changes", "the colour holds the overlay already: it would be there twice",
                      "write the colour before transparents, as colour or beside it as 'opaque', or give --overlay "
                      "ignore")


def overlay_missing(material: Material) -> Iterator[Finding]:
    """Two colours, with and without transparents, and no overlay."""
    frame = material.middle
    colours = (Role.COLOUR, Role.OPAQUE_COLOUR)
    if all(role in frame for role in colours) and Role.OVERLAY not in (*frame.planes, *frame.guides):
        share = percent((frame[Role.COLOUR] != frame[Role.OPAQUE_COLOUR]).any(2))
        evidence = (f"colours with and without transparents differ at {share:.3g} % of the pixels, but there is no "
                    "overlay: the one with them is denoised")
        yield info(Role.OVERLAY, "overlay-missing", evidence, "three differences a pixel do not tell the four channels "
                   "of an overlay", "write the transparents as 'overlay', premultiplied RGBA")


def _slope(overlay: np.ndarray) -> tuple[float, int]:
    """How the logarithm of the light grows with that of the coverage from pixel to pixel, and the pairs that tell: 1 of
    premultiplied colour, 0 of straight one."""
    light, alpha = luminance(np.maximum(overlay[..., :3], 0)), overlay[..., 3]
    used = (alpha > LEAST_COVERAGE) & (light > 1e-4)
    logs = [np.log2(np.where(used, plane, 1)) for plane in (light, alpha)]
    lit, covered = (np.concatenate([np.diff(log, axis=axis).ravel() for axis in (0, 1)]) for log in logs)
    both = np.concatenate([(used[1:] & used[:-1]).ravel(), (used[:, 1:] & used[:, :-1]).ravel()])
    both &= np.abs(covered) > LEAST_CHANGE
    lit, covered = lit[both], covered[both]
    return float(np.median(lit / covered)) if both.any() else 1.0, int(both.sum())


def _detail(plane: np.ndarray) -> np.ndarray:
    """Without what is finer or coarser, of which noise and shading make most."""
    result: np.ndarray = local_mean(plane[..., None], NARROW) - local_mean(plane[..., None], WIDE)
    return result
