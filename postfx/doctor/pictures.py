"""One picture for each plane, mapped so that mistakes show: values that are not finite are magenta."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from postfx.colour.displays import srgb_encode
from postfx.colour.views import to_codes
from postfx.doctor import finite
from postfx.doctor.geometry import is_hit
from postfx.errors import WriteError
from postfx.exposure import measure
from postfx.frame import ERROR_ROLES, Frame, Role
from postfx.report.pictures import png, png_uri, shrink

MAGENTA, RED, MISS = (255, 0, 255), (255, 0, 0), (24, 24, 96)
BRIGHTEST = 99  # percentile
SHEET_SIDE = 480
"""Pixels of the longer side of a picture in a contact sheet."""


def write_pictures(frame: Frame, folder: str | Path) -> list[Path]:
    """Write ROLE.png for each plane of a frame and guide_ROLE.png for each guide; returns the paths.

    WriteError when the folder cannot be written.
    """
    folder = Path(folder)
    pictures = {str(role): picture(plane, role) for role, plane in frame.planes.items()}
    pictures |= {f"guide_{role}": picture(plane, role) for role, plane in frame.guides.items()}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return [_write(folder / f"{name}.png", pixels) for name, pixels in pictures.items()]
    except OSError as error:
        raise WriteError(f"{folder}: pictures cannot be written: {error.strerror or error}; give another folder") \
            from error


def picture(plane: np.ndarray, role: Role) -> np.ndarray:
    """(height, width, 3) uint8 of a plane (height, width, C).

    Light is exposed, compressed by x / (1 + x) and sRGB-encoded; reflectance is sRGB-encoded, red above 1; normals are
    (n + 1) / 2; depth is black far away and white near, dark blue at misses; motion has the hue of its direction and
    the brightness of its length; distances, variances and numbers of samples are x / (x + their median); masks and
    roughness are grey.
    """
    shown = _MAPPINGS[role](finite(plane))
    pixels = np.rint(255 * np.clip(shown, 0, 1)).astype(np.uint8)
    pixels = np.repeat(pixels, 3, axis=2) if pixels.shape[2] == 1 else pixels
    if role is Role.DEPTH:
        pixels[~is_hit(plane)] = MISS
    if role in (Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO):
        pixels[(finite(plane) > 1.001).any(2)] = RED
    broken = np.isnan(plane).any(2) if role is Role.DEPTH else ~np.isfinite(plane).all(2)
    pixels[broken] = MAGENTA
    return pixels


def contact_sheet(frame: Frame) -> list[dict[str, Any]]:
    """For each plane and guide its 'name', 'src' (a data URI, at most 480 pixels wide or high) and 'size'."""
    planes = {str(role): _entry(plane, role) for role, plane in frame.planes.items()}
    planes |= {f"guide {role}": _entry(plane, role) for role, plane in frame.guides.items()}
    return [{"name": name, **entry} for name, entry in planes.items()]


def _entry(plane: np.ndarray, role: Role) -> dict[str, Any]:
    pixels = np.rint(shrink(picture(plane, role), SHEET_SIDE)).astype(np.uint8)
    return {"src": png_uri(pixels), "size": plane.shape[1::-1]}


def _write(path: Path, pixels: np.ndarray) -> Path:
    path.write_bytes(png(pixels))
    return path


def _light(plane: np.ndarray) -> np.ndarray:
    colour = np.ascontiguousarray(np.maximum(plane[..., :3], 0), np.float32)
    return to_codes(colour, 2.0 ** (measure(colour) or 0.0))


def _near(plane: np.ndarray) -> np.ndarray:
    hit = is_hit(plane)
    if not hit.any():
        return np.zeros_like(plane)
    inverse = 1 / np.where(hit[..., None], np.maximum(plane, 1e-6), np.inf)
    low, high = np.percentile(inverse[hit], (1, BRIGHTEST))
    result: np.ndarray = 0.08 + 0.92 * (inverse - low) / max(high - low, 1e-12)
    return result


def _direction(plane: np.ndarray) -> np.ndarray:
    """Hue by direction (red right, then clockwise), black where nothing moves."""
    length = np.linalg.norm(plane, axis=2, keepdims=True)
    hue = np.arctan2(plane[..., 1], plane[..., 0])[..., None] / (2 * np.pi) * 6
    colour = np.clip(np.abs((hue + (0, 4, 2)) % 6 - 3) - 1, 0, 1)
    result: np.ndarray = colour * length / max(float(np.percentile(length, BRIGHTEST)), 1e-6)
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
    Role.OPAQUE_COLOUR: _light,
    Role.DIFFUSE_ALBEDO: srgb_encode,
    Role.SPECULAR_ALBEDO: srgb_encode,
    Role.NORMAL: lambda plane: plane / 2 + 0.5,
    Role.DEPTH: _near,
    Role.MOTION: _direction,
    **dict.fromkeys((Role.SPECULAR_HIT_DISTANCE, *ERROR_ROLES), _over_median),
    **{role: lambda plane: plane for role in (Role.ALPHA, Role.ROUGHNESS, Role.STRENGTH, Role.REACTIVE)},
}
