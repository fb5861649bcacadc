"""Kernel that puts a picture together from what was computed in parts of it.

Each of ``places`` (n, 10) tells of one of ``tiles`` (n, th, tw, channels), in rows and columns of the frame: where its
first pixel lies (2), what of it may be used (4), and what of it is to be used before all others (4): top, left, bottom,
right, the last two not included. The first of several tiles counts. ``frame_rows`` and ``frame_columns`` are the rows
and columns of the frame that are written; what no tile holds is 0.
"""

import numpy as np

from postfx.kernels.denoise_layout import kernel
from postfx.kernels.numeric import compiled

ORIGIN, HELD, OWN = 0, 2, 6
PLACE = 10


@compiled
def copy(source, target):
    for i in range(target.size):
        target[i] = source[i]


@compiled
def assemble_rows(y0, y1, tiles, places, frame_rows, frame_columns, picture):
    """Row by row: first what tiles hold, then what is their own; of several tiles the first is written last."""
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
