"""Everything that the input holds beside the picture, bit for bit in the output: channels, parts and attributes.

The picture is always R, G, B (and A) of a part with the attribute `postfx:picture`. Where it has the input's size and
windows, and the input's colour is R, G, B of one part, it takes their place, and the part's other channels are written
again, without loss, as ZIP-compressed scanlines. Else it is the first part, and all parts of the input follow with
their own pixels and size, the render's colour among them; so a larger picture leaves ids and Cryptomattes as they were.
Parts that need not be written again, deep ones included, are copied as they are stored.

A file has one display window, pixel aspect, time code and set of primaries. Where those of the picture differ, a part's
own are kept under the name with `render:` before it. So are attributes that are no longer true of the picture (jitter,
samples per pixel, a cut) in the part that it shares with other channels.
"""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import numpy as np

from postfx.frame import ColourSource, Frame
from postfx.io.exr.container import SCANLINES, TILES, ExrContainer, Header, NewPart, pack_channels
from postfx.io.exr.zip import ZIP, Rows, zip_part
from postfx.io.image_file import ImageFile
from postfx.io.metadata import is_outdated
from postfx.io.windows import PICTURE

RENDER = "render:"
"""Before the name of an attribute of the render that the picture's file cannot have, or that is not true of it."""
_SHARED = ("displayWindow", "pixelAspectRatio", "timeCode", "chromaticities")
_STRUCTURE = ("channels", "compression", "dataWindow", "displayWindow", "lineOrder", "type", "name", "tiles", "version",
              "chunkCount", "maxSamplesPerPixel")
_INVENTED = "capDate"  # OpenImageIO writes today's where there is none
_NAME, _RENDER_NAME = "rgba", "render"


def merge_source(own: Header, rows: Rows, frame: Frame, stack: ExitStack) -> list[NewPart]:
    """Parts of a file that holds a picture and everything else that its frame's source holds.

    Args:
        own: header that the writer gave the picture.
        rows: reads the picture's channels, in the order of that header.
        frame: of the picture. A source that is no OpenEXR file has nothing to keep.
        stack: closes the source's files, from which the parts read while they are written.

    Raises ReadError when the source is broken, OSError when it is gone.
    """
    if frame.source is None or Path(frame.source).suffix.lower() != ".exr":
        return [zip_part(own, rows)]
    source = stack.enter_context(ExrContainer(Path(frame.source)))
    return _Merge(own, rows, source, frame, stack).parts()


class _Merge:
    """A picture and the file that its render was read from."""

    def __init__(self, own: Header, rows: Rows, source: ExrContainer, frame: Frame, stack: ExitStack) -> None:
        self._own, self._rows, self._source, self._frame, self._stack = own, rows, source, frame, stack
        self._stored = frame.colour_source or ColourSource(0, (), {})

    def parts(self) -> list[NewPart]:
        """All parts of the output."""
        index, headers = self._stored.part, self._source.headers
        in_place = self._is_in_place()
        header = self._header(headers[index], in_place)
        if in_place:
            parts = [self._together(part, header) if part == index else self._as_stored(part, header)
                     for part in range(len(headers))]
        else:
            parts = [zip_part(header, self._rows), *(self._as_stored(part, header) for part in range(len(headers)))]
        return _with_names(parts)

    def _is_in_place(self) -> bool:
        """Whether the picture takes the place of the render's colour."""
        render = self._source.headers[self._stored.part]
        same = (render.data, render.display) == (self._own.data, self._own.display)
        plain = all(channel.x_sampling == channel.y_sampling == 1 for channel in render.channels)
        flat = render.part_type in (SCANLINES, TILES)
        return same and plain and flat and self._stored.channels == ("R", "G", "B")

    def _as_stored(self, part: int, picture: Header) -> NewPart:
        """A part of the source with its pixels as they are, and what the whole file shares as the picture has it."""
        header = Header(dict(self._source.headers[part].attributes))
        for name in _SHARED:
            own, shared = header.attributes.get(name), picture.attributes.get(name)
            if own is not None and own != shared:
                header.attributes[RENDER + name] = header.attributes.pop(name)
                header.attributes |= {name: shared} if shared else {}
        if PICTURE in header.attributes:  # of a picture that was processed again
            header.attributes[RENDER + PICTURE] = header.attributes.pop(PICTURE)
        return NewPart(header, self._source.counts[part], self._source.copy_chunks(part))

    def _together(self, part: int, header: Header) -> NewPart:
        """The part that held the render's colour, with the picture in its place."""
        fresh = [channel.name for channel in self._own.channels]
        rest = [channel for channel in self._source.headers[part].channels if channel.name not in fresh]
        if not rest:
            return zip_part(header, self._rows)
        header.set("channels", "chlist", pack_channels(self._own.channels + rest))
        header.set("compression", "compression", bytes([ZIP]))
        source = self._stack.enter_context(ImageFile(self._source.path, checked=True))
        (render,) = (one for one in source.parts if one.index == part)
        old, order = [channel.name for channel in rest], [channel.name for channel in header.channels]

        def rows(first: int, last: int) -> list[np.ndarray]:
            found = dict(zip(fresh, self._rows(first, last), strict=True))
            found |= zip(old, source.read_stored(render, old, first, last), strict=True)
            return [found[name] for name in order]

        return zip_part(header, rows)

    def _header(self, render: Header, in_place: bool) -> Header:
        """Header of the picture's part: what the writer gave it, and what the render's says that it did not change."""
        own = self._own.attributes
        found = {name: own[name] for name in _STRUCTURE if name in own}
        for name, attribute in render.attributes.items():
            if name not in _STRUCTURE and not self._is_new(name):
                found[name] = attribute
            elif in_place and name not in _STRUCTURE:
                found[RENDER + name] = attribute
        read = {name.lower() for name in self._stored.attributes}
        found |= {name: attribute for name, attribute in own.items()
                  if name not in found and name != _INVENTED and (name.lower() not in read or self._is_new(name))}
        if in_place and "name" in render.attributes:
            found["name"] = render.attributes["name"]
        header = Header(found)
        header.set_text(PICTURE, ",".join(channel.name for channel in self._own.channels))
        return header

    def _is_new(self, name: str) -> bool:
        """Whether the picture does not have an attribute as the render has it."""
        read, now = self._stored.attributes, self._frame.metadata
        same = name not in read or np.array_equal(read[name], now.get(name, read[name]))
        return is_outdated(name, self._frame) or not same


def _with_names(parts: list[NewPart]) -> list[NewPart]:
    """The parts, each with a name of its own, which files of several parts need; those that have one keep it."""
    if len(parts) == 1:
        return parts
    taken = {part.header.name for part in parts}
    for part in parts:
        if not part.header.name:
            name = _NAME if PICTURE in part.header.attributes else _RENDER_NAME
            names = [name, *(f"{name}.{number}" for number in range(2, len(parts) + 2))]
            part.header.set_text("name", next(name for name in names if name not in taken))
            taken.add(part.header.name)
    return parts
