"""All checks, in lists. A check looks at the material and yields findings."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from postfx.doctor.checks import geometry, motion, planes
from postfx.doctor.findings import Finding
from postfx.doctor.material import Material

Check = Callable[[Material], Iterator[Finding]]

WHOLE_PLANE_CHECKS: tuple[Check, ...] = (
    planes.check_uniform_planes,
    planes.check_misplaced_planes,
    planes.check_enlarged_planes,
)
"""Find planes that are wrong as a whole. `COMPARING_CHECKS` then leave these planes out, as they would only confuse."""

PLANE_CHECKS: tuple[Check, ...] = (
    geometry.check_depth_misses,
    geometry.check_depth_kind,
    geometry.check_normal_encoding,
    geometry.check_normal_space,
    geometry.check_normal_mixed,
    geometry.check_normal_facing,
    geometry.check_albedo_above_one,
    geometry.check_albedo_noisy,
    geometry.check_bright_metal,
    geometry.check_roughness_range,
    geometry.check_roughness_kind,
    planes.check_overlay_alpha,
    planes.check_overlay_straight,
    planes.check_alpha_straight,
)
"""Compare planes of one frame with each other."""

COMPARING_CHECKS: tuple[Check, ...] = (
    motion.check_motion_variant,
    motion.check_motion_zero,
    *PLANE_CHECKS,
    geometry.check_albedo_encoded,
    motion.check_cut_unmarked,
    motion.check_reset_always,
    motion.check_jitter_range,
    motion.check_jitter_missing,
    motion.check_samples_repeat,
    planes.check_reactive_everywhere,
    planes.check_opaque_samples,
    planes.check_exposure_mismatch,
    planes.check_overlay_twice,
)
"""Compare planes with each other, within a frame and between frames."""

VALUE_CHECKS: tuple[Check, ...] = (
    planes.check_finite_values,
    planes.check_negative_values,
    planes.check_unit_range,
)
"""Find values that no plane should hold."""

SEQUENCE_CHECKS: tuple[Check, ...] = (
    planes.check_readable_frames,
    planes.check_colour_clipped,
    motion.check_frame_count,
    motion.check_frame_sizes,
    planes.check_hit_distance_unused,
    planes.check_missing_planes,
    motion.check_motion_unread,
    planes.check_overlay_missing,
)
"""Find what the sequence lacks, and what stops other checks."""

GUIDE_CHECKS: tuple[Check, ...] = (*VALUE_CHECKS, planes.check_enlarged_planes, *PLANE_CHECKS)
"""Checks that also make sense for the guides of a single frame."""
