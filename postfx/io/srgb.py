"""The sRGB transfer function (IEC 61966-2-1:1999, section 5.2) and its inverse."""

import numpy as np


def srgb_encode(linear: np.ndarray) -> np.ndarray:
    """Display-linear light 0..1 -> sRGB code values 0..1; negative light becomes 0. float64 stays, else float32."""
    linear = np.maximum(_floats(linear), 0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)


def srgb_decode(encoded: np.ndarray) -> np.ndarray:
    """sRGB code values 0..1 -> display-linear light 0..1; negative codes become 0. float64 stays, else float32."""
    encoded = np.maximum(_floats(encoded), 0)
    return np.where(encoded <= 0.04045, encoded / 12.92, ((np.maximum(encoded, 0.04045) + 0.055) / 1.055) ** 2.4)


def _floats(values: np.ndarray) -> np.ndarray:
    values = np.asarray(values)
    return values if values.dtype == np.float64 else values.astype(np.float32, copy=False)
