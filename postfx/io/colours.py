"""Colours of files to linear Rec.709, by what headers or the user say that they are."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from postfx.colour.interop import SILENT, ColourSpace, space_by_id, space_by_primaries
from postfx.colour.primaries import ACES2065_1, LINEAR_SPACES, REC709, Chromaticities, round_to_known
from postfx.errors import ColourError
from postfx.frame import Frame, Role

NATIVE = "native"
ACES, INTEROP, PRIMARIES = "acesImageContainerFlag", "colorInteropID", "chromaticities"
COLOUR_ATTRIBUTES = (ACES, INTEROP, PRIMARIES)
"""Headers that say what colours are, the one that counts most first (Color Interop Forum, "Identifying the Color Space
of OpenEXR Files")."""
_REFLECTANCES = (Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO)
_LIGHTS = (Role.COLOUR, Role.OPAQUE_COLOUR, Role.OVERLAY)
_PIECE = 256  # rows
_LARGEST = 1e30


@dataclass(frozen=True)
class InputColours:
    """What is known of the colours of files, and what is to become of them.

    Attributes:
        declared: the user's word, which counts more than headers; None: headers say it, and without any it is Rec.709,
            as OpenEXR has it.
        native: leave them in the primaries that they have. Encoded colours are made linear all the same.
    """

    declared: Chromaticities | None = None
    native: bool = False

    def space(self, attributes: Mapping[str, Any]) -> ColourSpace:
        """Colour space of files with such a header.

        Raises ColourError for chromaticities that span no colours and for an identifier that is not known.
        """
        if self.declared:
            return space_by_primaries(self.declared)
        flag = attributes.get(ACES)
        if isinstance(flag, int) and flag == 1:
            return space_by_primaries(ACES2065_1)
        if not is_silent(attributes):
            return space_by_id(str(attributes[INTEROP]))
        found = np.ravel(attributes.get(PRIMARIES, ()))
        if found.size == 8 and found.dtype.kind in "if":
            return space_by_primaries(round_to_known(tuple(map(float, found))))
        return space_by_primaries(REC709)

    def warnings(self, attributes: Mapping[str, Any]) -> list[str]:
        """What the user should know of files with such a header."""
        space = self.space(attributes)
        if space.is_rec709 and not space.decode:
            return []
        kept = "made linear" if space.decode else "kept as they are"
        return [f"colours are {space.title}: {kept if self.native else 'turned to linear Rec.709'}"]

    def apply(self, frame: Frame) -> None:
        """Turn a frame's colours and reflectances, guides included, in place; its header says what they are then.

        Light outside the gamut of Rec.709 becomes negative there and is kept; reflectances are cut at 0.
        """
        space = self.space(frame.metadata)
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
    return not isinstance(identifier, str) or identifier in SILENT


def gather_attributes(own: Mapping[str, Any], others: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """What headers of a file say of the colours in one part: its own, and an identifier of other parts where it has
    none."""
    speaking = next((header for header in (own, *others) if not is_silent(header)), own)
    found = {name: own[name] for name in COLOUR_ATTRIBUTES if name in own}
    return found | ({INTEROP: speaking[INTEROP]} if INTEROP in speaking else {})


def parse_colourspace(text: str | None) -> InputColours:
    """Colours declared by a name, 'native' or None; ColourError for other names."""
    if text is None or text == NATIVE:
        return InputColours(native=text == NATIVE)
    if text not in LINEAR_SPACES:
        raise ColourError(f"unknown colour space '{text}': use one of {', '.join(LINEAR_SPACES)}, all linear")
    return InputColours(LINEAR_SPACES[text])


def _label(metadata: dict[str, Any], space: ColourSpace) -> None:
    """Say in a header what colours are now."""
    metadata.pop(ACES, None)
    metadata[PRIMARIES] = space.primaries
    metadata |= {INTEROP: space.linear_id} if INTEROP in metadata else {}


def _turn(plane: np.ndarray, space: ColourSpace, matrix: np.ndarray | None, positive: bool) -> None:
    for first in range(0, len(plane), _PIECE):
        colour = plane[first:first + _PIECE, :, :3]
        turned = colour if space.decode is None else space.decode(colour)
        if matrix is not None:
            turned = np.clip(turned, -_LARGEST, _LARGEST) @ matrix.T  # infinity minus infinity would be NaN
        colour[:] = np.maximum(turned, 0) if positive else turned
