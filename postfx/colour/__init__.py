"""Colour in plain NumPy, which kernels are tested against. Here: RGB primaries, their
chromaticities, and the matrices between them.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from types import MappingProxyType

import numpy as np

from postfx.errors import ColourError

Chromaticities = tuple[float, ...]
"""x and y of red, green, blue and white."""

D65 = (0.3127, 0.3290)
D50_XYZ = (0.9642, 1.0, 0.8249)
"""White of the ICC's profile connection space (ICC.1:2022, 7.2.16)."""
REC709: Chromaticities = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, *D65)
"""ITU-R BT.709-6, table 1; the primaries of sRGB too."""
P3_D65: Chromaticities = (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, *D65)
"""SMPTE EG 432-1; the primaries of Display P3."""
REC2020: Chromaticities = (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, *D65)
"""ITU-R BT.2020-2, table 2; the primaries of BT.2100 too."""
ACESCG: Chromaticities = (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767)
"""AP1, S-2014-004."""
ACES2065_1: Chromaticities = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.0770, 0.32168, 0.33767)
"""AP0, SMPTE ST 2065-1."""

ADOBE_RGB: Chromaticities = (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, *D65)
"""Adobe RGB (1998)."""

LINEAR_SPACES: Mapping[str, Chromaticities] = MappingProxyType(
    {"rec709": REC709, "p3": P3_D65, "rec2020": REC2020, "acescg": ACESCG, "aces2065-1": ACES2065_1}
)
"""Linear colour spaces by the names that options use."""

LUMA_REC709 = (0.2126, 0.7152, 0.0722)
"""Weights of luminance, ITU-R BT.709-6, item 3.2."""
LUMA_REC2020 = (0.2627, 0.6780, 0.0593)
"""Weights of luminance, ITU-R BT.2100-2, table 5."""
_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367],
                      [0.0389, -0.0685, 1.0296]])
"""XYZ to sharpened cone responses; Lam 1985, as in ICC.1:2022, annex E."""

# Five digits in a header move a colour by less than 1e-4
_ROUNDED = 2.1e-5
_ALIKE = 2e-3
"""Difference of the coordinates of primaries up to which they are those of a known space."""

_FLAT_PRIMARIES = 1e-6
"""Determinant, of chromaticities, below which primaries lie on a line."""


def round_to_known(primaries: Chromaticities) -> Chromaticities:
    """The space of `LINEAR_SPACES` that matches a header's rounded numbers, else the numbers as
    they are."""
    return next((own for own in LINEAR_SPACES.values() if np.allclose(own, primaries, 0, _ROUNDED)),
                primaries)


def name_of(primaries: Chromaticities) -> str | None:
    """Name of the space in `LINEAR_SPACES` that these primaries are, or nearly are; None for
    others."""
    return next((name for name, own in LINEAR_SPACES.items()
                 if np.allclose(own, primaries, 0, _ALIKE)), None)


def is_degenerate(primaries: Chromaticities) -> bool:
    """Whether primaries and white span no colours: three on a line, no white, or NaN."""
    columns = _columns(primaries)
    if (not np.isfinite(columns).all() or abs(columns[1, 3]) < _FLAT_PRIMARIES
        or abs(np.linalg.det(columns[:, :3])) < _FLAT_PRIMARIES):
        return True
    return bool(np.abs(np.linalg.solve(columns[:, :3], columns[:, 3])).min() < _FLAT_PRIMARIES)


def _columns(primaries: Chromaticities) -> np.ndarray:
    """x, y and z of red, green, blue and white, (3, 4)."""
    x, y = np.reshape(np.asarray(primaries, np.float64), (4, 2)).T
    return np.stack([x, y, 1 - x - y])


@cache
def to_xyz(primaries: Chromaticities) -> np.ndarray:
    """3x3 matrix, linear RGB -> CIE XYZ with white at Y = 1, by SMPTE RP 177; column vectors.

    Primaries may have y = 0, as those of CIE XYZ itself do. Raises ColourError where they span no
    colours.
    """
    if is_degenerate(primaries):
        shown = ", ".join(f"{number:g}" for number in primaries)
        raise ColourError(f"chromaticities ({shown}) span no colours: say what the colours are "
                          f"with --colourspace ({', '.join(LINEAR_SPACES)}), or correct the header")
    columns = _columns(primaries)
    scale = np.linalg.solve(columns[:, :3], columns[:, 3] / columns[1, 3])
    matrix: np.ndarray = columns[:, :3] * scale
    return matrix


def adapt(primaries: Chromaticities, white: tuple[float, float, float]) -> np.ndarray:
    """3x3 matrix, linear RGB -> CIE XYZ as seen under another white, by the Bradford transform."""
    own = _BRADFORD @ to_xyz(primaries).sum(1)
    matrix: np.ndarray = (np.linalg.inv(_BRADFORD) @ np.diag(_BRADFORD @ white / own) @ _BRADFORD
                          @ to_xyz(primaries))
    return matrix


@cache
def matrix_between(source: Chromaticities, target: Chromaticities) -> np.ndarray:
    """3x3 matrix, linear RGB -> linear RGB of other primaries; white stays white (Bradford); column
    vectors."""
    if source == target:
        return np.eye(3)
    x, y, z = to_xyz(target).sum(1)
    matrix: np.ndarray = np.linalg.inv(to_xyz(target)) @ adapt(source, (x, y, z))
    return matrix


TO_WIDER_PRIMARIES = matrix_between(REC709, ACES2065_1)
"""To primaries as much wider than a picture's own as those of ACES2065-1, which hold all light that
there is, are than Rec.709's. No number is negative, so reflectance stays positive, and rows add up
to 1, so grey stays as it is."""


def luminance(colour: np.ndarray) -> np.ndarray:
    """Luminance (...) of linear Rec.709 (..., 3)."""
    light: np.ndarray = colour @ np.array(LUMA_REC709, np.float32)
    return light
