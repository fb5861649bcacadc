"""Kernels that make the output: lost detail restored, tiles assembled into the frame, and a blend
by strength.

Detail: the removed part, input minus result, looks alike everywhere if it was noise, and has
structure if it was detail. So the kernels judge tiles of the picture: by correlations of the
difference between near pixels, less those of the whole frame, because a renderer's filter may
spread samples over several pixels; by correlations between far pixels, which no filter reaches; and
by its size, because barely visible differences do no harm. If most of the removed part is detail,
the whole frame counts as clean. ``known`` is the share of detail that a tile has at least. Only for
results of the input's size with samples spread over the pixel. Tiles where ``judged`` is 0 are not
looked at, and count for nothing.

Tiles: each row of ``places`` (n, 10) describes one of ``tiles`` (n, th, tw, channels) in rows and
columns of the frame: its first pixel (2), the area that may be used (4), and the area to use before
all other tiles (4); areas are top, left, bottom, right, the last two exclusive. The first of
several tiles counts. ``frame_rows`` and ``frame_columns`` are the rows and columns of the frame to
write; pixels of no tile become 0.
"""

from __future__ import annotations

import numpy as np

from postfx.kernels.denoise import PLANES, kernel

# Detail

TILE = 16
LAGS = ((0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0), (0, 4), (4, 0))
NEAR = 6  # the first lags, which a pixel filter reaches
# Of ``sums``: where each stands, the first of the lags, and how many there are.
COUNT, POWER, HELD_POWER, FIRST = range(4)
SUMS = FIRST + len(LAGS)
# times a tile's root mean square: larger differences, such as fireflies, are clamped to it
LIMIT = 3.0
DARK = 1e-3  # exposed luminance below which smaller differences are no more visible
STRUCTURE = (0.45, 0.8)  # root of the summed squares of the correlations, from noise to detail
INVISIBLE = (10**-6.4, 10**-5.6)  # mean square of the visible difference, from invisible to visible
CLEAN = (0.35, 0.55)  # share of detail in what was removed from the frame, from noisy to clean
# mean square of the frame, from too little to enough for filtered noise
FILTERED = (10**-4.2, 10**-3.5)
LOUD = (10**-1.8, 10**-1.4)  # the same, from possibly clean to certainly noisy
# squares of the weights 1 2 1 by 1 2 1, summed, over their sum: how noisy a spread tile is
SPREAD_NOISE = 2.25
TINY_POWER = np.float32(1e-12)

IMAGE = PLANES["colour"]
TILES = ("tiles_high", "tiles_wide")
JUDGE = kernel("judge", ("colour", "denoised", "params", "judged"), ("sums",), None, ("sums", 0),
               denoised=IMAGE, judged=(*TILES, 1), sums=(*TILES, SUMS))
DETAIL = kernel("detail", ("sums", "evidence", "known"), ("detail",), None, ("detail", 0),
                sums=(*TILES, SUMS), evidence=(1,), known=(*TILES, 1), detail=(*TILES, 1))
ANY = (*IMAGE[:2], "channels")
RESTORE = kernel("restore", ("colour", "denoised", "detail"), ("output",), None, ("output", 0),
                 colour=ANY, denoised=ANY, detail=(*TILES, 1), output=ANY)


# Tiles and strength

# Of a row of ``places``: the tile's first row and column, then two boxes (first row, first column,
# last row, last column) of the frame.
HELD = 2
"""Where the box begins that the tile holds."""
OWN = HELD + 4
"""Where the box begins that is the tile's own."""
PLACE = OWN + 4
"""Numbers of a row."""

ASSEMBLE = kernel("assemble", ("tiles", "places", "frame_rows", "frame_columns"), ("picture",),
                  None, ("picture", 0), tiles=("tiles", "tile_h", "tile_w", "channels"),
                  places=("tiles", PLACE), frame_rows=("rows",), frame_columns=("columns",),
                  picture=("rows", "columns", "channels"))

OUT = ("height", "width", "channels")
STRENGTH = kernel("strength", ("denoised", "plain", "strength", "amount"), ("output",), None,
                  ("output", 0),
                  denoised=OUT, plain=OUT, output=OUT, strength=("height", "width", 1), amount=(1,))
