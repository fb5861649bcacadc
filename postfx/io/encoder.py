"""OpenImageIO as the encoder of pictures: whole files, and what they say of a picture beside the
pixels."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from postfx.colour.displays import Display, parse_display
from postfx.files import memory_file
from postfx.frame import LINEAR, Frame
from postfx.io.icc import make_profile
from postfx.io.windows import Pixels

PIECE_BYTES = 16 << 20
"""Of pixels in float32 that are converted and written at once."""
PIECE_ROWS = 16
"""Pieces have a multiple of them, which is what tiles and strips have."""


def display_of(frame: Frame) -> Display | None:
    """Display that a frame's code values are for, None where its colour is light."""
    return None if frame.encoding in LINEAR else parse_display(frame.encoding)


def tag_codes(spec: oiio.ImageSpec, display: Display, suffix: str) -> None:
    """Say in a PNG, TIFF or JPEG for which display its code values are.

    PNG: chunk sRGB, or for other displays iCCP, an ICC profile, and before it cICP (ITU-T H.273)
    where that can say it. TIFF and JPEG: an ICC profile.
    """
    if suffix == ".png" and display.name == "srgb":
        spec.attribute("oiio:ColorSpace", "sRGB")
        return
    icc = np.frombuffer(make_profile(display), np.uint8)
    spec.attribute("oiio:ColorSpace", "unknown")  # else OpenImageIO adds that it is sRGB
    spec.attribute("ICCProfile", oiio.TypeDesc(f"uint8[{len(icc)}]"), icc)
    if display.kind.cicp:
        spec.attribute("CICP", oiio.TypeDesc("int[4]"), display.kind.cicp)


def encode_all(
    path: Path, suffix: str, spec: oiio.ImageSpec, convert: Pixels, relax: Callable[[], None] | None
) -> None:
    """Encode a file in the format of a suffix. Raises OSError with OpenImageIO's reason, which may
    not tell of a full disk."""
    output = oiio.ImageOutput.create(suffix[1:])
    if output is None:
        raise OSError(oiio.geterror())
    written, row = output.open(str(path), spec), spec.y
    for pixels in cut_pieces(spec, convert, relax) if written else ():
        written = written and output.write_scanlines(row, row + len(pixels), 0, pixels)
        row += len(pixels)
    closed = output.close()
    # what TIFF says of Exif is harmless
    lines = [line for line in output.geterror().splitlines() if line and "Exif" not in line]
    if lines or not (written and closed):
        raise OSError(lines[0] if lines else "unknown reason")


def encode_pixel(suffix: str, spec: oiio.ImageSpec) -> bytes:
    """A file of one pixel that says everything else about a picture, made in memory."""
    pixel = oiio.ImageSpec(spec)
    pixel.width = pixel.height = 1
    with memory_file(suffix) as path:
        encode_all(
            path, suffix, pixel, lambda rows: np.zeros((1, 1, spec.nchannels), np.float32), None
        )
        return path.read_bytes()


def cut_pieces(
    spec: oiio.ImageSpec, convert: Pixels, relax: Callable[[], None] | None
) -> Iterator[np.ndarray]:
    """The picture some rows at a time."""
    step = max(
        PIECE_ROWS, PIECE_BYTES // (4 * spec.width * spec.nchannels) // PIECE_ROWS * PIECE_ROWS
    )
    for first in range(0, spec.height, step):
        yield np.ascontiguousarray(convert(slice(first, min(spec.height, first + step))))
        if relax is not None:
            relax()
