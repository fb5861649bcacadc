"""Motion for a run in reverse order, and the number of frames for which each pixel has been visible.

Everything here runs on the host: functions on frames first, then compiled loops over pixels.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from postfx.cuts import CutDetector
from postfx.frame import Frame, Role
from postfx.kernels.numeric import compiled
from postfx.repair import still_where_unknown

LONGEST = 8
"""Longest history that counts, in frames: a longer one hardly improves a result."""

FAR = np.float32(1e30)
"""Stands for an unknown depth or a larger one."""
LOST = np.float32(1e4)
"""Motion, in pixels, of a point that the next frame does not show: it points outside any picture."""
ALIKE = np.float32(0.03)
"""Relative difference in depth between neighbouring pixels of one surface."""
SAME = np.float32(0.05)
"""Relative difference in depth of one point between two frames."""
ROUNDS = 2
"""Pixels by which cracks are filled from each side. Cracks open where the next frame shows a surface larger."""


def reverse_motion(frame: Frame, after: Frame | None) -> Frame:
    """The frame with motion to the frame `after` it. Before a cut, or with None, it becomes a first frame.

    Pixels that the frame after does not show get motion that points outside the picture. A frame without a motion plane
    is only marked as a first frame.
    """
    if after is None or after.reset or Role.MOTION not in after or Role.MOTION not in frame:
        return replace(frame, reset=True)
    return replace(frame, planes={**frame.planes, Role.MOTION: motion_to_next(frame, after)}, reset=False)


def motion_to_next(frame: Frame, after: Frame) -> np.ndarray:
    """Motion (h, w, 2): position in the frame after minus position in this one, in pixels of this one; x right, y down.

    Computed from the motion of the frame after: each of its pixels says where it came from; the nearest one wins.
    Motion that is NaN counts as none, as in every pass.
    """
    return invert_motion(still_where_unknown(after[Role.MOTION]), _depth(after), _depth(frame))


def invert_motion(motion: np.ndarray, after: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Motion (height, width, 2) to the next frame, in pixels of this frame; LOST where the next frame hides a pixel.

    motion (h, w, 2) and after (h, w, 1): motion and depth of the next frame, which may have another size. depth
    (height, width, 1): of this frame. All are float32.
    """
    nearest = np.full(depth.shape[:2], 2 * FAR, np.float32)
    inverse = np.full((*depth.shape[:2], 2), LOST, np.float32)
    splat(motion, after, nearest, inverse)
    filled = np.empty(depth.shape[:2], np.bool_)
    for _ in range(ROUNDS):
        fill_cracks(nearest, depth, inverse, filled)
        nearest[filled] = 0
    return inverse


