"""How well each way explains two pictures: vectors, estimated motion ("flow"), standing still.

If vectors explain much less than the flow does, they are not used: those of frames that are held,
of a wrong sign or unit, or of the shot that goes in a dissolve. In a dissolve neither explains
much, and each leads somewhere else. Then all ways may count, the mean of both frames among them, by
how evenly colours go on along them through the frames around (`unevenness`).

A misfit is a mean difference of toned light. Constants below are ratios of misfits or shares of
pixels, with what was measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from postfx.sampling import bilinear, is_inside

COMPARED_ROWS = 100
"""Rows, or columns, of the shorter side that are looked at."""
MOST_APART = 0.1
"""Difference of toned light that a pixel counts with, at most."""
LEAST_INSIDE = 0.25
"""Share of the pixels that must lead into the picture."""

# Whether vectors fit

WORSE = 1.35
"""Misfit of vectors over the flow's, above which they are not used unless they explain enough.
Right vectors of nine noisy renders have up to 1.7."""
LEAST_EXPLAINED = 0.5
"""Share of what the flow explains that such vectors must explain. Right ones have at least 0.53,
those of half the motion 0.27 to 0.48."""
MUCH_WORSE = 2.2
"""Misfit of vectors over the flow's, above which they are not used whatever they explain."""
DIFFERENT_WAY_CELLS = 0.5
"""Distance in cells from which two ways differ at a pixel."""
DIFFERENT_WAY_SHARE = 0.5
"""Share of pixels at which vectors and flow must differ for vectors not to fit."""

# Whether other ways count beside vectors that fit

LITTLE_EXPLAINED = 0.5
"""The smaller misfit of vectors and flow over that of standing still, from which other ways may
count."""
LEAD_APART = 0.5
"""Disagreement of vectors and flow over the misfit of standing still, from which other ways may
count: up to 0.48 in renders, 0.63 to 1.2 in dissolves."""
CLEARLY_WORSE = 1.45
"""Misfit of vectors over the flow's, from which less disagreement is enough."""
FAR_APART = 0.27
"""Such disagreement, times the share of vectors that differ: up to 0.21 in water."""
DIFFERENT_VECTOR_SHARE = 0.5
"""Share of pixels at which vectors must differ, from the flow and from standing still, for other
ways to count: 0.33 where it snows, where the next ratio is 0.62."""
LEAST_SPREAD = 0.1
"""Share of the pixels over which the misfit of vectors must be spread for other ways to count: 0.02
to 0.06 for a wire that moves before a wall, 0.13 and more in dissolves."""
LIKE_STILL = 0.98
"""Misfit of vectors over that of standing still, from which nothing moves by them."""

# Thin things, such as wires

FINDS_MORE = 1.12
"""Misfit of vectors that explain much, over the flow's, from which the flow finds more of a thin
thing."""
LEAST_LED = 0.2
"""Share of the misfit of vectors that lies where these lead anywhere, from which they are wrong: 0
where they know nothing of a thing, such as sparks, and half where a wire has wrong ones."""
LED_CELLS = 0.1
"""Length in cells from which a vector leads anywhere."""
FINDS_NOTHING = 0.9
"""Misfit of vectors over that of standing still, from which they find nothing of a thin thing: up
to 0.92 for right ones, 0.97 and more for (1, 1)."""

# How much ways count by their unevenness

