"""Kernels that make the output: lost detail restored, tiles assembled into the frame, and a blend by strength.

Detail: the removed part, input minus result, looks alike everywhere if it was noise, and has structure if it was
detail. So the kernels judge tiles of the picture: by correlations of the difference between near pixels, less those of
the whole frame, because a renderer's filter may spread samples over several pixels; by correlations between far pixels,
which no filter reaches; and by its size, because barely visible differences do no harm. If most of the removed part is
detail, the whole frame counts as clean. Only for results of the input's size with samples spread over the pixel.

Tiles: each row of ``places`` (n, 10) describes one of ``tiles`` (n, th, tw, channels) in rows and columns of the frame:
its first pixel (2), the area that may be used (4), and the area to use before all other tiles (4); areas are top, left,
bottom, right, the last two exclusive. The first of several tiles counts. ``frame_rows`` and ``frame_columns`` are the
rows and columns of the frame to write; pixels of no tile become 0.
"""

from __future__ import annotations

import math

import numpy as np

from postfx.kernels.denoise import EXPOSURE, MAX_COLOUR, MAX_FLOAT, PLANES, kernel
from postfx.kernels.numeric import Real, add_product, clamp, compiled, inline, vectorised

# Detail

TILE = 16
LAGS = ((0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0), (0, 4), (4, 0))
NEAR = 6  # the first lags, which a pixel filter reaches
COUNT, POWER, HELD_POWER, FIRST = 0, 1, 2, 3
SUMS = FIRST + len(LAGS)
LIMIT = 3.0  # times a tile's root mean square: larger differences, such as fireflies, are clamped to it
DARK = 1e-3  # exposed luminance below which smaller differences are no more visible
STRUCTURE = (0.45, 0.8)  # root of the summed squares of the correlations, from noise to detail
INVISIBLE = (10**-6.4, 10**-5.6)  # mean square of the visible difference, from invisible to visible
CLEAN = (0.35, 0.55)  # share of detail in what was removed from the frame, from noisy to clean
FILTERED = (10**-4.2, 10**-3.5)  # mean square of the frame, from too little to enough for filtered noise
LOUD = (10**-1.8, 10**-1.4)  # the same, from possibly clean to certainly noisy
SPREAD_NOISE = 2.25  # squares of the weights 1 2 1 by 1 2 1, summed, over their sum: how noisy a spread tile is
ZERO, ONE, TINY_POWER = np.float32(0), np.float32(1), np.float32(1e-12)


@inline
def light(colour: np.ndarray, y: int, x: int, exposure: Real) -> Real:
    """Exposed luminance of a pixel, within what the network sees."""
    r = min(clamp(colour[y, x, 0], ZERO, MAX_FLOAT) * exposure, np.float32(MAX_COLOUR))
    g = min(clamp(colour[y, x, 1], ZERO, MAX_FLOAT) * exposure, np.float32(MAX_COLOUR))
    b = min(clamp(colour[y, x, 2], ZERO, MAX_FLOAT) * exposure, np.float32(MAX_COLOUR))
    return np.float32(0.2126) * r + np.float32(0.7152) * g + np.float32(0.0722) * b


@compiled
def difference_rows(top: int, colour: np.ndarray, denoised: np.ndarray, exposure: Real, removed: np.ndarray) -> None:
    """The removed part as the eye sees it: times the slope of sqrt(y / (1 + y)) at the result, within [-1, 1]."""
    for y in range(removed.shape[0]):
        for x in range(removed.shape[1]):
            clean = light(denoised, top + y, x, exposure)
            seen = max(clean, np.float32(DARK))
            slope = np.float32(0.5) / (np.sqrt(seen * (ONE + seen)) * (ONE + seen))
            removed[y, x] = min(max((light(colour, top + y, x, exposure) - clean) * slope, -ONE), ONE)


@vectorised
def hold(row: np.ndarray, limit: np.ndarray) -> None:
    """The row within plus and minus the limit."""
    for x in range(row.size):
        row[x] = min(max(row[x], -limit[x]), limit[x])


