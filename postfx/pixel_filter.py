"""Whether a renderer's pixel filter spread the noise of a picture over several pixels.

A gaussian filter that adds each sample to all pixels around it does. Noise then looks like detail,
and only networks that were trained with such noise remove it.
"""

from __future__ import annotations

import numpy as np

from postfx.sampling import local_mean

NOISE_WINDOW_PX = 640, 360
"""Most columns and rows, in the middle of the picture, that are looked at."""
BRIGHTNESS_REACH_PX = 4
"""Pixels to each side whose mean light tells how bright a pixel is."""
NOISE_CELL_PX = 16
"""Side of the cells whose noise is compared."""
LEAST_NOISE = 0.0036
"""Mean square of diagonal differences in cells that count, of light against that around; 3 %."""
LEAST_NOISY_CELLS = 8
"""Noisy cells without which nothing is said."""
INDEPENDENT_QUANTILE = 0.95
"""Quantile of the cells by how independent the noise of their pixels is: detail, which others may
hold, looks spread, too."""
MOST_SPREAD_RATIO = 0.65
"""Ratio of diagonal to straight differences there up to which noise is spread: a gaussian filter of
half a pixel makes 0.5 to 0.65. Independent noise has 1 and more, and 0.66 where a render of 16
samples has the most detail."""
LEAST_BRIGHTNESS = 1e-5
"""Light around a pixel is taken as at least this much."""
MOST_BRIGHTNESS = 1e9
"""Light above this is taken as this much, so that sums stay finite."""
MOST_NOISY_SAMPLES = 32
"""Known samples a pixel beyond which detail is more than noise, and looks spread."""


def spread_ratio(colour: np.ndarray, samples: float | None) -> float | None:
    """The `independence` of a picture's noise if a filter spread it, else None.

    Args:
        colour: (height, width, 3), light.
        samples: a pixel, if that is known.
    """
    if (samples or 0) > MOST_NOISY_SAMPLES:
        return None
    found = independence(colour)
    return found if found is not None and found <= MOST_SPREAD_RATIO else None


def independence(colour: np.ndarray) -> float | None:
    """How independent the noise of pixels beside each other is, 1 if it is, less if a filter spread
    it; None where there is too little noise to tell.

    Diagonal differences of 2x2 pixels have as much of independent noise as straight ones, and less
    of what is smooth.

    Args:
        colour: (height, width, 3), light.
    """
    height, width = colour.shape[:2]
    columns, rows = min(width, NOISE_WINDOW_PX[0]), min(height, NOISE_WINDOW_PX[1])
    left, top = (width - columns) // 2, (height - rows) // 2
    window = np.nan_to_num(colour[top:top + rows, left:left + columns], posinf=0.0, neginf=0.0)
    light = window.clip(0.0, MOST_BRIGHTNESS).mean(axis=2, keepdims=True)
    around = np.maximum(local_mean(light, BRIGHTNESS_REACH_PX), LEAST_BRIGHTNESS)
    seen = (light / (light + around))[..., 0]
    upper = seen[:-1, 1:] - seen[:-1, :-1]
    lower = seen[1:, 1:] - seen[1:, :-1]
    here = seen[1:, :-1] - seen[:-1, :-1]
    beside = seen[1:, 1:] - seen[:-1, 1:]
    diagonal, across, down = (_means_of_cells(np.square(difference)) for difference in (
        lower - upper, lower + upper, here + beside))
    noisy = diagonal > LEAST_NOISE
    if np.count_nonzero(noisy) < LEAST_NOISY_CELLS:
        return None
    ratios = diagonal[noisy] / np.maximum(across, down)[noisy]
    return float(np.quantile(ratios, INDEPENDENT_QUANTILE))


def _means_of_cells(plane: np.ndarray) -> np.ndarray:
    """Means of whole cells of a plane (rows, columns)."""
    rows, columns = (side // NOISE_CELL_PX for side in plane.shape)
    whole = plane[:rows * NOISE_CELL_PX, :columns * NOISE_CELL_PX]
    cells: np.ndarray = whole.reshape(rows, NOISE_CELL_PX, columns, NOISE_CELL_PX).mean(axis=(1, 3))
    return cells
