"""Colours of files: spaces that headers or the user name, and their conversion to linear Rec.709.

Spaces come from identifiers of the Color Interop Forum (header colorInteropID) or from
chromaticities. Identifiers and formulas follow the forum's recommendation "Color Space Encodings
for Texture Assets and CG Rendering" 1.1. Names that OpenColorIO added ("ocio:...") are looked up in
its built-in config.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache, cached_property, partial
from typing import Any

import numpy as np

from postfx.colour import (
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
    round_to_known,
    to_xyz,
)
from postfx.errors import ColourError, offer
from postfx.frame import Frame, Role
from postfx.streams import make_printable

Decode = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class ColourSpace:
    """A colour space of a file.

    Attributes:
        title: what messages call it.
        matrix: 3x3, its linear light -> linear Rec.709, column vectors; white stays white
            (Bradford).
        primaries: of its linear light; None if chromaticities cannot express them.
        linear_id: identifier of its linear light, or None.
        decode: stored values -> linear light, arrays of any shape (..., 3); None if they are
            linear.
    """

    title: str
    matrix: np.ndarray
    primaries: Chromaticities | None
    linear_id: str | None
    decode: Decode | None = None

    @cached_property
    def is_rec709(self) -> bool:
        """Whether its linear light is that of Rec.709."""
        return self.primaries == REC709


def _decode_srgb(codes: np.ndarray) -> np.ndarray:
    """sRGB code values of any size and sign -> light."""
    curve = ((np.maximum(codes, 0.04045) + 0.055) / 1.055) ** 2.4
    return np.where(codes <= 0.04045, codes / 12.92, curve)


def _decode_power(codes: np.ndarray, exponent: float) -> np.ndarray:
    """Codes to a power; negative ones stay as they are, as the forum recommends."""
    return np.where(codes > 0, np.maximum(codes, 0) ** exponent, codes)


_PRIMARIES: dict[str, Chromaticities] = {
    "ap0": ACES2065_1, "ap1": ACESCG, "rec709": REC709, "p3d65": P3_D65, "rec2020": REC2020,
    "adobergb": ADOBE_RGB,
}
_CURVES: dict[str, Decode] = {
    "srgb": _decode_srgb,
    "g18": partial(_decode_power, exponent=1.8),
    "g22": partial(_decode_power, exponent=2.2),
    "g24": partial(_decode_power, exponent=2.4),
}
_ENCODED = ("srgb_rec709", "g24_rec709", "g22_rec709", "g18_rec709", "srgb_ap1", "g22_ap1",
            "srgb_p3d65", "g22_adobergb")
_ADOBE_EXPONENT = 563 / 256
"""Adobe RGB (1998) Color Image Encoding, 4.3.1.2."""
SILENT_IDENTIFIERS = ("", "data", "unknown")
"""Identifiers that say nothing about colours."""
_OCIO = "ocio:"


@cache
def space_by_primaries(primaries: Chromaticities) -> ColourSpace:
    """Linear light of these primaries. Raises ColourError where they span no colours."""
    key = next((key for key, own in _PRIMARIES.items() if own == primaries), None)
    title = name_of(primaries) or "of primaries without a name"
    return ColourSpace(title, matrix_between(primaries, REC709), primaries,
                       f"lin_{key}_scene" if key else None)


@cache
def space_by_id(identifier: str) -> ColourSpace:
    """Colour space of an identifier. Raises ColourError for those of displays and for unknown
    ones."""
    shown = make_printable(identifier)
    curve, _, rest = identifier.removeprefix(_OCIO).partition("_")
    key = rest.removesuffix("_scene")
    if identifier == "lin_ciexyzd65_scene":  # equal values are illuminant E here, not white
        return ColourSpace(identifier, np.linalg.inv(to_xyz(REC709)), None, identifier)
    if identifier == f"lin_{key}_scene" and key in _PRIMARIES:
        return space_by_primaries(_PRIMARIES[key])
    if rest.endswith("_scene") and f"{curve}_{key}" in _ENCODED:
        decode = (partial(_decode_power, exponent=_ADOBE_EXPONENT) if key == "adobergb"
                  else _CURVES[curve])
        primaries = _PRIMARIES[key]
        return ColourSpace(identifier, matrix_between(primaries, REC709), primaries,
                           f"lin_{key}_scene", decode)
    if identifier.endswith("_display"):
        raise ColourError(f"colorInteropID '{shown}' is a picture for a display, not light of a "
                          "scene: give the render before its view transform, or --colourspace if "
                          "the header is wrong")
    if identifier.startswith(_OCIO) and (found := _space_by_ocio(identifier)):
        return found
    raise ColourError(f"colorInteropID '{shown}' is not known: say what the colours are with "
                      f"--colourspace ({', '.join(LINEAR_SPACES)}), or correct the header")


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


NATIVE = "native"
ACES = "acesImageContainerFlag"
INTEROP = "colorInteropID"
PRIMARIES = "chromaticities"
COLOUR_ATTRIBUTES = (ACES, INTEROP, PRIMARIES)
"""Headers that say what colours are, the one that counts most first (Color Interop Forum,
"Identifying the Color Space of OpenEXR Files")."""
_REFLECTANCES = (Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO)
_LIGHTS = (Role.COLOUR, Role.OPAQUE_COLOUR, Role.OVERLAY)
_PIECE_ROWS = 256  # rows
_LARGEST = 1e30


@dataclass(frozen=True)
class InputColours:
    """What is known about the colours of files, and what they become.

    Attributes:
        declared: by the user, which overrides headers; None: headers decide, and without any it is
            Rec.709, as OpenEXR has it.
        native: leave them in the primaries that they have. Encoded colours are made linear all the
            same.
    """

    declared: Chromaticities | None = None
    native: bool = False

    def space(self, attributes: Mapping[str, Any]) -> ColourSpace:
        """Colour space of files with such a header.

        Raises ColourError for chromaticities that span no colours and for an identifier that is not
        known.
        """
        if self.declared:
            return space_by_primaries(self.declared)
        flag = attributes.get(ACES)
        if isinstance(flag, int) and flag == 1:
            return space_by_primaries(ACES2065_1)
        if not is_silent(attributes):
            return space_by_id(str(attributes[INTEROP]))
        found = np.ravel(attributes.get(PRIMARIES, ()))
        if found.size == 8 and found.dtype.kind in "if" and found.any():
            return space_by_primaries(round_to_known(tuple(map(float, found))))
        return space_by_primaries(REC709)

    def warnings(self, space: ColourSpace) -> list[str]:
        """What the user should know of files with colours of this space."""
        if space.is_rec709 and not space.decode:
            return []
        kept = "made linear" if space.decode else "kept as they are"
        return [f"colours are {space.title}: {kept if self.native else 'turned to linear Rec.709'}"]

    def apply(self, frame: Frame, space: ColourSpace) -> None:
        """Convert a frame's colours and reflectances of this space, guides included, in place; its
        header says what they are then.

        Light outside the gamut of Rec.709 becomes negative there and is kept; reflectances are cut
        at 0.
        """
        matrix = None if self.native or space.is_rec709 else np.asarray(space.matrix, np.float32)
        for planes in (frame.planes, frame.guides) if space.decode or matrix is not None else ():
            for role in planes.keys() & {*_LIGHTS, *_REFLECTANCES}:
                _turn(planes[role], space, matrix, role in _REFLECTANCES)
        if matrix is not None:
            space = space_by_primaries(REC709)
        if matrix is not None or space.decode or self.declared or ACES in frame.metadata:
            _label(frame.metadata, space)


def is_silent(attributes: Mapping[str, Any]) -> bool:
    """Whether a header has no identifier of a colour space."""
    identifier = attributes.get(INTEROP)
    return not isinstance(identifier, str) or identifier in SILENT_IDENTIFIERS


def gather_attributes(own: Mapping[str, Any],
                      others: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """What headers of a file say of the colours in one part: its own, and an identifier of other
    parts where it has none."""
    speaking = next((header for header in (own, *others) if not is_silent(header)), own)
    found = {name: own[name]
             for name in COLOUR_ATTRIBUTES if name in own and is_given(name, own[name])}
    return found | ({INTEROP: speaking[INTEROP]} if INTEROP in speaking else {})


def is_given(name: str, value: Any) -> bool:
    """Whether an attribute says anything: programs write primaries of zeros where they know
    none, some of them beside a white."""
    return name != PRIMARIES or bool(np.any(np.ravel(value)[:6]))


def parse_colourspace(text: str | None) -> InputColours:
    """Colours declared by a name, 'native' or None; ColourError for other names."""
    if text is None or text == NATIVE:
        return InputColours(native=text == NATIVE)
    if text not in LINEAR_SPACES:
        known = offer(text, LINEAR_SPACES, "use one of")
        raise ColourError(f"unknown colour space '{text}'{known}, which are all linear")
    return InputColours(LINEAR_SPACES[text])


def _label(metadata: dict[str, Any], space: ColourSpace) -> None:
    """Write into a header what the colours are now."""
    metadata.pop(ACES, None)
    metadata[PRIMARIES] = space.primaries
    metadata |= {INTEROP: space.linear_id} if INTEROP in metadata else {}


def _turn(plane: np.ndarray, space: ColourSpace, matrix: np.ndarray | None, positive: bool) -> None:
    for first in range(0, len(plane), _PIECE_ROWS):
        colour = plane[first:first + _PIECE_ROWS, :, :3]
        turned = colour if space.decode is None else space.decode(colour)
        if matrix is not None:
            # infinity minus infinity would be NaN
            turned = np.clip(turned, -_LARGEST, _LARGEST) @ matrix.T
        colour[:] = np.maximum(turned, 0) if positive else turned
