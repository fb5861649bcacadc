"""What lies over the scene and does not move as it does: overlays, and sparks without vectors.

Both are taken out of the pictures before paths are chosen, and put over what those make. A spark is a small group
of pixels that are much brighter than those around it, where its vector does not lead from one to another.
Sparks of two frames are paired by how far they are apart and, if a third frame follows, by how straight they go on.
Each pair moves straight. What has no partner is shown while its frame is the nearer one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from postfx.kernels.numeric import Real, compiled, inline
from postfx.sampling import local_sum

COVERED = 0.98
"""Coverage from which an overlay hides the picture."""
HOT, CONTRAST, SWARM = np.float32(3), 15.0, 10
"""Light of a spark's pixels, summed over channels, in multiples of the middle light, and of its mean in multiples of
that around it. Fewer pairs than the last number are highlights, which paths follow better."""
WIDEST, MOST = 12, 400
"""The longest side of a spark is one of this many parts of the picture's height; more sparks than this are noise."""
REACH = 12
"""The longest way of a spark from frame to frame is one of this many parts of the picture's width."""
STRAYS, UNLIKE = 0.15, 4.0
"""Share of its way by which a spark's next step may miss this one, and how many times as bright it may become."""


@dataclass
class Spark:
    """One spark: light (rows, columns, 3) above what is behind it, from pixel (top, left) on, and its middle (y, x)."""

    top: int
    left: int
    light: np.ndarray
    middle: np.ndarray

    @property
    def total(self) -> float:
        """All its light."""
        return float(self.light.sum())


Pair: TypeAlias = "tuple[Spark | None, Spark | None]"
"""A spark in both frames, or in one."""


def track_sparks(before: np.ndarray, after: np.ndarray, later: np.ndarray | None, motion: np.ndarray | None, level: Real
                 ) -> list[Pair]:
    """Sparks of two pictures (h, w, 3) that move otherwise than motion (h, w, 2) of the second one says. later: the
    picture that follows. level: middle light."""
    first, last = find_sparks(before, level), find_sparks(after, level)
    if motion is not None:
        first, last = explain_sparks(first, last, motion)
    if min(len(first), len(last)) < SWARM:
        return []
    onward = [] if later is None else find_sparks(np.nan_to_num(later, posinf=0, neginf=0), level)
    return pair_sparks(first, last, onward, before.shape[1])


