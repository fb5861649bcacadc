"""Random arguments for the tone mapper's kernels."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from postfx.colour import REC709, REC2020, matrix_between, to_xyz
from postfx.colour.displays import parse_display
from postfx.kernels import Kernel
from postfx.kernels.colour import (
    APPLY_CUBE,
    APPLY_CUBE_FOURS,
    CONVERT_PRIMARIES,
    ENCODE_DISPLAY,
    SHOW_NEUTRAL,
    SHOW_REINHARD,
)
from postfx.kernels.image import CHECKERBOARD, turns
from postfx.kernels.tonemap import (
    EXPOSE,
    FOLLOW,
    GRID_SHAPE,
    KNOTS,
    LIGHT,
    LOWRES,
    SLICE_APPLY,
    SMOOTH_GRID,
)
from postfx.passes.display import decoding, encoding, parameters

KERNELS = (SLICE_APPLY, LOWRES, LIGHT, FOLLOW, SMOOTH_GRID, EXPOSE, ENCODE_DISPLAY, APPLY_CUBE,
           CHECKERBOARD)
ON_GPU = (APPLY_CUBE_FOURS, SHOW_NEUTRAL, SHOW_REINHARD)
HLG = parse_display("hlg")
SIZES = ((1, 1), (5, 7), (67, 129), (300, 260))
SHAPER = (2.0**-8, 1.0 / math.log2(1.0 + 2.0**16))  # toe, and the scale by which 2^8 becomes 1
SHOWING = np.array([1.7, *matrix_between(REC709, REC2020).ravel(), *to_xyz(REC2020)[1], 4.9])
"""Exposure, matrix, weights of luminance and most light of a view that is a formula."""
PARAMS = {ENCODE_DISPLAY: parameters(None, HLG, 1.7), FOLLOW: np.array([0.98, 0.6, 1.0, SHAPER[1]]),
          SHOW_NEUTRAL: SHOWING, SHOW_REINHARD: SHOWING}


def fixed_shape(kernel: Kernel, name: str) -> tuple[int, ...]:
    """A binding's shape, all of whose sides are the same for every frame."""
    return tuple(int(side) for side in kernel.shapes[name])


@dataclass(frozen=True)
class Pace:
    """What `follow` makes of a past and of light of 8 stops, where 0.98 is kept of steady light and
    0.6 followed."""

    name: str
    made_for: float
    last: float
    share: float
    after: tuple[float, float, float, float]
    past: float = 1.0

    def arguments(self) -> list[np.ndarray]:
        light = np.full(fixed_shape(LIGHT, "light"), 8 * SHAPER[1])
        params = [0.98, 0.6, self.past, SHAPER[1]]
        before = [[0.5, self.made_for, self.last, self.share]]
        return [np.array(values, np.float32) for values in (light, params, before)]


NONE = (0.0, 8.0, 8.0, 0.0)
PACES = (
    Pace("first", 8.0, 8.0, 0.02, NONE, past=0.0),
    Pace("steady", 8.0, 8.0, 0.0, (0.98, 8.0, 8.0, 0.02)),
    Pace("drift", 7.75, 7.95, 0.0, (0.98, 7.755, 8.0, 0.02)),
    Pace("half behind", 7.625, 7.95, 0.0, (0.7, 7.7375, 8.0, 0.3)),
    Pace("far behind", 5.0, 7.95, 0.0, (0.4, 6.8, 8.0, 0.6)),
    Pace("step", 8.0, 9.0, 0.0, (0.4, 8.0, 8.0, 0.6)),
    Pace("after a step", 7.9, 8.0, 0.4, (0.62, 7.938, 8.0, 0.38)),
    Pace("broken light", math.nan, 8.0, 0.0, NONE),
    Pace("endless light", 8.0, -math.inf, 0.0, NONE),
    Pace("broken share", 8.0, 8.0, math.nan, NONE),
)


@dataclass(frozen=True)
class Hold:
    """What `expose` makes of a past factor where a look asks for one stop, at an exposure of
    1.5."""

    name: str
    previous: float
    keep: float
    factor: float

    def arguments(self) -> list[np.ndarray]:
        previous, params = (self.previous, *SHAPER), (1.5, *SHAPER)
        return [np.array(values, np.float32)
                for values in (previous, [[1.0]], [[self.keep, 8, 8, 0.02]], params)]


