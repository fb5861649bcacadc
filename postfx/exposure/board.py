"""The checkerboard seen at the end of a chain: its level, and the stops that the level means."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from postfx.exposure.views import luma
from postfx.frame import Frame, Role
from postfx.passes.base import Pass
from postfx.passes.exposure_tool import CELLS, ExposureTool, cells
from postfx.pipeline import Pipeline
from postfx.runtime import Device

STEPS_EV = np.arange(-8.0, 8.01, 0.25)
"""Where a view's response is sampled."""
HEIGHT = 20 * CELLS


class Board:
    """A chain of passes that sees nothing but the checkerboard.

    passes: what comes after the upscaler. aspect: width over height of the frames. The board is 180 rows high whatever
    the frames are: it looks the same at every size, and what it covers does not matter.
    """

    def __init__(self, passes: Sequence[Pass], aspect: float = 16 / 9, device: Device | None = None) -> None:
        self._reference: dict[int, float] = {}
        self._blank = np.zeros((HEIGHT, max(round(HEIGHT * aspect), 1), 3), np.float32)
        tool = ExposureTool(reference=self._reference)
        self._pipeline = Pipeline([tool, *passes], device, "metadata")

    def level(self, exposure: float, reference: float, cut: bool) -> float:
        """Level of mid grey on the board divided by `reference`, when the chain is told to multiply by `exposure`."""
        number = len(self._reference)
        self._reference[number] = reference
        frame = Frame({Role.COLOUR: self._blank}, number=number, exposure=exposure, reset=cut)
        return grey_level(self._pipeline(frame)[Role.COLOUR])


class Response:
    """What a view makes of mid grey that is so many stops off, sampled and not assumed.

    Attributes:
        grey: level of the board when it is exposed right.
        limits_ev: stops between which the level tells the exposure; beyond, a view is black or white.
    """

    def __init__(self, view: Board) -> None:
        levels = [view.level(2.0**ev, 1.0, cut=True) for ev in STEPS_EV]
        self._levels, rising = np.unique(np.maximum.accumulate(levels), return_index=True)
        self._ev = STEPS_EV[rising]
        self.grey = self.level_at(0.0)
        self.limits_ev = float(self._ev[0]), float(self._ev[-1])

    def level_at(self, ev: float) -> float:
        """Level of mid grey that is `ev` stops too bright."""
        return float(np.interp(ev, self._ev, self._levels))

    def ev_of(self, level: float) -> float:
        """Stops that mid grey of this level is too bright, within the limits."""
        return float(np.interp(level, self._levels, self._ev))


def grey_level(picture: np.ndarray) -> float:
    """Mean of the levels of a board's two greys; picture: (height, width, 3) as it leaves the chain."""
    rows, columns = cells(*picture.shape[:2])
    dark = rows[:, None] == columns[None, :]
    level = luma(picture)
    return float((level[dark].mean(dtype=np.float64) + level[~dark].mean(dtype=np.float64)) / 2)
