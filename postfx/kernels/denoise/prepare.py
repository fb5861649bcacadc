"""Kernels that prepare what the network and its filters read.

They compute the scale of depth, spread motion over edges, average reflectance in cells, and weight
what accumulates over time.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from postfx.kernels import Blocks
from postfx.kernels.denoise import (
    BORDER_CELLS,
    REFLECTANCE,
    TRUST_CELL,
    in_half,
    kernel,
)

CLEARLY = np.float32(0.9)
"""Share of a pixel's depth below which a neighbour is clearly nearer."""

SUMMING = 256
"""Threads of a GPU's blocks that sum, and how many such blocks there are at most."""
SCALE = replace(kernel("scale", ("depth",), ("depth_scale",), None, ("depth_scale", 0)),
                blocks=Blocks(0, SUMMING, most=SUMMING // 2, between=4 * SUMMING + 4))
DILATE = kernel("dilate", ("motion", "depth", "part_rows", "part_columns"), ("moved",), None,
                ("moved", 0))
MEANS = replace(kernel("means", (*REFLECTANCE, "part_rows", "part_columns"), ("means",), None,
                       ("means", 0)),
                blocks=Blocks(0, SUMMING, most=1024))
ACCUMULATE = kernel("accumulate",
                    ("colour", *REFLECTANCE, "means", "depth", "past", "fine", "params", "window"),
                    ("next_state", "next_depth", "level", "factor"), None, ("level", 1),
                    fine=(1, "controls", "hp", "wp"))
in_half(ACCUMULATE, "fine")


def means_size(rows: int, columns: int) -> tuple[int, int]:
    """Cells of mean reflectance, down and across, that a part of the frame needs wherever it
    begins."""
    return -(-rows // TRUST_CELL) + BORDER_CELLS, -(-columns // TRUST_CELL) + BORDER_CELLS
