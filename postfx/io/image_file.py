"""Reading image files: which channels a file holds, and only the wanted ones as arrays.

Single-part and multi-part OpenEXR files (half, float, scanline, tiled, mip-mapped) and Radiance HDR
are read through OpenImageIO. Deep parts are left out. Every plane is brought to one rectangle, the
display window and overscan: pixels outside the data window get a fill value. Decoders get a file
only after its claims are checked, because they make room for what a header says before they see how
little follows.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio

from postfx.caching import LRUCache
from postfx.errors import MissingFrameError, ReadError
from postfx.files import is_utf8
from postfx.io.exr.container import (
    MAX_SIDE,
    STORAGE_ATTRIBUTES,
    ExrContainer,
    read_rows_by_threads,
)
from postfx.io.windows import (
    PICTURE_ATTRIBUTE,
    Part,
    Window,
    assign_windows,
    attributes_of,
    part_of,
    some_rows,
    to_area,
)
from postfx.workers import finished_before_the_end

READABLE = (".exr", ".hdr")
"""Endings of files that are looked for in folders."""
STILLS = (".tif", ".tiff", ".pfm")
"""Endings of files that are read where they are named, or where a folder holds no others, if they
hold floats; pictures for displays end so, too."""
_STORED = {"uint": oiio.UINT, "half": oiio.HALF, "float": oiio.FLOAT}
_STALE_ATTRIBUTES = ("Orientation", "hdr:exposure", "oiio:Gamma")
"""OpenImageIO's attributes of a Radiance file that are no longer true of pixels as they are read
here."""
_HDR_GROWS = 64  # runs of 127 bytes lie in 2
_STILL_GROWS = 1100
"""Most bytes of pixels to a byte of a file: Deflate, the best of TIFF's compressions,
reaches 1032."""
_FLOAT_TYPES = ("half", "float", "double")


def check_claims(path: Path) -> RadianceHeader | ExrContainer:
    """Header of a Radiance HDR file, or an OpenEXR file, by its first bytes, whatever its name.

    ReadError for a file that cannot be read, is neither, or claims more pixels than its bytes can
    hold.
    """
    try:
        file = path.open("rb")
        start = file.read(len(STARTS[0]))
        if start and not start.startswith(STARTS):
            file.seek(0)
            return ExrContainer(path, file)
        with file:
            if not start:
                raise ReadError(f"{path}: is empty: render or copy this frame again")
            start += file.read(MAX_HEADER - len(start))
            return _check_hdr(path, start, file.seek(0, os.SEEK_END))
    except OSError as error:
        raise ReadError(f"{path}: cannot be read: {error.strerror or error}; check the file's "
                        "rights") from error


def _check_hdr(path: Path, start: bytes, size: int) -> RadianceHeader:
    header = parse_header(start, path)
    width, height = header.size
    if max(width, height) > MAX_SIDE or 4 * width * height > _HDR_GROWS * size:
        raise ReadError(f"{path}: broken file: its header claims {width}x{height} pixels in {size} "
                        "bytes; render or copy this frame again")
    return header


class ImageFile(ExitStack):
    """An open file: `parts` says what is in it, `read` fetches channels. Use as a context manager.

    Attributes:
        parts: those that are read, all but deep ones.
        headers: index of each of these -> its header attributes.
        container: the same file as this package reads OpenEXR, by several threads; None for other
            formats, and where the caller has it.

    `checked` says that the caller has an `ExrContainer` of it, so what its header claims is not
    checked again. Raises MissingFrameError when there is no such file, ReadError when it is broken,
    deep or of an unknown format.
    """

    @finished_before_the_end()
    def __init__(self, path: Path, checked: bool = False) -> None:
        super().__init__()
        self.path = Path(path)
        self._is_still = self.path.suffix.lower() in STILLS
        if self.path.suffix.lower() not in READABLE and not self._is_still:
            raise ReadError(f"{path}: not a scene-linear image: give OpenEXR (.exr) or Radiance "
                            "(.hdr) files, or TIFF or PFM of floats")
        if not os.path.isfile(path):
            raise MissingFrameError(f"{path}: no such file: render this frame or leave it out with "
                                    "--frames")
        if not is_utf8(str(path)):
            raise ReadError(f"{path}: its name is not UTF-8: rename it")
        claims = None if checked or self._is_still else check_claims(self.path)
        self.container = (self.enter_context(claims) if isinstance(claims, ExrContainer)
                          else None)
        self._radiance = claims if isinstance(claims, RadianceHeader) else None
        # pixels of a Radiance file that does not store them as they are
        self._upright: np.ndarray | None = None
        how = oiio.ImageSpec()
        how.attribute("pnm:pfmflip", 1)  # a PFM begins with its lowest row
        opened = oiio.ImageInput.open(str(self.path), how)
        if opened is None:
            reason = reason_of(oiio.geterror)
            fix = ("save it as RGB, without luminance and chroma" if "ubsampled" in reason
                   else "write the file again")
            raise ReadError(f"{path}: cannot be opened: {reason}; {fix}")
        self._input = opened
        self.callback(finished_before_the_end()(opened.close))
        if self._is_still:
            _check_still(self.path, opened.spec())
        self.headers: dict[int, dict[str, Any]] = {}
        self.parts = self._scan()

    @finished_before_the_end()
    def read(
        self, part: Part, channels: Mapping[str, float], rows: tuple[int, int] | None = None
    ) -> dict[str, np.ndarray]:
        """Channels of a part as float32 arrays (height, width) of its area, or of some of its rows:
        first and last, not included.

        `channels` maps each wanted name to the value for pixels outside the data window. ReadError
        when the file ends early or its pixels cannot be decoded.
        """
        kinds = {name: part.formats[part.channels.index(name)] for name in channels}
        if "uint" in kinds.values():
            rest = {name: fill for name, fill in channels.items() if kinds[name] != "uint"}
            planes = self.read(part, rest, rows) if rest else {}
            part = part if rows is None else some_rows(part, *rows)
            return {name: planes[name] if name in planes else
                    to_area(self._read_counts(part, name).astype(np.float32), part, fill)
                    for name, fill in channels.items()}
        part = part if rows is None else some_rows(part, *rows)
        planes = {name: np.empty((part.data.height, part.data.width), np.float32)
                  for name in channels}
        if not self._read_plain(part,
                                {name: plane[..., None] for name, plane in planes.items()}):
            indices = [part.channels.index(name) for name in channels]
            first, last = min(indices), max(indices)
            if rows is None and self._is_as_stored():
                pixels = self._input.read_image(part.index, 0, first, last + 1, oiio.FLOAT)
            else:
                pixels = self._read_rows(part, first, last + 1)
            pixels = self._require_pixels(pixels).reshape(part.data.height, part.data.width,
                                                          last + 1 - first)
            planes = {name: pixels[:, :, index - first]
                      for name, index in zip(channels, indices, strict=True)}
        return {name: to_area(planes[name], part, fill) for name, fill in channels.items()}

    @finished_before_the_end()
    def read_ids(self, part: Part, name: str, rows: tuple[int, int] | None = None) -> np.ndarray:
        """One channel, likewise, with every bit of it: uint32 where it is stored so, else float32;
        0 where there is no data."""
        if part.formats[part.channels.index(name)] != "uint":
            return self.read(part, {name: 0.0}, rows)[name]
        part = part if rows is None else some_rows(part, *rows)
        return to_area(self._read_counts(part, name), part, 0)

    def _read_counts(self, part: Part, name: str) -> np.ndarray:
        """The data window of a channel of whole numbers, uint32: as floats they would be scaled to
        0..1."""
        index = part.channels.index(name)
        return self._require_pixels(self._read_rows(part, index, index + 1, oiio.UINT))[:, :, 0]

    @finished_before_the_end()
    def read_stored(self, part: Part, names: Sequence[str], first: int,
                    last: int) -> list[np.ndarray]:
        """Channels as they are stored, bit for bit: uint32, float16 or float32 (rows, width) of the
        data window's rows from `first` to `last`, not included, both counted from its top."""
        rows = replace(part,
                       data=part.data._replace(y0=part.data.y0 + first, y1=part.data.y0 + last - 1))
        found: dict[str, np.ndarray] = {}
        for begin, end in _runs(part, names):
            pixels = self._require_pixels(self._read_rows(rows, begin, end,
                                                          _STORED[part.formats[begin]]))
            found |= {part.channels[begin + column]: pixels[:, :, column]
                      for column in range(end - begin)}
        return [found[name] for name in names]

    def plain_columns(self, part: Part, names: Sequence[str]) -> np.ndarray | None:
        """These channels of a part for `read_planes`; None where it cannot read them: it reads what
        is stored as it is or by ZIP."""
        if self.container is None or part.data != part.area:
            return None
        return self.container.storages[part.index].columns(names)

    def _read_plain(self, part: Part, planes: Mapping[str, np.ndarray]) -> bool:
        """The same for a part's data window and any channels, by threads of its own."""
        if self.container is None or part.data.height <= 0:
            return False
        storage = self.container.storages[part.index]
        found = [(storage.columns([name]), plane) for name, plane in planes.items()]
        targets = [(columns, plane) for columns, plane in found if columns is not None]
        if len(targets) < len(found):
            return False
        top = storage.window.y0
        return read_rows_by_threads(self.container, part.index, targets, part.data.y0 - top,
                                    part.data.y1 + 1 - top)

    def _require_pixels(self, pixels: np.ndarray | None) -> np.ndarray:
        if pixels is None:
            reason = reason_of(self._input.geterror)
            raise ReadError(f"{self.path}: broken file: {reason}; render or copy this frame again")
        return pixels

    def _read_rows(
        self, part: Part, first: int, last: int, kind: oiio.BASETYPE = oiio.FLOAT
    ) -> np.ndarray | None:
        """The data window's rows of a part that has only some of them."""
        data = part.data
        if data.height <= 0:
            return np.empty((0, data.width, last - first), np.float32)
        if self._radiance and not self._radiance.is_plain:
            return self._turn_upright(self._radiance)[data.y0 : data.y1 + 1, :, first:last]
        self._input.seek_subimage(part.index, 0)
        spec = self._input.spec()
        if not spec.tile_height:
            return self._input.read_scanlines(part.index, 0, data.y0, data.y1 + 1, 0, first, last,
                                              kind)
        top = spec.y + (data.y0 - spec.y) // spec.tile_height * spec.tile_height
        bottom = min(spec.y + spec.height,
                     spec.y + -(-(data.y1 + 1 - spec.y) // spec.tile_height) * spec.tile_height)
        columns = (spec.x, spec.x + spec.width)
        pixels = self._input.read_tiles(part.index, 0, *columns, top, bottom, 0, 1, first, last,
                                        kind)
        if pixels is None:
            return None
        pixels = pixels.reshape(bottom - top, data.width, last - first)
        return np.ascontiguousarray(pixels[data.y0 - top:data.y1 + 1 - top])

    def _is_as_stored(self) -> bool:
        return self._radiance is None or self._radiance.is_plain

    def _turn_upright(self, header: RadianceHeader) -> np.ndarray:
        """The whole picture, (height, width, 3), which is read once."""
        if self._upright is None:
            stored = self._require_pixels(self._input.read_image(0, 0, 0, 3, oiio.FLOAT))
            self._upright = header.upright(stored.reshape(header.rows, header.columns, 3))
        return self._upright

    def _scan(self) -> tuple[Part, ...]:
        """The parts, and all header attributes. Files whose headers tell the same of their parts
        share these: then what was found in one holds for all."""
        specs: dict[int, oiio.ImageSpec] = {}
        index = 0
        while self._input.seek_subimage(index, 0):
            spec = self._input.spec()
            if not spec.deep:
                specs[index] = spec
                self.headers[index] = attributes_of(spec)
            index += 1
        if not specs:
            reason = "deep data is not supported: flatten it first, e.g. with oiiotool --flatten"
            raise ReadError(f"{self.path}: {reason if index else 'holds no image'}")
        stored = self.container.headers if self.container else ()
        alike = tuple([tuple(map(header.attributes.get, _PART_ATTRIBUTES)) for header in stored])
        found = _PARTS.find(alike) if alike else None
        if found is None:
            found = assign_windows([part_of(index, spec, self.headers[index])
                                    for index, spec in specs.items()])
            if self._radiance:
                found = (_radiance_part(found[0], self._radiance),)
            key: tuple[object, ...] = alike or tuple([part.key for part in found])
            found = _PARTS.find(key) or _PARTS.keep(key, found)
        if self._radiance:
            self.headers = {0: _radiance_attributes(self.headers[0], self._radiance)}
        return found


_PART_ATTRIBUTES = (*STORAGE_ATTRIBUTES, "name", "view", "multiView", PICTURE_ATTRIBUTE)
"""Of a header: those that tell what is known of its part."""
MOST_KINDS_OF_FILES = 64
"""Whose parts are kept."""
_PARTS: LRUCache[tuple[object, ...], tuple[Part, ...]] = LRUCache(MOST_KINDS_OF_FILES)
"""Parts of files by what their headers tell of them, or else by all that is known of them."""


def _check_still(path: Path, spec: oiio.ImageSpec) -> None:
    """ReadError unless a TIFF or PFM holds floats, and no more pixels than its bytes can."""
    if str(spec.format) not in _FLOAT_TYPES:
        raise ReadError(f"{path}: holds whole numbers, code values of a picture that was made for "
                        "a display: give the scene-linear render, as OpenEXR or as TIFF of 16 or "
                        "32-bit floats")
    size = path.stat().st_size
    if max(spec.width, spec.height) > MAX_SIDE or spec.image_bytes() > _STILL_GROWS * size:
        raise ReadError(f"{path}: broken file: its header claims {spec.width}x{spec.height} pixels "
                        f"in {size} bytes; render or copy this frame again")


def _radiance_part(part: Part, header: RadianceHeader) -> Part:
    """The part of a Radiance file with the picture's size."""
    window = Window(0, 0, header.size[0] - 1, header.size[1] - 1)
    return replace(part, data=window, display=window, area=window)


def _radiance_attributes(attributes: Mapping[str, Any], header: RadianceHeader) -> dict[str, Any]:
    """What is still true of pixels as they are read here, and the header's facts on their
    colours."""
    found = {name: value for name, value in attributes.items() if name not in _STALE_ATTRIBUTES}
    return found | ({"chromaticities": header.primaries} if header.primaries else {})


def _runs(part: Part, names: Sequence[str]) -> Iterator[tuple[int, int]]:
    """First and last channel, not included, of neighbours of one format that hold the named
    ones."""
    wanted = sorted(part.channels.index(name) for name in names)
    begin = wanted[0]
    for before, index in zip(wanted, wanted[1:], strict=False):
        if part.formats[index] != part.formats[before] or index > before + 1:
            yield begin, before + 1
            begin = index
    yield begin, wanted[-1] + 1


def reason_of(fetch: Callable[[], str]) -> str:
    """First line of an error message of OpenImageIO's, which may quote bytes of the file that are
    not text."""
    try:
        lines = [line for line in fetch().splitlines() if line.strip()]
    except UnicodeDecodeError:
        return "its names are not text"
    return lines[0].strip().rstrip(".") if lines else "unknown reason"


# Radiance headers ---------------------------------------------------------------------------------
# The format: https://radsite.lbl.gov/radiance/refer/filefmts.pdf, "Pictures".

STARTS = (b"#?RADIANCE", b"#?RGBE")
MAX_HEADER = 64 << 10
"""Bytes within which the size has to stand."""
_RADIANCE_SIZE = re.compile(rb"([-+])([XY]) +(\d{1,9}) +([-+])([XY]) +(\d{1,9})")


_MOST_HEADER_NUMBER = 1e15
"""What no number of a header may reach."""


@dataclass(frozen=True)
class RadianceHeader:
    """Header of a Radiance HDR file.

    Attributes:
        rows, columns: how many lines are stored, and pixels in each.
        is_turned: whether lines are columns of the picture.
        flips_y, flips_x: whether the picture's rows are stored from the bottom, its columns from
            the right.
        exposure_factors: what the stored red, green and blue were multiplied by.
        primaries: x and y of red, green, blue and white, None where the header does not say them.
    """

    rows: int
    columns: int
    is_turned: bool = False
    flips_y: bool = False
    flips_x: bool = False
    exposure_factors: tuple[float, float, float] = (1.0, 1.0, 1.0)
    primaries: tuple[float, ...] | None = None

    @property
    def is_plain(self) -> bool:
        """Whether the picture is stored as it is, from the top left."""
        return (not (self.is_turned or self.flips_y or self.flips_x)
                and set(self.exposure_factors) == {1.0})

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the picture."""
        return (self.rows, self.columns) if self.is_turned else (self.columns, self.rows)

    def upright(self, stored: np.ndarray) -> np.ndarray:
        """Stored pixels (rows, columns, 3) as light (height, width, 3) from the top left,
        float32."""
        pixels = stored.swapaxes(0, 1) if self.is_turned else stored
        pixels = pixels[::-1 if self.flips_y else 1, ::-1 if self.flips_x else 1]
        return np.ascontiguousarray(pixels / np.asarray(self.exposure_factors), np.float32)


def parse_header(start: bytes, path: Path) -> RadianceHeader:
    """Header at the start of a file. Raises ReadError where it is broken, or holds CIE XYZ."""
    facts, _, rest = start.partition(b"\n\n")
    found = _RADIANCE_SIZE.fullmatch(rest.partition(b"\n")[0])
    if found is None or {found[2], found[5]} != {b"X", b"Y"}:
        raise ReadError(f"{path}: broken file: its header has no size; render or copy this frame "
                        "again")
    factors, primaries = np.ones(3), None
    for line in facts.decode("latin-1").splitlines():
        key, _, value = line.partition("=")
        if key == "EXPOSURE":
            factors = factors * _numbers(value, 1, line, path)
        elif key == "COLORCORR":
            factors = factors * _numbers(value, 3, line, path)
        elif key == "PRIMARIES":
            given = _numbers(value, 8, line, path)
            # Photoshop writes zeros where it knows none
            primaries = (tuple(given) if given.any() else None)
        elif key == "FORMAT" and value.strip() == "32-bit_rle_xyze":
            raise ReadError(f"{path}: holds CIE XYZ, which is not read: convert it to RGB first, "
                            "with 'ra_xyze -r -u'")
    if not ((factors > 1 / _MOST_HEADER_NUMBER) & (factors < _MOST_HEADER_NUMBER)).all():
        raise ReadError(f"{path}: broken file: its header says that it was multiplied by "
                        f"{factors.min():g}; correct EXPOSURE and COLORCORR")
    signs = {found[2]: found[1], found[5]: found[4]}
    return RadianceHeader(int(found[3]), int(found[6]), found[2] == b"X", signs[b"Y"] == b"+",
                          signs[b"X"] == b"-",
                          (float(factors[0]), float(factors[1]), float(factors[2])), primaries)


def _numbers(value: str, count: int, line: str, path: Path) -> np.ndarray:
    try:
        numbers = np.array([float(word) for word in value.split()])
    except ValueError:
        numbers = np.empty(0)
    if len(numbers) != count or not all(abs(numbers) < _MOST_HEADER_NUMBER):
        words = "a number" if count == 1 else f"{count} numbers"
        raise ReadError(f"{path}: broken file: '{line[:60]}' is not {words}; correct its header")
    return numbers
