"""Values of planes at other places than their pixels. Positions count pixels, and are whole at pixel centres."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Curve = Callable[[np.ndarray], np.ndarray]


def bilinear(plane: np.ndarray, x: np.ndarray, y: np.ndarray, curve: Curve | None = None) -> np.ndarray:
    """Bilinear values (count, ...) of a plane (height, width, ...) at places x and y (count,); edges are repeated.

    `curve` is applied to the samples before they are mixed: only those that are needed have to be computed.
    """
    height, width = plane.shape[:2]
    x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
    left, top = (np.minimum(at.astype(np.int64), max(side - 2, 0)) for at, side in ((x, width), (y, height)))
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    u, v = (at.astype(plane.dtype).reshape(-1, *[1] * (plane.ndim - 2)) for at in (x - left, y - top))
    flat = plane.reshape(height * width, *plane.shape[2:])

    def near(rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        values = flat.take(rows * width + columns, axis=0)  # quarter of the time of two indices
        return curve(values) if curve else values

    upper = near(top, left) * (1 - u) + near(top, right) * u
    lower = near(bottom, left) * (1 - u) + near(bottom, right) * u
    return upper * (1 - v) + lower * v


def is_inside(plane: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(count,): whether places lie between the outermost pixel centres of a plane (height, width, ...)."""
    height, width = plane.shape[:2]
    return (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)


def motion_at(
    motion: np.ndarray, rows: np.ndarray, columns: np.ndarray, height: int, width: int
) -> np.ndarray:
    """Motion (rows, columns, 2) of those pixels of a picture of height x width, in its pixels.

    motion: (h, w, 2) in its own pixels; that of the pixel in which the picture's pixel centre lies.
    """
    h, w = motion.shape[:2]
    near = ((2 * rows + 1) * h // (2 * height))[:, None], (2 * columns + 1) * w // (2 * width)
    return motion[near] * np.array([width / w, height / h], np.float32)
