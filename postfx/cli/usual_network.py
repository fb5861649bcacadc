"""Which network a run takes where nobody chose one: what the arguments say of it."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any, NamedTuple

from postfx.frame import FrameSpec
from postfx.passes.denoise.models import lacks_memory, takes_best, usual_network
from postfx.passes.denoise.options import enlargement
from postfx.runtime import Device


class Choice(NamedTuple):
    """A network, and why memory is too short for the best one; None if that did not decide."""

    network: str
    lack: str | None


def is_chosen(arguments: argparse.Namespace, options: Mapping[str, Any]) -> bool:
    """Whether the denoiser's ``options`` name a network, or time or memory is bounded, which decide
    instead."""
    is_bounded = arguments.budget is not None or arguments.memory is not None
    return is_bounded or "model" in options


def choose_network(spec: FrameSpec, options: Mapping[str, Any], device: Device) -> Choice:
    """The network of a shot that begins with a spec, by the denoiser's ``options``."""
    size, scale = (spec.width, spec.height), enlargement(spec, options)
    guided = spec.guides is not None
    lack = lacks_memory(size, scale, device) if takes_best(scale, device, guided) else None
    return Choice(usual_network(size, scale, device, guided), lack)
