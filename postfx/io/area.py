"""Which rectangle the planes of a frame cover: the display window, and what was rendered around it."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from postfx.frame import Role
from postfx.io.convert import Camera
from postfx.io.layout import Layout
from postfx.io.windows import Window


class Area(NamedTuple):
    """A display window, and the rectangle that planes with this display window are read in."""

    display: Window
    window: Window

    @property
    def is_wider(self) -> bool:
        """Whether there is more than the display window."""
        return self.window != self.display


def area_of(layout: Layout, given: Area | None = None) -> Area | None:
    """Display window and data window together, of the colour or else of the first plane; None without planes.

    Where a frame before had the same display window, `given`, that frame's area is kept: all frames are of one size.
    """
    match = layout.planes.get(Role.COLOUR) or next(iter(layout.planes.values()), None)
    if match is None:
        return None
    part = match.channels[0].part
    if given is not None and given.display == part.display:
        return given
    return Area(part.display, part.display.around(part.data))


def camera_over(camera: Camera, area: Area) -> Camera:
    """The camera of planes that cover an area: its field of view and motion still refer to the display window."""
    display, window = area
    shift = (_middle(window.x0, window.x1) - _middle(display.x0, display.x1),
             _middle(window.y0, window.y1) - _middle(display.y0, display.y1))
    return replace(camera, display_size=(display.width, display.height), shift=shift)


def _middle(first: int, last: int) -> float:
    return (first + last + 1) / 2
