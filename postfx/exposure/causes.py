"""Which of the mistakes that integrators make fits what the exposure debugger measured."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from postfx.exposure.debugger import Reading

NEAR_EV = 0.25
"""A picture this close to mid grey needs no exposure: about what noise does to the meter."""
SAME_EV = 0.125
APPLIED_EV = 0.05  # the board's own error is below
STEADY_EV = 0.1
OPPOSED = -0.8  # correlation


def likely_cause(readings: Sequence[Reading], drifting: bool) -> str | None:
    """A sentence with the mistake and its mend, or None when none fits and the exposure may be a choice."""
    told, picture, found, expected = (
        np.array([getattr(reading, name) for reading in readings])
        for name in ("exposure_ev", "picture_ev", "mismatch_ev", "expected_ev")
    )
    return (
        _otherwise_applied(found - expected)
        or _pattern(told, picture)
        or (_movement(told, picture) if drifting else None)
    )


def _otherwise_applied(extra: np.ndarray) -> str | None:
    """What the passes after the upscaler did besides what they were told."""
    if abs(extra).max() <= APPLIED_EV:
        return None
    if np.ptp(extra) > STEADY_EV:
        return (
            f"after the upscaler the chain exposes by {extra.min():+.2f} to {extra.max():+.2f} EV besides what it is "
            "told: it meters for itself or lags; give the tone mapper the frame's exposure"
        )
    return (
        f"after the upscaler the chain exposes by {extra.mean():+.2f} EV besides what it is told: give the tone mapper "
        "the frame's exposure and nothing else"
    )


def _pattern(told: np.ndarray, picture: np.ndarray) -> str | None:
    """Exposures that are off by the kind of number they are."""
    if abs(picture).max() <= NEAR_EV < abs(told).max():
        return (
            "the colour is at mid grey before it is exposed: if the exposure is multiplied in already, it is given a "
            "second time; divide it out or give an exposure of 1 (0 EV)"
        )
    if not told.any():
        return "the exposure is 1 (0 EV) throughout: it is probably not passed on"
    if abs(told + picture).max() <= SAME_EV:
        return "the exposure is one over what is needed: inverted, give the multiplier and not its inverse"
    if (picture > 0).all() and abs(np.exp2(told) - picture).max() <= SAME_EV:
        return "the exposure is the number of stops that is needed: give 2 to the power of it"
    return None


def _movement(told: np.ndarray, picture: np.ndarray) -> str:
    """How exposure and picture move."""
    told_moves, picture_moves = np.ptp(told) > STEADY_EV, np.ptp(picture) > STEADY_EV
    if told_moves and not picture_moves:
        return "the exposure changes while the picture does not"
    if picture_moves and not told_moves:
        return "the picture's brightness changes and the exposure does not follow; where that is meant, it is right"
    if told_moves and np.corrcoef(told, picture)[0, 1] < OPPOSED:
        return (
            "the picture gets brighter as the exposure rises, so the exposure is in the colour when it is metered: it "
            "feeds back; meter before exposing"
        )
    return "the exposure follows the picture late or not far enough; --exposure smooth looks ahead"
