"""In which primaries files hold their colours, and turning them to linear Rec.709, which everything else works in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from postfx.colour.primaries import LINEAR_SPACES, REC709, Chromaticities, are_same, matrix_between, name_of
from postfx.errors import ColourError
from postfx.frame import Frame, Role

NATIVE = "native"
_INTEROP = {
    "lin_rec709_scene": "rec709",
    "lin_p3d65_scene": "p3",
    "lin_rec2020_scene": "rec2020",
    "lin_ap1_scene": "acescg",
    "lin_ap0_scene": "aces2065-1",
}
"""Identifiers of the Color Interop Forum, header colorInteropID."""
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
        native: leave them as they are.
    """

    declared: Chromaticities | None = None
    native: bool = False

    def primaries(self, attributes: Mapping[str, Any]) -> Chromaticities:
        """Primaries of files with such a header, by chromaticities or, without those, by colorInteropID."""
        found = attributes.get("chromaticities")
        if self.declared:
            return self.declared
        if np.size(found) == 8 and np.isfinite(found).all():
            return next((own for own in LINEAR_SPACES.values() if are_same(own, found)), tuple(map(float, found)))
        return LINEAR_SPACES[_INTEROP.get(str(attributes.get("colorInteropID")), "rec709")]

    def warnings(self, attributes: Mapping[str, Any]) -> list[str]:
        """What the user should know of files with such a header."""
        primaries = self.primaries(attributes)
        if primaries == REC709:
            return []
        kept = "kept as they are" if self.native else "turned to linear Rec.709"
        return [f"colours are {name_of(primaries) or 'of primaries without a name'}: {kept}"]

    def apply(self, frame: Frame) -> None:
        """Turn a frame's colours and reflectances, guides included, in place; its header says what they are then.

        Light outside the gamut of Rec.709 becomes negative there and is kept; reflectances are cut at 0.
        """
        primaries = self.primaries(frame.metadata)
        converted = primaries != REC709 and not self.native
        if converted:
            matrix = np.float32(matrix_between(primaries, REC709))
            for planes in (frame.planes, frame.guides):
                for role in planes.keys() & {*_LIGHTS, *_REFLECTANCES}:
                    _turn(planes[role], matrix, role in _REFLECTANCES)
        if converted or self.declared:
            frame.metadata.pop("colorInteropID", None)
            frame.metadata["chromaticities"] = REC709 if converted else primaries


def parse_colourspace(text: str | None) -> InputColours:
    """Colours declared by a name, 'native' or None; ColourError for other names."""
    if text is None or text == NATIVE:
        return InputColours(native=text == NATIVE)
    if text not in LINEAR_SPACES:
        raise ColourError(f"unknown colour space '{text}': use one of {', '.join(LINEAR_SPACES)}, all linear")
    return InputColours(LINEAR_SPACES[text])


def _turn(plane: np.ndarray, matrix: np.ndarray, positive: bool) -> None:
    for first in range(0, len(plane), _PIECE):
        colour = plane[first:first + _PIECE, :, :3]
        turned = np.clip(colour, -_LARGEST, _LARGEST) @ matrix.T  # infinity minus infinity would be NaN
        colour[:] = np.maximum(turned, 0) if positive else turned
