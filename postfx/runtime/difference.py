"""How much two arrays differ."""

from __future__ import annotations

import numpy as np

_BLOCK = 1 << 20


def largest_error(a: np.ndarray, b: np.ndarray) -> tuple[float, tuple[int, ...]]:
    """The largest relative error of `a` against the reference `b`, and its index.

    An element's is |a - b| / max(|b|, mean of |b|): elements near 0 are measured by the array's usual size. NaN equals
    NaN and an infinity one of its sign; finite against not finite is an infinite error. Works on blocks, so it takes
    little memory.
    """
    left, right = a.reshape(-1), b.reshape(-1)
    usual = _mean_size(right)
    worst, place = 0.0, 0
    for start in range(0, left.size, _BLOCK):
        errors = _errors(left[start : start + _BLOCK], right[start : start + _BLOCK], usual)
        at = int(errors.argmax())
        if errors[at] > worst:
            worst, place = float(errors[at]), start + at
    return worst, tuple(int(i) for i in np.unravel_index(place, a.shape))


def _errors(a: np.ndarray, b: np.ndarray, usual: float) -> np.ndarray:
    a, b = a.astype(np.float64), b.astype(np.float64)
    same = (a == b) | (np.isnan(a) & np.isnan(b))
    with np.errstate(invalid="ignore", divide="ignore"):
        errors = np.abs(a - b) / np.maximum(np.abs(b), usual)
    return np.where(same, 0.0, np.where(np.isfinite(a) & np.isfinite(b), errors, np.inf))


def _mean_size(values: np.ndarray) -> float:
    total, count = 0.0, 0
    for start in range(0, values.size, _BLOCK):
        block = np.abs(values[start : start + _BLOCK].astype(np.float64))
        kept = block[np.isfinite(block)]
        total, count = total + float(kept.sum()), count + kept.size
    return total / count if count else 0.0
