"""The sRGB transfer function (IEC 61966-2-1:1999, section 5.2) and its inverse."""

import numpy as np


def srgb_encode(linear: np.ndarray) -> np.ndarray:
    """Display-linear light 0..1 -> sRGB code values 0..1, float32; negative light becomes 0."""
    linear = np.maximum(np.asarray(linear, np.float32), 0)
    curve = np.float32(1.055) * np.maximum(linear, np.float32(0.0031308)) ** np.float32(1 / 2.4) - np.float32(0.055)
    return np.where(linear <= 0.0031308, np.float32(12.92) * linear, curve)


def srgb_decode(encoded: np.ndarray) -> np.ndarray:
    """sRGB code values 0..1 -> display-linear light 0..1, float32; negative codes become 0."""
    encoded = np.maximum(np.asarray(encoded, np.float32), 0)
    curve = ((np.maximum(encoded, np.float32(0.04045)) + np.float32(0.055)) / np.float32(1.055)) ** np.float32(2.4)
    return np.where(encoded <= 0.04045, encoded / np.float32(12.92), curve)