@compiled
def products(removed: np.ndarray, dy: int, dx: int, total: np.ndarray) -> None:
    """Products of pixels with their neighbours at a lag, summed down the rows of ``removed``."""
    height, width = removed.shape
    first, last = max(0, -dx), max(0, width - max(0, dx))
    total[:] = ZERO
    for y in range(height - dy):
        add_product(removed[y, first:last], removed[y + dy, first + dx:last + dx], total[first:last])


@compiled
def across_tiles(total: np.ndarray, dy: int, dx: int, sums: np.ndarray) -> None:
    """Sums of the columns of every tile, without those whose neighbour lies in another, per whole tile of pairs."""
    scale = np.float32(TILE * TILE / ((TILE - dy) * (TILE - abs(dx))))
    for column in range(sums.size):
        left = column * TILE
        found = ZERO
        for x in range(left + max(0, -dx), min(left + TILE - max(0, dx), total.size)):
            found += total[x]
        sums[column] = found * scale


@compiled
def judge_rows(y0: int, y1: int, colour: np.ndarray, denoised: np.ndarray, params: np.ndarray,
               sums: np.ndarray) -> None:
    """Sums over the removed part of each tile of 16 x 16 pixels."""
    h, w = colour.shape[:2]
    removed, total, limit = np.empty((TILE, w), np.float32), np.empty(w, np.float32), np.empty(w, np.float32)
    for row in range(y0, y1):
        rows = min(TILE, h - row * TILE)
        inner = removed[:rows]
        difference_rows(row * TILE, colour, denoised, params[EXPOSURE], inner)
        products(inner, 0, 0, total)
        across_tiles(total, 0, 0, sums[row, :, POWER])
        for column in range(sums.shape[1]):
            left, right = column * TILE, min(column * TILE + TILE, w)
            sums[row, column, COUNT] = np.float32(rows * (right - left))
            limit[left:right] = np.float32(LIMIT) * np.sqrt(sums[row, column, POWER] / sums[row, column, COUNT])
        for y in range(rows):
            hold(inner[y], limit)
        products(inner, 0, 0, total)
        across_tiles(total, 0, 0, sums[row, :, HELD_POWER])
        for k, (dy, dx) in enumerate(LAGS):
            products(inner, dy, dx, total)
            across_tiles(total, dy, dx, sums[row, :, FIRST + k])


@inline
def ramp(value: Real, low: Real, high: Real) -> Real:
    """0 up to `low`, 1 from `high` on, linear between."""
    return min(max((value - np.float32(low)) / np.float32(high - low), ZERO), ONE)


@compiled
def gather(y: int, x: int, sums: np.ndarray, spread: np.ndarray, found: np.ndarray) -> None:
    """Power, noise of the structure and correlations around a tile; neighbours count by 1 2 1 both ways."""
    spread[:] = ZERO
    for j in range(max(0, y - 1), min(sums.shape[0], y + 2)):
        for i in range(max(0, x - 1), min(sums.shape[1], x + 2)):
            weight = np.float32((2 - abs(j - y)) * (2 - abs(i - x)))
            for k in range(sums.shape[2]):
                spread[k] += weight * sums[j, i, k]
    found[0] = spread[POWER] / spread[COUNT]
    found[1] = np.float32(SPREAD_NOISE * len(LAGS)) / spread[COUNT]
    for k in range(len(LAGS)):
        found[2 + k] = spread[FIRST + k] / (spread[HELD_POWER] + TINY_POWER)


@compiled
def detail_of(found: np.ndarray, common: np.ndarray) -> Real:
    """Share of detail in the part removed around a tile, from the sums of ``gather``."""
    structure = -found[1]
    for k in range(len(LAGS)):
        own = found[2 + k] - common[k]
        structure += own * own
    faint = ramp(-np.log(found[0] + TINY_POWER), -math.log(INVISIBLE[1]), -math.log(INVISIBLE[0]))
    return max(ramp(np.sqrt(max(structure, ZERO)), STRUCTURE[0], STRUCTURE[1]), faint)


