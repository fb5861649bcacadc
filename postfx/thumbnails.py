"""Small pictures as PNG files: in pages, in reports and in notebooks."""

from __future__ import annotations

import base64
import struct
import zlib
from collections.abc import Sequence
from html import escape

import numpy as np
import OpenImageIO as oiio

from postfx.colour.displays import srgb_encode

NOTEBOOK_SIDE = 640
"""Longest side of a picture in a notebook, pixels."""


def png(pixels: np.ndarray) -> bytes:
    """A PNG file of uint8 (height, width, 3)."""
    height, width, _ = pixels.shape
    # each row begins with its filter, 0 for none
    rows = np.zeros((height, 1 + 3 * width), np.uint8)
    rows[:, 1:] = pixels.reshape(height, -1)
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunks = [_chunk(b"IHDR", header), _chunk(b"IDAT", zlib.compress(rows.tobytes(), 9)),
              _chunk(b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


def png_uri(pixels: np.ndarray) -> str:
    """A PNG file of uint8 (height, width, 3) as a data URI."""
    return "data:image/png;base64," + base64.b64encode(png(pixels)).decode("ascii")


def _chunk(kind: bytes, content: bytes) -> bytes:
    return (struct.pack(">I", len(content)) + kind + content
            + struct.pack(">I", zlib.crc32(kind + content)))


def shrink(pixels: np.ndarray, most: int) -> np.ndarray:
    """float32 (height, width, C) whose longer side is at most `most` pixels: means over areas."""
    height, width, channels = pixels.shape
    share = most / max(height, width)
    if share >= 1:
        return pixels
    size = oiio.ROI(0, max(round(width * share), 1), 0, max(round(height * share), 1), 0, 1, 0,
                    channels)
    source = oiio.ImageBuf(np.ascontiguousarray(pixels, np.float32))
    found = oiio.ImageBufAlgo.resize(source, filtername="box", roi=size).get_pixels(oiio.FLOAT)
    assert found is not None, "pixels in memory can be resized"
    return found


def notebook_picture(colour: np.ndarray, encoding: str, exposure_factor: float) -> bytes:
    """A frame's colour (height, width, 3) as a small PNG file; `encoding` is the frame's.

    Scene-linear light is multiplied by `exposure_factor` and shown as x / (1 + x) in sRGB.
    """
    shown = np.maximum(np.nan_to_num(shrink(colour, NOTEBOOK_SIDE), posinf=0, neginf=0), 0)
    if encoding == "scene-linear":
        shown = shown * exposure_factor
        shown = shown / (1 + shown)
    if encoding.endswith("-linear"):
        shown = srgb_encode(np.minimum(shown, 1))
    return png((np.clip(shown, 0, 1) * 255 + 0.5).astype(np.uint8))


def notebook_page(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]],
                  picture: bytes | None) -> str:
    """HTML of a table, under a PNG file's picture if there is one."""
    source = base64.b64encode(picture or b"").decode("ascii")
    image = f'<img src="data:image/png;base64,{source}" alt="colour">' if picture else ""
    head = "".join(f"<th>{escape(column)}</th>" for column in columns)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>"
                   for row in rows)
    return f"<p>{escape(title)}</p>{image}<table><tr>{head}</tr>{body}</table>"
