"""Pixels for a page: slices of tensors as pictures, and light that a page can expose anew."""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np

from postfx.thumbnails import png_uri

# Percentiles of the finite values that become black and white.
BLACK_PERCENTILE = 1
WHITE_PERCENTILE = 99

GAMMA = 2.2
"""Power that pictures of light are shown by."""
SHEET_COLUMNS = 4
"""Tiles in a row of a sheet."""
_NOT_FINITE = (255, 0, 255)


def picture(slices: list[np.ndarray]) -> dict[str, str]:
    """A picture of one slice (grey), two (red, green) or three (red, green, blue): {'src': data
    URI, 'range': text}.

    Values are float (height, width) of any range; black and white are chosen for all slices
    together. Without negative values, black is 0 and the gamma is 2.2; otherwise the scale is
    linear. NaN and infinities are magenta.
    """
    stack = np.stack(slices, axis=-1)
    shown, text = _shown(stack)
    pixels = _as_rgb(shown)
    pixels[~np.isfinite(stack).all(axis=-1)] = _NOT_FINITE
    return {"src": png_uri(pixels), "range": text}


def sheet(slices: list[np.ndarray]) -> dict[str, Any]:
    """A picture with a grey tile for each slice, `SHEET_COLUMNS` in a row: as `picture`, plus
    "tiles", [columns, rows], and "liveliest", the number of the slice with the most contrast, or of
    one with values that are not finite."""
    stack = np.stack(slices)
    shown, text = _shown(stack)
    tiles = np.repeat(shown[..., None], 3, axis=-1)
    tiles[~np.isfinite(stack)] = _NOT_FINITE
    columns = min(SHEET_COLUMNS, len(tiles))
    rows = -(-len(tiles) // columns)
    padded = np.zeros((rows * columns, *tiles.shape[1:]), np.uint8)
    padded[: len(tiles)] = tiles
    height, width = tiles.shape[1:3]
    grid = padded.reshape(rows, columns, height, width,
                          3).swapaxes(1, 2).reshape(rows * height, columns * width, 3)
    return {"src": png_uri(grid), "range": text, "tiles": [columns, rows],
            "liveliest": _liveliest(stack, shown)}


def _liveliest(stack: np.ndarray, shown: np.ndarray) -> int:
    wrong = ~np.isfinite(stack).all(axis=(1, 2))
    return int((shown.std(axis=(1, 2)) + 256 * wrong).argmax())


def _shown(stack: np.ndarray) -> tuple[np.ndarray, str]:
    """Values as uint8, and what black and white stand for."""
    low, high = _range(stack)
    gamma = low == 0
    with np.errstate(invalid="ignore"):
        shown = np.clip((stack - low) / (high - low), 0, 1) ** (1 / GAMMA if gamma else 1)
    text = f"black {low:.4g}, white {high:.4g}" + (f", gamma {GAMMA}" if gamma else "")
    return np.nan_to_num(shown * 255 + 0.5, nan=0, posinf=0, neginf=0).astype(np.uint8), text


def _range(stack: np.ndarray) -> tuple[float, float]:
    finite = stack[np.isfinite(stack)].astype(np.float64)
    if not finite.size:
        return 0.0, 1.0
    low = 0.0 if finite.min() >= 0 else float(np.percentile(finite, BLACK_PERCENTILE))
    high = float(np.percentile(finite, WHITE_PERCENTILE))
    high = high if high > low else float(finite.max())
    return low, high if high > low else low + 1.0


def _as_rgb(pixels: np.ndarray) -> np.ndarray:
    height, width, channels = pixels.shape
    if channels == 1:
        return np.repeat(pixels, 3, axis=-1)
    return np.concatenate([pixels, np.zeros((height, width, 3 - channels), np.uint8)], axis=-1)


HIGHEST_CODE = 511
"""Of a pixel's light, whose codes begin at 0."""
TOE_LIGHT = 2.0**-8
"""Light below which steps are even; above, they are even in stops."""
NOT_FINITE = (HIGHEST_CODE, 0, HIGHEST_CODE)
"""Codes of pixels that are not finite: magenta."""


def encode_light(light: np.ndarray, highest: float) -> np.ndarray:
    """Light (height, width, 3) as codes 0..511, uint16: 511 log(1 + light / TOE_LIGHT) / log(1 +
    highest / TOE_LIGHT).

    Negative light and light above `highest` is clipped; non-finite pixels become magenta. Up to 64,
    a stop has 36 codes; x / (1 + x) in sRGB has at most 32 of a screen's 255 steps in a stop.
    """
    steps = (np.log1p(np.clip(np.nan_to_num(light), 0, highest) / np.float32(TOE_LIGHT))
             / np.log1p(highest / TOE_LIGHT))
    codes: np.ndarray = np.rint(HIGHEST_CODE * steps).astype(np.uint16)
    codes[~np.isfinite(light).all(2)] = NOT_FINITE
    return codes


def pack_codes(codes: np.ndarray, highest: float) -> dict[str, Any]:
    """Codes for the page's script: 'width', 'height', 'toe', 'highest', and 'data', which is base64
    of zlib.

    It holds three planes, green, red - green and blue - green. Each row is stored as differences to
    the pixel before, folded as 0, -1, 1, -2, ... -> 0, 1, 2, 3, ...; the low bytes of all planes
    come first, then the high bytes.
    """
    red, green, blue = np.moveaxis(codes.astype(np.int32), 2, 0)
    steps = np.diff(np.stack([green, red - green, blue - green]), axis=2, prepend=0)
    folded = np.where(steps < 0, -2 * steps - 1, 2 * steps).astype("<u2").ravel()
    content = zlib.compress((folded & 255).astype(np.uint8).tobytes()
                            + (folded >> 8).astype(np.uint8).tobytes(), 9)
    height, width = codes.shape[:2]
    data = base64.b64encode(content).decode("ascii")
    return {"width": width, "height": height, "toe": TOE_LIGHT, "highest": highest, "data": data}