def find_sparks(picture: np.ndarray, level: Real) -> list[Spark]:
    """Sparks of a picture (h, w, 3). level: middle light."""
    h, w = picture.shape[:2]
    boxes, count = find_hot(picture, np.float32(HOT * level), max(4, h // WIDEST))
    found = []
    for top, left, low, right in boxes[:count].tolist() if count <= MOST else []:
        rows, columns = slice(max(top - 2, 0), low + 3), slice(max(left - 2, 0), right + 3)
        part = picture[rows, columns]
        rim = np.ones(part.shape[:2], bool)
        y, x = rows.start, columns.start
        rim[max(top - y - 1, 0):low - y + 2, max(left - x - 1, 0):right - x + 2] = False
        around = part[rim].mean(0) if rim.any() else part.min((0, 1))
        light = np.maximum(part - around, 0)
        light[rim] = 0
        inner = picture[top:low + 1, left:right + 1].sum(-1)
        if inner.max() < CONTRAST * max(float(around.sum()), 1e-6):
            continue
        weight = light.sum(-1) / light.sum()
        middle = [(weight * (axis + start)).sum() for axis, start in zip(np.indices(weight.shape), (y, x), strict=True)]
        found.append(Spark(y, x, light, np.array(middle)))
    return found


@compiled
def find_hot(picture: np.ndarray, least: Real, widest: int) -> tuple[np.ndarray, int]:
    """Boxes (n, 4) of groups of pixels with that much light, top, left, low and right, and how many there are; groups
    that are wider are left out."""
    h, w = picture.shape[:2]
    seen, queue = np.zeros((h, w), np.bool_), np.empty((h * w, 2), np.int32)
    boxes, count = np.empty((MOST, 4), np.int64), 0
    for y in range(0, h, 2):  # one pixel of four finds all but the smallest
        for x in range(0, w, 2):
            if seen[y, x] or not is_hot(picture, y, x, least):
                continue
            head, tail, top, left, low, right = 0, 1, y, x, y, x
            seen[y, x], queue[0, 0], queue[0, 1] = True, y, x
            while head < tail:
                j, i = queue[head]
                head += 1
                top, left, low, right = min(top, j), min(left, i), max(low, j), max(right, i)
                for b in range(max(j - 1, 0), min(j + 2, h)):
                    for a in range(max(i - 1, 0), min(i + 2, w)):
                        if not seen[b, a] and is_hot(picture, b, a, least):
                            seen[b, a], queue[tail, 0], queue[tail, 1] = True, b, a
                            tail += 1
            if max(low - top, right - left) < widest:
                if count < MOST:
                    boxes[count, 0], boxes[count, 1], boxes[count, 2], boxes[count, 3] = top, left, low, right
                count += 1
    return boxes, count


@inline
def is_hot(picture: np.ndarray, y: int, x: int, least: Real) -> bool:
    """Whether a pixel has that much light, summed over channels."""
    return bool(picture[y, x, 0] + picture[y, x, 1] + picture[y, x, 2] > least)


def pair_sparks(before: list[Spark], after: list[Spark], later: list[Spark], width: int) -> list[Pair]:
    """Sparks of both frames that are one, and those without a partner."""
    first, last = (np.array([one.middle for one in some]) for some in (before, after))
    step = last[None] - first[:, None]
    size = np.hypot(step[..., 0], step[..., 1])
    ratio = np.array([[other.total / one.total for other in after] for one in before])
    cost = size * (1 + np.abs(np.log(ratio)))
    if later:
        onward = np.array([one.middle for one in later])[None, None] - last[None, :, None] - step[:, :, None]
        miss = np.hypot(onward[..., 0], onward[..., 1]).min(-1)
        cost = np.where(miss <= 1 + STRAYS * size, miss + 0.2 * cost, 4 * cost)
    cost[(size > width / REACH) | (np.abs(np.log(ratio)) > np.log(UNLIKE))] = np.inf
    pairs: list[Pair] = []
    free_before, free_after = set(range(len(before))), set(range(len(after)))
    for k in np.argsort(cost, None):
        one, other = divmod(int(k), len(after))
        if not cost[one, other] < np.inf:
            break
        if one in free_before and other in free_after:
            pairs.append((before[one], after[other]))
            free_before.discard(one)
            free_after.discard(other)
    if len(pairs) < SWARM:
        return []
    return pairs + [(before[k], None) for k in sorted(free_before)] + [(None, after[k]) for k in sorted(free_after)]


def explain_sparks(before: list[Spark], after: list[Spark], motion: np.ndarray) -> tuple[list[Spark], list[Spark]]:
    """Those sparks that do not move as motion (h, w, 2) of the frame after says."""
    if not before or not after:
        return before, after
    middles, kept, known = np.array([one.middle for one in before]), [], np.zeros(len(before), bool)
    for one in after:
        y, x = np.rint(one.middle).astype(int)
        way = motion[y, x, ::-1]
        apart = np.hypot(*(middles - one.middle - way).T)
        close = apart < 1.5 + 0.1 * np.hypot(*way)
        known |= close
        if not close.any():
            kept.append(one)
    return [one for one, is_known in zip(before, known, strict=True) if not is_known], kept


def remove_sparks(picture: np.ndarray, sparks: Sequence[Spark | None]) -> np.ndarray:
    """The picture (h, w, 3) without their light."""
    if not sparks:
        return picture
    clean = picture.copy()
    for one in sparks:
        if one is None:
            continue
        rows, columns = one.light.shape[:2]
        clean[one.top:one.top + rows, one.left:one.left + columns] -= one.light
    return clean


def add_sparks(picture: np.ndarray, pairs: list[Pair], t: float) -> None:
    """Put sparks over a picture (h, w, 3) at a time: those of the nearer frame, by whole pixels, as a spark that is
    mixed or shared out between pixels is larger to the eye."""
    for pair in pairs:
        one, other = pair if t <= 0.5 else pair[::-1]
        if one is None:
            continue
        way = np.zeros(2) if other is None else (t if t <= 0.5 else 1 - t) * (other.middle - one.middle)
        top, left = np.rint((one.top, one.left) + way).astype(int)
        rows, columns = (slice(max(first, 0), max(first + count, 0))
                         for first, count in zip((top, left), one.light.shape, strict=False))
        part = picture[rows, columns]
        part += one.light[rows.start - top:, columns.start - left:][:part.shape[0], :part.shape[1]]


@compiled
def find_overlay(before: np.ndarray, after: np.ndarray, motion: np.ndarray, reach: int, known: np.ndarray) -> None:
    """Mark as unknown what is drawn over both pictures and stands still while the scene behind it moves.

    Such pixels have the same bits in both frames and an edge beside them that has, too, and their motion is half a
    pixel or more; `reach` pixels with the same bits around them belong to them.
    """
    h, w = known.shape
    steps = np.full((h, w), -1, np.int32)
    queue = np.empty((h * w, 2), np.int64)
    head, tail = 0, 0
    for y in range(h):
        for x in range(w):
            if not (is_same(before, after, y, x) and abs(motion[y, x, 0]) + abs(motion[y, x, 1]) >= 0.5):
                continue
            for j, i in ((y, x + 1), (y + 1, x), (y, x - 1), (y - 1, x)):
                if 0 <= j < h and 0 <= i < w and is_same(before, after, j, i) and steps[y, x] < 0:
                    edge = False
                    for c in range(3):
                        size = abs(before[y, x, c]) + abs(before[j, i, c])
                        edge = edge or abs(before[y, x, c] - before[j, i, c]) > np.float32(0.02) * size
                    if edge:
                        steps[y, x] = 0
                        queue[tail, 0], queue[tail, 1] = y, x
                        tail += 1
    while head < tail:
        y, x = queue[head, 0], queue[head, 1]
        head += 1
        known[y, x] = False
        if steps[y, x] >= reach:
            continue
        for j, i in ((y, x + 1), (y + 1, x), (y, x - 1), (y - 1, x)):
            if 0 <= j < h and 0 <= i < w and steps[j, i] < 0 and is_same(before, after, j, i):
                steps[j, i] = steps[y, x] + 1
                queue[tail, 0], queue[tail, 1] = j, i
                tail += 1


@inline
def is_same(before: np.ndarray, after: np.ndarray, y: int, x: int) -> bool:
    """Whether a pixel has the same colour in both frames."""
    return bool(before[y, x, 0] == after[y, x, 0] and before[y, x, 1] == after[y, x, 1]
                and before[y, x, 2] == after[y, x, 2])


def remove_overlay(colour: np.ndarray, overlay: np.ndarray) -> np.ndarray:
    """The picture under an overlay that was composited over it; black where nothing of it is left."""
    clear = 1 - overlay[..., 3:]
    picture = np.zeros_like(colour)
    np.divide(colour - overlay[..., :3], clear, out=picture, where=clear > 1 - COVERED)
    return picture


def measure_clearness(one: np.ndarray, other: np.ndarray, below: np.ndarray, below_other: np.ndarray) -> np.ndarray:
    """How much of the picture an overlay lets through (h, w, 1), 0 to 1, by the difference of two frames with and
    without it: least squares of colour = overlay + clearness * picture over 5x5 pixels, for an overlay that stands
    still. 1 where the picture does not change, as it makes no difference there."""
    change, seen = below_other - below, other - one
    product, square = (local_sum((change * by).sum(-1), 2) for by in (seen, change))
    clear = np.divide(product, square, out=np.ones_like(square), where=square > 0).clip(0, 1)
    still = (seen == 0).all(-1) & (change != 0).any(-1)
    clear[still] = 0  # to the pixel, where nothing comes through
    found: np.ndarray = clear[..., None]
    return found
