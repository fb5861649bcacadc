"""Frames as a run in reverse order sees them, and how far back their pixels are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from postfx.cuts import CutDetector
from postfx.frame import Frame, Role
from postfx.kernels.turning import follow, turned_motion

MOST = 8
"""Frames in a row that count: more history makes a result hardly better."""


def turned(frame: Frame, after: Frame | None) -> Frame:
    """The frame with motion that leads to the frame after it; None, or a cut there, makes it a first frame.

    A pixel that the frame after does not show has motion that leads out of the picture. Without a motion plane it is
    only marked as a first frame or not.
    """
    if after is None or after.reset or Role.MOTION not in after or Role.MOTION not in frame:
        return replace(frame, reset=True)
    return replace(frame, planes={**frame.planes, Role.MOTION: motion_to_next(frame, after)}, reset=False)


def motion_to_next(frame: Frame, after: Frame) -> np.ndarray:
    """Motion (h, w, 2), position in the frame after minus that in this one, in pixels of this one; x right, y down.

    Made from the motion of the frame after: each of its pixels says where it came from, and the nearest one counts.
    """
    return turned_motion(after[Role.MOTION], _depth(after), _depth(frame))


class Followed:
    """How many frames in a row show what each pixel shows, in the order in which it is called with them.

    `find_cuts`: frames that are unrelated to the one before are taken as first ones, as a `Pipeline` takes them; not
    where a pipeline has found that already, and `frame.reset` says so.
    """

    def __init__(self, find_cuts: bool = False) -> None:
        self._detector = CutDetector() if find_cuts else None
        self._before: tuple[np.ndarray, np.ndarray] | None = None

    def reset(self) -> None:
        """The next frame is taken as the first."""
        self._before = None
        if self._detector:
            self._detector.reset()

    def __call__(self, frame: Frame) -> np.ndarray:
        """Counts (h, w), uint8, from 1 to MOST."""
        count = np.ones(next(iter(frame.planes.values())).shape[:2], np.uint8)
        depth = _depth(frame)
        cut = self._detector is not None and self._detector(frame)
        if self._before and not (cut or frame.reset) and Role.MOTION in frame:
            follow(frame[Role.MOTION], depth, *self._before, MOST, count)
        self._before = depth.copy(), count  # the caller may write the next frame into the same arrays
        return count


def _depth(frame: Frame) -> np.ndarray:
    """Depth (h, w, 1), alike everywhere where the frame has none."""
    if Role.DEPTH in frame:
        return frame[Role.DEPTH]
    return np.ones((*next(iter(frame.planes.values())).shape[:2], 1), np.float32)