@compiled
def detail_rows(y0: int, y1: int, sums: np.ndarray, evidence: np.ndarray, detail: np.ndarray) -> None:
    """Share of each tile's difference to give back; every band of rows judges the whole frame for itself.

    ``evidence`` for detail is 1 when nothing is known. Below 1 it scales every tile's share; it always scales the share
    of detail by which the whole frame counts as clean.
    """
    height, width = sums.shape[:2]
    found, weight = np.empty((height, width, 2 + len(LAGS)), np.float32), np.empty((height, width), np.float32)
    spread, common, total = np.empty(sums.shape[2], np.float32), np.zeros(len(LAGS), np.float32), 1e-12
    for y in range(height):
        for x in range(width):
            gather(y, x, sums, spread, found[y, x])
            weight[y, x] = np.sqrt(found[y, x, 0]) * sums[y, x, COUNT]
            total += weight[y, x]
    power = sums[:, :, POWER].sum() / sums[:, :, COUNT].sum()
    filtered = ramp(np.log(power + TINY_POWER), math.log(FILTERED[0]), math.log(FILTERED[1]))
    quiet = ramp(-np.log(power + TINY_POWER), -math.log(LOUD[1]), -math.log(LOUD[0])) * min(evidence[0], ONE)
    for k in range(NEAR):
        common[k] = filtered * max((weight * found[:, :, 2 + k]).sum() / total, 0.0)
    share = 0.0
    for y in range(height):
        for x in range(width):
            found[y, x, 1] = quiet * detail_of(found[y, x], common)
            share += found[y, x, 1] * weight[y, x]
    clean = ramp(np.float32(share / total) * evidence[0], CLEAN[0], CLEAN[1])
    for y in range(y0, y1):
        for x in range(width):
            detail[y, x, 0] = found[y, x, 1] + (ONE - found[y, x, 1]) * clean


@inline
def between(position: int, count: int) -> tuple[int, int, Real]:
    """The tile before a pixel, the one after it, and how far the pixel lies between their centres."""
    at = min(max((np.float32(position) + np.float32(0.5)) / np.float32(TILE) - np.float32(0.5), ZERO),
             np.float32(count - 1))
    first = int(at)
    return first, min(first + 1, count - 1), at - np.float32(first)


@compiled
def restore_rows(y0: int, y1: int, colour: np.ndarray, denoised: np.ndarray, detail: np.ndarray,
                 output: np.ndarray) -> None:
    """From the result to the input by the share of detail, linear between the tiles' centres."""
    tiles_high, tiles_wide = detail.shape[:2]
    for y in range(y0, y1):
        top, bottom, v = between(y, tiles_high)
        for x in range(output.shape[1]):
            left, right, u = between(x, tiles_wide)
            upper = detail[top, left, 0] + (detail[top, right, 0] - detail[top, left, 0]) * u
            lower = detail[bottom, left, 0] + (detail[bottom, right, 0] - detail[bottom, left, 0]) * u
            share = upper + (lower - upper) * v
            for c in range(output.shape[2]):
                clean, noisy = denoised[y, x, c], clamp(colour[y, x, c], ZERO, MAX_FLOAT)
                output[y, x, c] = noisy if share == ONE else clean + (noisy - clean) * share


IMAGE, TILES = PLANES["colour"], ("tiles_high", "tiles_wide")
JUDGE = kernel("judge", ("colour", "denoised", "params"), ("sums",), judge_rows, ("sums", 0),
               denoised=IMAGE, sums=(*TILES, SUMS))
DETAIL = kernel("detail", ("sums", "evidence"), ("detail",), detail_rows, ("detail", 0), sums=(*TILES, SUMS),
                evidence=(1,), detail=(*TILES, 1))
ANY = (*IMAGE[:2], "channels")
RESTORE = kernel("restore", ("colour", "denoised", "detail"), ("output",), restore_rows, ("output", 0), colour=ANY,
                 denoised=ANY, detail=(*TILES, 1), output=ANY)


