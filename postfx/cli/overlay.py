"""`--overlay` of `postfx run`."""

from __future__ import annotations

import argparse

from postfx.errors import WriteError
from postfx.frame import Role
from postfx.io.frame_reader import FrameFiles
from postfx.io.output import OutputFiles
from postfx.plan import Skipped


def unread(arguments: argparse.Namespace) -> tuple[Role, ...]:
    """Roles that are taken as absent."""
    return (Role.OVERLAY,) if arguments.overlay == "ignore" else ()


def refuse_layer(arguments: argparse.Namespace, outputs: OutputFiles | None) -> None:
    """WriteError where the overlay cannot be written beside the colour: its light is scene-linear."""
    if arguments.overlay != "separate":
        return
    if outputs and outputs.display:
        raise WriteError("--overlay separate writes a layer, which only EXR holds: write EXR, or composite the overlay")
    if arguments.tonemap is not None:
        raise WriteError("--overlay separate keeps scene-linear light, --tonemap does not: give one of them")


def left_out_for(arguments: argparse.Namespace, files: FrameFiles) -> list[Skipped]:
    """What is not composited, and the colour that is not denoised because another one is."""
    found = [] if arguments.overlay == "composite" else [Skipped("overlay", f"--overlay {arguments.overlay}")]
    colour = files.match(Role.COLOUR)
    if colour.rule.role is Role.OPAQUE_COLOUR:
        found.append(Skipped("colour with transparents", f"{colour.names} is denoised under the overlay"))
    return found
