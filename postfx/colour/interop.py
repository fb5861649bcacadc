"""Colour spaces of files: by identifiers of the Color Interop Forum (header colorInteropID), or by chromaticities.

Identifiers and formulas are those of the forum's recommendation "Color Space Encodings for Texture Assets and CG
Rendering" 1.1. Names that OpenColorIO added ("ocio:...") are looked up in the config that is built into it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial

import numpy as np

from postfx.colour.primaries import (
    ACES2065_1,
    ACESCG,
    ADOBE_RGB,
    LINEAR_SPACES,
    P3_D65,
    REC709,
    REC2020,
    Chromaticities,
    matrix_between,
    name_of,
    to_xyz,
)
from postfx.errors import ColourError
from postfx.files import make_printable

Decode = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class ColourSpace:
    """A colour space of a file.

    Attributes:
        title: what messages call it.
        matrix: 3x3, its linear light -> linear Rec.709, column vectors; white stays white (Bradford).
        primaries: of its linear light; None where chromaticities cannot say it.
        linear_id: identifier of its linear light, None where there is none.
        decode: stored values -> linear light, arrays of any shape (..., 3); None where they are linear.
    """

    title: str
    matrix: np.ndarray
    primaries: Chromaticities | None
    linear_id: str | None
    decode: Decode | None = None

    @property
    def is_rec709(self) -> bool:
        """Whether its linear light is that of Rec.709."""
        return self.primaries == REC709


def _decode_srgb(codes: np.ndarray) -> np.ndarray:
    """sRGB code values of any size and sign -> light."""
    curve = ((np.maximum(codes, 0.04045) + 0.055) / 1.055) ** 2.4
    return np.where(codes <= 0.04045, codes / 12.92, curve)


def _decode_power(codes: np.ndarray, exponent: float) -> np.ndarray:
    """Codes to a power; negative ones stay as they are, as the forum has it."""
    return np.where(codes > 0, np.maximum(codes, 0) ** exponent, codes)


_PRIMARIES: dict[str, Chromaticities] = {
    "ap0": ACES2065_1, "ap1": ACESCG, "rec709": REC709, "p3d65": P3_D65, "rec2020": REC2020, "adobergb": ADOBE_RGB,
}
_CURVES: dict[str, Decode] = {
    "srgb": _decode_srgb,
    "g18": partial(_decode_power, exponent=1.8),
    "g22": partial(_decode_power, exponent=2.2),
    "g24": partial(_decode_power, exponent=2.4),
}
_ENCODED = ("srgb_rec709", "g24_rec709", "g22_rec709", "g18_rec709", "srgb_ap1", "g22_ap1", "srgb_p3d65",
            "g22_adobergb")
_ADOBE_EXPONENT = 563 / 256
"""Adobe RGB (1998) Color Image Encoding, 4.3.1.2."""
SILENT = ("", "data", "unknown")
"""Identifiers that say nothing about colours."""
_OCIO = "ocio:"


@cache
def space_by_primaries(primaries: Chromaticities) -> ColourSpace:
    """Linear light of these primaries. Raises ColourError where they span no colours."""
    key = next((key for key, own in _PRIMARIES.items() if own == primaries), None)
    title = name_of(primaries) or "of primaries without a name"
    return ColourSpace(title, matrix_between(primaries, REC709), primaries, f"lin_{key}_scene" if key else None)


@cache
def space_by_id(identifier: str) -> ColourSpace:
    """Colour space of an identifier. Raises ColourError for those of displays and for unknown ones."""
    shown = make_printable(identifier)
    curve, _, rest = identifier.removeprefix(_OCIO).partition("_")
    key = rest.removesuffix("_scene")
    if identifier == "lin_ciexyzd65_scene":  # equal values are illuminant E here, not white
        return ColourSpace(identifier, np.linalg.inv(to_xyz(REC709)), None, identifier)
    if identifier == f"lin_{key}_scene" and key in _PRIMARIES:
        return space_by_primaries(_PRIMARIES[key])
    if rest.endswith("_scene") and f"{curve}_{key}" in _ENCODED:
        decode = partial(_decode_power, exponent=_ADOBE_EXPONENT) if key == "adobergb" else _CURVES[curve]
        primaries = _PRIMARIES[key]
        return ColourSpace(identifier, matrix_between(primaries, REC709), primaries, f"lin_{key}_scene", decode)
    if identifier.endswith("_display"):
        raise ColourError(f"colorInteropID '{shown}' is a picture for a display, not light of a scene: give the "
                          "render before its view transform, or --colourspace if the header is wrong")
    if identifier.startswith(_OCIO) and (found := _space_by_ocio(identifier)):
        return found
    raise ColourError(f"colorInteropID '{shown}' is not known: say what the colours are with --colourspace "
                      f"({', '.join(LINEAR_SPACES)}), or correct the header")


def _space_by_ocio(identifier: str) -> ColourSpace | None:
    """A colour space that OpenColorIO's own config knows; None for others."""
    from postfx.colour import ocio  # the config is loaded for such files only

    name = ocio.name_of_id(identifier)
    if name is None:
        return None
    to_rec709 = matrix_between(ACES2065_1, REC709)
    if ocio.is_linear(name):
        own = ocio.convert(np.eye(3), name, ocio.INTERCHANGE).T
        return ColourSpace(identifier, to_rec709 @ own, None, identifier)

    def decode(codes: np.ndarray) -> np.ndarray:
        return ocio.convert(codes, name, ocio.INTERCHANGE)

    return ColourSpace(identifier, to_rec709, ACES2065_1, "lin_ap0_scene", decode)
