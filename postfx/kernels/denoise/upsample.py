"""Kernels that enlarge the filtered radiance by predicted weights, sharpen it, and blend it with the last output.

Every output row is made in planar rows and interleaved at its end. The work is split into many small loops over few
arrays, because those become vector code.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from postfx.kernels.denoise import (
    BLEND,
    BOTH,
    EXPOSURE,
    GUIDE_REFLECTANCE,
    HEIGHT,
    JITTER_X,
    JITTER_Y,
    LEFT,
    MAX_FLOAT,
    MIX,
    MOST_LOG,
    OUT_HEIGHT,
    OUT_LEFT,
    OUT_TOP,
    OUT_WIDTH,
    SHARPEN,
    TAP_WEIGHTS,
    TINY,
    TOP,
    WIDTH,
    in_half,
    kernel,
)
from postfx.kernels.denoise.features import place_of, trust_row
from postfx.kernels.denoise.history import kept_row
from postfx.kernels.denoise.network_io import Coded, open_fine_codes, room_for_codes
from postfx.kernels.numeric import (
    Real,
    between,
    centre,
    compiled,
    demodulation,
    expm1,
    fused,
    inline,
    interleave,
    log_encode,
    place,
    repeat_three,
    vectorised,
    weigh_picked,
    weigh_three,
)
from postfx.kernels.vectors import in_lanes

SIGMA, WIDE_SIGMA = 0.5, 1.0
NONE, GUIDED, OWN = range(3)
"""Reflectance that radiance is multiplied by while it is enlarged: none, the guides', the render pixels' own."""
ZERO, HALF = np.float32(0), np.float32(0.5)


@inline
def gauss(distance: Real) -> Real:
    """Weight of a sample for an output pixel at a distance in render pixels."""
    return np.float32(math.exp(-(distance * distance) / (2 * SIGMA * SIGMA)))


@inline
def wide_gauss(offset: Real) -> tuple[Real, Real, Real]:
    """Normalised weights of the samples at -1, 0 and 1 plus ``offset`` for the softened picture."""
    a = math.exp(-((offset - 1) * (offset - 1)) / (2 * WIDE_SIGMA * WIDE_SIGMA))
    b = math.exp(-(offset * offset) / (2 * WIDE_SIGMA * WIDE_SIGMA))
    c = math.exp(-((offset + 1) * (offset + 1)) / (2 * WIDE_SIGMA * WIDE_SIGMA))
    total = a + b + c
    return np.float32(a / total), np.float32(b / total), np.float32(c / total)


@inline
def lean(offset: Real) -> Real:
    """Share of the right or lower of the two quarter-pixel corners at an offset."""
    return np.float32(min(max(2 * offset + 0.5, 0.0), 1.0))


@inline
def pixel_of(position: int, side: int, window: np.ndarray, size: int) -> tuple[int, Real]:
    """The render pixel that holds the centre of a row (``side`` TOP) or column (LEFT) of a window's output, of the
    window's ``size`` rows or columns, and how far off its centre."""
    full, out = int(window[HEIGHT + side]), int(window[OUT_HEIGHT + side])
    at, offset = centre(min(int(window[OUT_TOP + side]) + position, out - 1), full, out)
    return min(max(at - int(window[TOP + side]), 0), size - 1), offset


@inline
def is_doubled(window: np.ndarray) -> bool:
    """Whether the output has twice the frame's rows and columns."""
    return bool(window[OUT_WIDTH] == 2 * window[WIDTH] and window[OUT_HEIGHT] == 2 * window[HEIGHT])


@inline
def is_inside(px: Real, py: Real, width: Real, height: Real) -> Real:
    """Whether a position lies in a picture."""
    return -HALF <= px <= np.float32(width) - HALF and -HALF <= py <= np.float32(height) - HALF


@vectorised
def lean_on(corners: np.ndarray, index: np.ndarray, leans: np.ndarray, out: np.ndarray) -> None:
    """Linear interpolation between the left and right corners of the pixels at ``index``."""
    for x in range(index.size):
        at = index[x]
        out[x] = corners[0, at] + (corners[1, at] - corners[0, at]) * leans[x]


