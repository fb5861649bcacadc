"""What an output keeps of its input beside the picture, bit for bit: channels, parts and
attributes.

Where the picture has the input's size and windows, and the input's colour is in one part, it takes
the place of the render's colour under the same names, such as ViewLayer.Combined.R, so that
programs that show the render show the picture. So do light groups and passes that were denoised
with it. The other channels of their parts are written again, without loss, as ZIP-compressed
scanlines, in a part of their own if the picture has another compression. Else the picture is R, G,
B (and A) of the first part, and all parts of the input follow, the render's colour among them.
Parts that need not be written again, deep ones included, are copied as they are stored. The
attribute `postfx:picture` names the picture's channels.

Beside a larger picture all channels have its size: each pixel has the bits of the nearest one, and
only distances in pixels grow. The render's colour, which the picture replaces, and deep parts are
left out there.

A file has one display window, pixel aspect, time code and set of primaries. Where those of the
picture differ, a part's own are kept under the name with `render:` before it. So are attributes
that are no longer true of the picture (jitter, samples per pixel, a cut) in the part that it shares
with other channels.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from postfx.errors import WriteError
from postfx.frame import ColourSource, Frame
from postfx.io.exr import SCANLINE_IMAGE, TILED_IMAGE, ChannelInfo, Header, pack_channels, raw
from postfx.io.exr.container import COMPRESSIONS, ZIP, ExrContainer, Rows
from postfx.io.image_file import ImageFile
from postfx.io.layout import ALPHA_OF_RED
from postfx.io.windows import (
    AREA,
    PICTURE_ATTRIBUTE,
    Part,
    Window,
    cover,
    output_windows,
)


@dataclass(frozen=True)
class Enlargement:
    """From the rectangle that an input's planes cover to that of a picture made of them."""

    source: Window
    target: Window

    @property
    def scale(self) -> tuple[float, float]:
        """Width and height of a pixel of the input, in pixels of the picture."""
        return self.target.width / self.source.width, self.target.height / self.source.height

    def window(self, data: Window) -> Window:
        """Data window of channels that have this one in the input."""
        return cover(data, self.scale)

    def nearest(self, data: Window) -> tuple[np.ndarray, np.ndarray]:
        """Row and column of the input's data window, counted from its corner, for each row and
        column of `window`."""
        larger, found = self.window(data), []
        for axis in (1, 0):
            places = np.arange(larger[axis], larger[axis + 2] + 1) - self.target[axis] + 0.5
            places = (np.floor(places / self.scale[axis]).astype(int) + self.source[axis]
                      - data[axis])
            found.append(places.clip(0, data[axis + 2] - data[axis]))
        return found[0], found[1]


def enlargement_of(frame: Frame) -> Enlargement | None:
    """How a frame was enlarged since it was read; None where it has its input's size, or is of no
    file."""
    if "displayWindow" not in frame.metadata:
        return None
    source = Window(*frame.metadata.get(AREA, frame.metadata["displayWindow"]))
    size = frame.spec.width, frame.spec.height
    return (None if (source.width, source.height) == size
            else Enlargement(source, output_windows(frame).area))


def enlarge_rows(
    file: ImageFile, part: Part, names: list[str], enlargement: Enlargement,
    pixels: Mapping[str, int]
) -> Rows:
    """Reads channels of a part at the picture's size, in the order of `names`.

    `pixels` are those whose values are distances in pixels, with their axis, 0 across and 1 down:
    they grow, too.
    """
    lines, columns = enlargement.nearest(part.data)

    def rows(first: int, last: int) -> list[np.ndarray]:
        wanted = lines[first:last]
        stored = file.read_stored(part, names, int(wanted[0]), int(wanted[-1]) + 1)
        planes = {name: plane[wanted - wanted[0]][:, columns]
                  for name, plane in zip(names, stored, strict=True)}
        for name in pixels.keys() & planes.keys():
            if planes[name].dtype.kind == "f":
                planes[name] = (planes[name] * np.float32(enlargement.scale[pixels[name]])).astype(
                    planes[name].dtype
                )
        return [planes[name] for name in names]

    return rows


