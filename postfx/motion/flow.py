"""Motion that two pictures show and their planes do not tell: for frames without vectors, and for
what does not move along with its surface.

Dense inverse search (Kroeger, Timofte, Dai and Van Gool 2016, "Fast Optical Flow using Dense
Inverse Search"): from coarse to fine, patches on a grid take over a neighbour's motion where it
fits better, are moved by Gauss-Newton steps, and every pixel gets the mean of the patches over it,
weighted by how well they fit there. Patches are compared without their means, so that a change of
light does not count.
"""

from __future__ import annotations

import math

import numpy as np

from postfx.caching import filled_array, new_array
from postfx.colour import LUMA_REC709
from postfx.compiled.calls import whole
from postfx.compiled.library import Rows
from postfx.system import in_bands

PATCH = 8
"""Pixels along a patch's side."""
STRIDE = 4
"""Pixels from one patch to the next."""
MARGIN = PATCH + 2
"""Pixels around a picture that is searched: its edges, repeated."""
COARSEST = 20
"""Pixels along the shorter side of the smallest picture that is searched."""
FINEST = 1
"""Halvings after which pictures are not searched finer: motion is interpolated from there."""
LUMINANCE = np.array(LUMA_REC709, np.float32)
"""Shares of channels in how bright a colour is (BT.709)."""

# Kernels: postfx/kernels/interpolate/flow.cpp

_tone = Rows("tone_rows")
_average_fours = Rows("average_fours")
_enlarge = Rows("enlarge_flow")
_search = Rows("search_flow")
_spread = Rows("spread_flow")
_keep_consistent = Rows("keep_consistent")
_move = Rows("move_flow")


def estimate_motion(after: np.ndarray, before: np.ndarray, finest: int = FINEST) -> np.ndarray:
    """Motion (h, w, 2) of the later picture: previous place minus this one, in pixels; x right, y
    down.

    after, before: (h, w) float32, of a range like that of a display, without NaN. Smaller ones than
    16 pixels stand still. finest: halvings of the pictures that are searched last.
    """
    if min(after.shape) < 2 * PATCH:
        return np.zeros((*after.shape, 2), np.float32)
    levels = [(after, before)]
    while min(levels[-1][0].shape) >= 2 * COARSEST:
        levels.append((halve(levels[-1][0]), halve(levels[-1][1])))
    levels = levels[min(finest, len(levels) - 1):]
    flow = np.zeros((*levels[-1][0].shape, 2), np.float32)
    for one, other in reversed(levels):
        h, w = one.shape
        padded, searched = np.pad(one, MARGIN, "edge"), np.pad(other, MARGIN, "edge")
        moved = np.zeros((max(h - PATCH, 0) // STRIDE + 1, max(w - PATCH, 0) // STRIDE + 1, 3),
                         np.float32)
        _search(0, 1, padded, searched, flow, moved)
        flow = new_array((h, w, 2))
        _spread(0, h, padded, searched, moved, flow)
    return enlarge_motion(flow, *after.shape)


def middle_light(pictures: tuple[np.ndarray, np.ndarray]) -> np.float32:
    """Light that is toned to about the middle: four times the geometric mean of both pictures."""
    # a quarter of the pixels along a side tells how bright a large picture is
    step = 4 if min(pictures[0].shape[:2]) >= 256 else 1
    light = np.stack([np.maximum(picture[::step, ::step] @ LUMINANCE, 0) for picture in pictures])
    mean = float(np.mean(light)) + 1e-12
    log_mean = float(np.mean(np.log(light + np.float32(1e-3 * mean))))
    return np.float32(4 * math.exp(log_mean))


def tone(picture: np.ndarray, level: float | np.floating, margin: int) -> np.ndarray:
    """Grey (h + 2 margin, w + 2 margin) of the range 0 to 1, in which differences are about as
    visible in the dark as in the light; the edges of a picture (h, w, 3) are repeated. level: light
    that is toned to about the middle."""
    h, w = picture.shape[:2]
    toned = new_array((h + 2 * margin, w + 2 * margin))
    in_bands(h, _tone.bind((picture, np.array((level, margin), np.float32), toned)))
    toned[:margin], toned[h + margin:] = toned[margin], toned[h + margin - 1]
    return toned


def halve(picture: np.ndarray, margin: int = 0) -> np.ndarray:
    """Means of 2x2 pixels of a picture within margins; an odd last row or column is averaged with
    the margin, or left out where there is none."""
    means = new_array(tuple((side - 2 * margin + (margin > 0)) // 2 for side in picture.shape))
    _average_fours(0, len(means), picture, np.array([margin], np.float32), means)
    return means


def enlarge_motion(flow: np.ndarray, height: int, width: int) -> np.ndarray:
    """Motion in pixels of a picture of this size, interpolated between centres."""
    if flow.shape[:2] == (height, width):
        return flow
    larger = new_array((height, width, 2))
    _enlarge(0, height, whole(flow, np.float32), larger)
    return larger


def consistent_motion(ahead: np.ndarray, back: np.ndarray,
                      scale: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Motion of two pictures to each other, NaN where the way there and back does not end where it
    began.

    scale: pixels of a picture `scale` times as large are what counts, and what the result is in.
    """
    found = new_array(ahead.shape), new_array(back.shape)
    for one, other, kept in ((ahead, back, found[0]), (back, ahead, found[1])):
        _keep_consistent(0, len(kept), one, other, np.array([scale], np.float32), kept)
    return found


def bring_to_time(flow: np.ndarray, known: np.ndarray, one: np.ndarray, other: np.ndarray,
                  scale: int, share: float) -> np.ndarray:
    """Flow (rows, columns, 2) of cells after a share of its way, in pixels: a thing's flow is where
    the thing is then.

    What planes tell, too, is left out (NaN). The rest is moved, away from edges between things that
    move differently. Where several arrive, that counts whose ends look most alike; where none does,
    flow stays as it is.

    known: likewise, in cells, motion by planes; NaN where there is none. one, other: grey pictures
    (rows, columns) of this frame and of the one that flow leads to. scale: pixels of a cell.
    """
    brought = new_array(flow.shape)
    brought[:] = flow
    if flow.size:
        planes = (whole(plane, np.float32) for plane in (flow, known, one, other))
        _move(0, len(flow), *planes, np.array((1 / scale, share), np.float32),
              filled_array(one.shape, 2), brought)
    return brought
