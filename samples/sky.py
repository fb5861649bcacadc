"""A daylight sky, a small scene under it, and its irradiance by Monte Carlo: shared by the samples
of small networks.

The sky is the analytic one of Preetham, Shirley and Smits (1999), without the sun's disc, in
Rec.709; below the horizon it is mirrored and darker. Directions are unit vectors (x, y, z) with y
up.
"""
from pathlib import Path

import numpy as np

from postfx.compiled.library import Rows
from postfx.kernels import Kernel

_PEREZ = np.array([  # slope and offset by turbidity of A to E, for Y, x and y
    [[0.1787, -1.4630], [-0.3554, 0.4275], [-0.0227, 5.3251], [0.1206, -2.5771], [-0.0670, 0.3703]],
    [[-0.0193, -0.2592], [-0.0665, 0.0008], [-0.0004, 0.2125], [-0.0641, -0.8989],
     [-0.0033, 0.0452]],
    [[-0.0167, -0.2608], [-0.0950, 0.0092], [-0.0079, 0.2102], [-0.0441, -1.6537],
     [-0.0109, 0.0529]]])
_ZENITH = np.array([
    [[0.00166, -0.00375, 0.00209, 0], [-0.02903, 0.06377, -0.03202, 0.00394],
     [0.11693, -0.21196, 0.06052, 0.25886]],
    [[0.00275, -0.00610, 0.00317, 0], [-0.04214, 0.08970, -0.04153, 0.00516],
     [0.15346, -0.26756, 0.06670, 0.26688]]])
TURBIDITY = 3.0
HEADER = Path(__file__).with_suffix(".h")


def sun_at(elevation: float, azimuth: float) -> np.ndarray:
    """Direction of a sun, angles in degrees."""
    up, round_ = np.radians([elevation, azimuth])
    return np.array([np.cos(up) * np.sin(round_), np.sin(up), np.cos(up) * np.cos(round_)])


def sky_of(sun: np.ndarray) -> np.ndarray:
    """The kernels' argument for a sun: A to E and the scale of Y, x and y, then the sun's
    direction: (21,)."""
    t, angle = TURBIDITY, np.arccos(sun[1])
    perez = _PEREZ @ [t, 1]
    wide = (4 / 9 - t / 120) * (np.pi - 2 * angle)
    zenith = [(4.0453 * t - 4.9710) * np.tan(wide) - 0.2155 * t + 2.4192,
              *(np.array([t * t, t, 1]) @ _ZENITH @ np.array([angle**3, angle**2, angle, 1]))]
    a, b, c, d, e = perez.T
    at_zenith = (1 + a * np.exp(b)) * (1 + c * np.exp(d * angle) + e * np.cos(angle) ** 2)
    return (np.concatenate([np.column_stack([perez, zenith / at_zenith]).ravel(), sun])
            .astype(np.float32))


SKY = Kernel("sample_sky", ("sky", "directions"), ("logs",), Rows("sample_sky", HEADER),
             ("logs", 0), {"sky": (21,), "directions": ("points", 3), "logs": ("points", 3)})
"""log(1 + colour) of the sky in directions."""
IRRADIANCE = Kernel("sample_irradiance", ("sky", "normals", "params"), ("logs",),
                    Rows("sample_irradiance", HEADER), ("logs", 0),
                    {"sky": (21,), "normals": ("points", 3), "params": (2,), "logs": ("points", 3)})
"""log(irradiance) by cosine-weighted samples, `params` = (samples, seed); a normal of length 0 is
empty: NaN."""


def sphere_directions(count: int) -> np.ndarray:
    """Evenly spread directions (count, 3)."""
    k = np.arange(count) + 0.5
    y, angle = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    radius = np.sqrt(1 - y * y)
    return np.column_stack([radius * np.cos(angle), y, radius * np.sin(angle)]).astype(np.float32)


def scene(width: int, height: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rays, normals (0 at misses) and albedo of five balls on a plain: each (height, width, 3)."""
    x, y = np.meshgrid((np.arange(width) + 0.5) / width * 2 - 1,
                       1 - (np.arange(height) + 0.5) / height * 2)
    rays = np.stack([x, y * height / width - 0.1, np.full_like(x, 1.4)], -1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    origin = np.array([0, 1.0, -4])
    distance = np.where(rays[..., 1] < -0.02, -origin[1] / np.minimum(rays[..., 1], -1e-6), np.inf)
    normals, albedo = np.zeros_like(rays), np.zeros_like(rays)
    normals[np.isfinite(distance)], albedo[np.isfinite(distance)] = (0, 1, 0), (0.35, 0.32, 0.28)
    colours = ((0.8, 0.2, 0.15), (0.8, 0.8, 0.8), (0.15, 0.35, 0.7), (0.2, 0.6, 0.25),
               (0.8, 0.6, 0.2))
    for k, colour in enumerate(colours):
        ball = np.array([1.3 * (k - 2), 0.5 + 0.2 * (k % 2), 0.8 * (k % 2)])
        radius = 0.5 + 0.2 * (k % 2)
        along = rays @ (ball - origin)
        inside = along**2 - ((ball - origin) ** 2).sum() + radius**2
        hit = along - np.sqrt(np.maximum(inside, 0))
        nearer = (inside > 0) & (hit < distance)
        distance[nearer], albedo[nearer] = hit[nearer], colour
        normals[nearer] = ((origin + rays * hit[..., None] - ball) / radius)[nearer]
    return rays.astype(np.float32), normals.astype(np.float32), albedo.astype(np.float32)


def rel_mse(found: np.ndarray, wanted: np.ndarray) -> float:
    """Relative mean squared error of colours."""
    return float(np.mean((found - wanted) ** 2 / (wanted**2 + 1e-2)))


def shown(light: np.ndarray) -> np.ndarray:
    """Light as codes 0..1: x/(1+x) and the sRGB curve."""
    x = light / (1 + light)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-9) ** (1 / 2.4) - 0.055)


def cleaned(light: np.ndarray) -> np.ndarray:
    """A reference (H, W, 3) without the rest of its noise."""
    import pyoidn

    return pyoidn.denoise(np.ascontiguousarray(light, np.float32), hdr=True, quality="high")
