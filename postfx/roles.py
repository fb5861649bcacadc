"""What planes mean: their roles, and the one convention of each."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import NamedTuple


class Role(StrEnum):
    """What a plane means. `ROLES` holds channels, unit, space, range and direction of each."""

    COLOUR = "colour"
    ALPHA = "alpha"
    DEPTH = "depth"
    MOTION = "motion"
    NORMAL = "normal"
    DIFFUSE_ALBEDO = "diffuse_albedo"
    SPECULAR_ALBEDO = "specular_albedo"
    ROUGHNESS = "roughness"
    SPECULAR_HIT_DISTANCE = "specular_hit_distance"
    STRENGTH = "strength"
    REACTIVE = "reactive"
    OPAQUE_COLOUR = "opaque_colour"
    OVERLAY = "overlay"
    LATER = "later"
    VARIANCE_OF_MEAN = "variance_of_mean"
    SAMPLE_VARIANCE = "sample_variance"
    SECOND_MOMENT = "second_moment"
    SAMPLE_COUNT = "sample_count"


class RoleInfo(NamedTuple):
    """Convention of one role: channel count, unit, space, range and direction."""

    channels: int
    unit: str
    space: str
    range: str
    direction: str


_REFLECTANCE = "linear Rec.709"
_COLOUR = "that of the colour"

ROLES: Mapping[Role, RoleInfo] = {
    Role.COLOUR: RoleInfo(3, "radiance", "scene-linear Rec.709", "0..inf", "none; premultiplied by alpha"),
    Role.ALPHA: RoleInfo(1, "coverage", "none", "0..1", "0 transparent, 1 opaque"),
    Role.DEPTH: RoleInfo(1, "scene units", "camera", "0..1e10", "along the view axis, away from the camera; miss 1e10"),
    Role.MOTION: RoleInfo(2, "pixels of this frame", "image", "any", "previous - current; x right, y down; no jitter"),
    Role.NORMAL: RoleInfo(3, "none", "world", "-1..1", "facing the viewer; unit length not forced, zero at misses"),
    Role.DIFFUSE_ALBEDO: RoleInfo(3, "reflectance", _REFLECTANCE, "0..1", "none"),
    Role.SPECULAR_ALBEDO: RoleInfo(3, "reflectance", _REFLECTANCE, "0..1", "Fresnel towards the viewer"),
    Role.ROUGHNESS: RoleInfo(1, "none", "linear (not squared)", "0..1", "0 mirror, 1 rough"),
    Role.SPECULAR_HIT_DISTANCE: RoleInfo(1, "scene units", "world", "0..inf", "primary surface to the reflected hit"),
    Role.STRENGTH: RoleInfo(1, "none", "none", "0..1", "0 leave as it is, 1 denoise fully"),
    Role.REACTIVE: RoleInfo(1, "none", "none", "0..1", "0 use the history, 1 ignore it"),
    Role.OPAQUE_COLOUR: RoleInfo(3, "radiance", "scene-linear Rec.709", "0..inf", "colour before transparency"),
    Role.OVERLAY: RoleInfo(4, "radiance and coverage", "scene-linear Rec.709", "0..inf", "RGBA, premultiplied"),
    Role.LATER: RoleInfo(4, "radiance and weight", "scene-linear Rec.709", "0..inf", "RGBA, times weight"),
    Role.VARIANCE_OF_MEAN: RoleInfo(3, "radiance squared", _COLOUR, "0..inf", "squared standard error of the pixel"),
    Role.SAMPLE_VARIANCE: RoleInfo(3, "radiance squared", _COLOUR, "0..inf", "of a pixel's samples"),
    Role.SECOND_MOMENT: RoleInfo(3, "radiance squared", _COLOUR, "0..inf", "mean of a pixel's squared samples"),
    Role.SAMPLE_COUNT: RoleInfo(1, "samples a pixel", "none", "0..inf", "or shares, 0..1, of the header's number"),
}

VARIANCES = (Role.SAMPLE_VARIANCE, Role.SECOND_MOMENT, Role.VARIANCE_OF_MEAN)
"""Planes that tell a pixel's error; the first that is there counts."""
ERROR_ROLES = (*VARIANCES, Role.SAMPLE_COUNT)
"""Planes that tell how far a render has converged. They are only looked at when that is asked for, so nothing misses
them."""
