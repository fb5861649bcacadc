"""Kernels of the classical filter: accumulation along the motion, an a-trous filter, and enlarging.
No network.

It follows SVGF (Schied 2017, "Spatiotemporal Variance-Guided Filtering"), with an a-trous filter
(Dammertz 2010, "Edge-Avoiding A-Trous Wavelet Transform for fast Global Illumination Filtering") of
3x3 taps. The first two hidden channels of the state hold the first two moments of the light's
luminance, so that the history goes on from a network's frame, and a network's from this.

- `GATHER`: planes and history -> next_state, next_depth; ``light`` (4, th, tw): the accumulated
  colour without reflectance, and the variance of its luminance; ``surface`` (6, th, tw): normal,
  1 / depth and its steps to the right and down, in which planes are straight; ``factor``.
- `ATROUS`: one pass over `light`, with taps ``step`` (1,) pixels apart -> ``smooth``, the same.
- `RESOLVE`: light, with reflectance again -> output and next_history: samples weighted by their
  distance from the output's pixel. A blend with the last output takes half as much time again for
  -0.7 to 0.3 dB, in fog 0.9.
"""

import numpy as np

from postfx.kernels.denoise import REFLECTANCE, kernel

STEPS = (1, 2, 4, 8, 16)
"""Distances of the taps, pass by pass."""
LEAST_SHARE = np.float32(0.2)
"""Share of a frame in the accumulated colour, at least."""
STEP = np.float32(0.1)
"""Relative change of depth from which on it is something else."""
FLAT = np.float32(0.02)
"""Relative depth that makes an edge, on a surface that faces the camera."""
SLANT = np.float32(0.3)
"""Share of the depth's own slope that makes one."""
LUMINANCE = np.float32(4)
"""Standard deviations of luminance that make one."""
_LIGHT = (4, "th", "tw")
_SURFACE = (6, "th", "tw")
GATHER = kernel("classic_gather", ("colour", *REFLECTANCE, "normal", "depth", "moved", "state",
                                   "last_depth", "params", "window", "keep"),
                ("next_state", "next_depth", "light", "surface", "factor"), None, ("light", 1),
                light=_LIGHT, surface=_SURFACE)
ATROUS = kernel("atrous", ("light", "surface", "step", "window"), ("smooth",), None, ("smooth", 1),
                light=_LIGHT, surface=_SURFACE, smooth=_LIGHT, step=(1,))
RESOLVE = kernel("resolve", ("light", "factor", "params", "window"), ("output", "next_history"),
                 None, ("output", 0), light=_LIGHT)
