"""Checks of the noise itself."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from postfx.doctor import Finding, finite, warning
from postfx.doctor.material import Material
from postfx.frame import Role
from postfx.sampling import local_mean

LOOKED_AT_PX = 640, 360
"""Most columns and rows, in the middle of the picture, that are looked at."""
AROUND_PX = 4
"""Pixels to each side whose mean light tells how bright a pixel is."""
CELL_PX = 16
"""Side of the cells whose noise is compared."""
LEAST_NOISE = 0.0036
"""Mean square of diagonal differences in cells that count, of light against that around; 3 %."""
LEAST_CELLS = 8
"""Noisy cells without which nothing is said."""
WHITEST = 0.95
"""Quantile of the cells by how independent the noise of their pixels is: detail, which others may
hold, looks spread, too."""
MOST_SPREAD = 0.62
"""Ratio of diagonal to straight differences there up to which noise is spread: a gaussian filter of
half a pixel makes 0.45 to 0.61. Independent noise has 1, and 0.85 in the noisy renders with the
most detail."""
LEAST_LIGHT = 1e-5
MOST_SAMPLES = 32
"""Known samples a pixel beyond which detail is more than noise, and looks spread."""


def check_pixel_filter(material: Material) -> Iterator[Finding]:
    """Noise that the renderer's pixel filter spreads over several pixels."""
    first = material.first
    if Role.COLOUR not in first or (first.samples or 0) > MOST_SAMPLES:
        return
    ratio = independence(first[Role.COLOUR])
    if ratio is None or ratio > MOST_SPREAD:
        return
    evidence = (f"noise of pixels beside each other is alike ({ratio:.2f} where independent noise "
                "has 1): 'xl' and OIDN take it for detail and leave most of it")
    yield warning(Role.COLOUR, "noise-spread", evidence,
                  "a pixel filter that adds each sample to several pixels, as a gaussian does",
                  "render with a box filter of one pixel, or denoise by --model m")


def independence(colour: np.ndarray) -> float | None:
    """How independent the noise of pixels beside each other is, 1 if it is, less if a filter spread
    it; None where there is too little noise to tell.

    Diagonal differences of 2x2 pixels have as much of independent noise as straight ones, and less
    of what is smooth.

    Args:
        colour: (height, width, 3), light.
    """
    height, width = colour.shape[:2]
    columns, rows = min(width, LOOKED_AT_PX[0]), min(height, LOOKED_AT_PX[1])
    left, top = (width - columns) // 2, (height - rows) // 2
    window = finite(colour[top:top + rows, left:left + columns])
    light = np.maximum(window.mean(axis=2, keepdims=True), 0)
    around = np.maximum(local_mean(light, AROUND_PX), LEAST_LIGHT)
    seen = (light / (light + around))[..., 0]
    upper = seen[:-1, 1:] - seen[:-1, :-1]
    lower = seen[1:, 1:] - seen[1:, :-1]
    here = seen[1:, :-1] - seen[:-1, :-1]
    beside = seen[1:, 1:] - seen[:-1, 1:]
    diagonal, across, down = (_means_of_cells(np.square(difference)) for difference in (
        lower - upper, lower + upper, here + beside))
    noisy = diagonal > LEAST_NOISE
    if np.count_nonzero(noisy) < LEAST_CELLS:
        return None
    ratios = diagonal[noisy] / np.maximum(across, down)[noisy]
    return float(np.quantile(ratios, WHITEST))


def _means_of_cells(plane: np.ndarray) -> np.ndarray:
    """Means of whole cells of a plane (rows, columns)."""
    rows, columns = (side // CELL_PX for side in plane.shape)
    whole = plane[:rows * CELL_PX, :columns * CELL_PX]
    cells: np.ndarray = whole.reshape(rows, CELL_PX, columns, CELL_PX).mean(axis=(1, 3))
    return cells
