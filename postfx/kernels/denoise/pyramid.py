"""Kernels after the upscaler's network: filter the pyramid from coarse to fine and multiply by reflectance again.

Pyramid levels are planar so that the inner loops run along rows with vector instructions. Cells of 2x2 pixels are the
same as in the whole frame, so a window's first row or column may be the second one of its cells.

Levels hold the picture, one plane, or several parts behind one another: the weights of a row are read from memory once
for all of them. Parts are pooled by the picture's importance. At the end there are alpha's first and last step.
"""

from dataclasses import replace

import numpy as np

from postfx.kernels import Blocks
from postfx.kernels.denoise import (
    BOTH,
    JITTER_X,
    JITTER_Y,
    LEFT,
    TAP_WEIGHTS,
    TINY,
    TOP,
    in_half,
    kernel,
)
from postfx.kernels.denoise.alpha import NEAR, QUARTERS, cell_of, pixel_mean, spans_of
from postfx.kernels.denoise.upsample import gauss, is_doubled, lean, pixel_of
from postfx.kernels.numeric import (
    Real,
    add_eight,
    add_products_of_eight,
    clamp,
    compiled,
    divide_eight,
    fused,
    load_eight,
    store_eight,
)

ZERO, ONE = np.float32(0), np.float32(1)
SIDE, REACH = 5, 2
"""Taps along a side of a kernel, and how far they reach."""


@compiled
def level_rows(y0: int, y1: int, next_samples: np.ndarray, part_rows: np.ndarray, part_columns: np.ndarray,
               seen_rows: np.ndarray, seen_columns: np.ndarray, level: np.ndarray) -> None:
    """The means of samples as the finest level of what is filtered, 0 beyond the part."""
    for y in range(y0, y1):
        level[0, y] = ZERO
        for x in range(part_columns.size if y < part_rows.size else 0):
            level[0, y, x] = pixel_mean(int(part_rows[y]), int(part_columns[x]), next_samples)


