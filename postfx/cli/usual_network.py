"""What a run takes where nobody chose it: the network, by its arguments and the memory that there
is, and the pixel filter that it undoes, by the noise of its first frame."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any, NamedTuple

from postfx.errors import ReadError
from postfx.frame import ALBEDOS, FrameSpec, Role
from postfx.io.sequence import Sequence
from postfx.passes.denoise.default_network import (
    USUAL_NETWORK,
    lacks_memory,
    takes_best,
    usual_network,
)
from postfx.passes.denoise.models import UNSCALED, gives_picture, model_of, validate_tag
from postfx.passes.denoise.options import enlargement
from postfx.pixel_filter import find_stddev, parse_stddev
from postfx.runtime import Device

LOOKED_AT = (Role.COLOUR, *ALBEDOS, Role.NORMAL)
"""Planes by which a pixel filter is found."""


class Choice(NamedTuple):
    """A network, and why it is not the best one, where its memory decided; else None."""

    network: str
    lack: str | None


def is_chosen(arguments: argparse.Namespace, options: Mapping[str, Any]) -> bool:
    """Whether the denoiser's ``options`` name a network, or time or memory is bounded, which decide
    instead."""
    is_bounded = arguments.budget is not None or arguments.memory is not None
    return is_bounded or "model" in options


def choose_network(spec: FrameSpec, options: Mapping[str, Any], device: Device) -> Choice:
    """The network of a shot whose first frame has this spec, by the denoiser's ``options``."""
    size, scale = (spec.width, spec.height), enlargement(spec, options)
    guided = spec.guides is not None
    lack = lacks_memory(size, scale, device) if takes_best(scale, device, guided) else None
    return Choice(usual_network(size, scale, device, guided), lack)


def choose_pixel_filter(sequence: Sequence, first: int,
                        options: Mapping[str, Any]) -> float | str:
    """The denoiser's option for the pixel filter of a sequence: what ``options`` say; or what the
    first frame on the disk tells, so that all frames have the same, wherever a run begins; or the
    ``first`` one that runs, where that tells nothing. Not looked for where no network would use
    it."""
    given: float | str = options.get("pixel_filter", "auto")
    named = parse_stddev(given)
    if named is not None:
        return named or "none"
    tag = validate_tag(str(options.get("model", USUAL_NETWORK)))
    if not gives_picture(model_of(tag, UNSCALED)):
        return given
    earliest = next(filter(sequence.holds, sequence.present()), first)
    stddevs = (_find_stddev(sequence.reader(), number)
               for number in dict.fromkeys((earliest, first)))
    return next(filter(None, stddevs), "none")


def _find_stddev(sequence: Sequence, number: int) -> float | None:
    """The standard deviation of the pixel filter, in pixels, that a frame's noise shows; None if it
    shows none."""
    try:
        with sequence.open(number) as files:
            spec = files.spec()
            if not spec.has(Role.COLOUR):
                return None
            frame = files.read(number, list(filter(spec.has, LOOKED_AT)), [])
    except ReadError:  # is told, or left out, when its turn comes
        return None
    return find_stddev(frame[Role.COLOUR], frame.planes)
