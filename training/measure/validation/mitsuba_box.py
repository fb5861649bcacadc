"""Mitsuba's own Cornell box, for `hosts/loop/render_mitsuba.py`, with a box filter.

Its gaussian filter would spread the noise over several pixels.
"""

from typing import Any

import mitsuba as mi

SIZE = 160, 96


def build(frame: int) -> dict[str, Any]:
    """The box; the same in all frames."""
    scene = mi.cornell_box()
    film = scene["sensor"]["film"]
    film["width"], film["height"] = SIZE
    film["rfilter"] = {"type": "box"}
    return scene
