"""Kernels of ambient occlusion from normals and depth: a classical estimate, and what a network
reads to improve it.

All work on `surface` (h, w, 4): the normal in camera space (x to the right, y up, z to the camera;
0 where there is no surface) and depth along the camera's axis, in radii. `camera` (12,) holds the
turn from the world to camera space (3, 3) for row vectors, the radius in scene units, and the
tangents of half the field of view across and down. Results are visibility (h, w): the share of a
cosine-weighted hemisphere in which nothing is nearer than the radius.

- `FIND_SURFACE`: normal (h, w, 3) of the world, depth (h, w, 1) -> surface.
- `HORIZONS`: GTAO (Jimenez 2016, "Practical Realtime Strategies for Accurate Indirect Occlusion"):
  in `SLICES` planes through the view ray, turned from pixel to pixel in a 4x4 pattern, the highest
  surface to both sides is searched in `STEPS` steps, and the visible arc between is integrated.
  Surfaces count less from `fade` radii on, and are passed behind after `thin`: settings (2,).
- `FIND_LOOKS`: what a network reads of each pixel of some rows: points (rows * w, `LOOK`). In
  `WAYS` directions on the screen, the first of which is that of the normal, at `REACHES` of the
  radius: the cosine between the way to the surface seen there and the normal, and how near it is,
  both 0 from 1.25 radii on. Then how the surface lies, the radius in pixels, and the classical
  estimate, raw and smooth. `first` (1,) is the first row.
- `SMOOTH_OCCLUSION`: mean over the pattern's 4x4 pixels, of those on the same surface.
"""

import numpy as np

from postfx.compiled.library import Rows
from postfx.kernels import Kernel

RADIUS = 9
TANGENTS = 10
CAMERA = 12
SLICES = 4
STEPS = 8
WAYS = 8
REACHES = (0.04, 0.1, 0.2, 0.4, 0.65, 1.0)
LOOK = 2 * WAYS * len(REACHES) + 5
FAR = np.float32(1e5)
"""Depth in radii from which on a pixel counts as empty."""

_OCCLUSION_SHAPES: dict[str, tuple[int | str, ...]] = {"surface": ("h", "w", 4),
                                                       "camera": (CAMERA,)}
FIND_SURFACE = Kernel(
    "occlusion_surface", ("normal", "depth", "camera"), ("surface",), Rows("occlusion_surface"),
    ("surface", 0), {**_OCCLUSION_SHAPES, "normal": ("h", "w", 3), "depth": ("h", "w", 1)})
HORIZONS = Kernel(
    "occlusion_horizons", ("surface", "camera", "settings"), ("visible",),
    Rows("occlusion_horizons"), ("visible", 0),
    {**_OCCLUSION_SHAPES, "settings": (2,), "visible": ("h", "w")})
SMOOTH_OCCLUSION = Kernel(
    "occlusion_smooth", ("surface", "noisy"), ("visible",), Rows("occlusion_smooth"),
    ("visible", 0), {"surface": ("h", "w", 4), "noisy": ("h", "w"), "visible": ("h", "w")})
FIND_LOOKS = Kernel(
    "occlusion_looks", ("surface", "camera", "raw", "smooth", "first"), ("points",),
    Rows("occlusion_looks"), ("points", 0),
    {**_OCCLUSION_SHAPES, "raw": ("h", "w"), "smooth": ("h", "w"), "first": (1,),
     "points": ("points", LOOK)})
