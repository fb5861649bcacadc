"""Encoders: picture files from a header and rows of pixels, in the format of their suffix, with ICC profiles.

Code values become whole numbers plainly, or dithered by blue noise, so that 8 bits show no bands.
"""

from __future__ import annotations

import errno
import io
import os
import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
import OpenImageIO as oiio
from isal import isal_zlib

from postfx.colour import D50_XYZ, Chromaticities, adapt, to_xyz
from postfx.colour.displays import KINDS, SRGB, Display
from postfx.errors import ReadError
from postfx.files import memory_file, read_to_end
from postfx.frame import Frame
from postfx.io.exr import Header, read_headers
from postfx.io.exr.container import ExrContainer, Rows, picture_part, write_container
from postfx.io.exr.passthrough import merge_source
from postfx.io.exr.views import View, merge_views
from postfx.io.windows import Pixels
from postfx.kernels.pixel_formats import dither_rows, halve, look_up, paeth
from postfx.workers import Workers

_STEPS = 1 << 16


def to_halves(light: np.ndarray) -> np.ndarray:
    """float16 nearest to light of any shape, cut to +-65504; NaN stays. Channels of (height, width, channels) lie one
    after the other in memory, as they are written."""
    height, width, count = light.shape if light.ndim == 3 else (1, light.size, 1)
    values, found = np.ascontiguousarray(light, np.float32), np.empty((count, height * width), np.uint16)
    halve(values.reshape(-1).view(np.int32), found)
    return np.moveaxis(found.view(np.float16).reshape(count, height, width), 0, -1).reshape(light.shape)


def light_of(codes: np.ndarray, display: Display) -> np.ndarray:
    """Code values (..., 3) of a display to its light, float32, 1 is white: what `Display.decode` gives, by a table
    where all are from 0 to 1.

    Where light is a normal half float it errs by less than 2e-6 of itself; a half float is as near as 2.4e-4.
    """
    values = np.ascontiguousarray(codes, np.float32).reshape(-1)
    light = np.empty_like(values)
    if not look_up(values, _table(display.name), light):
        return display.decode(codes).astype(np.float32, copy=False)
    return display.apply_ootf(light.reshape(codes.shape)).astype(np.float32, copy=False)


@cache
def _table(name: str) -> np.ndarray:
    light = KINDS[name].curve.decode(np.linspace(0, 1, _STEPS + 1))
    return np.append(light, light[-1]).astype(np.float32)


JPEG = (".jpg", ".jpeg")


def tag_codes(spec: oiio.ImageSpec, display: Display, path: Path) -> None:
    """Say in a PNG, TIFF or JPEG for which display its code values are.

    PNG: chunk sRGB, or for other displays iCCP, an ICC profile, and before it cICP (ITU-T H.273) where that can say it.
    TIFF and JPEG: an ICC profile.
    """
    if path.suffix.lower() == ".png" and display.name == "srgb":
        spec.attribute("oiio:ColorSpace", "sRGB")
        return
    icc = np.frombuffer(make_profile(display), np.uint8)
    spec.attribute("oiio:ColorSpace", "unknown")  # else OpenImageIO adds that it is sRGB
    spec.attribute("ICCProfile", oiio.TypeDesc(f"uint8[{len(icc)}]"), icc)
    if display.kind.cicp:
        spec.attribute("CICP", oiio.TypeDesc("int[4]"), display.kind.cicp)


def tag_light(spec: oiio.ImageSpec, primaries: Chromaticities, white: float | None = None) -> None:
    """Say in an EXR of which primaries its light is, and how bright 1 is in cd/m2, if that is known."""
    spec.attribute("chromaticities", oiio.TypeDesc("float[8]"), primaries)
    if white is not None:
        spec.attribute("whiteLuminance", float(white))


_SIGNATURE = 8  # bytes
_LEVEL = 1  # of ISA-L: a ninth of the time of zlib's level 3 for 1 % more bytes


def write_png(path: Path, like: bytes, size: tuple[int, int], pieces: Iterable[np.ndarray]) -> None:
    """Write a PNG of a width and height with all chunks of another, `like`, but for its pixels.

    `pieces` are rows from the top, (rows, width, channels) uint8 or uint16, channels and type as in `like`.
    """
    with path.open("wb") as file:
        file.write(like[:_SIGNATURE])
        for kind, content in _chunks(like):
            if kind == b"IHDR":
                _write(file, kind, struct.pack(">2I", *size) + content[8:])
            elif kind != b"IDAT":
                _write(file, kind, content)
            else:
                for compressed in filter(None, _compress(pieces)):
                    _write(file, kind, compressed)


