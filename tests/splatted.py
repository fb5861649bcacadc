"""Noisy pictures of a renderer that adds each sample to all pixels around it."""

from __future__ import annotations

import numpy as np

CUT_STDDEVS = 4
"""Standard deviations after which the filter is cut, as Mitsuba does."""


def splatted(light: np.ndarray, stddev: float, samples: int = 4, seed: int = 1) -> np.ndarray:
    """Light (height, width, channels) by as many samples a pixel, each with noise of its own at a
    random place in the pixel, weighed by a gaussian pixel filter; float32."""
    random = np.random.default_rng(seed)
    reach = int(np.ceil(CUT_STDDEVS * stddev))
    margin = ((reach, reach), (reach, reach), (0, 0))
    wide = np.pad(light, margin, mode="edge")
    total, weights = np.zeros(wide.shape), np.zeros((*wide.shape[:2], 1))
    for _ in range(samples):
        down, across = random.random((2, *wide.shape[:2], 1)) - 0.5
        sample = wide * random.gamma(0.5, 2.0, (*wide.shape[:2], 1))
        for y in range(-reach, reach + 1):
            for x in range(-reach, reach + 1):
                weight = _gaussian(y - down, stddev) * _gaussian(x - across, stddev)
                total += np.roll(weight * sample, (y, x), (0, 1))
                weights += np.roll(weight, (y, x), (0, 1))
    return (total / weights)[reach:-reach, reach:-reach].astype(np.float32)


def _gaussian(apart: np.ndarray, stddev: float) -> np.ndarray:
    edge = np.exp(-CUT_STDDEVS**2 / 2)
    return np.maximum(np.exp(-np.square(apart / stddev) / 2) - edge, 0)
