"""Kernels of what a frame takes from the one before: at another render size, where its pixels are
now, where what they reflect was, and how much of it each pixel may use.

The last output is warped by the motion of its pixels (`HISTORY`); a state at another render size is
resized (`RESIZE`).

Smooth surfaces get the motion of their reflections (`REFLECTIONS`). A mirror's image lies along the
view ray, as far behind the mirror as the reflected point is from it. This virtual point moves
through the picture like any other (virtual motion in Zhdan 2021, "ReBLUR: A Hierarchical Recurrent
Denoiser", Ray Tracing Gems II, ch. 49). Convex mirrors bring it nearer, by the mirror equation 1 /
image = 1 / distance + 2 curvature; rough ones, too, by the dominant direction of their lobe, (1 -
r) (sqrt(1 - r) + r) with roughness r (Lagarde and de Rousiers 2014, "Moving Frostbite to Physically
Based Rendering", on the dominant specular direction). ``camera`` is float32 (27,), in the picture's
axes, x right, y down, z along the view axis: focal length in pixels now (x, y) and then, jitter,
the turn (3, 3) and shift (3) from now to then for row vectors, and (3, 3) from the world to the
axes now for normals.

The reactive mask is the share of the history that each pixel must not use, from 0 (none) to 1
(all). What a reactive pixel leaves to the next frame does not move with the surface seen there. So
a pixel is limited by its own mask and by the mask at the place where it was in the last frame; the
larger of both counts. ``last_reactive`` is the last frame's mask, spread by a pixel because the
history is interpolated between pixels.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from postfx.kernels.denoise import STATE, kernel

RESIZE = kernel("resize", ("state", "last_depth", "at_rows", "at_columns"),
                ("resized", "resized_depth"),
                None, ("resized", 0), at_rows=("height",), at_columns=("width",),
                resized=("height", "width", STATE), resized_depth=("height", "width", 1))

HISTORY = replace(kernel("history",
                         ("history", "moved", "params", "window", "out_rows", "out_columns"),
                         ("warped",), None, ("warped", 0)), pixels=(2, 2))

# Of ``camera``: where its parts begin, and how many numbers it has.
FOCAL = 0
FOCAL_THEN = 2
JITTER = 4
TURN = 6
SHIFT = TURN + 9
WORLD = SHIFT + 3
CAMERA = WORLD + 9
ROUGHEST = np.float32(0.3)
"""Roughness up to which a surface shows an image that is worth following: docs/lab/denoising.md."""
STEP = np.float32(0.1)
"""Most relative difference in depth of neighbours on one surface."""
BEND = np.float32(0.9)
"""Least cosine between the normals of neighbours on one surface."""

# How far the motion of a surface at rest may differ from the camera's: the sum of both.
STILL = np.float32(0.25)
"""Part of it in pixels."""
PART = np.float32(0.05)
"""Part of it as a share of the motion."""

REFLECTIONS = kernel(
    "reflections", ("motion", "depth", "normal", "roughness", "diffuse_albedo", "specular_albedo",
                    "hit_distance", "camera"),
    ("reflected",), None, ("reflected", 0), hit_distance=("h", "w", 1), camera=(CAMERA,),
    reflected=("h", "w", 2))

MASK = ("h", "w", 1)
SPREAD = 1
"""Render pixels that a mask is spread by."""
REACTIVE = kernel("reactive", ("colour", "opaque_colour", "difference"), ("reactive",), None,
                  ("reactive", 0), opaque_colour=("h", "w", 3), difference=(3,), reactive=MASK)
SPREAD_MASK = kernel("spread", ("reactive",), ("next_reactive",), None, ("next_reactive", 0),
                     reactive=MASK, next_reactive=MASK)
KEEP = kernel("keep", ("reactive", "last_reactive", "moved", "part_rows", "part_columns"),
              ("keep",), None, ("keep", 0), reactive=MASK, last_reactive=MASK, keep=("th", "tw", 1))