@vectorised
def add_picked(corners: np.ndarray, source: np.ndarray, gauss_x: np.ndarray, index: np.ndarray, leans: np.ndarray,
               total: np.ndarray, row: np.ndarray) -> None:
    """Add a tap to a row at any scale; ``index`` and ``leans`` say which pixel and how far right in it."""
    for x in range(index.size):
        at = index[x]
        k = (corners[0, at] + (corners[1, at] - corners[0, at]) * leans[x]) * gauss_x[x]
        total[x] += k
        for c in range(3):
            row[c, x] += k * source[c, at]


@vectorised
def encode_sharp(row: np.ndarray, total: np.ndarray, soft: np.ndarray, sharpen: np.ndarray) -> None:
    """Normalise a row by its sum of weights, log-encode it, and sharpen it against a softened one."""
    for x in range(total.size):
        row[x] = log_encode(row[x] / total[x])
    for x in range(total.size):
        row[x] = max(row[x] + sharpen[x] * (row[x] - log_encode(soft[x])), ZERO)


TAPS = 9
WIDE = 16
"""Pixels whose taps are weighed at once."""
ONE, MOST_LIGHT = np.float32(1), np.float32(MAX_FLOAT)


@fused
def blend_rows(current: np.ndarray, warped: np.ndarray, trust: np.ndarray, darken: Real, history: np.ndarray,
               output: np.ndarray) -> None:
    """Blend with the reprojected history and decode, all channels interleaved; rounding never makes light negative, and
    broken values count as 0."""
    for i in range(history.size):
        now = current[i] if current[i] <= MOST_LOG else ZERO
        mixed = now + (warped[i] - now) * trust[i]
        history[i] = max(mixed, ZERO) if mixed <= MOST_LOG else now
    for i in range(history.size):
        output[i] = expm1(history[i]) * darken


@fused
def factor_row(y: int, left: int, diffuse_albedo: np.ndarray, specular_albedo: np.ndarray, guide: np.ndarray) -> None:
    """The guides' reflectance in a row of the output, planar."""
    for x in range(guide.shape[1]):
        at = min(left + x, diffuse_albedo.shape[1] - 1)
        guide[0, x], guide[1, x], guide[2, x] = demodulation(diffuse_albedo, specular_albedo, y, at)


@vectorised
def multiply(by: np.ndarray, row: np.ndarray) -> None:
    for x in range(row.size):
        row[x] *= by[x]


@compiled
def own_factor_row(factor: np.ndarray, index: np.ndarray, own: np.ndarray) -> None:
    """The render pixels' reflectance in a row of the output, planar."""
    for x in range(index.size):
        for c in range(3):
            own[c, x] = factor[index[x], c]


@vectorised
def guided_row(plain: np.ndarray, factor: np.ndarray, trust: np.ndarray, first: int, step: int,
               row: np.ndarray) -> None:
    """A row without reflectance times the guides' reflectance, every ``step``-th pixel from ``first`` on, as far as the
    guides are trusted; the rest is the ``plain`` row, which has the reflectance of the render size."""
    for x in range(row.size):
        at = first + step * x
        row[x] = plain[x] + (row[x] * factor[at] - plain[x]) * trust[at]


@compiled
def trust_side(first: int, y: Real, size: tuple[int, int], moved: np.ndarray, past: np.ndarray,
               scale: tuple[Real, Real], share: np.ndarray, trust: np.ndarray) -> None:
    """At scale 2, how much of the history each output pixel on one side of the render pixels keeps, from ``first`` on.

    ``share`` is how much each render pixel may keep, ``trust`` the predicted blend at first; nothing is kept where the
    pixel lay beyond the border, or where the history does not hold it. Flat arrays, numbers of 32 bits and tests
    without jumps become vector code.
    """
    flat, held_count, (across, down) = moved.reshape(moved.size), past.reshape(past.size), scale
    right, bottom = np.float32(size[0]) - HALF, np.float32(size[1]) - HALF
    for x in range(trust.size):
        px, py = np.float32(np.int32(2 * x + first)) + flat[2 * x] * across, y + flat[2 * x + 1] * down
        inside = (px >= -HALF) & (px <= right) & (py >= -HALF) & (py <= bottom) & (held_count[4 * x + 3] >= ZERO)
        kept = share[x] * (ONE - trust[x])
        trust[x] = kept if inside else ZERO


