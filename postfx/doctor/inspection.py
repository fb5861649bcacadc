"""An inspection of a sequence: the checks that it goes through, all facts and findings in plain
types, and one picture for each plane, mapped so that mistakes show.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from postfx.colour.displays import srgb_encode
from postfx.colour.views import to_codes
from postfx.doctor import (
    Finding,
    Level,
    Range,
    Values,
    count_values,
    exit_code,
    finite,
    geometry_checks,
    most_important_first,
    motion_checks,
    noise_checks,
    noise_level,
    plane_checks,
    range_of,
)
from postfx.doctor.geometry import is_hit
from postfx.doctor.material import Material, Reading, explain_roles, read_material
from postfx.errors import WriteError
from postfx.exposure import measure
from postfx.files import write_atomically
from postfx.frame import ALBEDOS, ERROR_ROLES, ROLES, Frame, Role
from postfx.io.layout import Match
from postfx.io.sequence import read_sequence
from postfx.thumbnails import png, png_uri, shrink

Check = Callable[[Material], Iterator[Finding]]

WHOLE_PLANE_CHECKS: tuple[Check, ...] = (
    plane_checks.check_uniform_planes,
    plane_checks.check_misplaced_planes,
    plane_checks.check_enlarged_planes,
)
"""Find planes that are wrong as a whole. `COMPARING_CHECKS` then leave these planes out, as they
would only confuse."""

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
    motion_checks.check_motion_coded,
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
    plane_checks.check_light_outside,
    plane_checks.check_unit_range,
)
"""Find values that no plane should hold."""

SEQUENCE_CHECKS: tuple[Check, ...] = (
    plane_checks.check_readable_frames,
    plane_checks.check_colour_clipped,
    noise_checks.check_pixel_filter,
    motion_checks.check_frame_count,
    motion_checks.check_frame_sizes,
    plane_checks.check_in_all_frames,
    plane_checks.check_hit_distance_unused,
    plane_checks.check_missing_planes,
    motion_checks.check_motion_unread,
    plane_checks.check_overlay_missing,
)
"""Find what the sequence lacks, and what stops other checks."""

GUIDE_CHECKS: tuple[Check, ...] = (*VALUE_CHECKS, plane_checks.check_enlarged_planes, *PLANE_CHECKS)
"""Checks that also make sense for the guides of a single frame."""


def examine(material: Material) -> list[Finding]:
    """Findings of all checks, the most important first; evidence about guides begins with
    'guides:'."""
    found = [finding for check in (*SEQUENCE_CHECKS, *VALUE_CHECKS) for finding in check(material)]
    whole = [finding for check in WHOLE_PLANE_CHECKS for finding in check(material)]
    compared = material.without({finding.role for finding in whole})
    found += whole + [finding for check in COMPARING_CHECKS for finding in check(compared)]
    return most_important_first([*found, *_findings_of_guides(material.middle)])


def _findings_of_guides(frame: Frame) -> Iterator[Finding]:
    if not frame.guides:
        return
    guides = Frame(dict(frame.guides), frame.number, frame.guide_jitter,
                   world_to_camera=frame.world_to_camera,
                   fov_x=frame.fov_x, source=frame.guide_source)
    for check in GUIDE_CHECKS:
        for finding in check(Material([guides])):
            if finding.level is not Level.INFO:
                yield replace(finding, evidence=f"guides: {finding.evidence}")


MADE_OR_RARE = (Role.LATER, Role.PARTNER, Role.DENOISING_ALBEDO, Role.DENOISING_NORMAL, Role.ERROR)
"""Planes that passes make, or that few can do with: nobody misses them."""


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
        self, source: str, frames: str | Iterable[int] | None, profile: str | None,
        guides: str | None = None, depth: str | None = None, colourspace: str | None = None,
        layer: str | None = None, view: str | None = None,
    ) -> None:
        self.sequence = read_sequence(source, frames, profile, guides=guides, depth=depth,
                                      colourspace=colourspace, layer=layer, view=view).first_view()
        self._reading: Reading = read_material(self.sequence)
        self.findings: list[Finding] = examine(self._reading.material)
        self.exit_code = exit_code(self.findings)
        self.pictures: list[str] = []

    @property
    def frames(self) -> list[Frame]:
        """The frames that were looked at, in order, neither clamped nor repaired."""
        return list(self._reading.material.frames)

    def write_pictures(self, folder: str) -> None:
        """Write a picture of every plane and guide of the first frame; WriteError when the folder
        cannot be written."""
        self.pictures = [str(path) for path in write_pictures(self._reading.material.first, folder)]

    def facts(self) -> dict[str, Any]:
        """Everything in plain types."""
        sequence, layout, material = self.sequence, self._reading.layout, self._reading.material
        frame, spec = material.first, material.first.spec
        return {
            "source": str(sequence.pattern),
            "frames": {"count": len(sequence), "first": sequence.numbers[0],
                       "last": sequence.numbers[-1]},
            "examined": [frame.number for frame in material.frames],
            "measured": material.measured,
            "absent_frames": [number
                              for number in sequence.numbers if number not in sequence.present()],
            "profile": {"name": layout.profile.name, "title": layout.profile.title,
                        "source": layout.profile.source},
            "width": spec.width,
            "height": spec.height,
            "roles": explain_roles(self._reading),
            "findings": [finding.as_dict() for finding in self.findings],
            "planes": [
                _plane(frame[role], role, layout.planes[role], material.stored[role],
                       material.ranges[role])
                for role in spec.roles
            ],
            "guides": _guides(frame, self._reading),
            "missing": [
                {"role": str(role), "fix": material.enable.get(role, "")}
                for role in Role if role not in frame and role not in (*ERROR_ROLES, *MADE_OR_RARE)
            ],
            "unread": material.other_layers,
            "header": _header(frame),
            "warnings": sequence.warnings,
            "pictures": self.pictures,
        }


def _guides(frame: Frame, reading: Reading) -> dict[str, Any] | None:
    if not frame.guides or reading.guides is None or frame.guide_size is None:
        return None
    matches = reading.guides.planes
    held = [(role, frame.guides[role]) for role in frame.spec.guide_roles]
    planes = [_plane(plane, role, matches[role], count_values(plane),
                     range_of(plane, role is Role.DEPTH))
              for role, plane in held]
    jitter = list(frame.guide_jitter) if any(frame.guide_jitter) else None
    width, height = frame.guide_size
    return {"source": frame.guide_source, "width": width, "height": height, "jitter": jitter,
            "planes": planes}


def _plane(pixels: np.ndarray, role: Role, match: Match, stored: Values,
           extent: Range) -> dict[str, Any]:
    """Facts of a plane in plain types. extent: its range."""
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


# One picture for each plane: values that are not finite are magenta.

MAGENTA_RGB = (255, 0, 255)
RED_RGB = (255, 0, 0)
MISS_RGB = (24, 24, 96)
BRIGHTEST_PERCENTILE = 99  # percentile
SHEET_SIDE = 480
"""Pixels of the longer side of a picture in a contact sheet."""


def write_pictures(frame: Frame, folder: str | Path) -> list[Path]:
    """Write ROLE.png for each plane of a frame and guide_ROLE.png for each guide; returns the
    paths.

    WriteError when the folder cannot be written.
    """
    folder = Path(folder)
    pictures = {str(role): picture(plane, role) for role, plane in frame.planes.items()}
    pictures |= {f"guide_{role}": picture(plane, role) for role, plane in frame.guides.items()}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return [_write(folder / f"{name}.png", pixels) for name, pixels in pictures.items()]
    except OSError as error:
        raise WriteError(f"{folder}: pictures cannot be written: {error.strerror or error}; give "
                         "another folder") from error


def picture(plane: np.ndarray, role: Role) -> np.ndarray:
    """(height, width, 3) uint8 of a plane (height, width, C).

    Light is exposed, compressed by x / (1 + x) and sRGB-encoded; reflectance is sRGB-encoded, red
    above 1; normals are (n + 1) / 2; depth is black far away and white near, dark blue at misses;
    motion has the hue of its direction and the brightness of its length; distances, variances and
    numbers of samples are x / (x + their median); masks and roughness are grey.
    """
    shown = _MAPPINGS[role](finite(plane))
    pixels = np.rint(255 * np.clip(shown, 0, 1)).astype(np.uint8)
    pixels = np.repeat(pixels, 3, axis=2) if pixels.shape[2] == 1 else pixels
    if role is Role.DEPTH:
        pixels[~is_hit(plane)] = MISS_RGB
    if role in ALBEDOS:
        pixels[(finite(plane) > 1.001).any(2)] = RED_RGB
    broken = np.isnan(plane).any(2) if role is Role.DEPTH else ~np.isfinite(plane).all(2)
    pixels[broken] = MAGENTA_RGB
    return pixels


def contact_sheet(frame: Frame) -> list[dict[str, Any]]:
    """For each plane and guide its 'name', 'src' (a data URI, at most 480 pixels wide or high) and
    'size'."""
    planes = {str(role): _entry(plane, role) for role, plane in frame.planes.items()}
    planes |= {f"guide {role}": _entry(plane, role) for role, plane in frame.guides.items()}
    return [{"name": name, **entry} for name, entry in planes.items()]


def _entry(plane: np.ndarray, role: Role) -> dict[str, Any]:
    pixels = np.rint(shrink(picture(plane, role), SHEET_SIDE)).astype(np.uint8)
    return {"src": png_uri(pixels), "size": plane.shape[1::-1]}


def _write(path: Path, pixels: np.ndarray) -> Path:
    write_atomically(path, lambda file: file.write(png(pixels)), durable=True)
    return path


def _light(plane: np.ndarray) -> np.ndarray:
    colour = np.ascontiguousarray(np.maximum(plane[..., :3], 0), np.float32)
    return to_codes(colour, 2.0 ** (measure(colour) or 0.0))


def _near(plane: np.ndarray) -> np.ndarray:
    hit = is_hit(plane)
    if not hit.any():
        return np.zeros_like(plane)
    inverse = 1 / np.where(hit[..., None], np.maximum(plane, 1e-6), np.inf)
    low, high = np.percentile(inverse[hit], (1, BRIGHTEST_PERCENTILE))
    result: np.ndarray = 0.08 + 0.92 * (inverse - low) / max(high - low, 1e-12)
    return result


def _direction(plane: np.ndarray) -> np.ndarray:
    """Hue by direction (red right, then clockwise), black where nothing moves."""
    length = np.linalg.norm(plane, axis=2, keepdims=True)
    hue = np.arctan2(plane[..., 1], plane[..., 0])[..., None] / (2 * np.pi) * 6
    colour = np.clip(np.abs((hue + (0, 4, 2)) % 6 - 3) - 1, 0, 1)
    result: np.ndarray = colour * length / max(float(np.percentile(length, BRIGHTEST_PERCENTILE)),
                                               1e-6)
    return result


def _over_median(plane: np.ndarray) -> np.ndarray:
    used = plane[plane > 0]
    middle = float(np.median(used)) if used.size else 1.0
    result: np.ndarray = np.maximum(plane, 0) / (np.maximum(plane, 0) + middle)
    return result


_MAPPINGS: Mapping[Role, Callable[[np.ndarray], np.ndarray]] = {
    Role.COLOUR: _light,
    Role.OVERLAY: _light,
    Role.LATER: _light,
    Role.PARTNER: _light,
    Role.DENOISING_ALBEDO: srgb_encode,
    Role.OPAQUE_COLOUR: _light,
    Role.DIFFUSE_ALBEDO: srgb_encode,
    Role.SPECULAR_ALBEDO: srgb_encode,
    **dict.fromkeys((Role.NORMAL, Role.DENOISING_NORMAL), lambda plane: plane / 2 + 0.5),
    Role.DEPTH: _near,
    Role.MOTION: _direction,
    **dict.fromkeys((Role.SPECULAR_HIT_DISTANCE, *ERROR_ROLES), _over_median),
    **{role: lambda plane: plane
       for role in (Role.ALPHA, Role.ROUGHNESS, Role.STRENGTH, Role.REACTIVE, Role.ERROR)},
}
