"""How well vectors and estimated motion explain two pictures, beside standing still.

Where vectors explain much less than estimated motion does, they are not used: those of frames that
are held, of a wrong sign or unit, of the shot that goes in a dissolve. In the middle of a dissolve
neither explains much, and each leads another way: the mean of both frames is better then than
either. Where frames beside the two are known, ways count there as they foretell a known frame
from those next to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from postfx.sampling import bilinear, is_inside

COMPARED_ROWS = 100
"""Rows or columns of the shorter side that are looked at."""
MOST_APART = 0.1
"""Difference of toned light up to which a pixel counts."""
LEAST_INSIDE = 0.25
"""Share of the pixels that must lead into the picture."""
WORSE = 1.35
"""Misfit of vectors, in that of the flow, beyond which they are not used if they explain too
little. Right vectors of nine noisy renders have up to 1.7."""
LEAST_EXPLAINED = 0.5
"""Share of what the flow explains that such vectors must explain. Right ones have at least 0.53,
those of half the motion 0.27 to 0.48."""
MUCH_WORSE = 2.2
"""Misfit beyond which they are not used whatever they explain."""
LIKE_STILL = 0.5, 0.55
"""Misfit of the better one, in that of standing still, from which the mean of both frames begins to
count, and from which it does in full. Both numbers below are ranges likewise."""
LEAD_APART = 0.5, 0.6
"""Difference of what both ways show, in that of standing still: up to 0.48 in renders, 0.63 to 1.2
in dissolves."""
DIFFERENT_WAY_CELLS = 0.5
"""Cells by which ways differ."""
DIFFERENT_WAY_SHARE = 0.5
"""Share of pixels whose ways must differ for vectors not to fit."""
DIFFERENT_VECTOR_SHARES = 0.5, 0.8
"""Share of pixels whose vectors differ: 0.33 where it snows, which has 0.62 of the former."""

FORETOLD_POWER = 4
"""Power of their errors by which ways count."""
FLOW_HANDICAP = 1.5
"""By how much the error of estimated motion counts as larger: it was found in the very pictures
that it foretells."""
LEAST_SHARE = 0.1
"""Ways that would count less do not count."""
LEAST_ERROR = 1e-5
"""Toned light that is added to errors: frames that are all alike have none."""


@dataclass(frozen=True)
class Ways:
    """Mean differences of two grey pictures over pixels that both ways lead into the earlier one.

    Attributes:
        flow, motion, still: along estimated motion, along vectors, and at the same place.
        between: of what estimated motion and vectors show in the earlier picture.
        apart: share of the pixels at which the two ways differ by more than
            DIFFERENT_WAY_CELLS.
        different: share of those at which vectors differ from standing still as well.
    """

    flow: float
    motion: float
    still: float
    between: float
    apart: float
    different: float

    @property
    def vectors_fit(self) -> bool:
        """Whether vectors may be used. They are where estimated motion is the same mostly: a thing
        may have none."""
        if self.apart < DIFFERENT_WAY_SHARE:
            return True
        if self.motion > MUCH_WORSE * self.flow:
            return False
        explained = self.still - self.motion
        return (self.motion <= WORSE * self.flow
                or explained >= LEAST_EXPLAINED * (self.still - self.flow))

    @property
    def share_of_mean(self) -> float:
        """How much the mean of both frames should count, 0 to 1."""
        if self.still <= 0:
            return 0.0
        better = min(self.flow, self.motion) / self.still
        return (_ramp(better, LIKE_STILL) * _ramp(self.between / self.still, LEAD_APART)
                * _ramp(self.different, DIFFERENT_VECTOR_SHARES))


def compare_ways(before: np.ndarray, after: np.ndarray, flow: np.ndarray,
                 motion: np.ndarray) -> Ways | None:
    """Compare two grey pictures (h, w) along two fields of motion (h, w, 2) of the later one, in
    pixels, NaN where unknown. None where too little leads into the earlier one."""
    step = max(2, min(after.shape) // COMPARED_ROWS)
    y, x = np.mgrid[:after.shape[0]:step, :after.shape[1]:step]
    fields = [one[::step, ::step] for one in (flow, motion)]
    places = [(x + one[..., 0], y + one[..., 1]) for one in fields]
    inside = np.logical_and(*(is_inside(before, *place) for place in places))  # false for NaN
    if inside.sum() < LEAST_INSIDE * inside.size:
        return None
    now, still = (picture[::step, ::step][inside] for picture in (after, before))
    one, other = (bilinear(before, across[inside], down[inside]) for across, down in places)
    misfits = (_misfit(one, now), _misfit(other, now), _misfit(still, now), _misfit(one, other))
    apart, moving = (np.abs(one).max(-1)[inside] > DIFFERENT_WAY_CELLS
                     for one in (fields[0] - fields[1], fields[1]))
    return Ways(*misfits, float(apart.mean()), float((apart & moving).mean()))


def foretelling_error(row: Sequence[np.ndarray], motion: np.ndarray) -> float:
    """How far frames in a row, grey pictures (h, w), are from the mean of those next to them along
    a field of motion (h, w, 2) to the frame before, which all of them share, in pixels; NaN is 0.
    """
    step = max(2, min(row[0].shape) // COMPARED_ROWS)
    y, x = (place.ravel() for place in np.mgrid[:row[0].shape[0]:step, :row[0].shape[1]:step])
    across, down = np.nan_to_num(motion[::step, ::step]).reshape(-1, 2).T
    errors = []
    for before, shown, after in zip(row, row[1:], row[2:], strict=False):
        one, other = bilinear(before, x + across, y + down), bilinear(after, x - across, y - down)
        errors.append(np.abs((one + other) / 2 - shown[y, x]).mean())
    return float(np.mean(errors))


def shares_of(errors: Sequence[float]) -> list[float]:
    """How much ways should count whose errors these are; the sum is 1."""
    counts = [(error + LEAST_ERROR) ** -FORETOLD_POWER for error in errors]
    counts = [count if count >= LEAST_SHARE * sum(counts) else 0.0 for count in counts]
    return [count / sum(counts) for count in counts]


def _misfit(one: np.ndarray, other: np.ndarray) -> float:
    """Mean difference of toned light."""
    return float(np.minimum(np.abs(one - other), MOST_APART).mean())


def _ramp(value: float, ends: tuple[float, float]) -> float:
    """0 up to the first end, 1 from the last one on."""
    return min(max((value - ends[0]) / (ends[1] - ends[0]), 0.0), 1.0)
