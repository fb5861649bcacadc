"""Rectangles: windows of the parts that are read, and of the output, scaled to its size."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import OpenImageIO as oiio

from postfx.frame import Frame

EXR_NAMES = {
    "Copyright": "owner",
    "DateTime": "capDate",
    "ExposureTime": "expTime",
    "FramesPerSecond": "framesPerSecond",
    "PixelAspectRatio": "pixelAspectRatio",
    "smpte:TimeCode": "timeCode",
    "smpte:KeyCode": "keyCode",
}
"""OpenImageIO's names of standard OpenEXR attributes -> OpenEXR's own, which are used everywhere
else here."""


_TALL = ("dwab", "htj2k")
"""Compressions with chunks of up to 256 rows; chunks of all others divide 32."""


PICTURE_ATTRIBUTE = "postfx:picture"
"""Attribute of the part whose R, G, B and A are the result, so that these are read and not the
render beside them."""


AREA = "postfx:area"
"""Key of a frame's metadata: the rectangle that its planes cover, overscan included, like a
window."""


WINDOW_ATTRIBUTES = ("displayWindow", AREA, "dataWindow")
"""Keys of a frame's metadata that are windows."""


class Window(NamedTuple):
    """Pixel rectangle, bounds included, y down."""

    x0: int
    y0: int
    x1: int
    y1: int

    @property
    def width(self) -> int:
        return self.x1 - self.x0 + 1

    @property
    def height(self) -> int:
        return self.y1 - self.y0 + 1

    def holds(self, other: Window) -> bool:
        """Whether another rectangle lies within this one."""
        return (self.x0 <= other.x0 and self.y0 <= other.y0 and self.x1 >= other.x1
                and self.y1 >= other.y1)

    def around(self, other: Window) -> Window:
        """The smallest rectangle that holds both."""
        least, most = map(min, self[:2], other[:2]), map(max, self[2:], other[2:])
        return Window(*least, *most)

    def common(self, other: Window) -> Window | None:
        """What lies within both; None where that is nothing."""
        found = Window(*map(max, self[:2], other[:2]), *map(min, self[2:], other[2:]))
        return found if found.width > 0 and found.height > 0 else None


@dataclass(frozen=True, eq=False)
class Part:
    """One part (sub-image) of a file: how its pixels lie there, which is the same in all frames of
    most sequences.

    Attributes:
        index: of the sub-image, counted from 0.
        name, view: '' where the header does not say them.
        views: all that the header lists, or None.
        channels: names, in the order of the file.
        formats: of the channels: half, float or uint.
        chunk: rows in which whole chunks lie.
        data, display: windows.
        area: rectangle that planes are read in: the display window, or more where there is
            overscan.
        is_picture: whether its R, G, B (and A) are a picture that postfx wrote.
    """

    index: int
    name: str
    view: str
    views: tuple[str, ...] | None
    channels: tuple[str, ...]
    formats: tuple[str, ...]
    chunk: int
    data: Window
    display: Window
    area: Window
    is_picture: bool

    @property
    def key(self) -> tuple[object, ...]:
        """All of it: what two parts are compared by."""
        return tuple(vars(self).values())


def to_area(pixels: np.ndarray, part: Part, fill: float) -> np.ndarray:
    """(data height, data width) -> (area height, area width); pixels without data become `fill`."""
    data, area = part.data, part.area
    if data == area:
        return pixels
    result = np.full((area.height, area.width), fill, pixels.dtype)
    if inside := data.common(area):
        result[_slices(inside, area)] = pixels[_slices(inside, data)]
    return result


def some_rows(part: Part, first: int, last: int) -> Part:
    """A part of which only these rows of the area are looked at."""
    data, area = part.data, part.area
    area = area._replace(y0=part.area.y0 + first, y1=part.area.y0 + last - 1)
    top, bottom = max(data.y0, area.y0), min(data.y1, area.y1)
    return replace(part, area=area, data=data._replace(y0=top, y1=max(bottom, top - 1)))


def assign_windows(parts: list[Part]) -> tuple[Part, ...]:
    """The parts, each with a display window and area of its own where they hold the picture at two
    sizes.

    OpenEXR wants one display window in all parts of a file: either the smaller picture's or the
    larger one's.
    """
    windows = sorted({part.data for part in parts}, key=lambda window: window.width)
    two_sizes = (len(windows) == 2 and _is_enlarged(*windows)
                 and all(part.display in windows for part in parts))
    return tuple(replace(part, display=part.data, area=part.data) if two_sizes else part
                 for part in parts)


def _is_enlarged(small: Window, large: Window) -> bool:
    """Whether a window is another one enlarged up to 3 times, to the pixel, with the same
    origin."""
    sides = ((large.width, small.width), (large.height, small.height))
    least, most = max((outer - 1) / side for outer, side in sides), min((outer + 1) / side
                                                                        for outer, side in sides)
    enlarged = all(outer > side for outer, side in sides) and least <= min(most, 3)
    return enlarged and (small.x0, small.y0) == (large.x0, large.y0)


