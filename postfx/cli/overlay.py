"""`--overlay` of `postfx run`."""

from __future__ import annotations

from postfx.errors import WriteError
from postfx.io.output import OutputFiles


def refuse_layer(tonemapped: bool, outputs: OutputFiles | None) -> None:
    """WriteError where the overlay cannot be written beside the colour: its light is scene-linear."""
    if outputs and outputs.display:
        raise WriteError("--overlay separate writes a layer, which only EXR holds: write EXR, or composite the overlay")
    if tonemapped:
        raise WriteError("--overlay separate keeps scene-linear light, --tonemap does not: give one of them")
