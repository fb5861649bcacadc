"""What the upscaler's kernels share: the layout of their tensors and a way to name them.

``params`` is float32 (4,): exposure, jitter x, jitter y and the exposure's gain since the previous
frame. ``keep`` is how much of the history each render pixel of the part uses, 0 nothing to 1 all:
(th, tw, 1), or one number for all pixels, (1, 1, 1). ``state`` (h, w, 12) holds accumulated
demodulated colour (3), effective sample count (0 where it holds nothing) and hidden channels (8),
colour already exposed; ``history`` (height, width, 3) is log(1 + exposed output). ``fine`` is the
network's head at render size: 5x5 kernel 25, 3x3 weights at four phases 36, history blend and
sharpening at four phases 4 each, mix, distrust, importance, hidden state 8. Pictures are (h, w,
channels), pyramid levels planar (channels, h, w). Names that begin with ``guide_`` are planes at
output size.

Kernels work on a part of the frame, whose planes and history are read whole; intermediate results
have the part's size, (th, tw) at render and (out_th, out_tw) at output size, and a part may end
beyond the frame. With guides ``radiance`` has the filtered colour without reflectance, then with
that of the render size. ``window`` is float32 (8,): the part's first row and column, the frame's
height and width, and the same at output size. ``part_rows``, ``part_columns``, ``out_rows`` and
``out_columns`` are the frame's rows and columns that the part holds, the last one repeated beyond
the frame. ``seen_rows`` and ``seen_columns`` are the part's as the network sees them: beyond the
frame they go on as in a mirror. ``past`` (th, tw, 4) is the reprojected accumulation with its
count, -1 where the history does not hold a pixel that lies in the frame. ``finer_rows`` and
``finer_columns`` tell where in the finer level a level's cells begin, -1 before its first,
``coarse_rows`` and ``coarse_columns`` in which cells of the coarser one its pixels lie. ``factor``
is the reflectance that colour is divided and multiplied by, ``means`` its mean in cells of 8x8
pixels of the frame, from the cell before the part's first row and column on; (1, 1, 3) where planes
are not doubted.

Numbers that several files use are defined here, others in the file of their kernel, each once:
`postfx.runtime.cuda` prints them for the CUDA kernels, and training imports them.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from postfx.compiled.library import Rows
from postfx.kernels import Kernel

# Channels: of the hidden state of a network, of `state`, and of what a network reads of a pixel.
HIDDEN = 8
STATE = 4 + HIDDEN
FEATURES = 27 + HIDDEN

KERNEL = 5 * 5
"""Channels of a 5x5 filter kernel."""
PHASES = 9 * 4
"""Channels of 3x3 weights at four phases."""

# Channels of the fine head: where its parts begin behind the 5x5 kernel, and how many there are.
TAP_WEIGHTS = KERNEL
BLEND = TAP_WEIGHTS + PHASES
SHARPEN = BLEND + 4
MIX = SHARPEN + 4
DISTRUST = MIX + 1
IMPORTANCE = DISTRUST + 1
MEMORY = IMPORTANCE + 1
FINE = MEMORY + HIDDEN
PLANE_TRUST = FINE - 1
"""The last hidden channel, -1 to 1: how far networks that doubt planes trust a pixel's
reflectance."""
CONTROLS = FINE - MIX
"""Channels of the controls of a network that gives the picture itself: those of a fine head from
its mix on, which is the share of the picture beside the history here."""
MIRRORED = 6
"""Channels of the planes that follow mirrors and glass: Denoising Albedo and Denoising Normal."""
# both albedos, normal, roughness and depth at the four quarter-pixel corners of a render pixel
GUIDES = 4 * 11
# Where numbers stand in `params`, and in `window`.
EXPOSURE, JITTER_X, JITTER_Y, GAIN = range(4)
TOP, LEFT, HEIGHT, WIDTH, OUT_TOP, OUT_LEFT, OUT_HEIGHT, OUT_WIDTH = range(8)
UNKNOWN = 1e-3  # share of a reprojected pixel that the history may lack
NEAR_CELL = 4
"""Render pixels along a side of the cells of ``near``, outside of which alpha is left alone."""
TRUST_CELL = 8
"""Render pixels along a side of the cells in which guides are judged and reflectance is
averaged."""
DOUBT = np.float32(0.7)
"""How much trust disagreeing guides lose."""
FAINT = np.float32(1e-4)
"""Squared relative detail below which guides are not judged."""
MAX_COUNT = 32.0
"""Frames that the accumulated colour counts as, at most."""
MAX_COLOUR = 1e4
"""Exposed light that a channel holds at most."""
MAX_LIGHT = np.float32(1e30)
"""Light that a division by reflectance may give before it is held at `MAX_COLOUR`: a pixel that is
brighter keeps its hue."""
# logarithm of the largest weight of a filter, and minus that of the smallest
STEEPEST = np.float32(8)
TINY = np.float32(1e-8)  # the smallest sum of weights that counts
LEAST_IMPORTANCE = np.float32(1e-30)
"""Weight of a pixel in the mean of its cell at least: where a network gives none to a whole cell,
the cell is not black."""
MAX_DEPTH = np.float32(1e10)
MAX_FLOAT = np.float32(3e38)
MOST_MOTION = np.float32(1e5)  # pixels a frame, more than a picture can have
NEAREST = np.float32(1e-6)
"""Least depth that counts as hit."""
FARTHEST = np.float32(1e9)
"""Most depth that counts as hit; a miss is farther, 1e10."""

# Limits that are never reached from frame to frame. Beyond them the history or the network's answer
# is broken and is not passed on. NaN is not below them, either.
MOST_LOG = np.float32(20)
"""Largest log-encoded light."""
MOST_STATE = np.float32(3e5)
"""Largest magnitude in a pixel's state."""

