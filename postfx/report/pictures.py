"""Slices of tensors as PNG data URIs."""

from __future__ import annotations

import base64
import struct
import zlib

import numpy as np

LOW, HIGH = 1, 99
"""Percentiles of the finite values that become black and white."""
GAMMA = 2.2
_NOT_FINITE = (255, 0, 255)


def picture(slices: list[np.ndarray]) -> dict[str, str]:
    """One slice as grey, two as red and green, three as red, green and blue: {'src': data URI, 'range': text}.

    Values are float (height, width) of any range; black and white are chosen for all slices together. What holds no
    negative value begins at 0 and gets a gamma of 2.2, the rest is linear. NaN and infinities are magenta.
    """
    stack = np.stack(slices, axis=-1)
    low, high = _range(stack)
    gamma = low == 0
    with np.errstate(invalid="ignore"):
        shown = np.clip((stack - low) / (high - low), 0, 1) ** (1 / GAMMA if gamma else 1)
    pixels = _as_rgb(np.nan_to_num(shown * 255 + 0.5, nan=0, posinf=0, neginf=0).astype(np.uint8))
    pixels[~np.isfinite(stack).all(axis=-1)] = _NOT_FINITE
    text = f"black {low:.4g}, white {high:.4g}" + (f", gamma {GAMMA}" if gamma else "")
    return {"src": "data:image/png;base64," + base64.b64encode(png(pixels)).decode("ascii"), "range": text}


def png(pixels: np.ndarray) -> bytes:
    """A PNG file of uint8 (height, width, 3)."""
    height, width, _ = pixels.shape
    rows = np.zeros((height, 1 + 3 * width), np.uint8)  # each row begins with its filter, 0 for none
    rows[:, 1:] = pixels.reshape(height, -1)
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunks = [_chunk(b"IHDR", header), _chunk(b"IDAT", zlib.compress(rows.tobytes(), 9)), _chunk(b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


def _range(stack: np.ndarray) -> tuple[float, float]:
    finite = stack[np.isfinite(stack)].astype(np.float64)
    if not finite.size:
        return 0.0, 1.0
    low = 0.0 if finite.min() >= 0 else float(np.percentile(finite, LOW))
    high = float(np.percentile(finite, HIGH))
    high = high if high > low else float(finite.max())
    return low, high if high > low else low + 1.0


def _as_rgb(pixels: np.ndarray) -> np.ndarray:
    height, width, channels = pixels.shape
    if channels == 1:
        return np.repeat(pixels, 3, axis=-1)
    return np.concatenate([pixels, np.zeros((height, width, 3 - channels), np.uint8)], axis=-1)


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
