"""How different two pictures for one display look: PSNR of code values, and Delta E ITP."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from postfx.colour.curves import PQ, PQ_NITS
from postfx.colour.displays import Display
from postfx.colour.primaries import REC2020, matrix_between

SDR_WHITE = 100.0
"""Light of an SDR display's white, cd/m2, for Delta E ITP."""
_TO_LMS = np.array([[1688, 2146, 262], [683, 2951, 462], [99, 309, 3688]]) / 4096
_TO_ITP = np.array([[2048, 2048, 0], [3305, -6806.5, 3501.5], [17933, -17390, -543]]) / 4096  # T is half of CT


class Difference(NamedTuple):
    """PSNR in dB, mean Delta E ITP, and the Delta E ITP that 99 % of the pixels stay below (`most`)."""

    psnr: float
    mean: float
    most: float

    def __str__(self) -> str:
        return f"PSNR {self.psnr:.2f} dB, Delta E ITP {self.mean:.2f} (99 % of the pixels below {self.most:.2f})"


def to_itp(codes: np.ndarray, display: Display) -> np.ndarray:
    """Code values (..., 3) in ITP: ITU-R BT.2100-2, table 7, with CT halved as in BT.2124."""
    nits = display.decode(np.asarray(codes, np.float64)) * (display.white or SDR_WHITE)
    light = np.maximum(nits @ matrix_between(display.kind.primaries, REC2020).T, 0)
    return PQ.encode(light @ _TO_LMS.T / PQ_NITS) @ _TO_ITP.T


def delta_e_itp(codes: np.ndarray, others: np.ndarray, display: Display) -> np.ndarray:
    """Delta E ITP (ITU-R BT.2124-0, annex 1) of each colour; about 1 can just be seen."""
    distance: np.ndarray = np.sqrt(np.square(to_itp(codes, display) - to_itp(others, display)).sum(-1))
    return 720 * distance


def measure_difference(codes: list[np.ndarray], others: list[np.ndarray], display: Display) -> Difference:
    """Difference over all pixels between two lists of pictures (height, width, 3) of code values."""
    pairs = list(zip(codes, others, strict=True))
    squares = np.concatenate([np.square(a.astype(np.float64) - b).ravel() for a, b in pairs])
    seen = np.concatenate([delta_e_itp(a, b, display).ravel() for a, b in pairs])
    psnr = -10 * np.log10(squares.mean() + 1e-12)
    return Difference(float(psnr), float(seen.mean()), float(np.percentile(seen, 99)))
