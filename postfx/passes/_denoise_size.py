"""How large the denoised upscaler's output is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from postfx.errors import FrameError, GuideError, PassOptionError
from postfx.frame import FrameSpec

LEAST, MOST, USUAL = 1.0, 3.0, 2.0
ASPECT = 0.01
"""Part of a side by which frames may be larger or smaller than the output's aspect asks for, if it is above a pixel:
sizes are often multiples of 8."""


class Size(NamedTuple):
    """Height and width."""

    height: int
    width: int

    def __str__(self) -> str:
        return f"{self.width}x{self.height}"


def checked_scale(scale: float | None) -> float | None:
    """The option `scale`; PassOptionError for one that cannot be."""
    if scale is not None and not LEAST <= float(scale) <= MOST:
        raise PassOptionError(f"pass 'denoise_upscale' scales by 1 to 3, not {scale:g}: give a scale in between")
    return None if scale is None else float(scale)


def checked_size(size: Sequence[int] | None, scale: float | None) -> Size | None:
    """The option `size`, width and height; PassOptionError for one that cannot be, and beside a scale."""
    if size is None:
        return None
    if len(size) != 2 or min(size) < 1 or any(side != int(side) for side in size):
        raise PassOptionError(f"pass 'denoise_upscale' cannot make the size {size}: give width and height in pixels")
    if scale is not None:
        raise PassOptionError("pass 'denoise_upscale' has a scale and a size: give one of them")
    return Size(int(size[1]), int(size[0]))


def output_size(spec: FrameSpec, scale: float | None, size: Size | None) -> Size:
    """The given size; or the guides', if the scale leads there, rounded or cut; or the scaled size, rounded.

    Raises FrameError for a frame that cannot have the given size, GuideError for guides of another size.
    """
    if size:
        return _fixed(spec, size)
    scaled = Size(round(spec.height * (scale or USUAL)), round(spec.width * (scale or USUAL)))
    return _guided(spec, scale, scaled) if spec.guides else scaled


def _fixed(spec: FrameSpec, size: Size) -> Size:
    found = f"{spec.source or 'frame'}: {spec.width}x{spec.height}"
    wide, high = spec.height * size.width / size.height, spec.width * size.height / size.width
    if abs(high - spec.height) > max(1, ASPECT * high) and abs(wide - spec.width) > max(1, ASPECT * wide):
        fitting = Size(round(high), spec.width)
        raise FrameError(f"{found} has another aspect than the output, {size}: render it at {fitting}, or give a size "
                         "of its aspect (both with all overscan)")
    if not all(side <= outer <= MOST * side for side, outer in ((spec.height, size.height), (spec.width, size.width))):
        least = Size(*(-(-side // int(MOST)) for side in size))
        raise FrameError(f"{found} cannot become {size}, which is 1 to 3 times as large as what it is made of: render "
                         f"it at {least} to {size}")
    if spec.guides and (spec.guides.height, spec.guides.width) != size:
        found = f"{spec.guides.source or 'frame'}: guides are {spec.guides.width}x{spec.guides.height}"
        raise GuideError(f"{found}, the output is {size}: render them at its size, or leave the size out")
    return size


def _guided(spec: FrameSpec, scale: float | None, scaled: Size) -> Size:
    guides = spec.guides
    sides = ((guides.width, spec.width), (guides.height, spec.height))
    if scale is None:
        low = max(LEAST, *((outer - 0.5) / side for outer, side in sides))
        high = min(MOST, *((outer + 1) / side for outer, side in sides))
        mend = "render them 1 to 3 times as large as the colour, by the same factor both ways"
        fits = low <= high
    else:
        mend = f"leave the scale out, or render them at {scaled} for a scale of {scale:g}"
        fits = all(outer in (round(side * scale), int(side * scale)) for outer, side in sides)
    if not fits:
        found = f"guides are {guides.width}x{guides.height}, the colour is {spec.width}x{spec.height}"
        raise GuideError(f"{guides.source or 'frame'}: {found}: {mend}")
    return Size(guides.height, guides.width)