HOLDS = (
    Hold("nothing kept", math.nan, 0.0, 2.0),
    Hold("half kept", 8.0, 0.5, 4.0),
    Hold("nearly all kept", 1.0, 0.9, 2.0**0.1),
    *(Hold(f"{value} before", value, 0.9, 2.0)
      for value in (math.nan, math.inf, -math.inf, 0.0, -1.0, 3e38)),
)


def sizes(kernel: Kernel) -> tuple[tuple[int, int], ...]:
    """Heights and widths that a kernel is run at; one where it does not see the picture."""
    return SIZES if any("height" in shape for shape in kernel.shapes.values()) else SIZES[:1]


def hdr(height: int, width: int) -> np.ndarray:
    """Colour over 20 stops with everything in it that a file should not hold."""
    colour = (np.exp2(np.random.default_rng(height).uniform(-12, 8, (height, width, 3)))
              .astype(np.float32))
    if height > 4:
        colour[1, 1, 0] = np.nan
        colour[2, 2, 1] = np.inf
        colour[3, 3, 2] = -np.inf
        colour[4, 4, 0] = -3.0
    return colour


def plain_guide() -> np.ndarray:
    """Numbers of a guide that is the channels' mean, as before any training; see
    ``postfx.kernels.tonemap``."""
    shifts, slopes = np.linspace(0, 1, KNOTS, endpoint=False), np.eye(1, KNOTS)[0]
    return np.concatenate([np.eye(3).ravel(), np.zeros(3), np.tile(shifts, 3), np.tile(slopes, 3),
                           np.full(3, 1 / 3), np.zeros(1)])


def bent_cube(size: int) -> np.ndarray:
    """A cube (size, size, size, 3) with curves, and channels that mix: about as steep as those of
    looks."""
    axis = np.linspace(0, 1, size)
    r, g, b = np.meshgrid(axis, axis, axis, indexing="ij")
    return np.stack([r**1.5, 0.8 * g + 0.1 * r + 0.1 * b, np.sin(1.5 * b) * (1 - 0.2 * g)], -1)


def arguments(kernel: Kernel, height: int, width: int) -> dict[str, np.ndarray]:
    """Inputs of a kernel by name, with a guide and grid that use every level and differ from cell
    to cell."""
    random = np.random.default_rng(7)
    guide = plain_guide()
    values = {
        "colour": hdr(height, width),
        "params": PARAMS.get(kernel, np.array([1.7, *SHAPER])),
        "decode": decoding(parse_display("srgb")),
        "encode": encoding(HLG),
        "matrix": matrix_between(REC709, REC2020).ravel(),
        "cube": bent_cube(17),
        "guide": guide + random.normal(0, 0.05, guide.size),
        "grid": random.normal(0, 0.4, GRID_SHAPE),
        "previous": random.normal(0, 1, GRID_SHAPE),
        "current": random.normal(0, 1, GRID_SHAPE),
        "lowres": random.random(fixed_shape(LOWRES, "lowres")),
        "light": random.random(fixed_shape(LIGHT, "light")),
        "before": np.array([[0.9, 7.6, 7.9, 0.1]]),
        "keep": np.array([[0.3, 7.6, 7.9, 0.7]]),
        "rows": turns(height, 6.5),
        "columns": turns(width, 6.5),
        "greys": np.array([0.15, 0.21]),
    }
    if kernel is APPLY_CUBE_FOURS:
        values["cube"] = np.pad(values["cube"], ((0, 0), (0, 0), (0, 0), (0, 1)),
                                constant_values=np.nan)
    if kernel is EXPOSE:
        values |= {"previous": np.array([1.9, *SHAPER]), "current": np.array([[-0.7]])}
    if kernel is CONVERT_PRIMARIES:
        values["colour"] = random.normal(0, 1, (height, width, 3))
    return {name: np.ascontiguousarray(values[name], np.float32) for name in kernel.reads}
