"""All checks, in two lists. A check looks at the material and yields findings."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from postfx.doctor.checks import (
    depth,
    exposure,
    motion,
    normals,
    overlays,
    planes,
    reactive,
    reflectance,
    shots,
    values,
)
from postfx.doctor.findings import Finding
from postfx.doctor.material import Material

Check = Callable[[Material], Iterator[Finding]]

PLANE_CHECKS: tuple[Check, ...] = (
    values.not_finite,
    values.negative,
    values.out_of_unit_range,
    depth.depth_misses,
    depth.depth_kind,
    normals.normal_encoding,
    normals.normal_space,
    normals.normal_facing,
    reflectance.albedo_above_one,
    reflectance.albedo_noisy,
    reflectance.bright_metal,
    reflectance.roughness_range,
    reflectance.roughness_kind,
    overlays.overlay_alpha,
    overlays.overlay_straight,
)
"""Those that look at planes of one frame: they look at guides, too."""

CHECKS: tuple[Check, ...] = (
    values.unreadable,
    values.colour_clipped,
    motion.motion_variant,
    motion.motion_zero,
    *PLANE_CHECKS,
    shots.one_frame,
    shots.sizes_change,
    shots.cut_unmarked,
    shots.reset_always,
    shots.jitter_missing,
    shots.samples_repeat,
    reactive.reactive_everywhere,
    reactive.opaque_samples,
    exposure.exposure_mismatch,
    planes.hit_distance_unused,
    planes.missing,
    overlays.overlay_twice,
    overlays.overlay_missing,
)
"""All, in the order of their findings where those are of one level."""