def attributes_of(spec: oiio.ImageSpec) -> dict[str, Any]:
    """Header attributes of a part, by OpenEXR's names; without those that are no text where
    OpenImageIO takes them for it, as before 3.2."""
    found: dict[str, Any] = {}
    for entry in spec.extra_attribs:
        with suppress(UnicodeDecodeError):
            found[EXR_NAMES.get(entry.name, entry.name)] = entry.value
    if "framesPerSecond" in found:
        found["framesPerSecond"] = _quotient(found["framesPerSecond"])
    return found


def part_of(index: int, spec: oiio.ImageSpec, attributes: Mapping[str, Any]) -> Part:
    """The part that OpenImageIO describes so, and its header attributes."""
    display, views = (_window(spec.full_x, spec.full_y, spec.full_width, spec.full_height),
                      attributes.get("multiView"))
    return Part(
        index=index,
        name=str(attributes.get("oiio:subimagename", "")),
        view=str(attributes.get("view", "")),
        views=tuple(map(str, views)) if isinstance(views, tuple) else None,
        channels=tuple(spec.channelnames),
        formats=tuple(map(str, spec.channelformats)) or (str(spec.format),) * spec.nchannels,
        chunk=spec.tile_height or (256 if str(attributes.get("compression")).startswith(_TALL)
                                   else 32),
        data=_window(spec.x, spec.y, spec.width, spec.height),
        display=display,
        area=display,
        is_picture=PICTURE_ATTRIBUTE in attributes,
    )


def _slices(window: Window, outer: Window) -> tuple[slice, slice]:
    """Rows and columns of a rectangle in an array that covers another one."""
    x, y = window.x0 - outer.x0, window.y0 - outer.y0
    return slice(y, y + window.height), slice(x, x + window.width)


def _quotient(rational: Any) -> float:
    try:
        numerator, denominator = rational if isinstance(rational, tuple) else (rational, 1)
        return numerator / denominator if denominator else 0.0
    except (TypeError, ValueError):  # it is stored as something else
        return 0.0


def _window(x: int, y: int, width: int, height: int) -> Window:
    return Window(x, y, x + width - 1, y + height - 1)


Pixels = Callable[[slice], np.ndarray]
"""Rows -> pixels (rows, width, channels) as they are stored."""


class OutputWindows(NamedTuple):
    """Rectangles of an output: the area of the frame's planes, the display window and the data
    window."""

    area: Window
    display: Window
    data: Window


def output_windows(frame: Frame) -> OutputWindows:
    """Windows of a frame's size out of those in its metadata, which are of the input's.

    Corners scale along, rounded to the nearest pixel, those of the data window outwards. A frame
    without windows covers the display window from (0, 0).
    """
    width, height = frame.spec.width, frame.spec.height
    display = Window(*frame.metadata.get("displayWindow", (0, 0, width - 1, height - 1)))
    covered = Window(*frame.metadata.get(AREA, display))
    return scale_windows(covered, display, Window(*frame.metadata.get("dataWindow", covered)),
                         width, height)


@lru_cache(64)
def scale_windows(covered: Window, display: Window, data: Window, width: int,
                  height: int) -> OutputWindows:
    """Windows of an output of this size, from the input's windows."""
    scale = (width / covered.width, height / covered.height)
    corner = _scale(covered, scale)
    area = Window(corner.x0, corner.y0, corner.x0 + width - 1, corner.y0 + height - 1)
    shown = area if display == covered else _scale(display, scale).common(area) or area
    return OutputWindows(area, shown, cover(data, scale).common(area) or area)


def crop(pixels: Pixels, area: Window, window: Window) -> Pixels:
    """Pixels of a rectangle within the area that they cover."""
    if window == area:
        return pixels
    x, y = window.x0 - area.x0, window.y0 - area.y0
    return lambda rows: pixels(slice(rows.start + y, rows.stop + y))[:, x : x + window.width]


def _scale(window: Window, scale: tuple[float, float]) -> Window:
    x0, y0 = round(window.x0 * scale[0]), round(window.y0 * scale[1])
    return Window(x0, y0, round((window.x1 + 1) * scale[0]) - 1,
                  round((window.y1 + 1) * scale[1]) - 1)


def cover(window: Window, scale: tuple[float, float]) -> Window:
    """A scaled rectangle, its corners rounded outwards."""
    x0, y0 = math.floor(window.x0 * scale[0]), math.floor(window.y0 * scale[1])
    return Window(x0, y0, math.ceil((window.x1 + 1) * scale[0]) - 1,
                  math.ceil((window.y1 + 1) * scale[1]) - 1)
