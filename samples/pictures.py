"""What several samples draw: crops, enlarged and beside each other, and a video that every browser
plays."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from postfx.canvas import Canvas

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_BLACK = (0, 0, 0)
_WHITE = (255, 255, 255)
_GAP = 4
"""Pixels between two crops."""
_NAME_HEIGHT = 24
"""Pixels of a row of names."""
_LETTER_HEIGHT = 16
"""Pixels of a line of text."""
_MARGIN = 6
"""Pixels around a name within a picture."""


def crops(pictures: Sequence[np.ndarray], places: Sequence[tuple[int, int]], side: int,
          zoom: int) -> np.ndarray:
    """Squares of pictures (height, width, 3) of one size, enlarged by repeating pixels: a row for
    each place (x, y), a column for each picture, white between them."""
    rows = []
    for x, y in places:
        cut = [picture[y:y + side, x:x + side].repeat(zoom, 0).repeat(zoom, 1)
               for picture in pictures]
        rows.append(_join(cut, axis=1))
    return _join(rows, axis=0)


def beside(pictures: Sequence[np.ndarray]) -> np.ndarray:
    """Pictures of one height in a row, white between them."""
    return _join(list(pictures), axis=1)


def below(pictures: Sequence[np.ndarray]) -> np.ndarray:
    """Pictures below each other, white between and beside them."""
    widest = max(picture.shape[1] for picture in pictures)
    padded = [np.pad(one, ((0, 0), (0, widest - one.shape[1]), (0, 0)), constant_values=1)
              for one in pictures]
    return _join(padded, axis=0)


def name_columns(names: Sequence[str], width: int) -> np.ndarray:
    """A row of names in black on white, each in the middle of a column of so many pixels."""
    row = Canvas(len(names) * (width + _GAP) - _GAP, _NAME_HEIGHT, _WHITE)
    for number, name in enumerate(names):
        middle = number * (width + _GAP) + width / 2
        row.text(middle, _NAME_HEIGHT / 2, name, _BLACK, _LETTER_HEIGHT, "center")
    return row.pixels / 255


def name_corner(picture: np.ndarray, name: str, corner: str = "left") -> np.ndarray:
    """A picture (height, width, 3) of code values with its name in white on black in a lower
    corner, "left" or "right"."""
    size = oiio.ImageBufAlgo.text_size(name, _LETTER_HEIGHT)
    width, height = size.width + 2 * _MARGIN, _LETTER_HEIGHT + 2 * _MARGIN
    box = Canvas(width, height, _BLACK)
    box.text(width / 2, height / 2, name, _WHITE, _LETTER_HEIGHT, "center")
    named = picture.copy()
    named[-height:, slice(width) if corner == "left" else slice(-width, None)] = box.pixels / 255
    return named


def means_of_blocks(light: np.ndarray, height: int) -> np.ndarray:
    """A picture (n * height, n * width, channels) as means over n x n pixels."""
    step = light.shape[0] // height
    return light.reshape(height, step, -1, step, light.shape[2]).mean((1, 3))


def split(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """One picture to the left of the middle, the other to its right, and a white line between
    them."""
    middle = left.shape[1] // 2
    joined = np.concatenate([left[:, :middle], right[:, middle:]], 1)
    joined[:, middle - 1:middle + 1] = 1
    return joined


def write_animation(path: Path, files: Sequence[Path], frames_a_second: int) -> None:
    """Join PNG files of one size and kind into one animated PNG, which is shown for ever."""
    pictures = [list(_chunks(file.read_bytes())) for file in files]
    header = next(data for kind, data in pictures[0] if kind == b"IHDR")
    width, height = struct.unpack(">II", header[:8])
    out, number = [_chunk(b"IHDR", header), _chunk(b"acTL", struct.pack(">II", len(files), 0))], 0
    for index, picture in enumerate(pictures):
        if next(data for kind, data in picture if kind == b"IHDR") != header:
            raise ValueError(f"{files[index]}: is not of the size and kind of {files[0]}")
        timing = struct.pack(">IIIIIHHBB", number, width, height, 0, 0, 1, frames_a_second, 0, 0)
        out.append(_chunk(b"fcTL", timing))
        number += 1
        for data in (data for kind, data in picture if kind == b"IDAT"):
            out.append(_chunk(b"IDAT", data) if index == 0
                       else _chunk(b"fdAT", struct.pack(">I", number) + data))
            number += index > 0
    path.write_bytes(_SIGNATURE + b"".join(out) + _chunk(b"IEND", b""))


def _chunks(file: bytes) -> Iterator[tuple[bytes, bytes]]:
    at = len(_SIGNATURE)
    while at < len(file):
        length, kind = struct.unpack(">I4s", file[at:at + 8])
        yield kind, file[at + 8:at + 8 + length]
        at += length + 12


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _join(pictures: list[np.ndarray], axis: int) -> np.ndarray:
    shape = list(pictures[0].shape)
    shape[axis] = _GAP
    parts = [pictures[0]]
    for picture in pictures[1:]:
        parts += [np.ones(shape, np.float32), picture]
    return np.concatenate(parts, axis)