_OUTDATED = (
    "acesimagecontainerflag", "postfx:exposureapplied", "postfx:exposureappliedev",
    "postfx:exposureused", "postfx:exposureusedev", "postfx:models", "postfx:reset",
    "postfx:settings", "postfx:spp", "postfx:version", "preview", "thumbnail",
)
JITTER_ATTRIBUTE = "postfx:jitter"
"""Name of the attribute, which is as true as the frame's own jitter."""
# What describes the input's storage, its samples or channels that are not written.
_DROPPED = (
    *_OUTDATED,
    AREA,
    "blendermultichannel",
    "compression",
    "cryptomatte/",
    "datawindow",
    "displaywindow",
    "fovcot",
    "name",
    "oiio:",
    "openexr:",
    "textureformat",
    "tiff:",
    "wrapmodes",
)
_SCENE_REFERRED = ("chromaticities", "colorinteropid", "postfx:exposure", "postfx:exposureev")


def select_attributes(frame: Frame) -> dict[str, Any]:
    """Header attributes to write with a frame: time code, camera, credits and the like.

    Left out: what describes the input's storage, its jitter and sample count, and for a picture
    made for a display whatever says that its colours are those of the scene.
    """
    dropped = _DROPPED if frame.encoding == "scene-linear" else _DROPPED + _SCENE_REFERRED
    return {name: value for name, value in frame.metadata.items()
            if not name.lower().startswith((*dropped, JITTER_ATTRIBUTE))}


def is_outdated(name: str, frame: Frame) -> bool:
    """Whether an attribute of the input is not true of the picture any more, whatever else is
    written with it."""
    if name.lower() == JITTER_ATTRIBUTE:
        return frame.jitter == (0.0, 0.0)
    outdated = _OUTDATED if frame.encoding == "scene-linear" else _OUTDATED + _SCENE_REFERRED
    return name.lower().startswith(outdated)


RENDER = "render:"
"""Before the name of an attribute of the render that the picture's file cannot have, or that is not
true of it."""
SHARED_ATTRIBUTES = ("displayWindow", "pixelAspectRatio", "timeCode", "chromaticities")
"""Of a header: those that are the same in all parts of a file."""
_STRUCTURE = ("channels", "compression", "dataWindow", "displayWindow", "lineOrder", "type", "name",
              "tiles", "version", "chunkCount", "maxSamplesPerPixel", "dwaCompressionLevel")
INVENTED = "capDate"
"""The date, for which OpenImageIO writes today if there is none."""
_RGBA_PART = "rgba"
_RENDER_NAME = "render"
RGB_LETTERS = ("R", "G", "B")

# Layers of Cycles: the colour before Blender's own denoiser, and the one after it, which
# compositors show.
_NOISY = "Noisy Image"
_SHOWN = "Combined"


class Recipe(NamedTuple):
    """How a part of the output is made.

    Attributes:
        header: of the part.
        part: of the source, whose chunks are copied where there is no order, or that holds the
            channels that are kept.
        fresh: places of the picture's channels that go into it.
        kept: names of the source's channels that do.
        order: of the header's channels, each one's place among the fresh ones and the kept ones.
        is_enlarged: whether the kept channels are brought to the picture's size.
    """

    header: Header
    part: int = 0
    fresh: tuple[int, ...] = ()
    kept: tuple[str, ...] = ()
    order: tuple[int, ...] = ()
    is_enlarged: bool = False


