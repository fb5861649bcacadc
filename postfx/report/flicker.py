"""How much a picture changes from frame to frame along its motion."""

from __future__ import annotations

import math

import numpy as np

from postfx.sampling import Curve, bilinear, is_inside, motion_at

MOST_POINTS, LEAST_POINTS = 40_000, 100
CALMEST = 0.8


def change(before: np.ndarray, now: np.ndarray, motion: np.ndarray, curve: Curve) -> float | None:
    """1000 times the mean absolute difference to the frame before, followed by the motion: what does not hold still.

    before, now: light (height, width, 3), `curve` makes code values 0..1 of it; motion: (h, w, 2) in its own pixels. Of
    an even grid of up to 40000 pixels the calmest 80 % count, which leaves out what was hidden before; so do not those
    that come from outside. None where too few pixels are left, or the sizes differ. Moving reflections and shadows
    count, so a clean picture is not at 0: compare pictures of the same frames.
    """
    height, width = now.shape[:2]
    if before.shape != now.shape:
        return None
    step = max(1, math.ceil(math.sqrt(height * width / MOST_POINTS)))
    rows, columns = np.arange(step // 2, height, step), np.arange(step // 2, width, step)
    moved = motion_at(motion, rows, columns, height, width)
    x, y = (columns + moved[..., 0]).ravel(), (rows[:, None] + moved[..., 1]).ravel()
    inside = is_inside(before, x, y)
    if inside.sum() < LEAST_POINTS:
        return None
    current = curve(now[rows[:, None], columns]).reshape(-1, 3)[inside]
    differences = np.abs(current - bilinear(before, x[inside], y[inside], curve)).mean(1)
    return float(1000 * np.sort(differences)[: int(CALMEST * differences.size)].mean())
