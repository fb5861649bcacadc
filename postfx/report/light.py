"""Light in a page: in whole numbers that are fine enough to be exposed anew, and compress well."""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np

LARGEST = 511
TOE = 2.0**-8
"""Light below which steps are even; above, they are even in stops."""
NOT_FINITE = (LARGEST, 0, LARGEST)


def coded(light: np.ndarray, highest: float) -> np.ndarray:
    """Light (height, width, 3) as codes 0..511, uint16: 511 log(1 + light / TOE) / log(1 + highest / TOE).

    What is above `highest` or negative is clipped; a pixel that is not finite becomes magenta. Up to 64, a stop has 36
    codes; of the 255 steps of a screen, x / (1 + x) in sRGB has at most 32 in a stop.
    """
    steps = np.log1p(np.clip(np.nan_to_num(light), 0, highest) / np.float32(TOE)) / np.log1p(highest / TOE)
    codes: np.ndarray = np.rint(LARGEST * steps).astype(np.uint16)
    codes[~np.isfinite(light).all(2)] = NOT_FINITE
    return codes


def packed(codes: np.ndarray, highest: float) -> dict[str, Any]:
    """Codes for the page's script: 'width', 'height', 'toe', 'highest', and 'data', which is base64 of zlib.

    Inside are three planes, green, red - green and blue - green: each row as differences to the pixel before it, folded
    to 0, -1, 1, -2, ... -> 0, 1, 2, 3, ...; the low bytes of all planes come first, then the high bytes.
    """
    red, green, blue = np.moveaxis(codes.astype(np.int32), 2, 0)
    steps = np.diff(np.stack([green, red - green, blue - green]), axis=2, prepend=0)
    folded = np.where(steps < 0, -2 * steps - 1, 2 * steps).astype("<u2").ravel()
    content = zlib.compress((folded & 255).astype(np.uint8).tobytes() + (folded >> 8).astype(np.uint8).tobytes(), 9)
    height, width = codes.shape[:2]
    data = base64.b64encode(content).decode("ascii")
    return {"width": width, "height": height, "toe": TOE, "highest": highest, "data": data}