class Merge:
    """A picture and the file that its render was read from: which parts the output has.

    Args:
        own: header that the writer gave the picture.
        source: the open file.
        frame: of the picture.
    """

    def __init__(self, own: Header, source: ExrContainer, frame: Frame) -> None:
        self._own, self._source, self._frame = own, source, frame
        self._held = [channel.name for channel in own.channels]
        self.stored = frame.colour_source or ColourSource(0, (), {})
        self.enlargement = enlargement_of(frame)

    def recipes(self) -> list[Recipe]:
        """All parts of the output."""
        if self.enlargement:
            return _with_names(self._enlarge_parts(self.enlargement))
        headers, (index, colour) = self._source.headers, self._shown()
        if not (self._takes(index) and len({*colour}) == len(RGB_LETTERS)):
            header = self.header(headers[self.stored.part], in_place=False)
            return _with_names([self._alone(header),
                                *(Recipe(self.header_of(part, header), part)
                                  for part in range(len(headers)))])
        names = dict(zip(RGB_LETTERS, colour, strict=True)) | {"A": alpha_of(colour)}
        header = self.header(headers[index], in_place=True,
                             names=[names.get(name, name) for name in self._held])
        fresh: dict[int, dict[str, str]] = {}
        for name in self._held:
            fresh.setdefault(index if name in names else self._home(name, index),
                             {})[names.get(name, name)] = name
        parts: list[Recipe] = []
        for part in range(len(headers)):
            own = header if part == index else self.header_of(part, header)
            parts += (self._merge_part(part, own, fresh[part]) if part in fresh
                      else [Recipe(own, part)])
        return _with_names(parts)

    def _alone(self, header: Header) -> Recipe:
        """The picture as a part of its own."""
        places = tuple(range(len(self._held)))
        return Recipe(header, fresh=places, order=places)

    def _shown(self) -> tuple[int, tuple[str, ...]]:
        """Part and names of the colour that programs show: the render's, or what Blender's own
        denoiser made of it."""
        if not self.stored.channels:  # colour of parts that each hold a channel
            return self.stored.part, ()
        names = tuple(name.replace(_NOISY, _SHOWN) for name in self.stored.channels)
        found = next((part for part, name in sorted(self.stored.renders) if name == names[0]),
                     self.stored.part)
        return found, names if (found, names[0]) in self.stored.renders else self.stored.channels

    def _home(self, name: str, picture: int) -> int:
        """The part that a channel beside the picture's goes into: the one that holds it in the
        source, if it can."""
        parts = (picture, *range(len(self._source.headers)))
        holds = (part for part in parts
                 if name in {one.name for one in self._source.headers[part].channels})
        return next(filter(self._takes, holds), picture)

    def _takes(self, part: int) -> bool:
        """Whether channels of the picture's size can take the place of those of a part."""
        render = self._source.headers[part]
        same = (render.data, render.display) == (self._own.data, self._own.display)
        plain = all(channel.x_sampling == channel.y_sampling == 1 for channel in render.channels)
        return same and plain and render.part_type in (SCANLINE_IMAGE, TILED_IMAGE)

    def header_of(self, part: int, picture: Header) -> Header:
        """Header of a part of the source; attributes that the whole file shares are the
        picture's."""
        header = Header(dict(self._source.headers[part].attributes))
        for name in SHARED_ATTRIBUTES:
            own, shared = header.attributes.get(name), picture.attributes.get(name)
            if own == shared:
                continue
            if own is not None:
                header.attributes[RENDER + name] = header.attributes.pop(name)
            if shared is not None:  # OpenEXR refuses a file whose first part alone lacks it
                header.attributes[name] = shared
        if PICTURE_ATTRIBUTE in header.attributes:  # of a picture that was processed again
            header.attributes[RENDER + PICTURE_ATTRIBUTE] = header.attributes.pop(PICTURE_ATTRIBUTE)
        return header

    def _enlarge_parts(self, enlargement: Enlargement) -> list[Recipe]:
        """The picture, and the source's flat parts at its size, without the render's colour."""
        index = self.stored.part
        picture, beside = self._alone(self.header(self._source.headers[index], in_place=False)), []
        with ImageFile(self._source.path, checked=True) as file:
            parts = file.parts
        display = next(part.display for part in parts if part.index == index)
        for part in parts:
            replaced = self.stored.renders | ({(index, name) for name in self._held}
                                              if part.index == index else set())
            kept = sorted((channel for channel in self._source.headers[part.index].channels
                           if (part.index, channel.name) not in replaced),
                          key=lambda channel: raw(channel.name))
            names = [channel.name for channel in kept]
            larger = enlargement.window(part.data)
            # of a file of two sizes, as where guides have the output's
            if kept and part.display != display and part.data == self._own.data:
                beside.append(Recipe(self.header_of(part.index, picture.header), part.index))
            if not kept or part.display != display:
                continue
            if (part.index == index and larger == self._own.data
                and self.stored.channels == RGB_LETTERS):
                header = self.header(self._source.headers[index], in_place=True)
                self.check_zip(header)
                header.set("channels", "chlist", pack_channels(self._own.channels + kept))
                fresh = {name: place for place, name in enumerate(self._held)}
                picture = _join(header, index, fresh, names, is_enlarged=True)
            else:
                header = resize_header(self.header_of(part.index, picture.header), larger, kept)
                beside.append(_join(header, part.index, {}, names, is_enlarged=True))
        return [picture, *beside]

    def _merge_part(self, part: int, header: Header, fresh: Mapping[str, str]) -> list[Recipe]:
        """A part of the source with channels of the picture in the place of its own, and one for
        the others if the picture's compression is not for them. fresh: their names -> those that
        the writer gave them."""
        own = {channel.name: channel for channel in self._own.channels}
        channels = [own[given]._replace(name=name) for name, given in fresh.items()]
        rest = [channel
                for channel in self._source.headers[part].channels if channel.name not in fresh]
        beside = resize_header(Header(dict(header.attributes)), header.data, rest)
        for name in ("compression", "dwaCompressionLevel"):
            header.attributes.pop(name, None)
            header.attributes |= ({name: self._own.attributes[name]} if name in self._own.attributes
                                  else {})
        compression, apart = (header.attributes["compression"],
                              bool(rest) and header.compression != ZIP)
        resize_header(header, header.data, channels + ([] if apart else rest))
        header.attributes["compression"] = compression
        places = {name: self._held.index(given) for name, given in fresh.items()}
        old = [channel.name for channel in rest]
        if not apart:
            return [_join(header, part, places, old)]
        beside.set_text("name", f"{header.name or _RENDER_NAME}.other")
        beside.attributes.pop(PICTURE_ATTRIBUTE, None)
        return [_join(header, part, places, []), _join(beside, part, {}, old)]

    def check_zip(self, header: Header) -> None:
        """WriteError unless a part that holds the picture and other channels is compressed by
        ZIP."""
        if header.compression != ZIP:
            name = COMPRESSIONS[header.compression]
            raise WriteError(f"{self._source.path}: has channels that stay in the picture's part "
                             f"bit for bit, with ZIP only: leave --compression {name} out, or give "
                             "--keep none")

    def header(self, render: Header, in_place: bool, names: Iterable[str] = ()) -> Header:
        """Header of the picture's part: the writer's attributes, and the render's that are still
        true. names: of the picture's channels, if not as the writer has them."""
        own = self._own.attributes
        found = {name: own[name] for name in _STRUCTURE if name in own}
        for name, attribute in render.attributes.items():
            if name not in _STRUCTURE and not self._is_new(name):
                found[name] = attribute
            elif in_place and name not in _STRUCTURE:
                found[RENDER + name] = attribute
        read = {name.lower() for name in self.stored.attributes}
        found |= {name: attribute for name, attribute in own.items() if name not in found
                  and name != INVENTED and (name.lower() not in read or self._is_new(name))}
        if in_place and "name" in render.attributes:
            found["name"] = render.attributes["name"]
        header = Header(found)
        header.set_text(PICTURE_ATTRIBUTE, ",".join(names or self._held))
        return header

    def _is_new(self, name: str) -> bool:
        """Whether the picture does not have an attribute as the render has it."""
        read, now = self.stored.attributes, self._frame.metadata
        same = name not in read or np.array_equal(read[name], now.get(name, read[name]))
        return is_outdated(name, self._frame) or not same


