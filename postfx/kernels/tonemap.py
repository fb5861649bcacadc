"""Kernels of the tone mapper, in the order in which they run. All bindings are float32.

`lowres` shapes colour and averages it by area to the 256x256 copy that the network sees. Bindings: colour (height,
width, 3) scene-linear; params (3,): exposure, toe and scale of the shaper; matrix (9,) row-major, applied first; lowres
(1, 3, 256, 256) in [0, 1]. Averaging after the shaper limits a firefly's effect to its share of the area.

`light` is the mean of each row and channel of the copy. Bindings: lowres; light (256, 3).

`follow` decides how much of the last frame's grid is kept: nearly all in steady light, less while the light changes.
Light is the mean of the shaped copy, in stops. It changes if it differs by more than `LAG` from the light that the grid
was made for, or by more than `JUMP` from the last frame's. Beyond twice as much, the grid covers `follow` of the way in
one frame, and `RELEASE` of that in each later frame. Two speeds for small and large changes come from the 1 euro filter
(Casiez, Roussel and Vogel 2012). A camera's motion changes the mean less than the grid, so the mean separates light
from motion. Bindings: light (256, 3); params (4,): keep and follow in [0, 1], whether there is a past (1 or 0), scale
of the shaper, which is one stop; before and after (1, 4): kept part of the grid, the light that the grid is made for,
the light, and 1 minus the kept part, which is 0 without a past. A past with NaN or infinity counts as none.

`smooth` is exponential smoothing over time: result = current + keep * (previous - current). Bindings: previous, current
and result (1, 16, 16, 8, 12); keep (1, 4), the output of `follow`, of which the first number counts; it is 0 on the
first frame and at cuts.

`expose` mixes the stops that a look adds with the last frame's, into the parameters of `apply_cube`. Bindings: previous
and result (3,): 2 ** stops, toe over the frame's exposure, and scale, which act like exposure, toe and scale; current
(1, 1): stops; keep (1, 4); params (3,): the frame's exposure, toe, scale. It mixes stops, not factors. A past with NaN
or infinity counts as none.

`slice_apply` looks up the bilateral grid at every pixel, applies the affine colour matrix found there, then the cube.
Bindings: colour (height, width, 3) scene-linear; params (3,): exposure, toe and scale of the shaper; matrix (9,)
row-major, to the cube's primaries; guide (112,): matrix 9, bias 3, shifts 3x16, slopes 3x16, mix 3, mix bias 1; grid
(1, 16, 16, 8, 12): y, x, guide level, 3x4 matrix row-major; cube (size, size, size, 3): red, green, blue, channel;
output (height, width, 3) in the cube's values. Formula: Gharbi et al. 2017, between the shaper and the cube.

The torch definitions are the functions of these names in `training.tonemap.model`.
"""

from __future__ import annotations

import numpy as np

from postfx.kernels import Kernel
from postfx.kernels.colour import cube_row, shape_row
from postfx.kernels.numeric import Real, compiled, fused, vectorised

SIDE = 256


@fused
def _sum_rows(colour: np.ndarray, params: np.ndarray, matrix: np.ndarray, top: int, bottom: int, total: np.ndarray,
              shaped: np.ndarray, scratch: np.ndarray) -> None:
    """total (3, width) = mean of the shaped rows between `top` and `bottom` (in pixels), each by its share."""
    height, width = colour.shape[0], colour.shape[1]
    total[:] = np.float32(0.0)
    for y in range(int(top), min(int(np.ceil(bottom)), height)):
        weight = np.float32((min(y + 1.0, bottom) - max(float(y), top)) / (bottom - top))
        if weight > 0:
            shape_row(colour[y], params, matrix, shaped, scratch)
            for c in range(3):
                for x in range(width):
                    total[c, x] += weight * shaped[c, x]


@compiled
def lowres_rows(y0: int, y1: int, colour: np.ndarray, params: np.ndarray, matrix: np.ndarray,
                lowres: np.ndarray) -> None:
    """Rows y0..y1-1 of the low-resolution copy."""
    height, width = colour.shape[0], colour.shape[1]
    shaped, scratch = np.empty((3, width), np.float32), np.empty(width, np.int32)
    total = np.empty((3, width), np.float32)
    for y in range(y0, y1):
        _sum_rows(colour, params, matrix, y * height / SIDE, (y + 1) * height / SIDE, total, shaped, scratch)
        for x in range(SIDE):
            left, right = x * width / SIDE, (x + 1) * width / SIDE
            r = g = b = np.float32(0.0)
            for i in range(int(left), min(int(np.ceil(right)), width)):
                weight = np.float32((min(i + 1.0, right) - max(float(i), left)) / (right - left))
                r += weight * total[0, i]
                g += weight * total[1, i]
                b += weight * total[2, i]
            lowres[0, 0, y, x], lowres[0, 1, y, x], lowres[0, 2, y, x] = r, g, b


