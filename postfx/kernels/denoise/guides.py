"""Kernels that sample planes at output size where the network predicts its filters, and judge how far to trust planes.

Channels of ``guides``, for the corners of a render pixel at top left, top right, bottom left and bottom right: diffuse
albedo 0, specular albedo 3, normal 6, roughness 9, depth 10. The torch definition is
``training.denoise.model.guide_features``.
"""

import numpy as np

from postfx.kernels.denoise import (
    DOUBT,
    FAINT,
    GUIDE_PLANES,
    GUIDE_REFLECTANCE,
    GUIDES,
    HEIGHT,
    LEFT,
    MAX_DEPTH,
    REFLECTANCE,
    TOP,
    TRUST_CELL,
    WIDTH,
    kernel,
)
from postfx.kernels.numeric import Real, clamp, compiled, demodulation, fused

CORNERS = 4
CHANNELS = GUIDES // CORNERS
ZERO, ONE, TWO, HALF = np.float32(0), np.float32(1), np.float32(2), np.float32(0.5)


@fused
def picked_planes(picture: np.ndarray, columns: np.ndarray, low: Real, high: Real, first: int, row: int,
                  guides: np.ndarray) -> None:
    """Pixels of a guide's row at ``columns``, within bounds, as planes from channel ``first`` on."""
    for c in range(picture.shape[1]):
        plane = guides[0, first + c, row]
        for x in range(columns.size):
            plane[x] = clamp(picture[columns[x], c], low, high)


@compiled
def guide_rows(y0: int, y1: int, guide_diffuse_albedo: np.ndarray, guide_specular_albedo: np.ndarray,
               guide_normal: np.ndarray, guide_roughness: np.ndarray, guide_depth: np.ndarray, depth_scale: np.ndarray,
               window: np.ndarray, seen_rows: np.ndarray, seen_columns: np.ndarray, guides: np.ndarray) -> None:
    """The nearest guide pixel at every corner of what the network sees."""
    h, w = int(window[HEIGHT]), int(window[WIDTH])
    top, left = int(window[TOP]), int(window[LEFT])
    height, width = guide_depth.shape[:2]
    scale, padded = depth_scale[0], guides.shape[3]
    columns = np.empty((2, padded), np.int64)
    for x in range(padded):
        for side in range(2):
            columns[side, x] = (4 * (left + int(seen_columns[x])) + 1 + 2 * side) * width // (4 * w)
    for row in range(y0, y1):
        for corner in range(CORNERS):
            y = (4 * (top + int(seen_rows[row])) + 1 + 2 * (corner // 2)) * height // (4 * h)
            at, first = columns[corner % 2], CHANNELS * corner
            picked_planes(guide_diffuse_albedo[y], at, ZERO, TWO, first, row, guides)
            picked_planes(guide_specular_albedo[y], at, ZERO, TWO, first + 3, row, guides)
            picked_planes(guide_normal[y], at, -ONE, ONE, first + 6, row, guides)
            picked_planes(guide_roughness[y], at, ZERO, ONE, first + 9, row, guides)
            picked_planes(guide_depth[y], at, ZERO, MAX_DEPTH, first + 10, row, guides)
            near = guides[0, first + 10, row]
            for x in range(padded):
                near[x] = scale / (scale + near[x])


GUIDE = kernel("guides", (*GUIDE_PLANES, "depth_scale", "window", "seen_rows", "seen_columns"), ("guides",), guide_rows,
               ("guides", 2))


@compiled
def judged_pixel(y: int, x: int, h: int, w: int, diffuse_albedo: np.ndarray, specular_albedo: np.ndarray,
                 guide_diffuse_albedo: np.ndarray, guide_specular_albedo: np.ndarray) -> tuple[Real, Real]:
    """Squared relative difference of the guides' mean reflectance over a render pixel from that of the render size, and
    the mean squared difference of the guides: the first is large beside it where guides disagree."""
    height, width = guide_diffuse_albedo.shape[:2]
    own_r, own_g, own_b = demodulation(diffuse_albedo, specular_albedo, y, x)
    own_r, own_g, own_b = ONE / own_r, ONE / own_g, ONE / own_b
    top, bottom = y * height // h, ((y + 1) * height + h - 1) // h
    left, right = x * width // w, ((x + 1) * width + w - 1) // w
    mean_r = mean_g = mean_b = spread = ZERO
    for v in range(top, bottom):
        for u in range(left, right):
            r, g, b = demodulation(guide_diffuse_albedo, guide_specular_albedo, v, u)
            r, g, b = r * own_r - ONE, g * own_g - ONE, b * own_b - ONE
            mean_r, mean_g, mean_b = mean_r + r, mean_g + g, mean_b + b
            spread += r * r + g * g + b * b
    share = ONE / np.float32((bottom - top) * (right - left))
    mean_r, mean_g, mean_b = mean_r * share, mean_g * share, mean_b * share
    return mean_r * mean_r + mean_g * mean_g + mean_b * mean_b, spread * share


@compiled
def trust_rows(y0: int, y1: int, diffuse_albedo: np.ndarray, specular_albedo: np.ndarray,
               guide_diffuse_albedo: np.ndarray, guide_specular_albedo: np.ndarray, window: np.ndarray,
               part_rows: np.ndarray, part_columns: np.ndarray, trust: np.ndarray) -> None:
    """How far the guides' reflectance is trusted, in cells of the part: fully where its mean over a render pixel is the
    reflectance at render size, less where that follows the detail, as with planes of one sample a pixel."""
    h, w = int(window[HEIGHT]), int(window[WIDTH])
    rows, columns = min(part_rows.size, h - int(window[TOP])), min(part_columns.size, w - int(window[LEFT]))
    for row in range(y0, y1):
        for column in range(trust.shape[1]):
            apart = spread = ZERO
            count = 0
            for i in range(TRUST_CELL * row, min(TRUST_CELL * (row + 1), rows)):
                for j in range(TRUST_CELL * column, min(TRUST_CELL * (column + 1), columns)):
                    found = judged_pixel(int(part_rows[i]), int(part_columns[j]), h, w, diffuse_albedo, specular_albedo,
                                         guide_diffuse_albedo, guide_specular_albedo)
                    apart, spread, count = apart + found[0], spread + found[1], count + 1
            trust[row, column, 0] = ONE - DOUBT * apart / (spread + 3 * FAINT * count) if count else ONE


@compiled
def place_of(at: Real, offset: Real, size: int) -> Real:
    """Where a pixel's centre lies among the cells of ``size`` render pixels, from centre to centre."""
    place = (np.float32(at) + offset + HALF) / np.float32(TRUST_CELL) - HALF
    return min(max(place, ZERO), np.float32((size - 1) // TRUST_CELL))


@compiled
def trust_row(trust: np.ndarray, place: Real, places: np.ndarray, row: np.ndarray) -> None:
    """How far each pixel of a row of the output trusts the guides, linear between cells."""
    upper = int(place)
    lower, share = min(upper + 1, trust.shape[0] - 1), place - np.float32(upper)
    for x in range(places.size):
        i = int(places[x])
        j, across = min(i + 1, trust.shape[1] - 1), places[x] - np.float32(i)
        above = trust[upper, i, 0] + (trust[upper, j, 0] - trust[upper, i, 0]) * across
        below = trust[lower, i, 0] + (trust[lower, j, 0] - trust[lower, i, 0]) * across
        row[x] = above + (below - above) * share


TRUST = kernel("trust", (*REFLECTANCE, *GUIDE_REFLECTANCE, "window", "part_rows", "part_columns"), ("trust",),
               trust_rows, ("trust", 0))
