"""All checks, in two lists. A check looks at the material and yields findings."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from postfx.doctor.checks import geometry, motion, planes
from postfx.doctor.findings import Finding
from postfx.doctor.material import Material

Check = Callable[[Material], Iterator[Finding]]

PLANE_CHECKS: tuple[Check, ...] = (
    planes.not_finite,
    planes.negative,
    planes.out_of_unit_range,
    geometry.depth_misses,
    geometry.depth_kind,
    geometry.normal_encoding,
    geometry.normal_space,
    geometry.normal_facing,
    geometry.albedo_above_one,
    geometry.albedo_noisy,
    geometry.bright_metal,
    geometry.roughness_range,
    geometry.roughness_kind,
    planes.overlay_alpha,
    planes.overlay_straight,
)
"""Those that look at planes of one frame: they look at guides, too."""

CHECKS: tuple[Check, ...] = (
    planes.unreadable,
    planes.colour_clipped,
    motion.motion_variant,
    motion.motion_zero,
    *PLANE_CHECKS,
    motion.one_frame,
    motion.sizes_change,
    motion.cut_unmarked,
    motion.reset_always,
    motion.jitter_missing,
    motion.samples_repeat,
    planes.reactive_everywhere,
    planes.opaque_samples,
    planes.exposure_mismatch,
    planes.hit_distance_unused,
    planes.missing,
    planes.overlay_twice,
    planes.overlay_missing,
)
"""All, in the order of their findings where those are of one level."""
