"""Planes of surfaces: albedo and roughness from materials, and the planes of scenes seen in mirrors
and glass.

A denoiser reuses the history where the motion says the same thing was seen before. In a mirror that
thing is the reflected scene, so its planes replace the mirror's: primary surface replacement
(Zimmer et al. 2015, "Path-space Motion Estimation and Decomposition for Robust Animation
Filtering"). Vectors are in world space, last axis 3.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from postfx.frame import ALBEDOS, Role
from postfx.spelling import takes_both_spellings

# Numerators and denominators of the rational fit, rows: powers of alpha, columns: powers of the
# cosine.
_BIAS = ([[0.99044, -1.28514], [1.29678, -0.755907]],
         [[1.0, 2.92338, 59.4188], [20.3225, -27.0302, 222.592], [121.563, 626.13, 316.627]])
_SCALE = ([[0.0365463, 3.32707], [9.0632, -9.04756]],
          [[1.0, 3.59685, -1.36772], [9.04401, -16.3174, 9.22949], [5.56589, 19.7886, -20.2123]])
_POWERS = {"alpha": (0, 1, 3), "bias": (0, 1, 3), "scale": (0, 2, 3)}
NO_SPECULAR = 0.02
"""Below this F0 nothing reflects: real materials begin here, and smaller values mean that specular
is switched off."""


def specular_albedo(f0: np.ndarray, roughness: np.ndarray, cosine: np.ndarray) -> np.ndarray:
    """Specular albedo 0..1, (height, width, 3): how much of a white environment the surface
    reflects to the viewer.

    f0: (height, width, 3) linear Rec.709 reflectance at normal incidence, 0..1, see `f0_of`.
    roughness: (height, width) or (height, width, 1), linear 0..1 (alpha = roughness^2). cosine:
    likewise, between normal and view direction; its sign does not count.

    The split sum f0 * scale + bias for GGX with Smith masking and Schlick's Fresnel, in the
    rational fit of Hirvonen et al. 2019, "Accurate Real-Time Specular Reflections with Radiance
    Caching" (Ray Tracing Gems, chapter 32, equation 4). For roughness and cosine from 0.05 to 1 it
    lies within 0.039 of the integral with separable masking, which was computed from 1.4 million
    directions; the mean error is 0.007. A renderer with height-correlated masking reflects more
    where rough surfaces are seen at grazing angles: up to 0.13 more for cosines from 0.2. It leaves
    out light that bounces between microfacets. f0 below 0.02 fades to no reflection at all.
    """
    f0 = np.asarray(f0, np.float64)
    scale, bias = split_sum(_channel(roughness), np.abs(_channel(cosine)))
    shown = np.clip(f0.max(axis=-1, keepdims=True) / NO_SPECULAR, 0, 1)
    result: np.ndarray = np.clip(f0 * scale + bias * shown, 0, 1)
    return result


def split_sum(roughness: np.ndarray, cosine: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Scale and bias of F0 in `specular_albedo`, from linear roughness and cosine 0..1; all arrays
    of one shape."""
    alpha = roughness**2
    return tuple(np.maximum(_rational(fit, alpha, cosine, _POWERS[name]), 0)
                 for name, fit in (("scale", _SCALE), ("bias", _BIAS)))


@takes_both_spellings
def f0_of(base_colour: np.ndarray, metallic: np.ndarray, ior: float = 1.5) -> np.ndarray:
    """Reflectance at normal incidence (height, width, 3) of the metallic workflow (Burley 2012).

    base_colour: (height, width, 3) linear, 0..1; metallic: (height, width) or (height, width, 1),
    0..1. Metals reflect their base colour, the rest ((ior - 1) / (ior + 1))^2, which is 0.04 for
    1.5.
    """
    metallic = _channel(metallic)
    return (metallic * np.asarray(base_colour, np.float64)
            + (1 - metallic) * ((ior - 1) / (ior + 1)) ** 2)


@takes_both_spellings
def diffuse_albedo(base_colour: np.ndarray, metallic: np.ndarray) -> np.ndarray:
    """Diffuse albedo (height, width, 3): base colour without its metallic part, which reflects
    nothing diffusely."""
    result: np.ndarray = np.asarray(base_colour, np.float64) * (1 - _channel(metallic))
    return result


def roughness_from_smoothness(smoothness: np.ndarray) -> np.ndarray:
    """Roughness 1 - smoothness (also called glossiness), both 0..1."""
    return 1 - np.clip(np.asarray(smoothness, np.float64), 0, 1)


def roughness_from_alpha(alpha: np.ndarray) -> np.ndarray:
    """Roughness from the width alpha = roughness^2 of a microfacet distribution (Burley 2012), both
    0..1.

    Of an anisotropic material give sqrt(alpha_x * alpha_y).
    """
    return np.sqrt(np.clip(np.asarray(alpha, np.float64), 0, 1))


def roughness_from_exponent(exponent: np.ndarray) -> np.ndarray:
    """Roughness from the exponent n >= 0 of a Blinn-Phong lobe: alpha^2 = 2 / (n + 2) (Walter et
    al. 2007)."""
    return (2 / (np.maximum(np.asarray(exponent, np.float64), 0) + 2)) ** 0.25


Matrix = list[list[float]]
"""Factors of a polynomial, by the powers of both variables."""


def _rational(fit: tuple[Matrix, Matrix], alpha: np.ndarray, cosine: np.ndarray,
              powers: tuple[int, ...]) -> np.ndarray:
    result: np.ndarray = _polynomial(fit[0], alpha, cosine, (0, 1), (0, 1)) / _polynomial(
        fit[1], alpha, cosine, _POWERS["alpha"], powers)
    return result