def _chunks(content: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Type and content of each chunk."""
    at = _SIGNATURE
    while at < len(content):
        length, kind = struct.unpack_from(">I4s", content, at)
        yield kind, content[at + 8 : at + 8 + length]
        at += length + 12


def _write(file: BinaryIO, kind: bytes, content: bytes) -> None:
    file.write(struct.pack(">I4s", len(content), kind))
    file.write(content)
    file.write(struct.pack(">I", isal_zlib.crc32(content, isal_zlib.crc32(kind))))


def _compress(pieces: Iterable[np.ndarray]) -> Iterator[bytes]:
    """One stream of zlib's format, in parts."""
    stream, above = isal_zlib.compressobj(_LEVEL), None
    for pixels in pieces:
        step = pixels.shape[2] * pixels.itemsize
        rows = pixels.astype(pixels.dtype.newbyteorder(">"), copy=False).view(np.uint8).reshape(len(pixels), -1)
        filtered = np.empty((len(rows), rows.shape[1] + 1), np.uint8)
        paeth(rows, np.zeros_like(rows[0]) if above is None else above, step, filtered)
        above = rows[-1]
        yield stream.compress(filtered)
    yield stream.flush()


_ENDS = {".png": b"\0\0\0\0IEND\xaeB`\x82", ".jpg": b"\xff\xd9", ".jpeg": b"\xff\xd9"}
_TIFF = {b"II*\0": ("<", "H", "I"), b"MM\0*": (">", "H", "I"), b"II+\0": ("<", "Q", "Q"), b"MM\0+": (">", "Q", "Q")}
# First bytes -> byte order, and how a directory's count of entries and offsets are stored.
_WHERE, _HOW_MANY = (273, 324), (279, 325)  # tags of strips and of tiles: offsets, and counts of bytes
_WHOLE = {3: "H", 4: "I", 16: "Q"}



def has_end(path: Path, suffix: str) -> bool:
    """Whether a file of the format of a suffix ends well: PNG's and JPEG's last bytes are there, TIFF's directory and
    all that it leads to, all chunks of all parts of an OpenEXR file."""
    suffix = suffix.lower()
    if suffix == ".exr":
        return _is_whole_exr(path)
    with path.open("rb") as file:
        if suffix in _ENDS:
            end = _ENDS[suffix]
            size = file.seek(0, os.SEEK_END)
            file.seek(max(0, size - len(end)))
            return file.read() == end
        return _is_whole_tiff(file, path.stat().st_size)


def _is_whole_tiff(file: BinaryIO, size: int) -> bool:
    """Whether the directory and the strips or tiles lie within the file (TIFF 6.0, section 2)."""
    layout = _TIFF.get(file.read(4))
    try:
        return layout is not None and _last_byte(file, layout) <= size
    except (struct.error, KeyError):
        return False


def _last_byte(file: BinaryIO, layout: tuple[str, str, str]) -> int:
    order, kind, offset = layout
    wide = struct.calcsize(order + offset)
    file.seek(wide)  # behind the first four bytes, or eight
    file.seek(*_unpack(file, order + offset))
    (count,) = _unpack(file, order + kind)
    entries = [_unpack(file, f"{order}HH{offset}{wide}s") for _ in range(min(count, 4096))]
    found = {tag: _numbers(file, order, wide, *rest) for tag, *rest in entries if tag in _WHERE + _HOW_MANY}
    starts, counts = ([found[tag] for tag in tags if tag in found] for tags in (_WHERE, _HOW_MANY))
    if not starts or not counts or not all(starts[0]):
        raise KeyError("strips")
    return max(map(sum, zip(starts[0], counts[0], strict=False)))


def _numbers(file: BinaryIO, order: str, wide: int, kind: int, count: int, value: bytes) -> tuple[int, ...]:
    """Values of an entry: its own bytes, or those that they lead to."""
    form = f"{order}{min(count, 1 << 20)}{_WHOLE[kind]}"
    if struct.calcsize(form) <= wide:
        return struct.unpack_from(form, value)
    file.seek(*struct.unpack(order + ("I" if wide == 4 else "Q"), value))
    return _unpack(file, form)


def _unpack(file: BinaryIO, form: str) -> tuple[Any, ...]:
    return struct.unpack(form, file.read(struct.calcsize(form)))


def _is_whole_exr(path: Path) -> bool:
    try:
        with ExrContainer(path) as file:
            file.check_whole()
    except ReadError:
        return False
    return True


OPAQUE = 3  # channels
_PIECE = 16 << 20  # bytes in float32 that are converted and written at once


def encode(
    path: Path, suffix: str, spec: oiio.ImageSpec, convert: Pixels, relax: Callable[[], None] | None,
    keep: Frame | None = None, views: Sequence[Picture] = (),
) -> None:
    """Encode a file; an EXR with everything else that the source of `keep` holds, or of several views.

    Raises OSError unless all bytes are in the file, which the encoders of JPEG, PNG and TIFF do not tell; ReadError
    when what is kept cannot be read.
    """
    if suffix == ".exr":
        whole = _write_exr(path, spec, convert, relax, keep, views) == path.stat().st_size
    else:
        write = _write_jpeg if suffix in JPEG else _write_png if _is_own_png(suffix, spec) else _encode
        write(path, suffix, spec, convert, relax)
        whole = has_end(path, suffix)
    if not whole:
        raise OSError(errno.ENOSPC, "the file has no end")


class Picture(NamedTuple):
    """One view of several that go into a file: its pixels, and the frame that they are of."""

    spec: oiio.ImageSpec
    convert: Pixels
    frame: Frame


def _write_exr(
    path: Path, spec: oiio.ImageSpec, convert: Pixels, relax: Callable[[], None] | None, keep: Frame | None,
    views: Sequence[Picture]
) -> int:
    """Scanlines, in ZIP in a third of the time that OpenImageIO takes; returns the file's bytes.

    Each chunk goes straight into the file, together with the channels and parts that are kept.
    """
    with ExitStack() as stack:
        if views:
            pictures = [View(*_header_and_rows(view.spec, view.convert, relax), view.frame) for view in views]
            parts = merge_views(pictures, keep is not None, stack)
        else:
            header, rows = _header_and_rows(spec, convert, relax)
            parts = merge_source(header, rows, keep, stack) if keep else [picture_part(header, rows, apart=True)]
        return write_container(path, parts)


def _header_and_rows(spec: oiio.ImageSpec, convert: Pixels, relax: Callable[[], None] | None) -> tuple[Header, Rows]:
    header = _exr_header(spec)
    places = [spec.channelnames.index(channel.name) for channel in header.channels]

    def rows(first: int, last: int) -> list[np.ndarray]:
        pixels = convert(slice(first, last))
        if relax is not None:
            relax()
        return [pixels[:, :, place] for place in places]

    return header, rows


def _exr_header(spec: oiio.ImageSpec) -> Header:
    """The header that OpenImageIO gives a picture."""
    _, (header,) = read_headers(io.BytesIO(_encode_pixel(".exr", spec)))
    last = spec.x + spec.width - 1, spec.y + spec.height - 1
    header.set("dataWindow", "box2i", struct.pack("<4i", spec.x, spec.y, *last))
    return header


def _is_own_png(suffix: str, spec: oiio.ImageSpec) -> bool:
    return suffix == ".png" and spec.nchannels == OPAQUE


def _write_png(path: Path, suffix: str, spec: oiio.ImageSpec, convert: Pixels,
               relax: Callable[[], None] | None) -> None:
    """In a third of the time that OpenImageIO takes; all but the pixels is what OpenImageIO writes."""
    write_png(path, _encode_pixel(suffix, spec), (spec.width, spec.height), _pieces(spec, convert, relax))


def _encode_pixel(suffix: str, spec: oiio.ImageSpec) -> bytes:
    """A file of one pixel that says everything else about a picture, made in memory."""
    pixel = oiio.ImageSpec(spec)
    pixel.width = pixel.height = 1
    with memory_file(suffix) as path:
        _encode(path, suffix, pixel, lambda rows: np.zeros((1, 1, spec.nchannels), np.float32), None)
        return path.read_bytes()


def _pieces(spec: oiio.ImageSpec, convert: Pixels, relax: Callable[[], None] | None) -> Iterator[np.ndarray]:
    """The picture some rows at a time."""
    step = max(16, _PIECE // (4 * spec.width * spec.nchannels) // 16 * 16)
    for first in range(0, spec.height, step):
        yield np.ascontiguousarray(convert(slice(first, min(spec.height, first + step))))
        if relax is not None:
            relax()


def _write_jpeg(path: Path, suffix: str, spec: oiio.ImageSpec, convert: Pixels,
                relax: Callable[[], None] | None) -> None:
    """Encode through a pipe, as libjpeg ends the process where a disk is full or a file is larger than it may be."""
    if not Path("/dev/fd").is_dir():  # on Windows, where pipes have no names: there must be room for any JPEG
        with memory_file(suffix, spec.image_bytes()) as made:
            _encode(made, suffix, spec, convert, relax)
            path.write_bytes(made.read_bytes())
        return
    reading, writing = os.pipe()
    with Workers(1) as reader:
        content = reader.submit(read_to_end, reading, 4 * spec.image_bytes() + (1 << 16))
        try:
            _encode(Path(f"/dev/fd/{writing}"), suffix, spec, convert, relax)
        finally:
            os.close(writing)
        path.write_bytes(content.result())


def _encode(path: Path, suffix: str, spec: oiio.ImageSpec, convert: Pixels, relax: Callable[[], None] | None) -> None:
    output = oiio.ImageOutput.create(suffix[1:])
    if output is None:
        raise OSError(oiio.geterror())
    written, row = output.open(str(path), spec), spec.y
    for pixels in _pieces(spec, convert, relax) if written else ():
        written = written and output.write_scanlines(row, row + len(pixels), 0, pixels)
        row += len(pixels)
    closed = output.close()
    lines = [line for line in output.geterror().splitlines() if line and "Exif" not in line]  # of TIFF, harmless
    if lines or not (written and closed):
        raise OSError(lines[0] if lines else "unknown reason")


_VERSION = 0x04400000
_MADE = (2025, 1, 1, 0, 0, 0)
_SAMPLES = 1024
_HEADER, _ENTRY = 128, 12


@cache
def make_profile(display: Display) -> bytes:
    """Profile of a display's code values.

    A curve cannot describe PQ and HLG up to their peak. It ends at diffuse white, so software without HDR clips
    brighter lights there; the tag `cicp` tells other software the true encoding.
    """
    primaries = display.kind.primaries
    colorants = adapt(primaries, D50_XYZ)
    curve = _curve(display)
    tags = {
        b"desc": _text(f"{display.kind.title} (postfx)"),
        b"cprt": _text("No copyright: CC0 1.0"),
        b"wtpt": _icc_numbers(b"XYZ ", D50_XYZ),
        b"chad": _icc_numbers(b"sf32", (colorants @ np.linalg.inv(to_xyz(primaries))).ravel()),
        b"rXYZ": _icc_numbers(b"XYZ ", colorants[:, 0]),
        b"gXYZ": _icc_numbers(b"XYZ ", colorants[:, 1]),
        b"bXYZ": _icc_numbers(b"XYZ ", colorants[:, 2]),
        b"rTRC": curve,
        b"gTRC": curve,
        b"bTRC": curve,
    }
    if display.kind.cicp:
        tags[b"cicp"] = b"cicp" + bytes(4) + bytes(display.kind.cicp)
    return _assemble(tags)


def _assemble(tags: dict[bytes, bytes]) -> bytes:
    start = _HEADER + 4 + _ENTRY * len(tags)
    table, data, places = struct.pack(">I", len(tags)), b"", {}
    for name, content in tags.items():
        if content not in places:  # the three curves are one
            places[content] = start + len(data)
            data += content + bytes(-len(content) % 4)
        table += struct.pack(">4sII", name, places[content], len(content))
    return _header(start + len(data)) + table + data


def _header(size: int) -> bytes:
    kinds = struct.pack(">4s4s4s6H4s", b"mntr", b"RGB ", b"XYZ ", *_MADE, b"acsp")
    white = b"".join(map(_encode_fixed, D50_XYZ))
    return (struct.pack(">I4sI", size, b"", _VERSION) + kinds + bytes(28) + white).ljust(_HEADER, b"\0")


def _curve(display: Display) -> bytes:
    if display.kind.curve is SRGB:
        numbers = 2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045
        return b"para" + struct.pack(">IHH", 0, 3, 0) + b"".join(map(_encode_fixed, numbers))
    if not display.hdr:
        return b"para" + struct.pack(">IHH", 0, 0, 0) + _encode_fixed(2.4)
    codes = np.linspace(0, 1, _SAMPLES)
    light = np.minimum(display.decode(np.repeat(codes[:, None], 3, 1))[:, 0], 1)
    samples: bytes = np.rint(light * 65535).astype(">u2").tobytes()
    return b"curv" + struct.pack(">II", 0, _SAMPLES) + samples


def _text(text: str) -> bytes:
    """multiLocalizedUnicodeType with one language."""
    encoded = text.encode("utf-16-be")
    return b"mluc" + struct.pack(">III4sII", 0, 1, 12, b"enUS", len(encoded), 28) + encoded


def _icc_numbers(kind: bytes, values: np.ndarray | tuple[float, ...]) -> bytes:
    return kind + bytes(4) + b"".join(map(_encode_fixed, values))


def _encode_fixed(value: float) -> bytes:
    """s15Fixed16Number."""
    return struct.pack(">i", round(float(value) * 65536))


# Quantising ---------------------------------------------------------------------------------------------------------

SIDE = 64
_SIGMA = 1.5
_TURN = np.array([0.7548776662466927, 0.5698402909980532])  # a shift that comes back late: Roberts 2018, R2


class Dither(StrEnum):
    """Pattern of the dither: another one each frame, the same for all frames, or no dither."""

    MOVING = "moving"
    STATIC = "static"
    NONE = "none"


def quantise(codes: np.ndarray, bits: int, dither: Dither, number: int = 1, first_row: int = 0) -> np.ndarray:
    """Code values (height, width, channels) to whole numbers of 8 or 16 bits; cut to 0..1, NaN becomes 0.

    Dithered, a value between two whole numbers becomes one of them, the larger the more often the nearer it is: the
    error stays below 1, and over each 64x64 pixels of a flat area the mean is kept to 1/8192. The pattern depends on
    the pixel, the channel and, if it moves, on the frame's number; `first_row` is the place of the first row. 16 bits
    are not dithered.
    """
    top = np.float32(2**bits - 1)
    if bits != 8 or dither is Dither.NONE:
        rounded: np.ndarray = np.rint(np.clip(np.nan_to_num(codes), 0, 1) * top)
        return rounded.astype(np.uint8 if bits == 8 else np.uint16)
    height, width, channels = codes.shape
    turns = range(0, channels) if dither is Dither.STATIC else range(3 * number, 3 * number + channels)
    whole = np.empty((height, width * channels), np.uint8)
    flat = np.ascontiguousarray(codes, np.float32).reshape(whole.shape)
    dither_rows(flat, top, np.stack([_thresholds(first_row, turn) for turn in turns], 2).reshape(SIDE, -1), whole)
    return whole.reshape(codes.shape)


def _thresholds(first_row: int, turn: int) -> np.ndarray:
    """Blue noise (64, 64) with another pixel first in each turn."""
    down, right = (turn * _TURN % 1 * SIDE).astype(int)
    return np.roll(blue_noise(), (-down - first_row, -right), (0, 1))


@cache
def blue_noise(side: int = SIDE) -> np.ndarray:
    """Thresholds (side, side) float32, each of (0.5 .. side^2 - 0.5) / side^2 once, repeating without a seam.

    Source: Ulichney, "The void-and-cluster method for dither array generation", 1993.
    """
    weight, taken = _neighbourhood(side), np.zeros((side, side), bool)
    energy = np.random.default_rng(0).uniform(0, 1e-6, (side, side))  # breaks ties
    first = _scatter(taken, energy, weight)
    ranks = np.empty((side, side))
    started = taken.copy(), energy.copy()
    for rank in reversed(range(first)):
        ranks[_put(np.argmax(np.where(taken, energy, -np.inf)), taken, energy, weight)] = rank
    taken, energy = started
    for rank in range(first, side * side):
        ranks[_put(np.argmin(np.where(taken, np.inf, energy)), taken, energy, weight)] = rank
    return ((ranks + 0.5) / side**2).astype(np.float32)


def _scatter(taken: np.ndarray, energy: np.ndarray, weight: np.ndarray) -> int:
    """Take a tenth of the places, as far from each other as they go; returns how many."""
    count = taken.size // 10
    for _ in range(count):
        _put(np.argmin(np.where(taken, np.inf, energy)), taken, energy, weight)
    while True:
        removed = _put(np.argmax(np.where(taken, energy, -np.inf)), taken, energy, weight)
        if removed == _put(np.argmin(np.where(taken, np.inf, energy)), taken, energy, weight):
            return count


def _put(at: np.intp, taken: np.ndarray, energy: np.ndarray, weight: np.ndarray) -> tuple[int, int]:
    """Take a free place, or give a taken one back; returns its row and column."""
    side = len(taken)
    y, x = divmod(int(at), side)
    energy += (-1 if taken[y, x] else 1) * weight[side - y : 2 * side - y, side - x : 2 * side - x]
    taken[y, x] = not taken[y, x]
    return y, x


def _neighbourhood(side: int) -> np.ndarray:
    """How near places are to the one at (side, side), on a torus; (2 * side, 2 * side)."""
    distance = np.minimum(np.arange(2 * side) % side, -np.arange(2 * side) % side)
    near = np.exp(-(distance**2) / (2 * _SIGMA**2))
    return near[:, None] * near
