"""Kernels that make the output: tiles assembled into the frame, and a blend with the input by strength.

Each row of ``places`` (n, 10) describes one of ``tiles`` (n, th, tw, channels) in rows and columns of the frame: its
first pixel (2), the area that may be used (4), and the area to use before all other tiles (4); areas are top, left,
bottom, right, the last two exclusive. The first of several tiles counts. ``frame_rows`` and ``frame_columns`` are the
rows and columns of the frame to write; pixels of no tile become 0.
"""

from __future__ import annotations

import numpy as np

from postfx.kernels.denoise.layout import kernel
from postfx.kernels.numeric import clamp, compiled

ORIGIN, HELD, OWN = 0, 2, 6
PLACE = 10


@compiled
def copy(source: np.ndarray, target: np.ndarray) -> None:
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


ZERO, ONE = np.float32(0), np.float32(1)


@compiled
def strength_rows(y0: int, y1: int, denoised: np.ndarray, plain: np.ndarray, strength: np.ndarray, amount: np.ndarray,
                  output: np.ndarray) -> None:
    """From ``plain`` to ``denoised`` by strength times amount; both ends are exact."""
    factor = clamp(amount[0], ZERO, ONE)
    for y in range(y0, y1):
        for x in range(output.shape[1]):
            share = clamp(strength[y, x, 0], ZERO, ONE) * factor
            for c in range(3):
                noisy, clean = plain[y, x, c], denoised[y, x, c]
                output[y, x, c] = clean if share == ONE else noisy + (clean - noisy) * share


IMAGE = ("height", "width", 3)
STRENGTH = kernel("strength", ("denoised", "plain", "strength", "amount"), ("output",), strength_rows, ("output", 0),
                  denoised=IMAGE, plain=IMAGE, output=IMAGE, strength=("height", "width", 1), amount=(1,))