@fused
def nine_taps(lines: np.ndarray, fine: np.ndarray, iy: int, corner: int, x0: int, x1: int, gauss_x: np.ndarray,
              gauss_y: np.ndarray, found: np.ndarray) -> None:
    """Weighted means of 3x3 pixels, three rows (3, w + 2), at a corner of the pixels in a span, eight at once."""
    (_, _, hp, wp), line = fine.shape, lines.shape[1]
    weights, samples = fine.reshape(fine.size), lines.reshape(lines.size)
    for block in range((x1 - x0 + 7) // 8):
        x = min(x0 + 8 * block, found.size - 8)
        zeros = (ZERO, ZERO, ZERO, ZERO, ZERO, ZERO, ZERO, ZERO)
        total, whole = zeros, zeros
        for j in range(3):
            for i in range(3):
                tap = TAP_WEIGHTS + 4 * (3 * j + i) + corner
                weight = add_eight(zeros, load_eight(weights, (tap * hp + iy) * wp + x), gauss_y[j] * gauss_x[i])
                whole = add_eight(whole, weight, ONE)
                total = add_products_of_eight(total, weight, load_eight(samples, j * line + x + i))
        store_eight(found, x, divide_eight(total, whole))


@fused
def tap_between(fine: np.ndarray, iy: int, x: int, tap: int, right: Real, lower: Real) -> Real:
    """A weight between the four corners of a pixel."""
    first = TAP_WEIGHTS + 4 * tap
    upper = fine[0, first, iy, x] + (fine[0, first + 1, iy, x] - fine[0, first, iy, x]) * right
    below = fine[0, first + 2, iy, x] + (fine[0, first + 3, iy, x] - fine[0, first + 2, iy, x]) * right
    return upper + (below - upper) * lower


@compiled
def enlarge_rows(y0: int, y1: int, filtered: np.ndarray, fine: np.ndarray, part_rows: np.ndarray,
                 part_columns: np.ndarray, params: np.ndarray, window: np.ndarray, near: np.ndarray,
                 out_rows: np.ndarray, out_columns: np.ndarray, enlarged: np.ndarray) -> None:
    """Filtered alpha at output size, by the picture's weights of 3x3 pixels; where nothing is near, that of the pixel
    itself."""
    h, w, width = part_rows.size, part_columns.size, enlarged.shape[1]
    top, left, doubled = int(window[TOP]), int(window[LEFT]), is_doubled(window) and w >= 8
    index, leans = np.empty(width, np.int64), np.empty(width, np.float32)
    gauss_x, gauss_y = np.empty((width, 3), np.float32), np.empty(3, np.float32)
    lines, sides = np.empty((3, w + 2), np.float32), np.empty((2, w), np.float32)
    spans = np.empty((near.shape[1], 2), np.int64)
    for x in range(width):
        index[x], offset = pixel_of(x, LEFT, window, w)
        leans[x] = lean(offset)
        for i in range(3):
            gauss_x[x, i] = gauss(i - 1 + params[JITTER_X] - offset)
    for row in range(y0, y1):
        iy, offset = pixel_of(row, TOP, window, h)
        lower = lean(offset)
        for j in range(3):
            gauss_y[j] = gauss(j - 1 + params[JITTER_Y] - offset)
        for x in range(width):
            enlarged[row, x, 0] = clamp(filtered[0, iy, index[x]], ZERO, ONE)
        out = 0
        for k in range(spans_of(near[cell_of(top + iy, near)], left + w, ONE, spans)):
            x0, x1 = max(spans[k, 0] - left, 0), min(spans[k, 1] - left, w)
            for j in range(3 if x0 < x1 else 0):
                source = min(max(iy + j - 1, 0), h - 1)
                for x in range(x0, x1 + 2):
                    lines[j, x] = filtered[0, source, min(max(x - 1, 0), w - 1)]
            while out < width and index[out] < x0:
                out += 1
            if doubled and x0 < x1:
                for side in range(2):
                    corner = 2 * (int(out_rows[row]) % 2) + side
                    nine_taps(lines, fine, iy, corner, x0, x1, gauss_x[out + side], gauss_y, sides[side])
                    for x in range(x0, x1):
                        enlarged[row, out + 2 * (x - x0) + side, 0] = clamp(sides[side, x], ZERO, ONE)
                continue
            while out < width and index[out] < x1:
                x, total, whole = index[out], ZERO, np.float32(TINY)
                for tap in range(9):
                    scale = gauss_y[tap // 3] * gauss_x[out, tap % 3]
                    weight = tap_between(fine, iy, x, tap, leans[out], lower) * scale
                    total, whole = total + weight * lines[tap // 3, x + tap % 3], whole + weight
                enlarged[row, out, 0] = clamp(total / whole, ZERO, ONE)
                out += 1


PLANAR = ("planes", "hp", "wp")
POOL = kernel("pool", ("finer", "finer_importance", "finer_rows", "finer_columns"), ("level", "importance"), None,
              ("level", 1), level=PLANAR)


def pools_rows(y0: int, y1: int, finer: np.ndarray, finer_importance: np.ndarray, firsts: np.ndarray,
               *written: np.ndarray) -> None:
    """What the kernel below computes. No device runs it."""
    levels, totals = written[:4], written[4:]
    for i, (level, importance) in enumerate(zip(levels, totals, strict=True)):
        rows, columns = (2 * np.arange(size, dtype=np.float32) + first
                         for size, first in zip(level.shape[1:], (firsts[i], firsts[4 + i]), strict=True))
        POOL.rows(0, level.shape[1], finer, finer_importance, rows, columns, level, importance)
        finer, finer_importance = level, importance


_LEVELS = {f"{name}{i}": (planes, f"level{i}_h", f"level{i}_w")
           for name, planes in (("level", "planes"), ("importance", 1)) for i in range(1, 5)}
POOLS = replace(kernel("pools", ("finer", "finer_importance", "firsts"), tuple(_LEVELS), pools_rows, ("level1", 1),
                       finer=PLANAR, finer_importance=(1, "hp", "wp"), firsts=(8,), **_LEVELS),
                blocks=Blocks(0, 256, most=1024))
"""All levels at once, on a GPU."""
MIX_LEVELS = kernel("mix", ("coarse", "level", "heads", "coarse_rows", "coarse_columns"), ("mixed",), None,
                    ("mixed", 1), level=PLANAR, mixed=PLANAR)
FILTER = kernel("filter", ("mixed", "heads", "area"), ("filtered",), None, ("filtered", 1), mixed=PLANAR,
                filtered=PLANAR)
FILTER_CODES = kernel("filter_codes", ("mixed", "codes", "factors", "scaling", "area"), ("filtered",),
                      None, ("filtered", 1), mixed=("planes", "2*half_hp", "2*half_wp"),
                      filtered=("planes", "2*half_hp", "2*half_wp"))
in_half(MIX_LEVELS, "heads")
in_half(FILTER, "heads")


def filter_mixed_rows(y0: int, y1: int, coarse: np.ndarray, level: np.ndarray, heads: np.ndarray,
                      coarse_rows: np.ndarray, coarse_columns: np.ndarray, area: np.ndarray,
                      filtered: np.ndarray) -> None:
    """What the kernel below computes. No device runs it."""
    mixed = np.empty_like(level)
    MIX_LEVELS.rows(0, level.shape[1], coarse, level, heads, coarse_rows, coarse_columns, mixed)
    FILTER.rows(y0, y1, mixed, heads, area, filtered)


FILTER_MIXED = kernel("filter_mixed", (*MIX_LEVELS.reads, "area"), ("filtered",), filter_mixed_rows, ("filtered", 1),
                      level=PLANAR, filtered=PLANAR)
"""Both at once, on a GPU."""
in_half(FILTER_MIXED, "heads")
REMODULATE = kernel("remodulate", ("filtered", "factor", "part_rows", "part_columns"), ("radiance",),
                    None, ("radiance", 1))


def filter_shaded_rows(y0: int, y1: int, coarse: np.ndarray, level: np.ndarray, heads: np.ndarray,
                       coarse_rows: np.ndarray, coarse_columns: np.ndarray, area: np.ndarray, factor: np.ndarray,
                       radiance: np.ndarray) -> None:
    """What the kernel below computes. No device runs it."""
    filtered = np.empty_like(level)
    filter_mixed_rows(0, level.shape[1], coarse, level, heads, coarse_rows, coarse_columns, area, filtered)
    rows, columns = (np.minimum(np.arange(size - 2, dtype=np.float32), end - 1)
                     for size, end in zip(radiance.shape[1:], area, strict=True))
    REMODULATE.rows(y0, y1, filtered, factor, rows, columns, radiance)


FILTER_SHADED = kernel("filter_shaded", (*FILTER_MIXED.reads, "factor"), ("radiance",), filter_shaded_rows,
                       ("radiance", 1), coarse=(3, "coarse_h", "coarse_w"), level=(3, "hp", "wp"))
"""Those of the finest level and `REMODULATE` at once, on a GPU."""
in_half(FILTER_SHADED, "heads")
REMODULATE_BOTH = kernel("remodulate_both", ("filtered", "factor", "part_rows", "part_columns"), ("radiance",),
                         None, ("radiance", 1), radiance=BOTH)
LEVEL = kernel("alpha_level", ("next_samples", "part_rows", "part_columns", "seen_rows", "seen_columns"), ("level",),
               level_rows, ("level", 1), next_samples=QUARTERS, level=(1, "hp", "wp"))
ENLARGE_ALPHA = kernel("enlarge_alpha", ("filtered", "fine", "part_rows", "part_columns", "params", "window", "near",
                                         "out_rows", "out_columns"), ("enlarged",), enlarge_rows, ("enlarged", 0),
                       filtered=(1, "hp", "wp"), near=NEAR, enlarged=("out_th", "out_tw", 1))
in_half(ENLARGE_ALPHA, "fine")
