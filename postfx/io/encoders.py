"""Picture files out of a header and rows of pixels, in the format of their suffix."""

from __future__ import annotations

import errno
import os
import struct
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from postfx.io.ends import has_end
from postfx.io.exr.container import PIXEL_BYTES, NewPart, read_headers, write_container
from postfx.io.exr.zip import ZIP_LINES, zip_chunks
from postfx.io.png import write_png
from postfx.io.tags import JPEG
from postfx.io.windows import Pixels

OPAQUE = 3  # channels
_PIECE = 16 << 20  # bytes in float32 that are converted and written at once


def encode(
    path: Path, suffix: str, spec: oiio.ImageSpec, convert: Pixels, relax: Callable[[], None] | None
) -> None:
    """Encode a file. OSError unless it got all its bytes, which the encoders of JPEG, PNG and TIFF do not tell."""
    if suffix == ".exr":
        _write_exr(path, spec, convert, relax)
    elif suffix == ".png" and spec.nchannels == OPAQUE:
        _write_png(path, spec, convert, relax)
    elif suffix in JPEG:
        _write_jpeg(path, spec, convert, relax)
    else:
        _encode(path, suffix, spec, convert, relax)
    if not has_end(path, suffix):
        raise OSError(errno.ENOSPC, "the file has no end")


def _write_exr(path: Path, spec: oiio.ImageSpec, convert: Pixels, relax: Callable[[], None] | None) -> None:
    """Scanlines in ZIP, in a third of the time that OpenImageIO takes; the header is that of a pixel that it writes."""
    _write_pixel(path, ".exr", spec)
    with path.open("rb") as file:
        _, (header,) = read_headers(file)
    last = spec.x + spec.width - 1, spec.y + spec.height - 1
    header.set("dataWindow", "box2i", struct.pack("<4i", spec.x, spec.y, *last))
    places = [spec.channelnames.index(channel.name) for channel in header.channels]

    def rows(first: int, last: int) -> list[np.ndarray]:
        pixels = convert(slice(first, last))
        if relax is not None:
            relax()
        return [pixels[:, :, place] for place in places]

    pixel_bytes = sum(PIXEL_BYTES[channel.kind] for channel in header.channels)
    chunks = zip_chunks(header.data, pixel_bytes, rows)
    write_container(path, [NewPart(header, -(-spec.height // ZIP_LINES), chunks)])


def _write_png(path: Path, spec: oiio.ImageSpec, convert: Pixels, relax: Callable[[], None] | None) -> None:
    """In a third of the time that OpenImageIO takes; all but the pixels is that of a pixel that it writes."""
    _write_pixel(path, ".png", spec)
    write_png(path, path.read_bytes(), (spec.width, spec.height), _pieces(spec, convert, relax))


def _write_pixel(path: Path, suffix: str, spec: oiio.ImageSpec) -> None:
    """Write a file of one pixel, which holds all that is to be said of the picture."""
    pixel = oiio.ImageSpec(spec)
    pixel.width = pixel.height = 1
    _encode(path, suffix, pixel, lambda rows: np.zeros((1, 1, spec.nchannels), np.float32), None)


def _pieces(spec: oiio.ImageSpec, convert: Pixels, relax: Callable[[], None] | None) -> Iterator[np.ndarray]:
    """The picture some rows at a time."""
    step = max(16, _PIECE // (4 * spec.width * spec.nchannels) // 16 * 16)
    for first in range(0, spec.height, step):
        yield np.ascontiguousarray(convert(slice(first, min(spec.height, first + step))))
        if relax is not None:
            relax()


def _write_jpeg(path: Path, spec: oiio.ImageSpec, convert: Pixels, relax: Callable[[], None] | None) -> None:
    """Encode through a pipe, as libjpeg ends the process where a disk is full."""
    reading, writing = os.pipe()
    with ThreadPoolExecutor(1) as reader, os.fdopen(reading, "rb") as encoded:
        content = reader.submit(encoded.read)
        try:
            _encode(Path(f"/dev/fd/{writing}"), ".jpg", spec, convert, relax)
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
