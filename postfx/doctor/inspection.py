"""An inspection of a sequence: the checks that it goes through, and all facts and findings in plain types."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from postfx.doctor import (
    Finding,
    Level,
    Range,
    Values,
    count_values,
    exit_code,
    geometry_checks,
    most_important_first,
    motion_checks,
    noise_level,
    plane_checks,
    range_of,
)
from postfx.doctor.material import Material, Reading, explain_roles, read_material
from postfx.doctor.pictures import write_pictures
from postfx.frame import ERROR_ROLES, ROLES, Frame, Role
from postfx.io.layout import Match
from postfx.io.sequence import Sequence

Check = Callable[[Material], Iterator[Finding]]

WHOLE_PLANE_CHECKS: tuple[Check, ...] = (
    plane_checks.check_uniform_planes,
    plane_checks.check_misplaced_planes,
    plane_checks.check_enlarged_planes,
)
"""Find planes that are wrong as a whole. `COMPARING_CHECKS` then leave these planes out, as they would only confuse."""

PLANE_CHECKS: tuple[Check, ...] = (
    geometry_checks.check_depth_misses,
    geometry_checks.check_depth_kind,
    geometry_checks.check_normal_encoding,
    geometry_checks.check_normal_space,
    geometry_checks.check_normal_mixed,
    geometry_checks.check_normal_facing,
    geometry_checks.check_albedo_above_one,
    geometry_checks.check_albedo_noisy,
    geometry_checks.check_bright_metal,
    geometry_checks.check_roughness_range,
    geometry_checks.check_roughness_kind,
    plane_checks.check_overlay_alpha,
    plane_checks.check_overlay_straight,
    plane_checks.check_alpha_straight,
)
"""Compare planes of one frame with each other."""

COMPARING_CHECKS: tuple[Check, ...] = (
    motion_checks.check_motion_variant,
    motion_checks.check_motion_zero,
    *PLANE_CHECKS,
    geometry_checks.check_albedo_encoded,
    motion_checks.check_cut_unmarked,
    motion_checks.check_reset_always,
    motion_checks.check_jitter_range,
    motion_checks.check_jitter_missing,
    motion_checks.check_samples_repeat,
    plane_checks.check_reactive_everywhere,
    plane_checks.check_opaque_samples,
    plane_checks.check_exposure_mismatch,
    plane_checks.check_overlay_twice,
)
"""Compare planes with each other, within a frame and between frames."""

VALUE_CHECKS: tuple[Check, ...] = (
    plane_checks.check_finite_values,
    plane_checks.check_negative_values,
    plane_checks.check_unit_range,
)
"""Find values that no plane should hold."""

SEQUENCE_CHECKS: tuple[Check, ...] = (
    plane_checks.check_readable_frames,
    plane_checks.check_colour_clipped,
    motion_checks.check_frame_count,
    motion_checks.check_frame_sizes,
    plane_checks.check_hit_distance_unused,
    plane_checks.check_missing_planes,
    motion_checks.check_motion_unread,
    plane_checks.check_overlay_missing,
)
"""Find what the sequence lacks, and what stops other checks."""

GUIDE_CHECKS: tuple[Check, ...] = (*VALUE_CHECKS, plane_checks.check_enlarged_planes, *PLANE_CHECKS)
"""Checks that also make sense for the guides of a single frame."""


def examine(material: Material) -> list[Finding]:
    """Findings of all checks, the most important first; evidence about guides begins with 'guides:'."""
    found = [finding for check in (*SEQUENCE_CHECKS, *VALUE_CHECKS) for finding in check(material)]
    whole = [finding for check in WHOLE_PLANE_CHECKS for finding in check(material)]
    compared = material.without({finding.role for finding in whole})
    found += whole + [finding for check in COMPARING_CHECKS for finding in check(compared)]
    return most_important_first([*found, *_findings_of_guides(material.middle)])


def _findings_of_guides(frame: Frame) -> Iterator[Finding]:
    if not frame.guides:
        return
    guides = Frame(dict(frame.guides), frame.number, frame.guide_jitter, world_to_camera=frame.world_to_camera,
                   fov_x=frame.fov_x, source=frame.guide_source)
    for check in GUIDE_CHECKS:
        for finding in check(Material([guides])):
            if finding.level is not Level.INFO:
                yield replace(finding, evidence=f"guides: {finding.evidence}")


class Inspection:
    """A sequence looked at: facts about its first frame, and findings of a few frames.

    Raises SequenceError, MissingFrameError, MissingPlaneError, GuideError, ReadError, ColourError
    or ProfileError.

    Attributes:
        sequence: what was looked at.
        findings: the most important first.
        exit_code: 0 fine, 1 warnings only, 2 errors.
        pictures: paths of the pictures that were written.
    """

    def __init__(
        self, source: str, frames: str | Iterable[int] | None, profile: str | None, guides: str | None = None,
        depth: str | None = None, colourspace: str | None = None, layer: str | None = None, view: str | None = None,
    ) -> None:
        self.sequence = Sequence(source, frames, profile, guides=guides, depth=depth, colourspace=colourspace,
                                 layer=layer, view=view).first_view()
        self._reading: Reading = read_material(self.sequence)
        self.findings: list[Finding] = examine(self._reading.material)
        self.exit_code = exit_code(self.findings)
        self.pictures: list[str] = []

    @property
    def frames(self) -> list[Frame]:
        """The frames that were looked at, in order, neither clamped nor repaired."""
        return list(self._reading.material.frames)

    def write_pictures(self, folder: str) -> None:
        """Write a picture of every plane and guide of the first frame; WriteError when the folder cannot be written."""
        self.pictures = [str(path) for path in write_pictures(self._reading.material.first, folder)]

    def facts(self) -> dict[str, Any]:
        """Everything in plain types."""
        sequence, layout, material = self.sequence, self._reading.layout, self._reading.material
        frame, spec = material.first, material.first.spec
        return {
            "source": str(sequence.pattern),
            "frames": {"count": len(sequence), "first": sequence.numbers[0], "last": sequence.numbers[-1]},
            "examined": [frame.number for frame in material.frames],
            "measured": material.measured,
            "absent_frames": [number for number in sequence.numbers if number not in sequence.present()],
            "profile": {"name": layout.profile.name, "title": layout.profile.title, "source": layout.profile.source},
            "width": spec.width,
            "height": spec.height,
            "roles": explain_roles(self._reading),
            "findings": [finding.as_dict() for finding in self.findings],
            "planes": [
                _plane(frame[role], role, layout.planes[role], material.stored[role], material.ranges[role])
                for role in spec.roles
            ],
            "guides": _guides(frame, self._reading),
            "missing": [
                {"role": str(role), "fix": material.enable.get(role, "")}
                for role in Role if role not in frame and role not in (*ERROR_ROLES, Role.LATER)
            ],
            "header": _header(frame),
            "warnings": sequence.warnings,
            "pictures": self.pictures,
        }


def _guides(frame: Frame, reading: Reading) -> dict[str, Any] | None:
    if not frame.guides or reading.guides is None or frame.guide_size is None:
        return None
    matches = reading.guides.planes
    held = [(role, frame.guides[role]) for role in frame.spec.guide_roles]
    planes = [_plane(plane, role, matches[role], count_values(plane), range_of(plane, role is Role.DEPTH))
              for role, plane in held]
    jitter = list(frame.guide_jitter) if any(frame.guide_jitter) else None
    width, height = frame.guide_size
    return {"source": frame.guide_source, "width": width, "height": height, "jitter": jitter, "planes": planes}


def _plane(pixels: np.ndarray, role: Role, match: Match, stored: Values, extent: Range) -> dict[str, Any]:
    return {
        "role": str(role),
        "channels": match.names,
        "source": match.rule.source,
        "min": extent.low,
        "max": extent.high,
        "misses": extent.misses,
        "non_finite": stored.nan + stored.infinite,
        "nan": stored.nan,
        "infinite": stored.infinite,
        "negative": stored.negative,
        "noise": noise_level(pixels),
        "unit": ROLES[role].unit,
    }


def _header(frame: Frame) -> dict[str, Any]:
    found = {
        "jitter": list(frame.jitter) if any(frame.jitter) else None,
        "exposure": frame.exposure,
        "samples": frame.samples,
        "reset": frame.reset or None,
        "fov_x": frame.fov_x,
        "world_to_camera": "present" if frame.world_to_camera is not None else None,
    }
    return {name: value for name, value in found.items() if value is not None}