@compiled
def trust_picked(left: int, y: Real, size: tuple[int, int], moved: np.ndarray, past: np.ndarray,
                 scale: tuple[Real, Real], share: np.ndarray, index: np.ndarray, blend: np.ndarray,
                 trust: np.ndarray) -> None:
    """The same for a row at any scale, three times a pixel."""
    for x in range(index.size):
        at = index[x]
        px, py = np.float32(left + x) + moved[at, 0] * scale[0], y + moved[at, 1] * scale[1]
        inside = is_inside(px, py, size[0], size[1]) and past[at, 3] >= ZERO
        trust[3 * x] = trust[3 * x + 1] = trust[3 * x + 2] = share[at] * (ONE - blend[x]) if inside else ZERO


@inline
def soften(line: np.ndarray, wide_x: np.ndarray, side: int, out: np.ndarray) -> None:
    """The wide Gaussian of a row of the softened picture, at one side of the render pixels."""
    weigh_three(line, line[1:], line[2:], wide_x[0, side], wide_x[1, side], wide_x[2, side], out)


@in_lanes(WIDE, results=0)
def weigh_some(v: Any, weights: Any, at: Any, phase: Any, tap: Any, scales: Any, samples: Any, to: Any, line: Any,
               plane: Any, found: Any, even: Any, odd: Any, sums: Any, row: Any) -> None:
    """Some pixels of `weigh_taps`: places in the flat arrays, and steps there."""
    sides = [[v.constant([float(TINY)] * WIDE), *[v.constant([0.0] * WIDE)] * 3] for _ in range(2)]
    for k in range(TAPS):
        place = v.step(v.step(to, line, k // 3), 1, k % 3)
        pixels = [v.load(samples, v.step(place, plane, c)) for c in range(3)]
        for side, (whole, *light) in enumerate(sides):
            weight = v.load(weights, v.step(v.step(at, phase, side), tap, k)) * v.repeat(scales, TAPS * side + k)
            sides[side] = [whole + weight, *(one + weight * pixel for one, pixel in zip(light, pixels, strict=True))]
    for side, (whole, *light) in enumerate(sides):
        v.store(found, v.step(sums, row, side), whole)
        for c, one in enumerate(light):
            v.store(found, v.step((even, odd)[side], row, c), one)


@fused
def weigh_taps(lower: int, iy: int, fine: np.ndarray, row: int, scales: np.ndarray, radiance: np.ndarray, channel: int,
               rows: np.ndarray) -> None:
    """Weighted sums of 3x3 samples of three planes, from a `channel` on, for a row at scale 2: into `rows` of the even
    pixels' channels, then the odd ones', and the sums of their weights. `scales` are those of the taps by distance."""
    (_, _, hp, wp), (channels, tall, wide), w = fine.shape, radiance.shape, rows.shape[1]
    weights, samples, found = fine.reshape(fine.size), radiance.reshape(radiance.size), rows.reshape(rows.size)
    at, to = ((TAP_WEIGHTS + 2 * lower) * hp + row) * wp, (channel * tall + iy) * wide
    for block in range((w + WIDE - 1) // WIDE):
        x = min(WIDE * block, w - WIDE)
        weigh_some(weights, at + x, hp * wp, 4 * hp * wp, scales, samples, to + x, wide, tall * wide, found,
                   channel * w + x, (channels + channel) * w + x, 2 * channels * w + x, w)


@compiled
def double_row(y: int, left: int, iy: int, lower: int, radiance: np.ndarray, column: np.ndarray, fine: np.ndarray,
               at: int, moved: np.ndarray, past: np.ndarray, gauss_x: np.ndarray, gauss_y: np.ndarray,
               wide_x: np.ndarray, size: tuple[int, int], scale: tuple[Real, Real], share: np.ndarray,
               guide: np.ndarray, rows: np.ndarray, soft: np.ndarray, current: np.ndarray, trust: np.ndarray) -> None:
    """A row at scale 2, where output pixels lie at the corners of render pixels: all loops are free of gaps. The fine
    head has the pixels ``iy`` in its row ``at``."""
    channels, w, scales = radiance.shape[0], rows.shape[1], np.empty(2 * TAPS, np.float32)
    sums, line = rows[2 * channels:2 * channels + 2], rows[2 * channels + 2]
    for tap in range(TAPS):
        for side in range(2):
            scales[TAPS * side + tap] = gauss_y[tap // 3] * gauss_x[tap % 3, side]
    for channel in range(0, channels, 3):
        weigh_taps(lower, iy, fine, at, scales, radiance, channel, rows)
    for side in range(2):
        found = rows[side * channels:(side + 1) * channels]
        for c in range(3):
            soften(column[c], wide_x, side, soft)
            if channels > 3:
                soften(column[3 + c], wide_x, side, line)
                guided_row(line, guide[c], guide[3], side, 2, soft)
                guided_row(found[3 + c], guide[c], guide[3], side, 2, found[c])
            encode_sharp(found[c], sums[side], soft, fine[0, SHARPEN + 2 * lower + side, at])
    interleave(rows[:3], rows[channels:], current)
    for side in range(2):  # in the rows of sums, which are done with
        sums[side] = fine[0, BLEND + 2 * lower + side, at, :w]
        trust_side(left + side, np.float32(y), size, moved[iy], past[iy], scale, share, sums[side])
    repeat_three(sums[0], sums[1], trust)


@compiled
def control_row(first: int, iy: int, ty: Real, fine: np.ndarray, index: np.ndarray, leans: np.ndarray,
                corners: np.ndarray, out: np.ndarray) -> None:
    """A control that is predicted at four phases, for a row at any scale."""
    for side in range(2):
        between(fine[0, first + side, iy], fine[0, first + 2 + side, iy], ty, ONE, corners[side])
    lean_on(corners, index, leans, out)


@compiled
def any_row(y: int, left: int, iy: int, ty: Real, radiance: np.ndarray, column: np.ndarray, fine: np.ndarray,
            at: int, moved: np.ndarray, past: np.ndarray, gauss_x: np.ndarray, gauss_y: np.ndarray, wide_x: np.ndarray,
            size: tuple[int, int], scale: tuple[Real, Real], share: np.ndarray, guide: np.ndarray, index: np.ndarray,
            leans: np.ndarray, corners: np.ndarray, rows: np.ndarray, soft: np.ndarray, current: np.ndarray,
            trust: np.ndarray) -> None:
    """A row at any scale; radiance of three channels is multiplied by the factors in `guide` if it has some."""
    channels, w = radiance.shape[0], corners.shape[1]
    total, line, sharpen = rows[channels], rows[channels + 1], rows[channels + 2]
    rows[:channels], rows[channels] = ZERO, TINY
    for tap in range(TAPS):
        j, i = tap // 3, tap % 3
        for side in range(2):
            corner = TAP_WEIGHTS + 4 * tap + side
            between(fine[0, corner, at], fine[0, corner + 2, at], ty, gauss_y[j], corners[side])
        add_picked(corners, radiance[:3, iy + j, i:i + w], gauss_x[i], index, leans, total, rows[:3])
        if channels > 3:
            add_picked(corners, radiance[3:, iy + j, i:i + w], gauss_x[i], index, leans, line, rows[3:6])
    control_row(SHARPEN, at, ty, fine, index, leans, corners, sharpen)
    for c in range(3):
        weigh_picked(column[c], wide_x, index, soft)
        if channels > 3:
            weigh_picked(column[3 + c], wide_x, index, line)
            guided_row(line, guide[c], guide[3], 0, 1, soft)
            guided_row(rows[3 + c], guide[c], guide[3], 0, 1, rows[c])
        elif guide.shape[1] > 0:
            multiply(guide[c], soft)
            multiply(guide[c], rows[c])
        encode_sharp(rows[c], total, soft, sharpen)
        place(rows[c], c, 3, current)
    control_row(BLEND, at, ty, fine, index, leans, corners, line)
    trust_picked(left, np.float32(y), size, moved[iy], past[iy], scale, share, index, line, trust)


@compiled
def resolve_rows(y0: int, y1: int, radiance: np.ndarray, fine: np.ndarray, coded: Coded, moved: np.ndarray,
                 past: np.ndarray, warped: np.ndarray, diffuse_albedo: np.ndarray, specular_albedo: np.ndarray,
                 cells: np.ndarray, factor: np.ndarray, by: int, params: np.ndarray, window: np.ndarray,
                 keep: np.ndarray, output: np.ndarray, history: np.ndarray) -> None:
    """Output pixels from 3x3 samples by predicted weight and distance, blended with the reprojected history.

    If there are codes, the fine head is made of them, two rows at a time. The albedos have the frame's output size;
    they and the cells of trust are looked at only ``by`` GUIDED reflectance, and the ``factor`` of the render size only
    by the OWN one.
    """
    frame_h, frame_w, frame_height, frame_width = (int(window[HEIGHT]), int(window[WIDTH]), int(window[OUT_HEIGHT]),
                                                   int(window[OUT_WIDTH]))
    channels, (h, w) = radiance.shape[0], moved.shape[:2]
    height, width = output.shape[:2]
    left = int(window[OUT_LEFT])
    size = frame_width, frame_height
    scale = np.float32(frame_width / frame_w), np.float32(frame_height / frame_h)
    index, leans = np.empty(width, np.int64), np.empty(width, np.float32)
    gauss_x, gauss_y = np.empty((3, width), np.float32), np.empty(3, np.float32)
    wide_x, places = np.empty((3, width), np.float32), np.empty(width, np.float32)
    held_h, held_w = min(h, frame_h - int(window[TOP])), min(w, frame_w - int(window[LEFT]))
    for x in range(width):
        index[x], offset = pixel_of(x, LEFT, window, w)
        places[x] = place_of(index[x], offset, held_w)
        leans[x] = lean(offset)
        wide_x[0, x], wide_x[1, x], wide_x[2, x] = wide_gauss(params[JITTER_X] - offset)
        for i in range(3):
            gauss_x[i, x] = gauss(i - 1 + params[JITTER_X] - offset)
    double = is_doubled(window) and w >= WIDE
    (codes, factors, scaling), pair = coded, -1
    room, lines = room_for_codes(codes), 2 if codes.size > 0 else 1
    opened = fine.reshape((1, fine.shape[1], fine.shape[2] // lines, lines, fine.shape[3]))
    corners = np.empty((2, w), np.float32)
    rows = np.empty((2 * channels + 3, w) if double else (channels + 3, width), np.float32)
    column, soft = np.empty((channels, w + 2), np.float32), np.empty(rows.shape[1], np.float32)
    current, trust = np.empty(3 * width, np.float32), np.empty(3 * width, np.float32)
    share = np.empty(w, np.float32)
    guide = np.empty((4, width if by in (GUIDED, OWN) else 0), np.float32)
    for row in range(y0, y1):
        y = min(int(window[OUT_TOP]) + row, frame_height - 1)
        iy, offset = pixel_of(row, TOP, window, h)
        at = iy % 2 if lines == 2 else iy
        if lines == 2 and pair != iy // 2:
            pair = iy // 2
            open_fine_codes(codes[0, pair], factors, scaling, (TAP_WEIGHTS, MIX), room, opened, 0, 0)
        kept_row(keep, iy, share)
        upper, middle, lower = wide_gauss(params[JITTER_Y] - offset)
        for j in range(3):
            gauss_y[j] = gauss(j - 1 + params[JITTER_Y] - offset)
        for c in range(channels):
            weigh_three(radiance[c, iy], radiance[c, iy + 1], radiance[c, iy + 2], upper, middle, lower, column[c])
        if by == OWN:
            own_factor_row(factor[iy], index, guide)
        if by == GUIDED:
            factor_row(y, left, diffuse_albedo, specular_albedo, guide)
            trust_row(cells, place_of(iy, offset, held_h), places, guide[3])
        if double:
            double_row(y, left, iy, y % 2, radiance, column, fine, at, moved, past, gauss_x, gauss_y, wide_x, size,
                       scale, share, guide, rows, soft, current, trust)
        else:
            any_row(y, left, iy, lean(offset), radiance, column, fine, at, moved, past, gauss_x, gauss_y, wide_x, size,
                    scale, share, guide, index, leans, corners, rows, soft, current, trust)
        blend_rows(current, warped[row].reshape(3 * width), trust, ONE / params[EXPOSURE],
                   history[row].reshape(3 * width), output[row].reshape(3 * width))


@inline
def no_codes() -> Coded:
    """Where the fine head is there."""
    return np.empty((0, 0, 0, 0), np.uint8), np.empty((0, 0), np.int8), np.empty((0, 0), np.float32)


@inline
def room_for_pair(codes: np.ndarray) -> np.ndarray:
    """Two rows of the fine head, to be made of codes."""
    return np.empty((1, MIX, 2, 2 * codes.shape[2]), np.float32)


@compiled
def upsample_rows(y0: int, y1: int, radiance: np.ndarray, fine: np.ndarray, moved: np.ndarray, past: np.ndarray,
                  warped: np.ndarray, params: np.ndarray, window: np.ndarray, keep: np.ndarray, output: np.ndarray,
                  history: np.ndarray) -> None:
    """Radiance that already holds the reflectance."""
    resolve_rows(y0, y1, radiance, fine, no_codes(), moved, past, warped, warped, warped, warped, warped, NONE, params,
                 window, keep, output, history)


@compiled
def upsample_codes_rows(y0: int, y1: int, radiance: np.ndarray, codes: np.ndarray, factors: np.ndarray,
                        scaling: np.ndarray, moved: np.ndarray, past: np.ndarray, warped: np.ndarray,
                        params: np.ndarray, window: np.ndarray, keep: np.ndarray, output: np.ndarray,
                        history: np.ndarray) -> None:
    """The same, where the fine head is made of codes."""
    resolve_rows(y0, y1, radiance, room_for_pair(codes), (codes, factors, scaling), moved, past, warped, warped, warped,
                 warped, warped, NONE, params, window, keep, output, history)


@compiled
def guided_rows(y0: int, y1: int, radiance: np.ndarray, fine: np.ndarray, moved: np.ndarray, past: np.ndarray,
                warped: np.ndarray, diffuse_albedo: np.ndarray, specular_albedo: np.ndarray, trust: np.ndarray,
                params: np.ndarray, window: np.ndarray, keep: np.ndarray, output: np.ndarray,
                history: np.ndarray) -> None:
    """Radiance without reflectance. It gets the guides' reflectance at output size as far as the guides are trusted;
    the rest has the reflectance of the render size."""
    resolve_rows(y0, y1, radiance, fine, no_codes(), moved, past, warped, diffuse_albedo, specular_albedo, trust,
                 warped, GUIDED, params, window, keep, output, history)


@compiled
def guided_codes_rows(y0: int, y1: int, radiance: np.ndarray, codes: np.ndarray, factors: np.ndarray,
                      scaling: np.ndarray, moved: np.ndarray, past: np.ndarray, warped: np.ndarray,
                      diffuse_albedo: np.ndarray, specular_albedo: np.ndarray, trust: np.ndarray, params: np.ndarray,
                      window: np.ndarray, keep: np.ndarray, output: np.ndarray, history: np.ndarray) -> None:
    """The same, where the fine head is made of codes."""
    resolve_rows(y0, y1, radiance, room_for_pair(codes), (codes, factors, scaling), moved, past, warped, diffuse_albedo,
                 specular_albedo, trust, warped, GUIDED, params, window, keep, output, history)


@compiled
def unscaled_rows(y0: int, y1: int, radiance: np.ndarray, fine: np.ndarray, moved: np.ndarray, past: np.ndarray,
                  warped: np.ndarray, factor: np.ndarray, params: np.ndarray, window: np.ndarray, keep: np.ndarray,
                  output: np.ndarray, history: np.ndarray) -> None:
    """Radiance without reflectance, which is multiplied after the samples are weighed where they lie at the centres of
    the output's pixels: texture of one pixel is not resampled. Else radiance that already holds it."""
    resolve_unscaled(y0, y1, radiance, fine, no_codes(), moved, past, warped, factor, params, window, keep, output,
                     history)


@compiled
def unscaled_codes_rows(y0: int, y1: int, radiance: np.ndarray, codes: np.ndarray, factors: np.ndarray,
                        scaling: np.ndarray, moved: np.ndarray, past: np.ndarray, warped: np.ndarray,
                        factor: np.ndarray, params: np.ndarray, window: np.ndarray, keep: np.ndarray,
                        output: np.ndarray, history: np.ndarray) -> None:
    """The same, where the fine head is made of codes."""
    resolve_unscaled(y0, y1, radiance, room_for_pair(codes), (codes, factors, scaling), moved, past, warped, factor,
                     params, window, keep, output, history)


@compiled
def resolve_unscaled(y0: int, y1: int, radiance: np.ndarray, fine: np.ndarray, coded: Coded, moved: np.ndarray,
                     past: np.ndarray, warped: np.ndarray, factor: np.ndarray, params: np.ndarray, window: np.ndarray,
                     keep: np.ndarray, output: np.ndarray, history: np.ndarray) -> None:
    """Output pixels where no enlarging is needed."""
    if params[JITTER_X] == ZERO and params[JITTER_Y] == ZERO:
        resolve_rows(y0, y1, radiance[:3], fine, coded, moved, past, warped, warped, warped, warped, factor, OWN,
                     params, window, keep, output, history)
    else:
        resolve_rows(y0, y1, radiance[3:], fine, coded, moved, past, warped, warped, warped, warped, factor, NONE,
                     params, window, keep, output, history)


WRITES = ("output", "next_history")
BETWEEN, LAST = ("moved", "past", "warped"), ("params", "window", "keep")
HELD, CODED = ("radiance", "fine", *BETWEEN), ("radiance", "codes", "factors", "scaling", *BETWEEN)
GUIDES_READ = (*GUIDE_REFLECTANCE, "trust")
UPSAMPLE = kernel("upsample", (*HELD, *LAST), WRITES, upsample_rows, ("output", 0))
UPSAMPLE_GUIDED = kernel("upsample_guided", (*HELD, *GUIDES_READ, *LAST), WRITES, guided_rows, ("output", 0),
                         radiance=BOTH)
UPSAMPLE_UNSCALED = kernel("upsample_unscaled", (*HELD, "factor", *LAST), WRITES, unscaled_rows, ("output", 0),
                           radiance=BOTH)
CODES_PLAIN = kernel("upsample_codes", (*CODED, *LAST), WRITES, upsample_codes_rows, ("output", 0))
CODES_GUIDED = kernel("upsample_guided_codes", (*CODED, *GUIDES_READ, *LAST), WRITES, guided_codes_rows, ("output", 0),
                      radiance=BOTH)
CODES_UNSCALED = kernel("upsample_unscaled_codes", (*CODED, "factor", *LAST), WRITES, unscaled_codes_rows,
                        ("output", 0), radiance=BOTH)
UPSAMPLE, UPSAMPLE_GUIDED = (replace(one, pixels=(2, 2)) for one in (UPSAMPLE, UPSAMPLE_GUIDED))
for one in (UPSAMPLE, UPSAMPLE_GUIDED, UPSAMPLE_UNSCALED):
    in_half(one, "fine")