# Tiles and strength

ORIGIN, HELD, OWN = 0, 2, 6
PLACE = 10


@compiled
def copy(source: np.ndarray, target: np.ndarray) -> None:
    """target = source."""
    for i in range(target.size):
        target[i] = source[i]


@compiled
def assemble_rows(y0: int, y1: int, tiles: np.ndarray, places: np.ndarray, frame_rows: np.ndarray,
                  frame_columns: np.ndarray, picture: np.ndarray) -> None:
    """Row by row: first each tile's usable area, then the area where it comes before all others. The first of several
    tiles is written last."""
    left, right = int(frame_columns[0]), int(frame_columns[0]) + frame_columns.size
    count, height, width, channels = tiles.shape
    lines = tiles.reshape(count, height, width * channels)
    for row in range(y0, y1):
        y, target = int(frame_rows[row]), picture[row].reshape(frame_columns.size * channels)
        target[:] = np.float32(0)
        for kind in (HELD, OWN):
            for tile in range(count - 1, -1, -1):
                place = places[tile]
                if place[kind] <= y < place[kind + 2]:
                    first, last = max(int(place[kind + 1]), left), min(int(place[kind + 3]), right)
                    if first < last:
                        begin = (first - int(place[ORIGIN + 1])) * channels
                        copy(lines[tile, y - int(place[ORIGIN])][begin:],
                             target[(first - left) * channels:(last - left) * channels])


ASSEMBLE = kernel("assemble", ("tiles", "places", "frame_rows", "frame_columns"), ("picture",), assemble_rows,
                  ("picture", 0), tiles=("tiles", "tile_h", "tile_w", "channels"), places=("tiles", PLACE),
                  frame_rows=("rows",), frame_columns=("columns",), picture=("rows", "columns", "channels"))


@compiled
def blend_row(share: np.ndarray, plain: np.ndarray, denoised: np.ndarray, row: np.ndarray) -> None:
    """A row of numbers, each with its share."""
    for x in range(share.size):
        mixed = plain[x] + (denoised[x] - plain[x]) * share[x]
        row[x] = denoised[x] if share[x] == ONE else mixed


@compiled
def blend_pixels(share: np.ndarray, plain: np.ndarray, denoised: np.ndarray, row: np.ndarray) -> None:
    """A flat row of pixels, each with its share: in vector code."""
    for x in range(share.size):
        s, red, green, blue = share[x], denoised[3 * x], denoised[3 * x + 1], denoised[3 * x + 2]
        r, g, b = plain[3 * x], plain[3 * x + 1], plain[3 * x + 2]
        r, g, b = r + (red - r) * s, g + (green - g) * s, b + (blue - b) * s
        row[3 * x], row[3 * x + 1] = red if s == ONE else r, green if s == ONE else g
        row[3 * x + 2] = blue if s == ONE else b


@compiled
def strength_rows(y0: int, y1: int, denoised: np.ndarray, plain: np.ndarray, strength: np.ndarray, amount: np.ndarray,
                  output: np.ndarray) -> None:
    """From ``plain`` to ``denoised`` by strength times amount; both ends are exact."""
    factor, (width, channels) = clamp(amount[0], ZERO, ONE), output.shape[1:]
    share = np.empty(width, np.float32)
    for y in range(y0, y1):
        for x in range(width):
            share[x] = clamp(strength[y, x, 0], ZERO, ONE) * factor
        if channels == 3:
            blend_pixels(share, plain[y].reshape(3 * width), denoised[y].reshape(3 * width),
                         output[y].reshape(3 * width))
        for c in range(channels if channels != 3 else 0):
            blend_row(share, plain[y, :, c], denoised[y, :, c], output[y, :, c])


OUT = ("height", "width", "channels")
STRENGTH = kernel("strength", ("denoised", "plain", "strength", "amount"), ("output",), strength_rows, ("output", 0),
                  denoised=OUT, plain=OUT, output=OUT, strength=("height", "width", 1), amount=(1,))
