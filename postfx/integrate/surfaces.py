"""What to write where the first surface only shows another one: mirrors and glass.

A denoiser reuses the history where the motion says the same thing was seen before. In a mirror that thing is the
reflected scene, so its planes replace the mirror's: primary surface replacement (Zimmer et al. 2015, "Path-space
Motion Estimation and Decomposition for Robust Animation Filtering"). Vectors are in world space, last axis 3.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from postfx.frame import Role

MIXED = (Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO)
"""Planes of which the two surfaces of glass are mixed; of the others the stronger surface's value is taken."""


def mirrored_positions(positions: np.ndarray, mirror: np.ndarray, mirror_normals: np.ndarray) -> np.ndarray:
    """Virtual positions (..., 3): where a flat mirror seems to show what is at `positions`.

    mirror: a point of the mirror, where the view ray hit it; mirror_normals: unit normals there.
    p - 2 ((p - mirror) . n) n. With several mirrors on the way, begin with the last. Their depth is `depth_of` of the
    virtual positions. For a curved mirror it is that of the tangent plane, and `unfolded_positions` is steadier.
    """
    positions, normals = np.asarray(positions, np.float64), np.asarray(mirror_normals, np.float64)
    return positions - 2 * _dot(positions - mirror, normals) * normals


def unfolded_positions(eye: np.ndarray, mirror: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Virtual positions (..., 3) on the view ray: as far behind the mirror as the reflected surface is from it.

    eye: (3,). For a flat mirror the same as `mirrored_positions`, and defined for any surface.
    """
    mirror = np.asarray(mirror, np.float64)
    ray = mirror - eye
    result: np.ndarray = mirror + ray / _length(ray) * _length(np.asarray(positions, np.float64) - mirror)
    return result


def mirrored_normals(normals: np.ndarray, mirror_normals: np.ndarray) -> np.ndarray:
    """Normals (..., 3) of reflected surfaces as the virtual scene behind a mirror has them: n - 2 (n . m) m."""
    normals, mirror_normals = np.asarray(normals, np.float64), np.asarray(mirror_normals, np.float64)
    result: np.ndarray = normals - 2 * _dot(normals, mirror_normals) * mirror_normals
    return result


def fresnel_schlick(f0: np.ndarray | float, cosine: np.ndarray | float) -> np.ndarray:
    """Reflectance 0..1 of a surface by Schlick (1994): f0 + (1 - f0) (1 - cosine)^5; the arguments broadcast.

    f0: reflectance at normal incidence, 0..1. cosine: between normal and view direction; its sign does not count.
    """
    f0 = np.asarray(f0, np.float64)
    result: np.ndarray = f0 + (1 - f0) * (1 - np.clip(np.abs(cosine), 0, 1)) ** 5
    return result


def fresnel_dielectric(cosine: np.ndarray | float, ior: float = 1.5) -> np.ndarray:
    """Reflectance 0..1 of unpolarised light at a smooth border (Fresnel's equations).

    cosine: between normal and view direction on the side of the viewer; its sign does not count. ior: refractive index
    behind the border over that before it; below 1 there is total reflection beyond the critical angle.
    """
    cosine = np.clip(np.abs(np.asarray(cosine, np.float64)), 0, 1)
    inside = 1 - (1 - cosine**2) / ior**2
    total, beyond = inside <= 0, np.sqrt(np.maximum(inside, 0))
    across = (cosine - ior * beyond) / (cosine + ior * beyond)
    along = (ior * cosine - beyond) / (ior * cosine + beyond)
    return np.where(total, 1.0, (across**2 + along**2) / 2)


def glass_weights(cosine: np.ndarray | float, ior: float = 1.5, pane: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """How much of the reflected and of the transmitted surface glass shows; the two add up to 1.

    One border reflects R = `fresnel_dielectric`. A thin pane has two, between which light goes to and fro: it
    reflects 2 R / (1 + R), the sum of R + (1 - R)^2 R (1 + R^2 + R^4 + ...), without absorption.
    """
    reflected = fresnel_dielectric(cosine, ior)
    reflected = 2 * reflected / (1 + reflected) if pane else reflected
    return reflected, 1 - reflected


def blend_surfaces(
    weight: np.ndarray, reflected: Mapping[Role, np.ndarray], transmitted: Mapping[Role, np.ndarray]
) -> dict[Role, np.ndarray]:
    """Planes of glass from those of what it reflects and of what is seen through it.

    weight: (height, width) or (height, width, 1), 0..1, of the reflected surface: `glass_weights`, or better the share
    of the reflected light, where the renderer knows it. Planes are (height, width, channels). Albedos are mixed by it;
    depth, motion, normal, roughness and the rest are the stronger surface's, since one pixel has one motion only.
    Planes that one of the two does not have are left out.
    """
    weight = np.asarray(weight, np.float64).reshape(*np.shape(weight)[:2], 1)
    blended = {}
    for role in (role for role in Role if role in reflected and role in transmitted):
        share = weight if role in MIXED else weight > 0.5
        blended[role] = np.where(share > 0, reflected[role], 0) * share + np.where(
            share < 1, transmitted[role], 0) * (1 - share)
    return blended


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    result: np.ndarray = (a * b).sum(axis=-1, keepdims=True)
    return result


def _length(vectors: np.ndarray) -> np.ndarray:
    result: np.ndarray = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return result
