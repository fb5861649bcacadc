"""All checks, in lists. A check looks at the material and yields findings."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from postfx.doctor.checks import geometry, motion, planes
from postfx.doctor.findings import Finding
from postfx.doctor.material import Material

Check = Callable[[Material], Iterator[Finding]]

WHOLE_PLANE_CHECKS: tuple[Check, ...] = (
    planes.uniform,
    planes.misplaced,
    planes.enlarged,
)
"""Planes that are wrong as a whole. What these name is left out of `COMPARING_CHECKS`, which it would only confuse."""

PLANE_CHECKS: tuple[Check, ...] = (
    geometry.depth_misses,
    geometry.depth_kind,
    geometry.normal_encoding,
    geometry.normal_space,
    geometry.normal_mixed,
    geometry.normal_facing,
    geometry.albedo_above_one,
    geometry.albedo_noisy,
    geometry.bright_metal,
    geometry.roughness_range,
    geometry.roughness_kind,
    planes.overlay_alpha,
    planes.overlay_straight,
    planes.alpha_straight,
)
"""Planes of one frame, compared with each other."""

COMPARING_CHECKS: tuple[Check, ...] = (
    motion.motion_variant,
    motion.motion_zero,
    *PLANE_CHECKS,
    geometry.albedo_encoded,
    motion.cut_unmarked,
    motion.reset_always,
    motion.jitter_range,
    motion.jitter_missing,
    motion.samples_repeat,
    planes.reactive_everywhere,
    planes.opaque_samples,
    planes.exposure_mismatch,
    planes.overlay_twice,
)
"""Planes compared with each other, and over frames."""

VALUE_CHECKS: tuple[Check, ...] = (
    planes.not_finite,
    planes.negative,
    planes.out_of_unit_range,
)
"""Values that no plane should hold."""

SEQUENCE_CHECKS: tuple[Check, ...] = (
    planes.unreadable,
    planes.colour_clipped,
    motion.one_frame,
    motion.sizes_change,
    planes.hit_distance_unused,
    planes.missing,
    motion.motion_unread,
    planes.overlay_missing,
)
"""What is there and what is not."""

GUIDE_CHECKS: tuple[Check, ...] = (*VALUE_CHECKS, planes.enlarged, *PLANE_CHECKS)
"""Those that make sense for the guides of a single frame, too."""