UNEVEN_POWER = 4
"""Ways count by the inverse of this power of their unevenness."""
FLOW_HANDICAP = 1.1
"""Factor of the flow's unevenness: it was found in the very pictures that it is compared by."""
REST_HANDICAP = 1.5
"""Factor of the unevenness of what moves before a shot that stands still: half of it was fitted."""
CLEARLY_BETTER = 0.9
"""Unevenness of the flow over that of vectors that stand still, below which it counts beside them.
In noise the flow has 1.1 to 1.8."""
AS_EVEN = 0.84
"""Unevenness of vectors over a blend's, from which they do not count alone: up to 0.77 in
renders."""
AS_EVEN_ALONE = 0.95
"""The same where only two frames are known: up to 0.82 in renders, 1.15 in noise."""
LEAST_LEFT = 0.5
"""Misfit of vectors over that of standing still, below which unevenness does not raise doubt: what
moves may hide and uncover much that is uneven."""
LEAST_LEFT_ALONE = 0.9
"""The same where only two frames are known."""
LEAST_SPREAD_OF_FLOW = 0.25
"""Share of the pixels over which the flow's misfit must be spread for a blend to count beside it:
0.09 to 0.13 for a wire, 0.35 and more in dissolves."""
LEAST_LEFT_OF_FLOW = 0.4
"""Misfit of the flow over that of standing still, from which a blend may count where there are no
vectors."""
LESS_EVEN_THAN_FLOW = 0.5
"""Unevenness of the flow over a blend's, from which a blend may count."""
MORE_EVEN = 1.03
"""Unevenness of vectors that explain nothing over a blend's, from which a blend is better."""
MOSTLY_NOISE = 0.5
"""Unevenness that neighbouring cells have in common over all of it, below which noise hides the
rest."""
DOUBTING_ROWS = 50
"""Rows that are looked at for `MOSTLY_NOISE`."""
ALONE = 0.3
"""Weight of differences that neighbouring cells do not have in common: noise, and finest detail."""
LEAST_SHARE = 0.1
"""Ways that would count less do not count."""
LEAST_UNEVEN = 1e-5
"""Toned light that is added to unevenness: frames that are all alike have none."""


@dataclass(frozen=True)
class MotionFit:
    """How well vectors, flow and standing still explain two pictures, over the pixels that vectors
    and flow lead into the earlier one.

    Attributes:
        flow, vectors, still: misfits along the flow, along vectors, and at the same place.
        disagreement: difference of what flow and vectors show in the earlier picture.
        apart: share of the pixels at which the two differ by more than DIFFERENT_WAY_CELLS.
        moving_apart: share of pixels at which vectors differ from standing still as well.
        vectors_spread, flow_spread: share of pixels over which each misfit is spread.
        led: share of the misfit of vectors that lies where these lead anywhere.
    """

    flow: float
    vectors: float
    still: float
    disagreement: float
    apart: float
    moving_apart: float
    vectors_spread: float
    flow_spread: float
    led: float

    @property
    def vectors_fit(self) -> bool:
        """Whether vectors may be used. They may if the flow is mostly the same: single things may
        have none. They may not if they fit worse than standing still, too."""
        if self.vectors > max(MUCH_WORSE * self.flow, WORSE * self.still):
            return False
        if self.apart < DIFFERENT_WAY_SHARE:
            return True
        if self.vectors > MUCH_WORSE * self.flow:
            return False
        explained = self.still - self.vectors
        return (self.vectors <= WORSE * self.flow
                or explained >= LEAST_EXPLAINED * (self.still - self.flow))

    @property
    def in_doubt(self) -> bool:
        """Whether vectors and flow lead apart, and neither explains much or vectors explain much
        less, as in a dissolve."""
        if self.is_thin:
            return False
        if self.vectors >= CLEARLY_WORSE * self.flow:
            return self.disagreement * self.moving_apart >= FAR_APART * self.still
        return (min(self.flow, self.vectors) >= LITTLE_EXPLAINED * self.still
                and self.disagreement >= LEAD_APART * self.still
                and self.moving_apart >= DIFFERENT_VECTOR_SHARE)

    def vectors_explain_little(self, frames: int) -> bool:
        """Whether vectors explain so little that a blend may be as even. frames: how many are
        known."""
        least = LEAST_LEFT_ALONE if frames == 2 else LEAST_LEFT
        return self.vectors > least * self.still

    @property
    def is_thin(self) -> bool:
        """Whether only a thin thing is not where vectors lead: then nothing dissolves."""
        return self.vectors_spread < LEAST_SPREAD

    @property
    def is_thin_along_flow(self) -> bool:
        """Whether only a thin thing is not where the flow leads."""
        return self.flow_spread < LEAST_SPREAD_OF_FLOW

    def shares_of_thin(self, frames: int) -> tuple[float, float]:
        """How much vectors and flow count for a picture with a thin thing: by how much of it each
        finds. frames: how many are known."""
        if self.vectors_stand_still and self.led < LEAST_LED:
            return 1.0, 0.0  # vectors know nothing of it, and cells take the flow where it fits
        is_much_found = not self.vectors_explain_little(frames)
        if self.vectors <= self.flow * (FINDS_MORE if is_much_found else 1):
            return 1.0, 0.0
        # all but the thing fits any way, so that small differences tell much
        power = 2 if self.vectors > FINDS_NOTHING * self.still else 1
        given, flowing = shares_of(((self.vectors / self.flow) ** power, 1.0))
        return given, flowing

    @property
    def vectors_stand_still(self) -> bool:
        """Whether nothing moves by the vectors."""
        return (self.vectors >= LIKE_STILL * self.still
                and self.moving_apart < DIFFERENT_VECTOR_SHARE)


