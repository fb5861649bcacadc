"""What headers of Radiance HDR files say beside the size: orientation, exposure and primaries.

The format: https://radsite.lbl.gov/radiance/refer/filefmts.pdf, "Pictures".
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from postfx.errors import ReadError

STARTS = (b"#?RADIANCE", b"#?RGBE")
MAX_HEADER = 64 << 10
"""Bytes within which the size has to stand."""
_SIZE = re.compile(rb"\n([-+])([XY]) +(\d{1,9}) +([-+])([XY]) +(\d{1,9})\n")


_MOST = 1e15
"""What no number of a header may reach."""


@dataclass(frozen=True)
class RadianceHeader:
    """Header of a Radiance HDR file.

    Attributes:
        rows, columns: how many lines are stored, and pixels in each.
        is_turned: whether lines are columns of the picture.
        flips_y, flips_x: whether the picture's rows are stored from the bottom, its columns from the right.
        exposure: what the stored red, green and blue were multiplied by.
        primaries: x and y of red, green, blue and white, None where the header does not say them.
    """

    rows: int
    columns: int
    is_turned: bool = False
    flips_y: bool = False
    flips_x: bool = False
    exposure: tuple[float, float, float] = (1.0, 1.0, 1.0)
    primaries: tuple[float, ...] | None = None

    @property
    def is_plain(self) -> bool:
        """Whether the picture is stored as it is, from the top left."""
        return not (self.is_turned or self.flips_y or self.flips_x) and set(self.exposure) == {1.0}

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the picture."""
        return (self.rows, self.columns) if self.is_turned else (self.columns, self.rows)

    def upright(self, stored: np.ndarray) -> np.ndarray:
        """Stored pixels (rows, columns, 3) as light (height, width, 3) from the top left, float32."""
        pixels = stored.swapaxes(0, 1) if self.is_turned else stored
        pixels = pixels[::-1 if self.flips_y else 1, ::-1 if self.flips_x else 1]
        return np.ascontiguousarray(pixels / np.asarray(self.exposure), np.float32)


def parse_header(start: bytes, path: Path) -> RadianceHeader:
    """Header at the start of a file. Raises ReadError where it is broken, or holds CIE XYZ."""
    found = _SIZE.search(start)
    if found is None or {found[2], found[5]} != {b"X", b"Y"}:
        raise ReadError(f"{path}: broken file: its header has no size; render or copy this frame again")
    exposure, primaries = np.ones(3), None
    for line in start[: found.start()].decode("latin-1").splitlines():
        key, _, value = line.partition("=")
        if key == "EXPOSURE":
            exposure = exposure * _numbers(value, 1, line, path)
        elif key == "COLORCORR":
            exposure = exposure * _numbers(value, 3, line, path)
        elif key == "PRIMARIES":
            primaries = tuple(_numbers(value, 8, line, path))
        elif key == "FORMAT" and value.strip() == "32-bit_rle_xyze":
            raise ReadError(f"{path}: holds CIE XYZ, which is not read: turn it to RGB first, with 'ra_xyze -r -u'")
    if not ((exposure > 1 / _MOST) & (exposure < _MOST)).all():
        raise ReadError(f"{path}: broken file: its header says that it was multiplied by {exposure.min():g}; correct "
                        "EXPOSURE and COLORCORR")
    signs = {found[2]: found[1], found[5]: found[4]}
    return RadianceHeader(int(found[3]), int(found[6]), found[2] == b"X", signs[b"Y"] == b"+", signs[b"X"] == b"-",
                          (float(exposure[0]), float(exposure[1]), float(exposure[2])), primaries)


def _numbers(value: str, count: int, line: str, path: Path) -> np.ndarray:
    try:
        numbers = np.array([float(word) for word in value.split()])
    except ValueError:
        numbers = np.empty(0)
    if len(numbers) != count or not all(abs(numbers) < _MOST):
        words = "a number" if count == 1 else f"{count} numbers"
        raise ReadError(f"{path}: broken file: '{line[:60]}' is not {words}; correct its header")
    return numbers
