"""What the options of the denoised upscaler mean: the output's size, the render's within a frame
time, and how the reactive mask is made."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from postfx.errors import FrameError, GuideError, PassOptionError, offer
from postfx.frame import FrameSpec, GuideSpec, Role
from postfx.passes.denoise.geometry import Size
from postfx.passes.denoise.ladder import Ladder

# Output size over render size: what networks can do, and what is done unless a size is given.
LEAST_SCALE = 1.0
MOST_SCALE = 3.0
USUAL_SCALE = 1.0

ASPECT = 0.01
"""Share of a side by which frames may be off the output's aspect, if that is more than a pixel:
sizes are often multiples of 8."""


def validate_scale(scale: float | None) -> float | None:
    """The option `scale`; PassOptionError for an impossible one."""
    try:
        found = None if scale is None else float(scale)
    except (TypeError, ValueError):
        found = math.nan
    if found is not None and not LEAST_SCALE <= found <= MOST_SCALE:
        shown = f"{found:g}" if isinstance(scale, int | float) else repr(scale)
        network = "; a network is model=" if isinstance(scale, str) else ""
        raise PassOptionError(f"scale {shown}: give a number from 1 to 3{network}")
    return found


def validate_size(size: Sequence[int] | None, scale: float | None) -> Size | None:
    """The option `size`, width and height; PassOptionError for an impossible size, and for a size
    beside a scale."""
    if size is None:
        return None
    try:
        is_size = len(size) == 2 and min(size) >= 1 and all(side == int(side) for side in size)
    except (TypeError, ValueError, OverflowError):
        is_size = False
    if not is_size:
        raise PassOptionError(f"pass 'denoise_upscale' cannot make the size {size}: give width and "
                              "height in pixels")
    if scale is not None:
        raise PassOptionError("pass 'denoise_upscale' has a scale and a size: give one of them")
    return Size(int(size[1]), int(size[0]))


def output_size(spec: FrameSpec, scale: float | None, size: Size | None) -> Size:
    """The given size; or the guides', if the scale leads there, rounded or cut; or the scaled size,
    rounded.

    Raises FrameError for a frame that cannot have the given size, GuideError for guides of another
    size.
    """
    if size:
        return _fixed(spec, size)
    scaled = Size(round(spec.height * (scale or USUAL_SCALE)),
                  round(spec.width * (scale or USUAL_SCALE)))
    return _guided(spec, spec.guides, scale, scaled) if spec.guides else scaled


def enlargement(spec: FrameSpec, options: Mapping[str, Any]) -> float:
    """Output over render width, by the options `scale` and `size` of the denoiser. Raises what
    `validate_size` and `output_size` do."""
    scale, size = options.get("scale"), options.get("size")
    return output_size(spec, scale, validate_size(size, scale)).width / spec.width


def _fixed(spec: FrameSpec, size: Size) -> Size:
    """The output's size that was asked for; FrameError for a frame of other proportions, or one
    that is too small or too large."""
    found = f"{spec.source or 'frame'}: {spec.width}x{spec.height}"
    wide, high = spec.height * size.width / size.height, spec.width * size.height / size.width
    if (abs(high - spec.height) > max(1, ASPECT * high)
        and abs(wide - spec.width) > max(1, ASPECT * wide)):
        fitting = Size(round(size.width * spec.height / spec.width), size.width)
        rendered = Size(round(high), spec.width)
        raise FrameError(f"{found} does not have the proportions of {size}, overscan included: "
                         f"give a size like {fitting}, or render at {rendered}")
    if not all(side <= outer <= MOST_SCALE * side
               for side, outer in ((spec.height, size.height), (spec.width, size.width))):
        least = Size(*(-(-side // int(MOST_SCALE)) for side in size))
        raise FrameError(f"{found} cannot become {size}: frames are enlarged up to 3 times, and "
                         f"never reduced: render at {least} to {size}")
    guides = spec.guides
    if guides and (guides.height, guides.width) != size:
        found = f"{guides.source or 'frame'}: guides are {guides.width}x{guides.height}"
        raise GuideError(f"{found}, the output is {size}: render them at its size, or leave the "
                         "size out")
    return size


def _guided(spec: FrameSpec, guides: GuideSpec, scale: float | None, scaled: Size) -> Size:
    """The output's size by a frame's guides; GuideError where they do not fit the frame or the
    scale."""
    sides = ((guides.width, spec.width), (guides.height, spec.height))
    if scale is None:
        low = max(LEAST_SCALE, *((outer - 0.5) / side for outer, side in sides))
        high = min(MOST_SCALE, *((outer + 1) / side for outer, side in sides))
        fix = "render them 1 to 3 times as large as the colour, by the same factor both ways"
        fits = low <= high
    else:
        fix = f"leave the scale out, or render them at {scaled} for a scale of {scale:g}"
        fits = all(outer in (round(side * scale), int(side * scale)) for outer, side in sides)
    if not fits:
        found = (f"guides are {guides.width}x{guides.height}, the colour is "
                 f"{spec.width}x{spec.height}")
        raise GuideError(f"{guides.source or 'frame'}: {found}: {fix}")
    return Size(guides.height, guides.width)


PATIENT = 8
"""Frames in a row at most that must allow a larger render size; the history goes on, unlike between
networks."""


class RenderSize:
    """Chooses the size to render the next frame at, so that frames take the wanted time.

    The pass has the option `size` and its history goes on when frames change their size, so a
    renderer may ask for a size before every frame and tell afterwards how long all of it took.

    Args:
        size: width and height of the output.
        milliseconds: that a frame may take, rendering and post-processing.
        least, most: render size over output size, 1/3 to 1.
        count: how many sizes there are, evenly between the two; each is prepared once.
        fixed: share of a frame's time at `most` that does not depend on the render size.

    Attributes:
        sizes: (width, height) to choose from, smallest first.

    Raises PassOptionError for an impossible size, time or range.
    """

    def __init__(self, size: Sequence[int], milliseconds: float, least: float = 1 / MOST_SCALE,
                 most: float = 1.0, count: int = 9, fixed: float = 0.2) -> None:
        if not 1 / MOST_SCALE <= least <= most <= 1 or count < 1 or not 0 <= fixed < 1:
            raise PassOptionError(f"render sizes from {least:g} to {most:g} of the output in "
                                  f"{count} steps: give a range within 1/3 and 1, and 1 step or "
                                  "more")
        if not milliseconds > 0:
            raise PassOptionError(f"a frame cannot take {milliseconds:g} ms: give a time above 0")
        whole = validate_size(size, None)
        assert whole is not None  # as a size is given
        shares = [most - (most - least) * step / max(count - 1, 1)
                  for step in reversed(range(count))]
        self.sizes = [(max(round(share * whole.width), -(-whole.width // int(MOST_SCALE))),
                       max(round(share * whole.height), -(-whole.height // int(MOST_SCALE))))
                      for share in shares]
        parts = [width * height / (self.sizes[-1][0] * self.sizes[-1][1])
                 for width, height in self.sizes]
        self._ladder = Ladder([fixed + (1 - fixed) * part for part in parts], milliseconds,
                              most_patience=PATIENT)

    def choose(self) -> tuple[int, int]:
        """Width and height to render the next frame at."""
        return self.sizes[self._ladder.rung]

    def note_time(self, milliseconds: float) -> None:
        """Tell how long the frame of the last choice took. A first frame of a size does not
        count."""
        self._ladder.note_time(milliseconds)


SOURCES = {"auto": (Role.REACTIVE, Role.OPAQUE_COLOUR), "plane": (Role.REACTIVE,),
           "difference": (Role.OPAQUE_COLOUR,), "none": ()}
"""Words of the option `reactive` -> planes that the mask is made of, best first."""


@dataclass(frozen=True)
class ReactiveOption:
    """How the mask is made.

    Attributes:
        kind: one of `SOURCES`.
        scale: factor of the difference of the two displayed colours, each within 0..1; the mask is
            clipped to 1.
        threshold: below this difference the mask is 0.
    """

    kind: str
    scale: float = 4.0
    threshold: float = 0.05

    def role(self, spec: FrameSpec) -> Role | None:
        """The plane from which the mask is made; None without one, or without motion and so without
        a history."""
        found = [role for role in SOURCES[self.kind] if spec.has(role)]
        return found[0] if found and spec.has(Role.MOTION) else None

    def demands(self) -> tuple[Role, ...]:
        """The plane that the user asked for by name."""
        return SOURCES[self.kind] if len(SOURCES[self.kind]) == 1 else ()

    def remarks(self, spec: FrameSpec) -> tuple[str, ...]:
        """How the mask is made, for the user."""
        role = self.role(spec)
        if role is Role.OPAQUE_COLOUR:
            return (f"reactive mask from the difference of colour and {role}: times "
                    f"{self.scale:g}, 0 below {self.threshold:g}",)
        return (f"reactive mask from the AOV '{role}'",) if role else ()


def parse_reactive(text: str) -> ReactiveOption:
    """The option from a text: auto, plane, difference or none, then scale= and threshold=,
    separated by commas.

    'difference,scale=8,threshold=0.02' marks faint smoke, too. Raises PassOptionError for anything
    else.
    """
    kind, *pairs = [word.strip() for word in text.split(",")]
    if kind not in SOURCES:
        raise PassOptionError(f"reactive '{text}'{offer(kind, SOURCES, 'begin with')}")
    numbers = {}
    for pair in pairs:
        name, _, value = pair.partition("=")
        if name not in ("scale", "threshold"):
            raise PassOptionError(f"reactive '{text}': unknown '{name}': use scale= or threshold=")
        try:
            numbers[name] = float(value)
        except ValueError:
            numbers[name] = -1.0
        if not numbers[name] >= 0:
            raise PassOptionError(f"reactive '{text}': '{pair}' needs a number from 0 on, e.g. "
                                  f"{name}=0.1")
    return ReactiveOption(kind, **numbers)
