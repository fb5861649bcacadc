"""The pictures of several views in one file, each where its render was: in its own part, or as a
layer of one part.

All names are those of the source: parts keep theirs and the attributes that tell views, layers
theirs ('right.R'). What else the source holds is kept as beside a single picture, see
`postfx.io.exr.passthrough`.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import numpy as np

from postfx.errors import WriteError
from postfx.frame import ColourSource, Frame
from postfx.io.exr import ChannelInfo, Header, pack_channels
from postfx.io.exr.container import ExrContainer, NewPart, Rows, picture_part
from postfx.io.exr.passthrough import (
    RGB_LETTERS,
    Enlargement,
    Merge,
    alpha_of,
    enlarge_rows,
    enlargement_of,
    resize_header,
)
from postfx.io.image_file import ImageFile
from postfx.io.windows import PICTURE_ATTRIBUTE, Part, Window


class View(NamedTuple):
    """One view's picture: the header that the writer gave it, its rows in the order of that header,
    and its frame."""

    own: Header
    rows: Rows
    frame: Frame


def merge_views(views: Sequence[View], keep: bool, stack: ExitStack) -> list[NewPart]:
    """Parts of a file that holds all these pictures and, to `keep`, everything else that their
    source holds.

    stack: closes the source's files, from which the parts read while they are written. Raises
    WriteError for views that were not read from one OpenEXR file, ReadError when it is broken,
    OSError when it is gone.
    """
    sources = {view.frame.source for view in views}
    source, colours = sources.pop(), [view.frame.colour_source for view in views]
    if sources or source is None or Path(source).suffix.lower() != ".exr" or None in colours:
        raise WriteError("views of a frame that are not of one OpenEXR file: write each into a "
                         "file of its own")
    return _ViewMerge(views, [colour for colour in colours if colour], Path(source), keep,
                      stack).parts()


class _ViewMerge:
    """Pictures and the file that their renders were read from."""

    def __init__(self, views: Sequence[View], colours: list[ColourSource], source: Path, keep: bool,
                 stack: ExitStack) -> None:
        self._views, self._colours, self._keep = views, colours, keep
        container = stack.enter_context(ExrContainer(source))
        self._headers = container.headers
        self._container = container
        self._merges = [Merge(view.own, container, view.frame) for view in views]
        self._file = stack.enter_context(ImageFile(source, checked=True))
        self._flat = {part.index: part for part in self._file.parts}
        self._enlargement = enlargement_of(views[0].frame)
        self._in_pixels = {place: axis for colour in colours
                           for place, axis in colour.pixels.items()}

    def parts(self) -> list[NewPart]:
        """All parts of the output, in the order of the source."""
        found: list[NewPart] = []
        for index in range(len(self._headers)):
            held = [number for number, colour in enumerate(self._colours) if colour.part == index]
            if held:
                found += self._pictures(index, held)
            elif self._keep:
                found += self._copy_part(index)
        if len(found) == 1:
            return found
        for number, part in enumerate(found):  # files of several parts need names
            if not part.header.name:
                part.header.set_text("name", f"part{number}")
        return found

    def _pictures(self, index: int, held: list[int]) -> list[NewPart]:
        """The part with these views' pictures, and one for what lay beside them where the windows
        differ."""
        first = held[0]
        header = self._merges[first].header(self._headers[index], in_place=True)
        names = [self._names(number, len(held) > 1) for number in held]
        channels = [channel._replace(name=own[channel.name])
                    for number, own in zip(held, names, strict=True)
                    for channel in self._views[number].own.channels]
        readers = [self._views[number].rows for number in held]
        order = [channel.name for channel in channels]
        kept, rest = self._kept_channels(index, set(order)), []
        if kept and self._window(index) == header.data:
            self._merges[first].check_zip(header)
            channels = channels + kept
            readers.append(self._read_kept(index, kept))
            order += [channel.name for channel in kept]
        elif kept:
            beside = resize_header(self._merges[first].header_of(index, header),
                                   self._window(index), kept)
            beside.set_text("name", f"{self._headers[index].name or 'render'}.other")
            rest = [picture_part(beside, self._read_kept(index, kept))]
        header.set("channels", "chlist", pack_channels(channels))
        header.set_text(PICTURE_ATTRIBUTE, ",".join(name for own in names for name in own.values()))
        return [picture_part(header, _join(header, order, readers)), *rest]

    def _names(self, number: int, is_layered: bool) -> dict[str, str]:
        """The picture's channels -> what they are called in the file."""
        colour, own = self._colours[number], [channel.name
                                              for channel in self._views[number].own.channels]
        layer, alpha = colour.channels[0].rpartition(".")[0], alpha_of(colour.channels)
        view = layer.rpartition(".")[2] if is_layered else ""
        found = {name: name for name in own}
        if view:  # OpenEXR has views before the last word of a name
            found |= {name: f"overlay.{view}.{name[-1]}"
                      for name in own if name.startswith("overlay.")}
        return (found | dict(zip(RGB_LETTERS, colour.channels, strict=True))
                | ({"A": alpha} if "A" in own else {}))

    def _kept_channels(self, index: int, written: set[str]) -> list[ChannelInfo]:
        """Channels of the source's part that are no picture's and stay."""
        part = self._flat.get(index)
        if part is None or not self._keep:
            return []
        replaced = ({name for colour in self._colours
                     for own, name in colour.renders if own == index}
            if self._enlargement else set())
        return [channel for channel in self._headers[index].channels
                if channel.name not in written | replaced]

    def _copy_part(self, index: int) -> list[NewPart]:
        """A part without a picture: as it is stored, or enlarged; deep ones are left out there."""
        picture = self._merges[0].header(self._headers[self._colours[0].part], in_place=True)
        part, colour = self._flat.get(index), self._flat[self._colours[0].part]
        # guides have the output's
        has_own_size = (part is not None and part.display != colour.display)
        if not self._enlargement or (has_own_size and part and part.data == picture.data):
            header = self._merges[0].header_of(index, picture)
            return [NewPart(header, self._container.counts[index],
                            self._container.copy_chunks(index))]
        kept = self._kept_channels(index, set())
        if not kept or has_own_size:
            return []
        header = resize_header(self._merges[0].header_of(index, picture), self._window(index), kept)
        return [picture_part(header, self._read_kept(index, kept))]

    def _window(self, index: int) -> Window:
        """Data window of what is kept of a part."""
        return self._change().window(self._flat[index].data)

    def _change(self) -> Enlargement:
        area = self._views[0].own.display
        return self._enlargement or Enlargement(area, area)

    def _read_kept(self, index: int, kept: list[ChannelInfo]) -> Rows:
        part: Part = self._flat[index]
        pixels = {name: axis for (own, name), axis in self._in_pixels.items() if own == index}
        return enlarge_rows(self._file, part, [channel.name for channel in kept], self._change(),
                            pixels)


def _join(header: Header, names: list[str], readers: list[Rows]) -> Rows:
    """Reads the channels `names`, which `readers` give one after another, in the order of the
    header."""
    order = [channel.name for channel in header.channels]

    def read_joined(first: int, last: int) -> list[np.ndarray]:
        found = dict(zip(names, (rows for read in readers for rows in read(first, last)),
                         strict=True))
        return [found[name] for name in order]

    return read_joined