LOWRES = Kernel(
    name="lowres",
    reads=("colour", "params", "matrix"),
    writes=("lowres",),
    rows=lowres_rows,
    row_axis=("lowres", 2),
    shapes={"colour": ("height", "width", 3), "params": (3,), "matrix": (9,), "lowres": (1, 3, SIDE, SIDE)},
)


@compiled
def light_rows(y0: int, y1: int, lowres: np.ndarray, light: np.ndarray) -> None:
    """Rows y0..y1-1 of the means."""
    for y in range(y0, y1):
        for c in range(3):
            total = np.float64(0.0)
            for x in range(SIDE):
                total += lowres[0, c, y, x]
            light[y, c] = total / SIDE


LIGHT = Kernel(
    name="light",
    reads=("lowres",),
    writes=("light",),
    rows=light_rows,
    row_axis=("light", 0),
    shapes={"lowres": (1, 3, SIDE, SIDE), "light": (SIDE, 3)},
)


LAG, JUMP = np.float64(1 / 4), np.float64(1 / 16)
"""Stops: a camera that crossed a staircase in 8 frames moved the mean by 0.17, by no more than 0.04 in a frame."""
RELEASE, MOST = np.float64(0.95), np.float64(1e4)
"""Stops between two lights that cannot be, as is NaN: there is no past, then."""


@compiled
def follow_rows(y0: int, y1: int, light: np.ndarray, params: np.ndarray, before: np.ndarray, after: np.ndarray) -> None:
    """The one row; in float64, so that nothing depends on the order of the sum."""
    keep, follow, past, scale = params[0], params[1], params[2], params[3]
    for y in range(y0, y1):
        total = np.float64(0.0)
        for value in light.flat:
            total += value
        now = total / light.size / scale
        lag, jump = abs(before[y, 1] - now), abs(before[y, 2] - now)
        after[y, 0], after[y, 1], after[y, 2], after[y, 3] = 0.0, now, now, 0.0
        if past > 0 and lag <= MOST and jump <= MOST and abs(before[y, 3]) <= 1:
            change = min(max(max(lag / LAG, jump / JUMP) - 1, 0.0), 1.0)
            share = max(max(follow * change, RELEASE * before[y, 3]), 1 - keep)
            after[y, 0], after[y, 3] = 1 - share, share
            after[y, 1] = now + (1 - share) * (before[y, 1] - now)


FOLLOW = Kernel(
    name="follow",
    reads=("light", "params", "before"),
    writes=("after",),
    rows=follow_rows,
    row_axis=("after", 0),
    shapes={"light": (SIDE, 3), "params": (4,), "before": (1, 4), "after": (1, 4)},
)


LEVELS, COEFFICIENTS = 8, 12
GRID = (1, 16, 16, LEVELS, COEFFICIENTS)
BROKEN = np.float32(1e4)
"""Change beyond that of any grid, as is NaN: there `previous` counts for nothing."""


@compiled
def smooth_rows(y0: int, y1: int, previous: np.ndarray, current: np.ndarray, keep: np.ndarray,
                result: np.ndarray) -> None:
    """Grid rows y0..y1-1; with keep 0 `previous` is not looked at, so it may hold anything."""
    weight = np.float32(keep[0, 0])
    for y in range(y0, y1):
        for x in range(current.shape[2]):
            for level in range(current.shape[3]):
                for k in range(current.shape[4]):
                    value = current[0, y, x, level, k]
                    change = previous[0, y, x, level, k] - value
                    if weight > 0 and abs(change) <= BROKEN:
                        value += weight * change
                    result[0, y, x, level, k] = value


SMOOTH = Kernel(
    name="smooth",
    reads=("previous", "current", "keep"),
    writes=("result",),
    rows=smooth_rows,
    row_axis=("result", 1),
    shapes={"previous": GRID, "current": GRID, "keep": (1, 4), "result": GRID},
)


MOST_STOPS = np.float64(64)
"""Stops between two exposures that cannot be, as is NaN: there `previous` counts for nothing."""