class HistoryLength:
    """For how many frames each pixel's point has been visible. Stateful: call it on frames in order.

    Args:
        find_cuts: find cuts, as a `Pipeline` does, and start again at them. Not needed if a pipeline has already marked
            them in `frame.reset`.
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
        """Lengths (h, w), uint8, from 1 to LONGEST."""
        length = np.ones(next(iter(frame.planes.values())).shape[:2], np.uint8)
        depth = _depth(frame)
        cut = self._detector is not None and self._detector(frame)
        if self._before and not (cut or frame.reset) and Role.MOTION in frame:
            extend_history(frame[Role.MOTION], depth, *self._before, LONGEST, length)
        self._before = depth.copy(), length  # the caller may write the next frame into the same arrays
        return length


def _depth(frame: Frame) -> np.ndarray:
    """Depth (h, w, 1); 1 everywhere if the frame has none."""
    if Role.DEPTH in frame:
        return frame[Role.DEPTH]
    return np.ones((*next(iter(frame.planes.values())).shape[:2], 1), np.float32)


@compiled
def splat(motion: np.ndarray, depth: np.ndarray, nearest: np.ndarray, inverse: np.ndarray) -> None:
    """Write each pixel's inverse motion to the place it came from; the nearest of several wins.

    motion (h, w, 2) and depth (h, w, 1) are the next frame's. nearest (height, width), which is 2 * FAR where nothing
    arrived, and inverse (height, width, 2) are this frame's, which may have another size.
    """
    height, width = nearest.shape
    tall, wide = np.float32(height / motion.shape[0]), np.float32(width / motion.shape[1])
    half = np.float32(0.5)
    for y in range(motion.shape[0]):
        for x in range(motion.shape[1]):
            right, down = motion[y, x, 0] * wide, motion[y, x, 1] * tall
            u, v = (x + half) * wide + right, (y + half) * tall + down
            if not (0 <= u < width and 0 <= v < height):  # false for NaN, too
                continue
            i, j = int(u), int(v)
            z = depth[y, x, 0] if depth[y, x, 0] < FAR else FAR
            if z < nearest[j, i]:
                nearest[j, i], inverse[j, i, 0], inverse[j, i, 1] = z, -right, -down


@compiled
def fill_cracks(nearest: np.ndarray, depth: np.ndarray, inverse: np.ndarray, filled: np.ndarray) -> None:
    """Fill pixels where nothing arrived with the motion of the 3x3 neighbour of most similar depth.

    `filled` marks them. Only such pixels of `inverse` change, so the order of pixels does not matter.
    """
    height, width = nearest.shape
    for y in range(height):
        for x in range(width):
            filled[y, x] = False
            if nearest[y, x] <= FAR:
                continue
            best = ALIKE
            for j in range(max(0, y - 1), min(height, y + 2)):
                for i in range(max(0, x - 1), min(width, x + 2)):
                    unlike = abs(depth[j, i, 0] / depth[y, x, 0] - np.float32(1))
                    if nearest[j, i] <= FAR and unlike < best:
                        best, filled[y, x] = unlike, True
                        inverse[y, x, 0], inverse[y, x, 1] = inverse[j, i, 0], inverse[j, i, 1]


@compiled
def extend_history(
    motion: np.ndarray, depth: np.ndarray, before: np.ndarray, known: np.ndarray, most: int, length: np.ndarray
) -> None:
    """Write each pixel's history length: one more than at the place its motion points to, at most `most`.

    motion (h, w, 2) and depth (h, w, 1) are this frame's; before (h', w', 1) and known (h', w') are depth and length of
    the frame before. A point counts as the same if a pixel in the 3x3 around that place has its depth.
    """
    height, width = known.shape
    tall, wide = np.float32(height / length.shape[0]), np.float32(width / length.shape[1])
    half = np.float32(0.5)
    for y in range(length.shape[0]):
        for x in range(length.shape[1]):
            length[y, x] = 1
            u, v = (x + half + motion[y, x, 0]) * wide, (y + half + motion[y, x, 1]) * tall
            if not (0 <= u < width and 0 <= v < height):
                continue
            column, row = int(u), int(v)
            for j in range(max(0, row - 1), min(height, row + 2)):
                for i in range(max(0, column - 1), min(width, column + 2)):
                    if abs(before[j, i, 0] / depth[y, x, 0] - np.float32(1)) < SAME:
                        length[y, x] = min(known[row, column] + 1, most)


@compiled
def share_by_length(ahead: np.ndarray, back: np.ndarray, share: np.ndarray) -> None:
    """Write the later frames' share of a result, back / (ahead + back), averaged over 3x3.

    ahead and back (h, w): history lengths in order and in reverse order.
    """
    height, width = share.shape
    for y in range(height):
        for x in range(width):
            total, places = np.float32(0), 0
            for j in range(max(0, y - 1), min(height, y + 2)):
                for i in range(max(0, x - 1), min(width, x + 2)):
                    total += np.float32(back[j, i]) / np.float32(ahead[j, i] + back[j, i])
                    places += 1
            share[y, x] = total / places


@compiled
def premultiply(share: np.ndarray, colour: np.ndarray, later: np.ndarray) -> None:
    """Write premultiplied RGBA `later` (H, W, 4): colour (H, W, 3) times a share (h, w), which is also its alpha.

    The share is interpolated between pixel centres, so that its coarser pixels are not visible.
    """
    height, width = later.shape[:2]
    tall, wide = np.float32(share.shape[0] / height), np.float32(share.shape[1] / width)
    half, one = np.float32(0.5), np.float32(1)
    for y in range(height):
        v = max((y + half) * tall - half, np.float32(0))
        upper = min(int(v), share.shape[0] - 1)
        lower, down = min(upper + 1, share.shape[0] - 1), v - upper
        for x in range(width):
            u = max((x + half) * wide - half, np.float32(0))
            left = min(int(u), share.shape[1] - 1)
            right, along = min(left + 1, share.shape[1] - 1), u - left
            above = share[upper, left] * (one - along) + share[upper, right] * along
            below = share[lower, left] * (one - along) + share[lower, right] * along
            weight = above * (one - down) + below * down
            for c in range(3):
                later[y, x, c] = colour[y, x, c] * weight
            later[y, x, 3] = weight
