"""Reading image files: which channels a file holds, and only the wanted ones as arrays.

Single-part and multi-part OpenEXR files (half, float, scanline, tiled, mip-mapped) and Radiance HDR are read through
OpenImageIO. Deep parts are refused. Every plane is brought to the display window: pixels outside the data window get
a fill value, overscan is cut off.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import OpenImageIO as oiio

from postfx.errors import MissingFrameError, ReadError

READABLE = (".exr", ".hdr")

EXR_NAMES = {
    "Copyright": "owner",
    "DateTime": "capDate",
    "ExposureTime": "expTime",
    "FramesPerSecond": "framesPerSecond",
    "PixelAspectRatio": "pixelAspectRatio",
    "smpte:TimeCode": "timeCode",
    "smpte:KeyCode": "keyCode",
}
"""OpenImageIO's names of standard OpenEXR attributes -> OpenEXR's own, which are used everywhere else here."""


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


@dataclass(frozen=True, eq=False)
class Part:
    """One part (sub-image) of a file; `formats` are those of the channels: half, float or uint."""

    index: int
    name: str
    view: str
    channels: tuple[str, ...]
    formats: tuple[str, ...]
    data: Window
    display: Window
    attributes: Mapping[str, Any]

    @property
    def overscan(self) -> bool:
        """Whether there are pixels outside the display window."""
        data, display = self.data, self.display
        return data.x0 < display.x0 or data.y0 < display.y0 or data.x1 > display.x1 or data.y1 > display.y1


class ImageFile:
    """An open file: `parts` says what is in it, `read` fetches channels. Use as a context manager.

    Raises MissingFrameError when there is no such file, ReadError when it is broken, deep or of an unknown format.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        if self.path.suffix.lower() not in READABLE:
            raise ReadError(f"{path}: not a scene-linear image: give OpenEXR (.exr) or Radiance (.hdr) files")
        if not self.path.is_file():
            raise MissingFrameError(f"{path}: no such file: render this frame or leave it out with --frames")
        self._input = oiio.ImageInput.open(str(self.path))
        if self._input is None:
            raise ReadError(f"{path}: cannot be opened: {_first_line(oiio.geterror())}; write the file again")
        self.parts = self._scan()

    def __enter__(self) -> ImageFile:
        return self

    def __exit__(self, *_: object) -> None:
        self._input.close()

    def read(
        self, part: Part, channels: Mapping[str, float], rows: tuple[int, int] | None = None
    ) -> dict[str, np.ndarray]:
        """Channels of a part as float32 arrays (height, width) of the display window, or of some of its rows: first
        and last, not included.

        `channels` maps each wanted name to the value for pixels outside the data window. ReadError when the file ends
        early or its pixels cannot be decoded.
        """
        indices = [part.channels.index(name) for name in channels]
        first, last = min(indices), max(indices)
        if rows is None:
            pixels = self._input.read_image(part.index, 0, first, last + 1, oiio.FLOAT)
        else:
            part = _some_rows(part, *rows)
            pixels = self._read_rows(part, first, last + 1)
        pixels = self._decoded(pixels).reshape(part.data.height, part.data.width, last + 1 - first)
        fills = channels.values()
        return {
            name: to_display_window(pixels[:, :, index - first], part, fill)
            for name, index, fill in zip(channels, indices, fills, strict=True)
        }

    def read_ids(self, part: Part, name: str, rows: tuple[int, int] | None = None) -> np.ndarray:
        """One channel, likewise, with every bit of it: uint32 where it is stored so, else float32; 0 where there is no
        data. As floats whole numbers would be scaled to 0..1."""
        index = part.channels.index(name)
        if part.formats[index] != "uint":
            return self.read(part, {name: 0.0}, rows)[name]
        part = part if rows is None else _some_rows(part, *rows)
        pixels = self._read_rows(part, index, index + 1, oiio.UINT)
        return to_display_window(self._decoded(pixels)[:, :, 0], part, 0)

    def _decoded(self, pixels: np.ndarray | None) -> np.ndarray:
        if pixels is None:
            reason = _first_line(self._input.geterror())
            raise ReadError(f"{self.path}: broken file: {reason}; render or copy this frame again")
        return pixels

    def _read_rows(
        self, part: Part, first: int, last: int, kind: oiio.BASETYPE = oiio.FLOAT
    ) -> np.ndarray | None:
        """The data window's rows of a part that has only some of them."""
        data = part.data
        if data.height <= 0:
            return np.empty((0, data.width, last - first), np.float32)
        self._input.seek_subimage(part.index, 0)
        spec = self._input.spec()
        if not spec.tile_height:
            return self._input.read_scanlines(part.index, 0, data.y0, data.y1 + 1, 0, first, last, kind)
        top = spec.y + (data.y0 - spec.y) // spec.tile_height * spec.tile_height
        bottom = min(spec.y + spec.height, spec.y + -(-(data.y1 + 1 - spec.y) // spec.tile_height) * spec.tile_height)
        columns = (spec.x, spec.x + spec.width)
        pixels = self._input.read_tiles(part.index, 0, *columns, top, bottom, 0, 1, first, last, kind)
        if pixels is None:
            return None
        pixels = pixels.reshape(bottom - top, data.width, last - first)
        return np.ascontiguousarray(pixels[data.y0 - top:data.y1 + 1 - top])

    def _scan(self) -> tuple[Part, ...]:
        parts, deep = [], []
        while self._input.seek_subimage(len(parts) + len(deep), 0):
            spec = self._input.spec()
            (deep if spec.deep else parts).append(_part(len(parts) + len(deep), spec))
        if not parts:
            reason = "deep data is not supported: flatten it first, e.g. with oiiotool --flatten"
            raise ReadError(f"{self.path}: {reason if deep else 'holds no image'}")
        return _own_windows(parts)


def to_display_window(pixels: np.ndarray, part: Part, fill: float) -> np.ndarray:
    """(data height, data width) -> contiguous (display height, display width); pixels without data become `fill`."""
    data, display = part.data, part.display
    if data == display:
        return np.ascontiguousarray(pixels)
    result = np.full((display.height, display.width), fill, pixels.dtype)
    x0, x1 = max(data.x0, display.x0), min(data.x1, display.x1) + 1
    y0, y1 = max(data.y0, display.y0), min(data.y1, display.y1) + 1
    if x0 < x1 and y0 < y1:
        inside = pixels[y0 - data.y0 : y1 - data.y0, x0 - data.x0 : x1 - data.x0]
        result[y0 - display.y0 : y1 - display.y0, x0 - display.x0 : x1 - display.x0] = inside
    return result


def _some_rows(part: Part, first: int, last: int) -> Part:
    """A part of which only these rows of the display window are looked at."""
    data, display = part.data, part.display
    display = display._replace(y0=part.display.y0 + first, y1=part.display.y0 + last - 1)
    top, bottom = max(data.y0, display.y0), min(data.y1, display.y1)
    return replace(part, display=display, data=data._replace(y0=top, y1=max(bottom, top - 1)))


def _own_windows(parts: list[Part]) -> tuple[Part, ...]:
    """The parts, each with a display window of its own where they hold the picture at two sizes.

    OpenEXR wants one display window in all parts of a file, so it is that of the smaller or of the larger picture.
    """
    windows = sorted({part.data for part in parts}, key=lambda window: window.width)
    two_sizes = len(windows) == 2 and _is_enlarged(*windows) and all(part.display in windows for part in parts)
    return tuple(replace(part, display=part.data) if two_sizes else part for part in parts)


def _is_enlarged(small: Window, large: Window) -> bool:
    """Whether a window is another one enlarged up to 3 times, to the pixel, with the same origin."""
    sides = ((large.width, small.width), (large.height, small.height))
    least, most = max((outer - 1) / side for outer, side in sides), min((outer + 1) / side for outer, side in sides)
    enlarged = all(outer > side for outer, side in sides) and least <= min(most, 3)
    return enlarged and (small.x0, small.y0) == (large.x0, large.y0)


def _part(index: int, spec: oiio.ImageSpec) -> Part:
    attributes = {EXR_NAMES.get(entry.name, entry.name): entry.value for entry in spec.extra_attribs}
    if "framesPerSecond" in attributes:
        attributes["framesPerSecond"] = _quotient(attributes["framesPerSecond"])
    return Part(
        index=index,
        name=str(attributes.get("oiio:subimagename", "")),
        view=str(attributes.get("view", "")),
        channels=tuple(spec.channelnames),
        formats=tuple(str(spec.channelformat(channel)) for channel in range(spec.nchannels)),
        data=_window(spec.x, spec.y, spec.width, spec.height),
        display=_window(spec.full_x, spec.full_y, spec.full_width, spec.full_height),
        attributes=attributes,
    )


def _quotient(rational: Any) -> float:
    numerator, denominator = rational if isinstance(rational, tuple) else (rational, 1)
    return numerator / denominator if denominator else 0.0


def _window(x: int, y: int, width: int, height: int) -> Window:
    return Window(x, y, x + width - 1, y + height - 1)


def _first_line(message: str) -> str:
    lines = [line for line in message.splitlines() if line.strip()]
    return lines[0].strip() if lines else "unknown reason"
