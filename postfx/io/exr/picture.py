"""A picture as OpenEXR: its header, its light in half floats, and the file that both go into."""

from __future__ import annotations

import errno
import io
import struct
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import OpenImageIO as oiio

from postfx.colour import Chromaticities
from postfx.colour.displays import DISPLAY_KINDS, Display
from postfx.frame import Frame
from postfx.io.encoder import encode_pixel
from postfx.io.exr import Header, read_headers
from postfx.io.exr.container import Rows, picture_part, write_container
from postfx.io.exr.passthrough import merge_source
from postfx.io.exr.views import View, merge_views
from postfx.io.pixel_formats import halve, look_up
from postfx.io.windows import Pixels

TABLE_STEPS = 1 << 16
"""Of the table from code values to light."""


def to_halves(light: np.ndarray) -> np.ndarray:
    """float16 nearest to light of any shape, cut to +-65504; NaN stays. Channels of (height, width,
    channels) lie one after the other in memory, as they are written."""
    height, width, count = light.shape if light.ndim == 3 else (1, light.size, 1)
    values, found = (
        np.ascontiguousarray(light, np.float32),
        np.empty((count, height * width), np.uint16),
    )
    halve(values.reshape(-1).view(np.int32), found)
    return np.moveaxis(found.view(np.float16).reshape(count, height, width), 0, -1).reshape(
        light.shape
    )


def light_of(codes: np.ndarray, display: Display) -> np.ndarray:
    """Code values (..., 3) of a display to its light, float32, 1 is white: what `Display.decode`
    gives, by a table where all are from 0 to 1.

    Where light is a normal half float it errs by less than 2e-6 of itself; a half float is as near
    as 2.4e-4.
    """
    values = np.ascontiguousarray(codes, np.float32).reshape(-1)
    light = np.empty_like(values)
    if not look_up(values, _table(display.name), light):
        return display.decode(codes).astype(np.float32, copy=False)
    return display.apply_ootf(light.reshape(codes.shape)).astype(np.float32, copy=False)


@cache
def _table(name: str) -> np.ndarray:
    light = DISPLAY_KINDS[name].curve.decode(np.linspace(0, 1, TABLE_STEPS + 1))
    return np.append(light, light[-1]).astype(np.float32)


def tag_light(spec: oiio.ImageSpec, primaries: Chromaticities, white: float | None = None) -> None:
    """Say in an EXR of which primaries its light is, and how bright 1 is in cd/m2, if that is
    known."""
    spec.attribute("chromaticities", oiio.TypeDesc("float[8]"), primaries)
    if white is not None:
        spec.attribute("whiteLuminance", float(white))


class Picture(NamedTuple):
    """What goes into a file: what OpenImageIO is told of it, its pixels, and the frame that they
    are of."""

    spec: oiio.ImageSpec
    convert: Pixels
    frame: Frame | None = None


def write_exr(
    path: Path,
    pictures: Sequence[Picture],
    relax: Callable[[], None] | None = None,
    keeps_rest: bool = False,
) -> None:
    """Scanlines, in ZIP in a third of the time that OpenImageIO takes, of one picture or several
    views.

    Each chunk goes straight into the file, with `keeps_rest` together with all else that the source
    of the pictures' frames holds. Raises OSError unless all bytes are in the file, ReadError when
    what is kept cannot be read.
    """
    with ExitStack() as stack:
        written = [(*_header_and_rows(picture, relax), picture.frame) for picture in pictures]
        header, rows, frame = written[0]
        if len(written) > 1:
            views = [View(header, rows, frame) for header, rows, frame in written if frame]
            parts = merge_views(views, keeps_rest, stack)
        elif keeps_rest and frame:
            parts = merge_source(header, rows, frame, stack)
        else:
            parts = [picture_part(header, rows, apart=True)]
        if write_container(path, parts) != path.stat().st_size:
            raise OSError(errno.ENOSPC, "the file has no end")


def _header_and_rows(picture: Picture, relax: Callable[[], None] | None) -> tuple[Header, Rows]:
    header = _exr_header(picture.spec)
    places = [picture.spec.channelnames.index(channel.name) for channel in header.channels]

    def rows(first: int, last: int) -> list[np.ndarray]:
        pixels = picture.convert(slice(first, last))
        if relax is not None:
            relax()
        return [pixels[:, :, place] for place in places]

    return header, rows


def _exr_header(spec: oiio.ImageSpec) -> Header:
    """The header that OpenImageIO gives a picture."""
    _, (header,) = read_headers(io.BytesIO(encode_pixel(".exr", spec)))
    last = spec.x + spec.width - 1, spec.y + spec.height - 1
    header.set("dataWindow", "box2i", struct.pack("<4i", spec.x, spec.y, *last))
    return header
