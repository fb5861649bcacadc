"""Motion for a run in reverse order, and the number of frames for which each pixel has been
visible.

Everything here runs on the host: functions on frames, and the kernels that they call.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from postfx.compiled.calls import whole
from postfx.compiled.library import Rows
from postfx.cuts import CutDetector
from postfx.frame import Frame, Role
from postfx.repair import still_where_unknown

LONGEST_HISTORY_FRAMES = 8
"""Longest history that counts, in frames: a longer one hardly improves a result."""

FAR = np.float32(1e30)
"""Stands for an unknown depth or a larger one."""
LOST = np.float32(1e4)
"""Motion, in pixels, of a point that the next frame does not show: it points outside any
picture."""
ALIKE = np.float32(0.03)
"""Relative difference in depth between neighbouring pixels of one surface."""
SAME = np.float32(0.05)
"""Relative difference in depth of one point between two frames."""
CRACK_ROUNDS = 2
"""Pixels by which cracks are filled from each side. Cracks open where the next frame shows a
surface larger."""


def reverse_motion(frame: Frame, after: Frame | None) -> Frame:
    """The frame with motion to the frame `after` it. Before a cut, or with None, it becomes a first
    frame.

    Pixels that the frame after does not show get motion that points outside the picture. A frame
    without a motion plane is only marked as a first frame.
    """
    if after is None or after.reset or Role.MOTION not in after or Role.MOTION not in frame:
        return replace(frame, reset=True)
    return replace(frame, planes={**frame.planes, Role.MOTION: motion_to_next(frame, after)},
                   reset=False)


def motion_to_next(frame: Frame, after: Frame) -> np.ndarray:
    """Motion (h, w, 2): position in the frame after minus position in this one, in pixels of this
    one; x right, y down.

    Computed from the motion of the frame after: each of its pixels says where it came from; the
    nearest one wins. Motion that is NaN counts as none, as in every pass.
    """
    return invert_motion(still_where_unknown(after[Role.MOTION]), _depth(after), _depth(frame))


def invert_motion(motion: np.ndarray, after: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Motion (height, width, 2) to the next frame, in pixels of this frame; LOST where the next
    frame hides a pixel.

    motion (h, w, 2) and after (h, w, 1): motion and depth of the next frame, which may have another
    size. depth (height, width, 1): of this frame. All are float32.
    """
    nearest = np.full(depth.shape[:2], 2 * FAR, np.float32)
    inverse = np.full((*depth.shape[:2], 2), LOST, np.float32)
    motion, after, depth = (whole(plane, np.float32) for plane in (motion, after, depth))
    _splat(0, len(motion), motion, after, nearest, inverse)
    filled = np.empty(depth.shape[:2], np.bool_)
    for _ in range(CRACK_ROUNDS):
        _fill_cracks(0, len(depth), nearest, depth, inverse, filled)
        nearest[filled] = 0
    return inverse


class HistoryLength:
    """For how many frames each pixel's point has been visible. Stateful: call it on frames in
    order.

    Args:
        find_cuts: find cuts, as a `Pipeline` does, and start again at them. Not needed if a
            pipeline has already marked them in `frame.reset`.
    """

    def __init__(self, find_cuts: bool = False) -> None:
        self._detector = CutDetector() if find_cuts else None
        self._before: tuple[np.ndarray, np.ndarray] | None = None

    def reset(self) -> None:
        """Treat the next frame as the first."""
        self._before = None
        if self._detector:
            self._detector.reset()

    def __call__(self, frame: Frame) -> np.ndarray:
        """Lengths (h, w), uint8, from 1 to LONGEST_HISTORY_FRAMES."""
        length = np.ones(next(iter(frame.planes.values())).shape[:2], np.uint8)
        depth = _depth(frame)
        cut = self._detector is not None and self._detector(frame)
        if self._before and not (cut or frame.reset) and Role.MOTION in frame:
            given = (whole(plane, np.float32) for plane in (frame[Role.MOTION], depth))
            _extend_history(0, len(length), *given, *self._before,
                            np.array([LONGEST_HISTORY_FRAMES], np.float32), length)
        # the caller may write the next frame into the same arrays
        self._before = depth.copy(order="C"), length
        return length


def _depth(frame: Frame) -> np.ndarray:
    """Depth (h, w, 1); 1 everywhere if the frame has none."""
    if Role.DEPTH in frame:
        return frame[Role.DEPTH]
    return np.ones((*next(iter(frame.planes.values())).shape[:2], 1), np.float32)


# Kernels: postfx/kernels/interpolate/reverse_motion.cpp

_splat = Rows("reverse_splat")
_fill_cracks = Rows("reverse_fill_cracks")
_extend_history = Rows("reverse_extend_history")
_share_by_length = Rows("reverse_share_by_length")
_premultiply = Rows("reverse_premultiply")


def share_by_length(ahead: np.ndarray, back: np.ndarray, share: np.ndarray) -> None:
    """Write the later frames' share of a result, back / (ahead + back), averaged over 3x3 pixels:
    (h, w) float32.

    ahead and back (h, w) uint8: history lengths in order and in reverse order.
    """
    _share_by_length(0, len(share), ahead, back, share)


def premultiply(share: np.ndarray, colour: np.ndarray, later: np.ndarray) -> None:
    """Write premultiplied RGBA `later` (H, W, 4): colour (H, W, 3) times a share (h, w), which is
    also its alpha.

    The share is interpolated between pixel centres, so that its coarser pixels are not visible.
    """
    _premultiply(0, len(later), share, whole(colour, np.float32), later)
