"""Kernels around a network that sees each pixel of one scene alone.

- `FIND_POINTS`: camera (16,), box (4,), depth (height, width, 1), normal (height, width, 3) of the
  world -> points (height * width, `POINT`): place in the scene's box, normal, and mirrored view
  direction. The camera's numbers are its axes left, up and forward, its place, tangents of half the
  field of view, and jitter; the box's are its middle and half its longest side.
- `LIGHT_OF_POINTS`: values (height * width, 3), which are logarithms of light over reflectance, and
  diffuse, specular and colour (height, width, 3) -> output (height, width, 3). Lamps and misses
  keep their colour.
"""

from __future__ import annotations

import numpy as np

from postfx.compiled.library import Rows
from postfx.kernels import Blocks, Kernel

CAMERA_NUMBERS = 16
# Where they are: its axes, its place, tangents of half the field of view, jitter in pixels.
CAMERA_LEFT = slice(0, 3)
CAMERA_UP = slice(3, 6)
CAMERA_FORWARD = slice(6, 9)
CAMERA_PLACE = slice(9, 12)
CAMERA_TANGENT_ACROSS = 12
CAMERA_TANGENT_DOWN = 13
CAMERA_JITTER_X = 14
CAMERA_JITTER_Y = 15
BOX_NUMBERS = 4
POINT = 9
"""Numbers of a point."""
FARTHEST_PLACE = np.float32(1.5)
"""Places farther out than so many half sides of the box count as there."""
LAMP_REFLECTANCE = np.float32(0.005)
"""Less reflectance than this have lamps and misses only."""

# Of each channel's reflectance: a share of the largest channel, and what is added.
REFLECTANCE_SHARE = np.float32(0.15)
REFLECTANCE_OFFSET = np.float32(0.01)

MOST_LIGHT_LOG = np.float32(20)
"""Bound of the logarithm of light that a network may give."""
POINTS_OF_A_BLOCK = 256
"""On a GPU, where each thread makes one."""

_PICTURE = ("height", "width", 3)
FIND_POINTS = Kernel(
    "scene_points", ("camera", "box", "depth", "normal"), ("points",), Rows("scene_points"),
    ("points", 0), {"camera": (CAMERA_NUMBERS,), "box": (BOX_NUMBERS,),
                    "depth": ("height", "width", 1), "normal": _PICTURE,
                    "points": ("points", POINT)},
    blocks=Blocks(POINTS_OF_A_BLOCK, POINTS_OF_A_BLOCK))
LIGHT_OF_POINTS = Kernel(
    "scene_light", ("values", "diffuse", "specular", "colour"), ("output",), Rows("scene_light"),
    ("output", 0), {"values": ("points", 3), "diffuse": _PICTURE, "specular": _PICTURE,
                    "colour": _PICTURE, "output": _PICTURE})
