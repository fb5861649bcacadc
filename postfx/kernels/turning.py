"""Sequences in reverse order: motion turned round, how far back a pixel is known, and results of both directions mixed.

These run on the host, as frames are read.
"""

from __future__ import annotations

import numpy as np

from postfx.kernels.numeric import compiled

FAR = np.float32(1e30)
"""In place of a depth that is not known, or larger."""
LOST = np.float32(1e4)
"""Motion, in pixels, of what the next frame does not show: it leads out of any picture."""
ALIKE = np.float32(0.03)
"""Part by which depths of one surface differ from pixel to pixel."""
SAME = np.float32(0.05)
"""Part by which the depth of a point differs from frame to frame."""
ROUNDS = 2
"""Pixels by which what the next frame shows stretched is filled from its sides."""


def turned_motion(motion: np.ndarray, after: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Motion (height, width, 2) to the next frame, from that frame's ``motion`` (h, w, 2) and depth ``after`` (h, w, 1)
    and this frame's ``depth`` (height, width, 1), all float32.

    In pixels of this frame, x right and y down; LOST where the next frame does not show a pixel.
    """
    nearest = np.full(depth.shape[:2], 2 * FAR, np.float32)
    turned = np.full((*depth.shape[:2], 2), LOST, np.float32)
    splat(motion, after, nearest, turned)
    filled = np.empty(depth.shape[:2], np.bool_)
    for _ in range(ROUNDS):
        mend(nearest, depth, turned, filled)
        nearest[filled] = 0
    return turned


@compiled
def splat(motion, depth, nearest, turned):
    """Give each pixel's motion, turned round, to where the pixel was; of several the nearest counts.

    motion (h, w, 2) and depth (h, w, 1): of the frame after; nearest (height, width), FAR * 2 where nothing came, and
    turned (height, width, 2): of this frame, which may have another size.
    """
    height, width = nearest.shape
    tall, wide = np.float32(height / motion.shape[0]), np.float32(width / motion.shape[1])
    half = np.float32(0.5)
    for y in range(motion.shape[0]):
        for x in range(motion.shape[1]):
            right, down = motion[y, x, 0] * wide, motion[y, x, 1] * tall
            u, v = (x + half) * wide + right, (y + half) * tall + down
            if not (0 <= u < width and 0 <= v < height):  # neither is NaN
                continue
            i, j = int(u), int(v)
            z = depth[y, x, 0] if depth[y, x, 0] < FAR else FAR
            if z < nearest[j, i]:
                nearest[j, i], turned[j, i, 0], turned[j, i, 1] = z, -right, -down


@compiled
def mend(nearest, depth, turned, filled):
    """Where nothing came, take the motion of the neighbour in 3x3 whose depth is most alike; `filled` tells where one
    was found. Turned is only changed where nothing came, so the order does not count."""
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
                        turned[y, x, 0], turned[y, x, 1] = turned[j, i, 0], turned[j, i, 1]


@compiled
def follow(motion, depth, before, known, most, count):
    """How many frames in a row show a pixel's point: one more than at the place that motion leads to, at most `most`.

    depth (h, w, 1) and motion (h, w, 2): of this frame; before (h', w', 1) and known (h', w'): depth and count of the
    one before. A point is the same if a pixel in 3x3 around that place has its depth.
    """
    height, width = known.shape
    tall, wide = np.float32(height / count.shape[0]), np.float32(width / count.shape[1])
    half = np.float32(0.5)
    for y in range(count.shape[0]):
        for x in range(count.shape[1]):
            count[y, x] = 1
            u, v = (x + half + motion[y, x, 0]) * wide, (y + half + motion[y, x, 1]) * tall
            if not (0 <= u < width and 0 <= v < height):
                continue
            column, row = int(u), int(v)
            for j in range(max(0, row - 1), min(height, row + 2)):
                for i in range(max(0, column - 1), min(width, column + 2)):
                    if abs(before[j, i, 0] / depth[y, x, 0] - np.float32(1)) < SAME:
                        count[y, x] = min(known[row, column] + 1, most)


@compiled
def shared(ahead, back, share):
    """Part of the result that comes from the frames after: `back` / (`ahead` + `back`), counts of frames in both
    directions, averaged over 3x3."""
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
def weighted(share, colour, later):
    """Premultiplied RGBA `later` (H, W, 4): colour (H, W, 3) times a share (h, w), which is also its alpha.

    The share is read between pixel centres, so that its pixels do not show.
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