def compare_motion(before: np.ndarray, after: np.ndarray, flow: np.ndarray,
                   vectors: np.ndarray) -> MotionFit | None:
    """Compare two grey pictures (h, w) along two fields of motion (h, w, 2) of the later one, in
    pixels, NaN where unknown. None if too few pixels lead into the earlier one."""
    step = max(2, min(after.shape) // COMPARED_ROWS)
    y, x = np.mgrid[:after.shape[0]:step, :after.shape[1]:step]
    fields = [one[::step, ::step] for one in (flow, vectors)]
    places = [(x + one[..., 0], y + one[..., 1]) for one in fields]
    inside = np.logical_and(*(is_inside(before, *place) for place in places))  # false for NaN
    if inside.sum() < LEAST_INSIDE * inside.size:
        return None
    now, still = (picture[::step, ::step][inside] for picture in (after, before))
    one, other = (bilinear(before, across[inside], down[inside]) for across, down in places)
    misfits = (_misfit(one, now), _misfit(other, now), _misfit(still, now), _misfit(one, other))
    apart, moving = (np.abs(one).max(-1)[inside] > DIFFERENT_WAY_CELLS
                     for one in (fields[0] - fields[1], fields[1]))
    left = np.minimum(np.abs(other - now), MOST_APART)
    leads = np.abs(fields[1]).max(-1)[inside] > LED_CELLS
    return MotionFit(*misfits, float(apart.mean()), float((apart & moving).mean()),
                _spread(other, now), _spread(one, now),
                float(left[leads].sum() / max(left.sum(), LEAST_UNEVEN)))


def unevenness(row: Sequence[np.ndarray], first: int, motion: np.ndarray, level: float,
               shot: np.ndarray | None = None, alone: float = ALONE,
               rows: int = COMPARED_ROWS) -> float:
    """How unevenly the colours of frames in a row go on along a way: by how much frames differ from
    the mean of those next to them, or, of two frames, by how much they differ.

    In a dissolve, what moves along the right way goes over evenly. Colours are compared, as two
    shots may look alike in grey. Noise counts less, as it differs from cell to cell: differences
    are multiplied with those beside and below.

    Args:
        row: (h, w, 3) two to four frames.
        first: number of the one before the time between, 0 or 1.
        motion: (rows, columns, 2) to the frame before in pixels of the pictures, for cells of them.
        level: light that is toned to about the middle.
        shot: likewise, of a shot that goes over into one that moves by `motion`: what four frames
            show beside `straight_course` along it is looked at.
        alone: how much differences count that cells beside have not in common.
        rows: of cells, or columns of the shorter side, that are looked at.
    """
    h, w = row[0].shape[:2]
    side, step = h / motion.shape[0], max(1, min(motion.shape[:2]) // rows)
    last_row, last_column = (max(count - 1, 1) for count in motion.shape[:2])
    moved = np.nan_to_num(motion[:last_row:step, :last_column:step]).reshape(-1, 2)
    cells = np.mgrid[:last_row:step, :last_column:step].reshape(2, -1)
    down, across = (cells + 0.5) * side - 0.5
    since = [np.float32(first + 0.5 - number) for number in range(len(row))]
    places = [(across + time * moved[:, 0], down + time * moved[:, 1]) for time in since]
    is_seen = np.logical_and.reduce([is_inside(row[0], *place) for place in places])
    if not is_seen.any():
        is_seen[:] = True
    led = None if shot is None else np.nan_to_num(
        shot[:last_row:step, :last_column:step]).reshape(-1, 2)[is_seen]
    here, beside, below = (
        _differences(row, [(x[is_seen] + right, y[is_seen] + lower) for x, y in places], level,
                     led)
        for right, lower in ((0, 0), (side, 0), (0, side)))
    common = max(float(np.mean(here * (beside + below))) / 2, 0.0)
    return float((common + alone * (float(np.mean(here * here)) - common)) ** 0.5)


def _differences(row: Sequence[np.ndarray], places: Sequence[tuple[np.ndarray, np.ndarray]],
                 level: float, led: np.ndarray | None) -> np.ndarray:
    """The differences of `unevenness` at places (x, y) in each frame, (..., 3). led: motion (count,
    2) of the other shot there."""
    shown = []
    for number, (x, y) in enumerate(places):
        toned = partial(tone_light, level=level)
        if led is None:
            shown.append(bilinear(row[number], x, y, toned))
            continue
        seen = [bilinear(one, x + (number - other) * led[:, 0], y + (number - other) * led[:, 1],
                         toned)
                for other, one in enumerate(row)]
        shown.append(rest_of(seen, number))
    if len(shown) == 2:
        return np.asarray(shown[0] - shown[1])
    return np.stack([(one + other) / 2 - middle for one, middle, other in
                     zip(shown, shown[1:], shown[2:], strict=False)])


def straight_course(row: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """The straight line through each number of four arrays of a shape that is nearest to them:
    their mean, and by what they grow from one to the next."""
    mean = sum(row[1:], row[0]) / np.float32(4)
    growth = np.float32(0.3) * (row[3] - row[0]) + np.float32(0.1) * (row[2] - row[1])
    return mean, growth


def rest_of(row: Sequence[np.ndarray], number: int) -> np.ndarray:
    """One of four arrays less its `straight_course`."""
    mean, growth = straight_course(row)
    rest: np.ndarray = row[number] - mean - np.float32(number - 1.5) * growth
    return rest


def shares_of(uneven: Sequence[float]) -> list[float]:
    """How much ways should count that are so uneven; the sum is 1."""
    counts = [(one + LEAST_UNEVEN) ** -UNEVEN_POWER for one in uneven]
    counts = [count if count >= LEAST_SHARE * sum(counts) else 0.0 for count in counts]
    return [count / sum(counts) for count in counts]


def _misfit(one: np.ndarray, other: np.ndarray) -> float:
    """Mean difference of toned light."""
    return float(np.minimum(np.abs(one - other), MOST_APART).mean())


def _spread(one: np.ndarray, other: np.ndarray) -> float:
    """Share of pixels over which the difference of toned light is spread."""
    left = np.minimum(np.abs(one - other), MOST_APART)
    return float(left.sum() ** 2 / max(left.size * np.square(left).sum(), LEAST_UNEVEN**2))


def tone_light(light: np.ndarray, level: float) -> np.ndarray:
    """Light of the range 0 to 1, in which differences are about as visible in the dark as in the
    light."""
    positive = np.maximum(light, 0)
    toned: np.ndarray = np.sqrt(positive / (positive + np.float32(level)))
    return toned
