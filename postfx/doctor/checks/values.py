"""Values that should not be there: NaN, infinities, negative light, clipped colour."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from postfx.doctor.findings import Finding, error, info, warning
from postfx.doctor.material import Material
from postfx.doctor.statistics import percent
from postfx.frame import Role

MANY = 50.0  # percent
NEVER_NEGATIVE = (Role.COLOUR, Role.ALPHA, Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO, Role.ROUGHNESS,
                  Role.SPECULAR_HIT_DISTANCE, Role.STRENGTH, Role.REACTIVE, Role.OPAQUE_COLOUR)
IN_UNIT_RANGE = (Role.ALPHA, Role.STRENGTH, Role.REACTIVE)


def not_finite(material: Material) -> Iterator[Finding]:
    """NaN and infinities; an infinite depth is a miss."""
    for role, values in material.stored.items():
        infinite = 0 if role is Role.DEPTH else values.infinite
        share = 100 * (values.nan + infinite) / values.total
        if share == 0:
            continue
        evidence = f"{values.nan} NaN, {infinite} infinite of {values.total} values ({share:.3g} %)"
        cause = "division by zero in a shader or light, or a plane that was never written"
        mend = "find the material with a picture of the plane (--pictures); values that are not finite count as 0"
        yield (error if share > MANY else warning)(role, "not-finite", evidence, cause, mend)


def negative(material: Material) -> Iterator[Finding]:
    """Negative values where none can be."""
    for role in NEVER_NEGATIVE:
        values = material.stored.get(role)
        if values is None or values.negative == 0:
            continue
        share = 100 * values.negative / values.total
        lowest = float(np.nanmin(material.first[role]))
        evidence = f"{values.negative} of {values.total} values below 0 ({share:.3g} %), least {lowest:.3g}"
        cause = "a filter with negative lobes, a conversion of primaries, or a plane of another meaning"
        level = error if share > MANY else warning if share > 0.1 else info
        yield level(role, "negative", evidence, cause, "render with a positive pixel filter, and linear Rec.709")


def out_of_unit_range(material: Material) -> Iterator[Finding]:
    """Masks above 1."""
    for role in IN_UNIT_RANGE:
        if role in material.first and (share := percent(material.first[role] > 1.001)) > 0:
            evidence = f"{share:.3g} % of the pixels above 1, largest {np.nanmax(material.first[role]):.3g}"
            yield warning(role, "above-one", evidence, "stored in percent or 0..255", "store 0..1, or scale it in a "
                          "profile")


def colour_clipped(material: Material) -> Iterator[Finding]:
    """Colour that ends at exactly 1: made for a display."""
    if Role.COLOUR not in material.first:
        return
    colour = material.first[Role.COLOUR]
    share = percent(colour == 1.0)
    if float(np.nanmax(colour, initial=0.0)) == 1.0 and 0.5 < share < 90:
        evidence = f"the largest value is exactly 1, at {share:.3g} % of the values"
        yield warning(Role.COLOUR, "colour-clipped", evidence, "tone-mapped, clamped or converted for a display",
                      "write scene-linear light without a view transform or clamp")


def unreadable(material: Material) -> Iterator[Finding]:
    """A later frame that cannot be read."""
    if material.unreadable:
        yield error("sequence", "unreadable", material.unreadable, "the file is broken or lacks planes of the others",
                    "render or copy this frame again")
