"""AgX view (Troy Sobotka), in the polynomial form of Benjamin Wrensch as used by three.js and Filament.

Domain: scene-linear Rec.709, any shape (..., 3). Range: sRGB-encoded display colour in [0, 1]. Negative input is cut.
"""

from __future__ import annotations

import numpy as np

REC709_TO_REC2020 = np.array([[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0113], [0.0164, 0.0880, 0.8956]])
REC2020_TO_REC709 = np.array([[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]])
INSET = np.array(
    [
        [0.856627153315983, 0.0951212405381588, 0.0482516061458583],
        [0.137318972929847, 0.761241990602591, 0.101439036467562],
        [0.11189821299995, 0.0767994186031903, 0.811302368396859],
    ]
)
OUTSET = np.array(
    [
        [1.1271005818144368, -0.11060664309660323, -0.016493938717834573],
        [-0.1413297634984383, 1.157823702216272, -0.016493938717834257],
        [-0.14132976349843826, -0.11060664309660294, 1.2519364065950405],
    ]
)
MIN_EV, MAX_EV = -12.47393, 4.026069
SIGMOID = (15.5, -40.14, 31.96, -6.868, 0.4298, 0.1191, -0.00232)  # highest power first


def srgb_encode(linear: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1 curve of linear [0, 1]."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)


def agx(rgb: np.ndarray) -> np.ndarray:
    """AgX base look of scene-linear Rec.709 (..., 3)."""
    x = np.maximum(np.asarray(rgb, np.float64), 0.0) @ (INSET @ REC709_TO_REC2020).T
    x = (np.log2(np.maximum(x, 1e-10)) - MIN_EV) / (MAX_EV - MIN_EV)
    x = np.polyval(SIGMOID, x.clip(0.0, 1.0)) @ OUTSET.T
    linear = np.maximum(x, 0.0) ** 2.2 @ REC2020_TO_REC709.T
    return srgb_encode(linear.clip(0.0, 1.0)).astype(np.float32)
