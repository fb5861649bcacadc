"""How a camera moves, by points whose motion and depth are known.

A point (x, y, 1) at depth z was at H (x, y, 1) + e / z, where H is the homography of the plane at
infinity and e the epipole (Hartley and Zisserman, Multiple View Geometry, 2nd edition, 13.4).
Positions are around the middle of the picture, in its widths.
"""

from __future__ import annotations

import numpy as np

WEIGHTING_ROUNDS = 8
"""How often points are weighted by how well the fit before explains them."""
LEAST_ERROR_PX = 0.02
"""The error that exact vectors have at least."""
SURE_PX = 0.1
"""Points with a smaller error fit."""


def apply_homography(found: np.ndarray, x: np.ndarray,
                     y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where infinitely far points were in the frame before."""
    a, b, c, d, e, f, g, h = found[:8]
    over = 1 / (g * x + h * y + 1)
    return (a * x + b * y + c) * over, (d * x + e * y + f) * over


def skew_of(found: np.ndarray) -> float:
    """How far a fit is from a turn of the camera, which neither stretches nor shears, beyond what a
    wide turn does."""
    shift = found[2] ** 2 + found[5] ** 2
    return float(max(abs(found[0] - found[4]), abs(found[1] + found[3])) - 2 * shift)


def centre_positions(rows: np.ndarray, columns: np.ndarray, height: float,
                     width: float) -> np.ndarray:
    """Homogeneous positions (count, 3) around the middle of the picture, in widths."""
    x, y = (columns + 0.5 - width / 2) / width, (rows + 0.5 - height / 2) / width
    return np.stack([x, y, np.ones_like(x)], axis=-1)


def camera_equations(now: np.ndarray, before: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Left sides (2 count, 11) for H without its last 1, by rows, and e: first all of x, then all
    of y."""
    none, zero, near = np.zeros_like(now), np.zeros((len(now), 1)), near[:, None]
    x, y = before[:, :1], before[:, 1:]
    return np.concatenate([
        np.concatenate([now, none, -x * now[:, :2], near, zero, -x * near], axis=1),
        np.concatenate([none, now, -y * now[:, :2], zero, near, -y * near], axis=1)])


def fit_camera(now: np.ndarray, before: np.ndarray, near: np.ndarray, pixel: float
                ) -> tuple[np.ndarray, np.ndarray, float, float]:
    """H and e (11,), their covariance, the error of points that fit in pixels, and the share of
    points that do."""
    # a camera at rest, which weak evidence does not change
    start = np.append(np.eye(3).reshape(-1)[:8], np.zeros(3))
    equations = camera_equations(now, before, near)
    right = before.T.reshape(-1) - equations @ start
    weights = np.ones(len(now))
    for _ in range(WEIGHTING_ROUNDS):
        weighted = equations * np.tile(weights, 2)[:, None]
        normal = weighted.T @ equations + 1e-9 * len(now) * np.eye(start.size)
        change = np.linalg.solve(normal, weighted.T @ right)
        errors = np.hypot(*(right - equations @ change).reshape(2, -1)) / pixel
        typical = max(float(np.median(errors)), 0.02)
        weights = (1 + (errors / (3 * typical)) ** 2) ** -2
    fitting = errors < max(5 * typical, SURE_PX)
    error = float(np.sqrt((errors[fitting] ** 2).mean() / 2))
    # large where all surfaces lie in one plane, which tells little of the camera
    covariance = np.linalg.inv(normal) * (max(error, LEAST_ERROR_PX) * pixel) ** 2
    return start + change, covariance, error, float(fitting.mean())