@compiled
def expose_rows(y0: int, y1: int, previous: np.ndarray, current: np.ndarray, keep: np.ndarray, params: np.ndarray,
                result: np.ndarray) -> None:
    """Numbers y0..y1-1; in float64, so that the exposure of a still picture stays as it is to the bit."""
    stops = np.float64(current[0, 0])
    before = np.log2(np.float64(previous[0])) if previous[0] > 0 else np.nan
    if keep[0, 0] > 0 and abs(before - stops) <= MOST_STOPS:
        stops += keep[0, 0] * (before - stops)
    for y in range(y0, y1):
        if y == 0:
            result[y] = 2.0**stops
        elif y == 1:
            result[y] = params[1] / params[0]
        else:
            result[y] = params[y]


EXPOSE = Kernel(
    name="expose",
    reads=("previous", "current", "keep", "params"),
    writes=("result",),
    rows=expose_rows,
    row_axis=("result", 0),
    shapes={"previous": (3,), "current": (1, 1), "keep": (1, 4), "params": (3,), "result": (3,)},
)


KNOTS = 16
GUIDE_SIZE = 9 + 3 + 6 * KNOTS + 3 + 1
SHIFTS, SLOPES, MIX, MIX_BIAS = 12, 12 + 3 * KNOTS, 12 + 6 * KNOTS, GUIDE_SIZE - 1
ZERO, ONE, HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)


@fused
def _guide_row(shaped: np.ndarray, guide: np.ndarray, mapped: np.ndarray, level: np.ndarray) -> None:
    """Guide of one row: shaped (3, width) -> level (width,), before the clip."""
    width = level.shape[0]
    for x in range(width):
        level[x] = guide[MIX_BIAS]
    for c in range(3):
        r, g, b, bias = guide[3 * c], guide[3 * c + 1], guide[3 * c + 2], guide[9 + c]
        for x in range(width):
            mapped[x] = r * shaped[0, x] + g * shaped[1, x] + b * shaped[2, x] + bias
        mix = guide[MIX + c]
        for k in range(0, KNOTS, 4):
            s = SHIFTS + c * KNOTS + k
            t = SLOPES + c * KNOTS + k
            s0, s1, s2, s3 = guide[s], guide[s + 1], guide[s + 2], guide[s + 3]
            t0, t1, t2, t3 = mix * guide[t], mix * guide[t + 1], mix * guide[t + 2], mix * guide[t + 3]
            for x in range(width):
                v = mapped[x]
                low = t0 * max(v - s0, ZERO) + t1 * max(v - s1, ZERO)
                level[x] += low + (t2 * max(v - s2, ZERO) + t3 * max(v - s3, ZERO))


@fused
def _grid_row(grid: np.ndarray, position: Real, row: np.ndarray) -> None:
    """Grid between two of its rows: (1, gh, gw, gd, 12) at `position` in [0, 1] -> row (gw, gd, 12)."""
    gh, gw, gd = grid.shape[1], grid.shape[2], grid.shape[3]
    y = min(max(position * gh - HALF, ZERO), np.float32(gh - 1))
    y0 = int(y)
    y1, f = min(y0 + 1, gh - 1), y - np.float32(y0)
    for i in range(gw):
        for j in range(gd):
            for k in range(COEFFICIENTS):
                a, b = grid[0, y0, i, j, k], grid[0, y1, i, j, k]
                row[i, j, k] = a + f * (b - a)


@fused
def _add_level(a: np.ndarray, b: np.ndarray, target: Real, across: np.ndarray, red: np.ndarray, green: np.ndarray,
               blue: np.ndarray, depth: np.ndarray, out_red: np.ndarray, out_green: np.ndarray,
               out_blue: np.ndarray) -> None:
    """Add one guide level's share to a span of pixels, which lie between the columns with matrices `a` and `b`."""
    a0, a1, a2, a3, a4, a5 = a[0], a[1], a[2], a[3], a[4], a[5]
    a6, a7, a8, a9, a10, a11 = a[6], a[7], a[8], a[9], a[10], a[11]
    d0, d1, d2, d3, d4, d5 = b[0] - a0, b[1] - a1, b[2] - a2, b[3] - a3, b[4] - a4, b[5] - a5
    d6, d7, d8, d9, d10, d11 = b[6] - a6, b[7] - a7, b[8] - a8, b[9] - a9, b[10] - a10, b[11] - a11
    for x in range(depth.shape[0]):
        weight = max(ONE - abs(depth[x] - target), ZERO)
        f, r, g, b_ = across[x], red[x] * weight, green[x] * weight, blue[x] * weight
        out_red[x] += (a0 + f * d0) * r + (a1 + f * d1) * g + (a2 + f * d2) * b_ + (a3 + f * d3) * weight
        out_green[x] += (a4 + f * d4) * r + (a5 + f * d5) * g + (a6 + f * d6) * b_ + (a7 + f * d7) * weight
        out_blue[x] += (a8 + f * d8) * r + (a9 + f * d9) * g + (a10 + f * d10) * b_ + (a11 + f * d11) * weight


