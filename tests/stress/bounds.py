"""What the denoiser is held to, by provider and precision."""

from __future__ import annotations

from typing import NamedTuple

from postfx.runtime import Device


class Bounds(NamedTuple):
    """Of one precision on one provider.

    Attributes:
        local: most that a bad pixel changes in its own frame, by the light at the place.
        reach: output pixels beyond which that is below `far`.
        far: most that it changes there, by the light at the place: exposures and low levels of the
            pyramid see it, and their rounding.
        turned: decibels between the picture of a turned scene and the turned picture. Networks
            learned from turned pictures, but nothing makes them symmetric; what is left is the
            noise that they leave, about as far from the truth.
        brighter: decibels between pictures of a scene and of one that is brighter by any factor,
            exposed as much less.
        drift: part by which the mean of one picture differs from what it was a period or many
            before. In integers and halves the least difference in a history makes some values fall
            to another step.
        near: difference, as a display shows it, between a pixel of a tile and of the whole frame.
        sessions: part by which light differs in two sessions, as cuDNN may choose other algorithms.
    """

    local: float
    reach: int
    far: float
    turned: float
    brighter: float
    drift: float
    near: float
    sessions: float


BOUNDS = {
    ("cpu", "fp32"): Bounds(0.02, 40, 1e-3, 36.0, 120.0, 1e-4, 1e-3, 0.0),
    ("cpu", "int8"): Bounds(0.15, 64, 1e-3, 36.5, 60.0, 6e-3, 1e-3, 0.0),
    ("cuda", "fp32"): Bounds(0.02, 40, 2e-3, 36.0, 90.0, 1e-4, 1e-3, 1e-3),
    ("cuda", "fp16"): Bounds(0.02, 40, 3e-3, 36.0, 80.0, 1e-4, 1e-3, 1e-3),
}
"""A GPU multiplies in TensorFloat-32, with as many bits as a half has; its networks in fp16 also
keep halves between their layers."""


WIDE = 84
"""Least `reach` of s, whose four levels see 72 render pixels around."""


def bounds(device: Device, model: str) -> Bounds:
    tag, _, precision = model.rpartition(".")
    found = BOUNDS[device.name, precision]
    return found._replace(reach=max(found.reach, WIDE)) if tag == "s" else found
