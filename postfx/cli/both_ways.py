"""`--both-ways`: frames profit from those after them, too."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from postfx.frame import Frame, FrameSpec
    from postfx.temporal import Backwards

NAME = "denoise_upscale backwards"
"""Of what it takes, in the summary."""


def add_argument(group: argparse._ActionsContainer) -> None:
    """Add the argument."""
    group.add_argument(
        "--both-ways", action="store_true", help="also denoise the sequence in reverse order, in parts, and mix both "
        "results: frames are cleaner, the first ones most; takes two to three times as long",
    )


class BothWays:
    """What a run does for `--both-ways`; nothing without it.

    Args:
        make: makes the frames' run in reverse order; asked only if it is needed.

    Raises PassOptionError beside options that it cannot go with.
    """

    def __init__(self, arguments: argparse.Namespace, make: Callable[[], Backwards]) -> None:
        self._backwards = make() if arguments.both_ways and _fits(arguments) else None

    @property
    def passes(self) -> tuple[str, ...]:
        """Names of the passes that mix the results."""
        return ("both_ways",) if self._backwards else ()

    def spec(self, spec: FrameSpec) -> FrameSpec:
        """What frames of a spec become."""
        return self._backwards.spec(spec) if self._backwards else spec

    def __call__(self, frame: Frame, wanted: bool, check: Callable[[], None], tell: Callable[[str], None]) -> Frame:
        """The frame with what those after it make of it; `tell` gets a line before what takes long."""
        if self._backwards is None:
            return frame
        part = self._backwards.part(frame.number) if wanted else None
        if part and part[0] != part[1]:
            tell(f"frames {part[1]} to {part[0]}, backwards first")
        return self._backwards(frame, wanted, check)

    def took(self) -> dict[str, float]:
        """Milliseconds of the last frame in reverse order, by name."""
        found = self._backwards.milliseconds if self._backwards else None
        return {} if found is None else {NAME: found}


def _fits(arguments: argparse.Namespace) -> bool:
    """Whether there is something to denoise; PassOptionError beside options that it cannot go with."""
    from postfx.errors import PassOptionError  # loads what --help must not wait for

    if arguments.no_denoise:
        raise PassOptionError("--both-ways is for the denoiser, which --no-denoise leaves out: give one of them")
    if arguments.budget is not None:
        raise PassOptionError("--both-ways runs every frame twice, --budget keeps to a time: give one of them")
    if arguments.memory is not None:
        raise PassOptionError("--both-ways keeps results of 32 frames, --memory keeps to a size: give one of them")
    return arguments.strength != 0