@fused
def _apply_row(spans: np.ndarray, across: np.ndarray, shaped: np.ndarray, depth: np.ndarray, row: np.ndarray,
               total: np.ndarray) -> None:
    """Sum the affine colours of all guide levels into total (3, width).

    Pixels between two grid columns share their matrices, so each level is one vector loop over them; levels that no
    pixel of the span is near are left out. Measured several times as fast as a look-up a pixel.
    """
    gw, gd = row.shape[0], row.shape[1]
    total[:] = ZERO
    for span in range(gw + 1):
        x0, x1 = spans[span], spans[span + 1]
        if x1 > x0:
            near = depth[x0:x1]
            low, high = _limits(near)
            left, right, f = max(span - 1, 0), min(span, gw - 1), across[x0:x1]
            r, g, b = shaped[0, x0:x1], shaped[1, x0:x1], shaped[2, x0:x1]
            to_r, to_g, to_b = total[0, x0:x1], total[1, x0:x1], total[2, x0:x1]
            for j in range(int(low), min(int(high) + 2, gd)):
                _add_level(row[left, j], row[right, j], np.float32(j), f, r, g, b, near, to_r, to_g, to_b)


@vectorised
def _limits(values: np.ndarray) -> tuple[Real, Real]:
    """Smallest and largest of finite values."""
    low = high = values[0]
    for x in range(values.shape[0]):
        low, high = min(low, values[x]), max(high, values[x])
    return low, high


@compiled
def _columns(width: int, gw: int, spans: np.ndarray, across: np.ndarray) -> None:
    """First pixel of each span between grid columns (gw + 2,), and how far across its span each pixel is, 0..1."""
    spans[0], spans[gw + 1] = 0, width
    for span in range(1, gw + 1):
        spans[span] = min(max(int(np.ceil((span - 0.5) * width / gw - 0.5)), spans[span - 1]), width)
    for span in range(gw + 1):
        for x in range(spans[span], spans[span + 1]):
            across[x] = min(max((x + 0.5) * gw / width - 0.5 - (span - 1), 0.0), 1.0)


@compiled
def slice_apply_rows(y0: int, y1: int, colour: np.ndarray, params: np.ndarray, matrix: np.ndarray, guide: np.ndarray,
                     grid: np.ndarray, cube: np.ndarray, output: np.ndarray) -> None:
    """Output rows y0..y1-1."""
    height, width, levels = colour.shape[0], colour.shape[1], np.float32(grid.shape[3])
    shaped, scratch = np.empty((3, width), np.float32), np.empty(width, np.int32)
    total = np.empty((3, width), np.float32)
    depth, mapped = np.empty(width, np.float32), np.empty(width, np.float32)
    places, shares = np.empty((3, width), np.int32), np.empty((3, width), np.float32)
    spans, across = np.empty(grid.shape[2] + 2, np.int64), np.empty(width, np.float32)
    _columns(width, grid.shape[2], spans, across)
    row = np.empty((grid.shape[2], grid.shape[3], COEFFICIENTS), np.float32)
    for y in range(y0, y1):
        shape_row(colour[y], params, matrix, shaped, scratch)
        _guide_row(shaped, guide, mapped, depth)
        for x in range(width):
            depth[x] = min(max(depth[x] * levels - HALF, ZERO), levels - ONE)
        _grid_row(grid, (np.float32(y) + HALF) / np.float32(height), row)
        _apply_row(spans, across, shaped, depth, row, total)
        cube_row(total, cube, places, shares, output[y])


SLICE_APPLY = Kernel(
    name="slice_apply",
    reads=("colour", "params", "matrix", "guide", "grid", "cube"),
    writes=("output",),
    rows=slice_apply_rows,
    row_axis=("output", 0),
    shapes={
        "colour": ("height", "width", 3),
        "params": (3,),
        "matrix": (9,),
        "guide": (GUIDE_SIZE,),
        "grid": GRID,
        "cube": ("size", "size", "size", 3),
        "output": ("height", "width", 3),
    },
)
