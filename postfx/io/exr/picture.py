"""A picture as OpenEXR: its header, its light in half floats, and the file that both go into."""

from __future__ import annotations

import errno
import io
import struct
import time
from collections.abc import Hashable, Mapping, Sequence
from contextlib import ExitStack, suppress
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import OpenImageIO as oiio

from postfx.colour import Chromaticities
from postfx.colour.displays import DISPLAY_KINDS, Display
from postfx.frame import Frame
from postfx.io.encoder import encode_pixel
from postfx.io.exr import Attribute, Header, pack_value, read_headers
from postfx.io.exr.container import Rows, picture_part, write_container
from postfx.io.exr.keep_plan import merge_source
from postfx.io.exr.passthrough import INVENTED
from postfx.io.exr.views import View, merge_views
from postfx.io.pixel_formats import halve_pixels, look_up
from postfx.io.windows import EXR_NAMES

TABLE_STEPS = 1 << 16
"""Of the table from code values to light."""


def to_halves(light: np.ndarray) -> np.ndarray:
    """float16 nearest to light of any shape, cut to +-65504; NaN stays. Channels of (height, width,
    channels) lie one after the other in memory, as they are written."""
    height, width, count = light.shape if light.ndim == 3 else (1, light.size, 1)
    values = np.ascontiguousarray(light, np.float32).reshape(-1)
    found = np.empty((count, height * width), np.uint16)
    halve_pixels(0, height * width, values, found)
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
    light, inside = np.empty_like(values), np.empty(1, bool)
    look_up(0, values.size, values, _table(display.name), light, inside)
    if not inside[0]:
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


def set_attributes(spec: oiio.ImageSpec, attributes: Mapping[str, Any]) -> None:
    """Put attributes into an image's spec with the EXR types they had; values of other types are
    left out."""
    for name, value in attributes.items():
        kind = type_of(value, name)
        # another type than its name promises, or broken text
        with suppress(TypeError, ValueError, RuntimeError):
            if kind == "rational":
                value = Fraction(value).limit_denominator(1001).as_integer_ratio()
            if kind:
                spec.attribute(_STORED_NAMES.get(name, name), oiio.TypeDesc(kind), value)


def type_of(value: Any, name: str = "") -> str:
    """The EXR type that an attribute is written as; '' where it cannot be."""
    if name in _NAMED_TYPES:
        return _NAMED_TYPES[name]
    if isinstance(value, tuple):
        kinds = {type(item) for item in value}
        if len(kinds) != 1:
            return ""
        kind = kinds.pop()
        return _TUPLE_TYPES.get((kind, len(value)),
                                f"{_TYPE_WORDS[kind]}[{len(value)}]" if kind in _TYPE_WORDS else "")
    return _TYPE_WORDS.get(type(value), "")


_NAMED_TYPES = {"timeCode": "timecode", "keyCode": "keycode", "framesPerSecond": "rational"}
_STORED_NAMES = {name: stored for stored, name in EXR_NAMES.items()}
_TUPLE_TYPES = {(float, 9): "matrix33", (float, 16): "matrix", (float, 3): "vector",
                (int, 2): "vector2i"}
_TYPE_WORDS = {float: "float", int: "int", str: "string"}


class PictureHeader:
    """The header of a picture: what OpenImageIO makes of a spec.

    `given` are the attributes that the spec has; another picture's, of the same names and types,
    are put into the same header.

    Attributes:
        first: the header of the first picture.
        places: of the header's channels among those of the pixels.
    """

    def __init__(self, spec: oiio.ImageSpec, given: Mapping[str, Any]) -> None:
        _, (self.first,) = read_headers(io.BytesIO(encode_pixel(".exr", spec)))
        last = spec.x + spec.width - 1, spec.y + spec.height - 1
        self.first.set("dataWindow", "box2i", struct.pack("<4i", spec.x, spec.y, *last))
        self._given = dict(given)
        channels = [channel.name for channel in self.first.channels]
        self.places = [spec.channelnames.index(name) for name in channels]

    def tell(self, given: Mapping[str, Any]) -> Header | None:
        """The header with other values; None where one has changed that only OpenImageIO writes."""
        attributes = dict(self.first.attributes)
        if INVENTED not in given:
            attributes |= {INVENTED: Attribute("string", time.strftime(_DATE).encode())}
        for name, value in given.items():
            known = self._given[name]
            if value is known or repr(value) == repr(known):
                continue
            kind, stored = self.first.attributes.get(name, ("", b""))
            packed = pack_value(kind, value)
            if packed is None or pack_value(kind, known) != stored:
                return None
            attributes[name] = Attribute(kind, packed)
        return Header(attributes)


_DATE = "%Y:%m:%d %H:%M:%S"
"""How OpenImageIO writes today into a header without a date."""


class Picture(NamedTuple):
    """What goes into a file: its header, its rows in the order of that header, and the frame that
    they are of."""

    header: Header
    rows: Rows
    frame: Frame | None = None


def write_exr(
    path: Path, pictures: Sequence[Picture], keeps_rest: bool = False, alike: Hashable = None
) -> None:
    """Scanlines, in ZIP in a third of the time that OpenImageIO takes, of one picture or several
    views.

    Each chunk goes straight into the file, with `keeps_rest` together with all else that the source
    of the pictures' frames holds; `alike` is what pictures have in common that are written alike.
    Raises OSError unless all bytes are in the file, ReadError when what is kept cannot be read.
    """
    with ExitStack() as stack:
        header, rows, frame = pictures[0]
        if len(pictures) > 1:
            views = [View(header, rows, frame) for header, rows, frame in pictures if frame]
            parts = merge_views(views, keeps_rest, stack)
        elif keeps_rest and frame:
            parts = merge_source(header, rows, frame, alike, stack)
        else:
            parts = [picture_part(header, rows, apart=True)]
        if write_container(path, parts) != path.stat().st_size:
            raise OSError(errno.ENOSPC, "the file has no end")
