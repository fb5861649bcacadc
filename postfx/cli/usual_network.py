"""Which network a run takes where nobody chose one: by its arguments, the memory that there is, and
the noise of its first frame."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any, NamedTuple

from postfx.errors import ReadError
from postfx.frame import FrameSpec, Role
from postfx.io.sequence import Sequence
from postfx.passes.denoise.models import (
    BEST_NETWORK,
    USUAL_NETWORK,
    lacks_memory,
    takes_best,
    usual_network,
)
from postfx.passes.denoise.options import enlargement
from postfx.pixel_filter import spread_ratio
from postfx.runtime import Device

SPREAD = (f"a pixel filter spread the noise, which '{BEST_NETWORK}' takes for detail: "
          f"{USUAL_NETWORK} runs; a box filter is better")


class Choice(NamedTuple):
    """A network, and why it is not the best one, where its memory or the noise decided; else
    None."""

    network: str
    lack: str | None


def is_chosen(arguments: argparse.Namespace, options: Mapping[str, Any]) -> bool:
    """Whether the denoiser's ``options`` name a network, or time or memory is bounded, which decide
    instead."""
    is_bounded = arguments.budget is not None or arguments.memory is not None
    return is_bounded or "model" in options


def choose_network(sequence: Sequence, first: int, options: Mapping[str, Any],
                   device: Device) -> Choice:
    """The network of a shot that begins with the frame ``first`` of a sequence, by the denoiser's
    ``options``."""
    with sequence.open(first) as files:
        spec = files.spec()
        choice = _choose_by_size(spec, options, device)
        if choice.network != BEST_NETWORK or not spec.has(Role.COLOUR):
            return choice
        try:
            frame = files.read(first, [Role.COLOUR], [])
        except ReadError:  # is told, or left out, when its turn comes
            return choice
    if spread_ratio(frame[Role.COLOUR], frame.samples) is not None:
        return Choice(USUAL_NETWORK, SPREAD)
    return choice


def _choose_by_size(spec: FrameSpec, options: Mapping[str, Any], device: Device) -> Choice:
    size, scale = (spec.width, spec.height), enlargement(spec, options)
    guided = spec.guides is not None
    lack = lacks_memory(size, scale, device) if takes_best(scale, device, guided) else None
    return Choice(usual_network(size, scale, device, guided), lack)