def _polynomial(
    matrix: Matrix, alpha: np.ndarray, cosine: np.ndarray, alphas: tuple[int, ...],
    cosines: tuple[int, ...]
) -> np.ndarray:
    terms = ((matrix[i][j], a, c) for i, a in enumerate(alphas) for j, c in enumerate(cosines))
    result: np.ndarray = sum(factor * alpha**a * cosine**c for factor, a, c in terms)
    return result


def _channel(values: np.ndarray) -> np.ndarray:
    """(height, width) or (height, width, 1) -> (height, width, 1), within 0..1 but for the sign."""
    values = np.clip(np.asarray(values, np.float64), -1, 1)
    return values if values.ndim == 3 else values[..., None]


def mirrored_positions(positions: np.ndarray, mirror: np.ndarray,
                       mirror_normals: np.ndarray) -> np.ndarray:
    """Virtual positions (..., 3): where points at `positions` seem to be, seen in a flat mirror.

    mirror: a point of the mirror, where the view ray hit it; mirror_normals: unit normals there.
    p - 2 ((p - mirror) . n) n. With several mirrors on the way, begin with the last. Their depth is
    `depth_of` of the virtual positions. For a curved mirror it is that of the tangent plane, and
    `unfolded_positions` is steadier.
    """
    positions, normals = np.asarray(positions, np.float64), np.asarray(mirror_normals, np.float64)
    return positions - 2 * _dot(positions - mirror, normals) * normals


def unfolded_positions(eye: np.ndarray, mirror: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Virtual positions (..., 3) on the view ray: as far behind the mirror as the reflected surface
    is from it.

    eye: (3,). For a flat mirror the same as `mirrored_positions`, and defined for any surface.
    """
    mirror = np.asarray(mirror, np.float64)
    ray = mirror - eye
    result: np.ndarray = mirror + ray / _length(ray) * _length(np.asarray(positions, np.float64)
                                                               - mirror)
    return result


def mirrored_normals(normals: np.ndarray, mirror_normals: np.ndarray) -> np.ndarray:
    """Normals (..., 3) of reflected surfaces as the virtual scene behind a mirror has them: n - 2
    (n . m) m."""
    normals = np.asarray(normals, np.float64)
    mirror_normals = np.asarray(mirror_normals, np.float64)
    result: np.ndarray = normals - 2 * _dot(normals, mirror_normals) * mirror_normals
    return result


def fresnel_schlick(f0: np.ndarray | float, cosine: np.ndarray | float) -> np.ndarray:
    """Reflectance 0..1 of a surface by Schlick (1994): f0 + (1 - f0) (1 - cosine)^5; the arguments
    broadcast.

    f0: reflectance at normal incidence, 0..1. cosine: between normal and view direction; its sign
    does not count.
    """
    f0 = np.asarray(f0, np.float64)
    result: np.ndarray = f0 + (1 - f0) * (1 - np.clip(np.abs(cosine), 0, 1)) ** 5
    return result


def fresnel_dielectric(cosine: np.ndarray | float, ior: float = 1.5) -> np.ndarray:
    """Reflectance 0..1 of unpolarised light at a smooth border (Fresnel's equations).

    cosine: between normal and view direction on the side of the viewer; its sign does not count.
    ior: refractive index behind the border over that before it; below 1 there is total reflection
    beyond the critical angle.
    """
    cosine = np.clip(np.abs(np.asarray(cosine, np.float64)), 0, 1)
    inside = 1 - (1 - cosine**2) / ior**2
    total, beyond = inside <= 0, np.sqrt(np.maximum(inside, 0))
    across = (cosine - ior * beyond) / (cosine + ior * beyond)
    along = (ior * cosine - beyond) / (ior * cosine + beyond)
    return np.where(total, 1.0, (across**2 + along**2) / 2)


def glass_weights(cosine: np.ndarray | float, ior: float = 1.5,
                  pane: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """How much of the reflected and of the transmitted surface glass shows; the two add up to 1.

    One border reflects R = `fresnel_dielectric`. A thin pane has two, between which light goes to
    and fro: it reflects 2 R / (1 + R), the sum of R + (1 - R)^2 R (1 + R^2 + R^4 + ...), without
    absorption.
    """
    reflected = fresnel_dielectric(cosine, ior)
    reflected = 2 * reflected / (1 + reflected) if pane else reflected
    return reflected, 1 - reflected


def blend_surfaces(
    weight: np.ndarray, reflected: Mapping[Role, np.ndarray], transmitted: Mapping[Role, np.ndarray]
) -> dict[Role, np.ndarray]:
    """Planes of glass from the planes of its reflection and of the scene behind it.

    weight: (height, width) or (height, width, 1), 0..1, of the reflected surface: `glass_weights`,
    or better the share of the reflected light, if the renderer knows it. Planes are (height, width,
    channels). Albedos are mixed by weight; depth, motion, normal, roughness and the rest are the
    stronger surface's, since one pixel has one motion only. Planes that one of the two does not
    have are left out.
    """
    weight = np.asarray(weight, np.float64).reshape(*np.shape(weight)[:2], 1)
    blended = {}
    for role in (role for role in Role if role in reflected and role in transmitted):
        share = weight if role in ALBEDOS else weight > 0.5
        blended[role] = np.where(share > 0, reflected[role], 0) * share + np.where(
            share < 1, transmitted[role], 0) * (1 - share)
    return blended


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    result: np.ndarray = (a * b).sum(axis=-1, keepdims=True)
    return result


def _length(vectors: np.ndarray) -> np.ndarray:
    result: np.ndarray = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return result
