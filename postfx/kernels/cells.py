"""What a coarse grid's cells hold: means and moments, by which cuts are found, and whether anything is positive.

Runs on the host, before a frame is uploaded.
"""

from __future__ import annotations

import numpy as np

from postfx.kernels.numeric import add, compiled, vectorised


@compiled
def box_means(planes, width, means):
    """Mean over width x width cells, an odd number, edges repeated; planes (rows, columns, channels) to the same."""
    rows, columns, channels = planes.shape
    near, share = width // 2, 1.0 / (width * width)
    flat, written = planes.reshape(rows, columns * channels), means.reshape(rows, columns * channels)
    line = np.empty((columns + 2 * near) * channels)
    inner = line[near * channels:(near + columns) * channels]
    for y in range(rows):
        inner[:] = 0.0
        for v in range(y - near, y + near + 1):
            add(flat[min(max(v, 0), rows - 1)], inner)
        for i in range(near * channels):
            line[i] = inner[i % channels]
            line[(near + columns) * channels + i] = inner[(columns - 1) * channels + i % channels]
        written[y] = 0.0
        for u in range(width):
            add(line[u * channels:], written[y])
        for i in range(written.shape[1]):
            written[y, i] *= share


@vectorised
def products(a, b, mean_a, mean_b):
    """Sums of squares and of products of two channels without their means."""
    square_a = square_b = both = 0.0
    for i in range(a.size):
        x, y = a[i] - mean_a, b[i] - mean_b
        square_a, square_b, both = square_a + x * x, square_b + y * y, both + x * y
    return square_a, square_b, both


@compiled
def moments(a, b):
    """Mean square of two sets of cells (cells, channels) without the means of their channels, and mean product."""
    cells, channels = a.shape
    square_a = square_b = both = 0.0
    for c in range(channels):
        of_a, of_b = np.ascontiguousarray(a[:, c]), np.ascontiguousarray(b[:, c])
        found = products(of_a, of_b, of_a.sum() / cells, of_b.sum() / cells)
        square_a, square_b, both = square_a + found[0], square_b + found[1], both + found[2]
    count = cells * channels
    return square_a / count, square_b / count, both / count


@compiled
def mark_positive(plane, side, cells):
    """Set cells of side x side pixels in which a plane (h, w, 1) is positive anywhere."""
    for y in range(plane.shape[0]):
        for x in range(plane.shape[1]):
            if plane[y, x, 0] > 0:
                cells[y // side, x // side] = True
