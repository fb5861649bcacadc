"""Which network a run takes where nobody chose one: what the arguments say of it."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any

from postfx.frame import FrameSpec
from postfx.passes.denoise.options import enlargement


def is_chosen(arguments: argparse.Namespace, options: Mapping[str, Any]) -> bool:
    """Whether the denoiser's ``options`` name a network, or time or memory is bounded, which decide
    instead."""
    is_bounded = arguments.budget is not None or arguments.memory is not None
    return is_bounded or "model" in options


def keeps_render_size(spec: FrameSpec, options: Mapping[str, Any]) -> bool:
    """Whether all frames of a shot that begins with a spec have the render's size behind the
    denoiser. Frames of any size come to a given one."""
    return "size" not in options and enlargement(spec, options) == 1
