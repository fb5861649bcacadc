"""Kernel that shows the upscaler's network the planes at output size, at the points where it predicts its filters.

Channels of ``guides``, for the corners of a render pixel at top left, top right, bottom left and bottom right: diffuse
albedo 0, specular albedo 3, normal 6, roughness 9, depth 10. The torch definition is
``training.networks.denoise_upscale.guide_features``.
"""

import numpy as np

from postfx.kernels.denoise_layout import GUIDE_PLANES, GUIDES, HEIGHT, MAX_DEPTH, WIDTH, kernel
from postfx.kernels.numeric import clamp, compiled, fused, mirrored

CORNERS = 4
CHANNELS = GUIDES // CORNERS
ZERO, ONE, TWO = np.float32(0), np.float32(1), np.float32(2)


@fused
def picked_planes(picture, columns, low, high, first, row, guides):
    """Pixels of a guide's row at ``columns``, within bounds, as planes from channel ``first`` on."""
    for c in range(picture.shape[1]):
        plane = guides[0, first + c, row]
        for x in range(columns.size):
            plane[x] = clamp(picture[columns[x], c], low, high)


@compiled
def guide_rows(y0, y1, guide_diffuse_albedo, guide_specular_albedo, guide_normal, guide_roughness, guide_depth,
               depth_scale, window, part_rows, part_columns, guides):
    """The nearest guide pixel at every corner; mirrored up to the network's size."""
    h, w = int(window[HEIGHT]), int(window[WIDTH])
    top, left = int(part_rows[0]), int(part_columns[0])
    height, width = guide_depth.shape[:2]
    scale, padded = depth_scale[0], guides.shape[3]
    columns = np.empty((2, padded), np.int64)
    for x in range(padded):
        for side in range(2):
            columns[side, x] = (4 * mirrored(left + x, w) + 1 + 2 * side) * width // (4 * w)
    for row in range(y0, y1):
        for corner in range(CORNERS):
            y = (4 * mirrored(top + row, h) + 1 + 2 * (corner // 2)) * height // (4 * h)
            at, first = columns[corner % 2], CHANNELS * corner
            picked_planes(guide_diffuse_albedo[y], at, ZERO, TWO, first, row, guides)
            picked_planes(guide_specular_albedo[y], at, ZERO, TWO, first + 3, row, guides)
            picked_planes(guide_normal[y], at, -ONE, ONE, first + 6, row, guides)
            picked_planes(guide_roughness[y], at, ZERO, ONE, first + 9, row, guides)
            picked_planes(guide_depth[y], at, ZERO, MAX_DEPTH, first + 10, row, guides)
            near = guides[0, first + 10, row]
            for x in range(padded):
                near[x] = scale / (scale + near[x])


GUIDE = kernel("guides", (*GUIDE_PLANES, "depth_scale", "window", "part_rows", "part_columns"), ("guides",), guide_rows,
               ("guides", 2))