def alpha_of(colour: tuple[str, ...]) -> str:
    """What alpha beside a colour is called: 'beauty.red' has 'beauty.alpha'."""
    layer, _, red = colour[0].rpartition(".")
    return ".".join(filter(None, (layer, ALPHA_OF_RED.get(red, "A"))))


def _join(header: Header, part: int, fresh: Mapping[str, int], kept: Sequence[str],
          is_enlarged: bool = False) -> Recipe:
    """A part of the picture's channels, by name and place, and of some that the source's part
    holds, in the order of its header."""
    among = {name: place for place, name in enumerate((*fresh, *kept))}
    order = tuple(among[channel.name] for channel in header.channels)
    return Recipe(header, part, tuple(fresh.values()), tuple(kept), order, is_enlarged)


def resize_header(header: Header, data: Window, channels: list[ChannelInfo]) -> Header:
    """Header of a part with these channels in another data window, as ZIP-compressed scanlines."""
    header.attributes.pop("tiles", None)
    header.set("channels", "chlist", pack_channels(channels))
    header.set("compression", "compression", bytes([ZIP]))
    header.set("dataWindow", "box2i", struct.pack("<4i", *data))
    header.set("lineOrder", "lineOrder", bytes(1))
    if "type" in header.attributes:
        header.set_text("type", SCANLINE_IMAGE)
    return header


def _with_names(parts: list[Recipe]) -> list[Recipe]:
    """The parts, each with a name of its own, which files of several parts need; those that have
    one keep it."""
    if len(parts) == 1:
        return parts
    taken = {part.header.name for part in parts}
    for part in parts:
        if not part.header.name:
            name = _RGBA_PART if PICTURE_ATTRIBUTE in part.header.attributes else _RENDER_NAME
            names = [name, *(f"{name}.{number}" for number in range(2, len(parts) + 2))]
            part.header.set_text("name", next(name for name in names if name not in taken))
            taken.add(part.header.name)
    return parts
