"""A look at image files before a decoder gets them: is it the format, and can it hold what its header claims?"""

from __future__ import annotations

import re
from pathlib import Path

from postfx.errors import ReadError
from postfx.io.container.chunks import MAX_SIDE, ExrContainer

_HDR_STARTS = (b"#?RADIANCE", b"#?RGBE")
_HDR_HEADER = 64 << 10  # bytes within which the size has to stand
_HDR_SIZE = re.compile(rb"\n[-+][XY] +(\d{1,9}) +[-+][XY] +(\d{1,9})\n")
_HDR_GROWS = 64  # runs of 127 bytes lie in 2


def check_claims(path: Path) -> None:
    """ReadError for a file that cannot be read, is neither OpenEXR nor Radiance HDR, or claims more pixels than its
    bytes can hold. By its first bytes, whatever its name."""
    try:
        with path.open("rb") as file:
            start = file.read(_HDR_HEADER)
            size = file.seek(0, 2)
        if not start:
            raise ReadError(f"{path}: is empty: render or copy this frame again")
        if start.startswith(_HDR_STARTS):
            _check_hdr(path, start, size)
        else:
            with ExrContainer(path):
                pass
    except OSError as error:
        raise ReadError(f"{path}: cannot be read: {error.strerror or error}; check the file's rights") from error


def _check_hdr(path: Path, start: bytes, size: int) -> None:
    found = _HDR_SIZE.search(start)
    if found is None:
        raise ReadError(f"{path}: broken file: its header has no size; render or copy this frame again")
    sides = int(found[1]), int(found[2])
    if max(sides) > MAX_SIDE or 4 * sides[0] * sides[1] > _HDR_GROWS * size:
        raise ReadError(f"{path}: broken file: its header claims {sides[1]}x{sides[0]} pixels in {size} bytes; "
                        "render or copy this frame again")
