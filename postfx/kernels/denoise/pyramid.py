"""Kernels after the upscaler's network: filter the pyramid from coarse to fine and multiply by
reflectance again.

Pyramid levels are planar so that the inner loops run along rows with vector instructions. Cells of
2x2 pixels are the same as in the whole frame, so a window's first row or column may be the second
one of its cells.

Levels hold the picture, one plane, or several parts behind one another: the weights of a row are
read from memory once for all of them. Parts are pooled by the picture's importance. At the end
there are alpha's first and last step.
"""

from dataclasses import replace

import numpy as np

from postfx.kernels import Blocks
from postfx.kernels.denoise import BOTH, in_half, kernel
from postfx.kernels.denoise.alpha import NEAR, QUARTERS

REACH = 2
"""Pixels that the taps of a kernel reach."""
SIDE = 2 * REACH + 1
"""Taps along a side of a kernel."""
PLANAR = ("planes", "hp", "wp")
POOL = kernel("pool", ("finer", "finer_importance", "finer_rows", "finer_columns"),
              ("level", "importance"), None, ("level", 1), level=PLANAR)


def pools_rows(y0: int, y1: int, finer: np.ndarray, finer_importance: np.ndarray,
               firsts: np.ndarray, *written: np.ndarray) -> None:
    """What the kernel below computes. No device runs it."""
    levels, totals = written[:4], written[4:]
    for i, (level, importance) in enumerate(zip(levels, totals, strict=True)):
        rows, columns = (2 * np.arange(size, dtype=np.float32) + first
                         for size, first in zip(level.shape[1:], (firsts[i], firsts[4 + i]),
                                                strict=True))
        POOL.rows(0, level.shape[1], finer, finer_importance, rows, columns, level, importance)
        finer, finer_importance = level, importance


_LEVELS = {f"{name}{i}": (planes, f"level{i}_h", f"level{i}_w")
           for name, planes in (("level", "planes"), ("importance", 1)) for i in range(1, 5)}
POOLS = replace(kernel("pools", ("finer", "finer_importance", "firsts"), tuple(_LEVELS), pools_rows,
                       ("level1", 1),
                       finer=PLANAR, finer_importance=(1, "hp", "wp"), firsts=(8,), **_LEVELS),
                blocks=Blocks(0, 256, most=1024))
"""All levels at once, on a GPU."""
MIX_LEVELS = kernel("mix", ("coarse", "level", "heads", "coarse_rows", "coarse_columns"),
                    ("mixed",), None, ("mixed", 1), level=PLANAR, mixed=PLANAR)
FILTER = kernel("filter", ("mixed", "heads", "area"), ("filtered",), None, ("filtered", 1),
                mixed=PLANAR, filtered=PLANAR)
FILTER_CODES = kernel("filter_codes", ("mixed", "codes", "factors", "scaling", "area"),
                      ("filtered",),
                      None, ("filtered", 1), mixed=("planes", "2*half_hp", "2*half_wp"),
                      filtered=("planes", "2*half_hp", "2*half_wp"))
in_half(MIX_LEVELS, "heads")
in_half(FILTER, "heads")


def filter_mixed_rows(y0: int, y1: int, *arrays: np.ndarray) -> None:
    """What the kernel below computes. No device runs it."""
    *of_mixing, area, filtered = arrays
    _, level, heads, *_ = of_mixing
    mixed = np.empty_like(level)
    MIX_LEVELS.rows(0, level.shape[1], *of_mixing, mixed)
    FILTER.rows(y0, y1, mixed, heads, area, filtered)


FILTER_MIXED = kernel("filter_mixed", (*MIX_LEVELS.reads, "area"), ("filtered",), filter_mixed_rows,
                      ("filtered", 1), level=PLANAR, filtered=PLANAR)
"""Both at once, on a GPU."""
in_half(FILTER_MIXED, "heads")
REMODULATE = kernel("remodulate", ("filtered", "factor", "part_rows", "part_columns"),
                    ("radiance",), None, ("radiance", 1))


def filter_shaded_rows(y0: int, y1: int, *arrays: np.ndarray) -> None:
    """What the kernel below computes. No device runs it."""
    *of_filtering, factor, radiance = arrays
    _, level, *_, area = of_filtering
    filtered = np.empty_like(level)
    filter_mixed_rows(0, level.shape[1], *of_filtering, filtered)
    rows, columns = (np.minimum(np.arange(size - 2, dtype=np.float32), end - 1)
                     for size, end in zip(radiance.shape[1:], area, strict=True))
    REMODULATE.rows(y0, y1, filtered, factor, rows, columns, radiance)


FILTER_SHADED = kernel("filter_shaded", (*FILTER_MIXED.reads, "factor"), ("radiance",),
                       filter_shaded_rows,
                       ("radiance", 1), coarse=(3, "coarse_h", "coarse_w"), level=(3, "hp", "wp"))
"""Those of the finest level and `REMODULATE` at once, on a GPU."""
in_half(FILTER_SHADED, "heads")
REMODULATE_BOTH = kernel("remodulate_both", ("filtered", "factor", "part_rows", "part_columns"),
                         ("radiance",), None, ("radiance", 1), radiance=BOTH)
LEVEL = kernel("alpha_level",
               ("next_samples", "part_rows", "part_columns", "seen_rows", "seen_columns"),
               ("level",), None, ("level", 1), next_samples=QUARTERS, level=(1, "hp", "wp"))
ENLARGE_ALPHA = kernel("enlarge_alpha", ("filtered", "fine", "part_rows", "part_columns", "params",
                                         "window", "near", "out_rows", "out_columns"),
                       ("enlarged",), None, ("enlarged", 0),
                       filtered=(1, "hp", "wp"), near=NEAR, enlarged=("out_th", "out_tw", 1))
in_half(ENLARGE_ALPHA, "fine")
