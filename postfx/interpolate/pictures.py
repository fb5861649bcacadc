"""What two frames show: their colours without what lies over them, in the light of a time, and as
the grey pictures by which motion is looked for and paths are compared."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from postfx.frame import Frame, Role
from postfx.interpolate.blend import DARK, Pair
from postfx.interpolate.choose import MARGIN
from postfx.interpolate.light import change_of_light, lit_at
from postfx.interpolate.overlays import remove_overlay
from postfx.motion.flow import halve, middle_light, tone
from postfx.planes import largest_bits_of
from postfx.system import at_once

LEAST_SIDE_OF_LARGE_CELLS_PX = 64
"""Length of a picture's shorter side from which paths are found for cells of 2x2 pixels."""
MOST_COUNTED_LIGHT = np.float32(1e18)
"""Light that is counted at most: sums of its squares are finite."""


class PairPictures:
    """The pictures of two frames that follow each other. Everything is made when it is first asked
    for, and may be asked for from several threads.

    Args:
        before, after: the two frames, scene-linear and of one size.
        flow: whether light that changes between the two is looked for where there are vectors, too.
        composited: whether the plane overlay is in the colour.
    """

    def __init__(self, before: Frame, after: Frame, *, flow: bool, composited: bool) -> None:
        self.before, self.after = before, after
        self._flow = flow
        self.composited = composited and self.both_have(Role.OVERLAY)

    def both_have(self, role: Role) -> bool:
        """Whether both frames have a plane."""
        return role in self.before and role in self.after

    @cached_property
    def size(self) -> tuple[int, int]:
        """Height and width of the pictures."""
        height, width = self.before[Role.COLOUR].shape[:2]
        return height, width

    @cached_property
    def scale(self) -> int:
        """Pixels along a side of the cells that paths are found for."""
        return scale_of(*self.size)

    @cached_property
    def grid(self) -> tuple[int, int]:
        """Rows and columns of cells."""
        return -(-self.size[0] // self.scale), -(-self.size[1] // self.scale)

    @cached_property
    def longest_px(self) -> np.float32:
        """Length of a vector, in pixels, beyond which it stands for "unknown", as some renderers
        write it."""
        return np.float32(max(self.size))

    @cached_property
    def overlays(self) -> Pair:
        """Overlays (h, w, 4) of both frames."""
        return finite(self.before[Role.OVERLAY]), finite(self.after[Role.OVERLAY])

    @cached_property
    def colours(self) -> Pair:
        """Colours (h, w, 3) as they are in the frames."""
        first, last = at_once([lambda: finite(self.before[Role.COLOUR]),
                               lambda: finite(self.after[Role.COLOUR])])
        return first, last

    @cached_property
    def scene(self) -> Pair:
        """Colours (h, w, 3) without overlays."""
        if self.both_have(Role.OPAQUE_COLOUR):
            return finite(self.before[Role.OPAQUE_COLOUR]), finite(self.after[Role.OPAQUE_COLOUR])
        if not self.composited:
            return self.colours
        first, last = (remove_overlay(*both)
                       for both in zip(self.colours, self.overlays, strict=True))
        return first, last

    @cached_property
    def change(self) -> np.ndarray | None:
        """How light changes from the frame before to the one after, as `light.change_of_light`
        gives it; None where it does not."""
        if Role.MOTION in self.after and not self._flow:
            return None
        return change_of_light(*self.scene, self.after.planes.get(Role.MOTION),
                               float(self.longest_px))

    def lit(self, t: float) -> Pair:
        """Colours without overlays, in the light of a time from 0 to 1."""
        return self.scene if self.change is None else lit_at(*self.scene, self.change, t)

    @cached_property
    def level(self) -> np.float32:
        """Light that is toned to about the middle of the range."""
        return middle_light(self.lit(0.5))

    @cached_property
    def dim(self) -> np.float32:
        """Light, summed over channels, that counts as dark."""
        return np.float32(DARK * self.level)

    @cached_property
    def toned(self) -> Pair:
        """Grey pictures with margins (h + 2 MARGIN, w + 2 MARGIN), by which paths are compared."""
        first, last = (tone(picture, self.level, MARGIN) for picture in self.lit(0.5))
        return first, last

    @cached_property
    def small(self) -> Pair:
        """The grey pictures at one pixel a cell, (rows, columns)."""
        first, last = (_at_cells(toned, self.scale) for toned in self.toned)
        return first, last


def scale_of(height: int, width: int) -> int:
    """Pixels along a side of the cells that paths are found for, in pictures of a size."""
    return 2 if min(height, width) >= LEAST_SIDE_OF_LARGE_CELLS_PX else 1


def finite(plane: np.ndarray) -> np.ndarray:
    """A plane with 0 for what is not finite, held within MOST_COUNTED_LIGHT. The plane itself if
    none of it changes and it lies in one piece."""
    plane = np.ascontiguousarray(plane)
    if largest_bits_of(plane) <= MOST_COUNTED_LIGHT.view(np.uint32):
        return plane
    found: np.ndarray = np.nan_to_num(plane, nan=0, posinf=0, neginf=0).clip(-MOST_COUNTED_LIGHT,
                                                                             MOST_COUNTED_LIGHT)
    return found


def _at_cells(toned: np.ndarray, scale: int) -> np.ndarray:
    """A grey picture with margins, at one pixel a cell."""
    return (halve(toned, MARGIN) if scale == 2
            else np.ascontiguousarray(toned[MARGIN:-MARGIN, MARGIN:-MARGIN]))