MOST_REFLECTANCE = np.float32(4)
"""What both albedos of a channel reflect at most."""
EMITTER = np.float32(0.005)
"""Reflectance below which a pixel gives light of its own."""
LEAST_TINT = np.float32(0.15)
"""What every channel reflects at least, as a share of the largest."""
ADDED = np.float32(0.01)
"""What is added to the reflectance of every channel, as a share of the largest, so that nothing is
divided by 0."""

REFLECTANCE = ("diffuse_albedo", "specular_albedo")
PLANES = {
    "colour": ("h", "w", 3), "diffuse_albedo": ("h", "w", 3), "specular_albedo": ("h", "w", 3),
    "normal": ("h", "w", 3),
    "roughness": ("h", "w", 1), "depth": ("h", "w", 1), "motion": ("h", "w", 2),
}
GUIDE_REFLECTANCE = ("guide_diffuse_albedo", "guide_specular_albedo")
GUIDE_PLANES = {
    "guide_diffuse_albedo": ("height", "width", 3), "guide_specular_albedo": ("height", "width", 3),
    "guide_normal": ("height", "width", 3), "guide_roughness": ("height", "width", 1),
    "guide_depth": ("height", "width", 1),
}
MIRRORED_PLANES = {"denoising_albedo": ("h", "w", 3), "denoising_normal": ("h", "w", 3)}
BOTH = (6, "padded_h", "padded_w")
"""Radiance without reflectance and with it."""
BORDER_CELLS = 3
"""Cells of mean reflectance beyond those that fit into a part: one before it and two after it."""
SHAPES = (PLANES | GUIDE_PLANES | MIRRORED_PLANES | {
    "depth_scale": (1,), "moved": ("th", "tw", 2), "history": ("height", "width", 3),
    "warped": ("out_th", "out_tw", 3),
    "params": (4,), "window": (8,), "part_rows": ("th",), "part_columns": ("tw",),
    "seen_rows": ("hp",), "seen_columns": ("wp",), "out_rows": ("out_th",),
    "out_columns": ("out_tw",),
    "state": ("h", "w", STATE), "last_depth": ("h", "w", 1), "past": ("th", "tw", 4),
    "keep": ("keep_h", "keep_w", 1), "features": (1, FEATURES, "hp", "wp"),
    "fine": (1, FINE, "hp", "wp"),
    "next_state": ("th", "tw", STATE), "next_depth": ("th", "tw", 1), "level": (4, "hp", "wp"),
    "finer": ("planes", "finer_h", "finer_w"), "finer_importance": (1, "finer_h", "finer_w"),
    "importance": (1, "hp", "wp"), "finer_rows": ("hp",), "finer_columns": ("wp",),
    "coarse": ("planes", "coarse_h", "coarse_w"), "coarse_rows": ("hp",), "coarse_columns": ("wp",),
    "heads": (1, "heads", "hp", "wp"), "area": (2,), "filtered": (3, "hp", "wp"),
    "radiance": (3, "padded_h", "padded_w"), "output": ("out_th", "out_tw", 3),
    "next_history": ("out_th", "out_tw", 3), "guides": (1, GUIDES, "hp", "wp"),
    "mirrored": (1, MIRRORED, "hp", "wp"), "trust": ("cells_h", "cells_w", 1),
    "means": ("means_h", "means_w", 3), "factor": ("th", "tw", 3),
    "picture": (1, 3, "hp", "wp"), "controls": (1, CONTROLS, "hp", "wp"),
    "codes": (1, "half_hp", "half_wp", "codes"), "factors": ("rows", "codes"),
    "scaling": (2, "outputs"),
})
TYPES = {"codes": "uint8", "factors": "int8"}


def kernel(name: str, reads: tuple[str, ...], writes: tuple[str, ...],
           rows: Callable[..., None] | None,
           rows_of: tuple[str, int], **shapes: tuple[int | str, ...]) -> Kernel:
    """A kernel whose bindings have the shapes above, or those given. Without `rows`, C++ exports
    them by its name."""
    named = SHAPES | shapes
    own = f"denoise_{name}"
    return Kernel(own, reads, writes, rows or Rows(own), rows_of,
                  {key: named[key] for key in reads + writes},
                  {key: TYPES[key] for key in reads if key in TYPES})


IN_HALF: dict[Kernel, Kernel] = {}
"""Kernels that take the place of others on a GPU, beside a network in half precision."""


def in_half(kernel: Kernel, *names: str) -> None:
    """Add the kernel to `IN_HALF` with these bindings in half precision, too: they are most of what
    it reads or writes. The rows say what it computes; no device runs them."""
    bindings = tuple(dict.fromkeys(kernel.reads + kernel.writes))
    axis = kernel.row_axis[1]

    def rows(y0: int, y1: int, *tensors: np.ndarray) -> None:
        own = [tensor.astype(kernel.types.get(name, "float32")) if name in names else tensor
               for name, tensor in zip(bindings, tensors, strict=True)]
        kernel.rows(y0, y1, *own)
        for name, tensor, made in zip(bindings, tensors, own, strict=True):
            if name in kernel.writes and made is not tensor:
                band = (slice(None),) * axis + (slice(y0, y1),)
                tensor[band] = made[band]

    types = dict(kernel.types) | dict.fromkeys(names, "float16")
    IN_HALF[kernel] = replace(kernel, name=f"{kernel.name}_half", rows=rows, types=types)
