"""Panoramas, whose right edge goes on at the left one.

Frames run with a margin of what lies beyond either edge, and the result is cropped. The margin is
wider than what the networks see around a pixel, so edges come out as any other place does. Motion
across the edge is followed as far as the margin reaches.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from postfx.errors import FrameError, PassOptionError, offer
from postfx.frame import Frame, FrameSpec, Role
from postfx.passes import Pass
from postfx.passes.denoise.geometry import SIDE_MULTIPLE
from postfx.plan import Plan, make_plan

WRAP_AUTO = "auto"
WRAP_AROUND = "x"
WRAP_NONE = "none"
WRAPS = (WRAP_AUTO, WRAP_AROUND, WRAP_NONE)
LEAST_MARGIN = 64
"""Render pixels on either side: what the networks see around a pixel."""
MARGINS_A_WIDTH = 16
"""A margin is at least the frame's width divided by this, to hold motion across the edge."""
MOST_STEPS = 64
"""Wider margins that are tried, in steps of the networks' grid, until one is a whole number of the
output's pixels."""


def validate_wrap(wrap: str) -> str:
    """The value itself; PassOptionError for none of `WRAPS`."""
    if wrap not in WRAPS:
        raise PassOptionError(f"wrap '{wrap}'{offer(wrap, WRAPS, 'give')}")
    return wrap


def is_panorama(attributes: Mapping[str, Any]) -> bool:
    """Whether a header says, as OpenEXR's attribute 'envmap', that the picture is
    equirectangular."""
    return attributes.get("textureformat") == "LatLong Environment"


def widened_plan(passes: Sequence[Pass], plan: Plan) -> tuple[Plan, int]:
    """The plan for frames with a margin, and the margin in render pixels.

    Raises PassOptionError for an output of a size of its own.
    """
    spec, output = plan.available, plan.output
    sizes = [output.width, *([spec.guides.width] if spec.guides else [])]
    least = -(-max(LEAST_MARGIN, spec.width // MARGINS_A_WIDTH) // SIDE_MULTIPLE) * SIDE_MULTIPLE
    fitting = (margin for margin in range(least, least + MOST_STEPS * SIDE_MULTIPLE, SIDE_MULTIPLE)
               if not any(margin * size % spec.width for size in sizes))
    margin = next(fitting, None)
    try:
        wide = None if margin is None else make_plan(passes, _widened_spec(spec, margin))
    except FrameError:  # another aspect
        wide = None
    if margin is not None and wide is not None:
        if wide.output.width == output.width + 2 * margin * output.width // spec.width:
            return wide, margin
    raise PassOptionError(
        f"a panorama of {spec.width} pixels cannot become {output.width} wide without a seam: "
        "give a scale such as 1, 1.5 or 2 in place of a size, or wrap none")


def widen(frame: Frame, margin: int) -> Frame:
    """A frame with a margin on either side."""
    width = frame.spec.width

    def around(array: np.ndarray) -> np.ndarray:
        own = array.shape[1]
        beyond = margin * own // width
        found: np.ndarray = np.take(array, np.arange(-beyond, own + beyond) % own, axis=1)
        return found

    planes = {role: around(plane) for role, plane in frame.planes.items()}
    if Role.MOTION in planes:
        across = planes[Role.MOTION][..., 0]
        across -= width * np.round(np.nan_to_num(across) / width)  # the short way round
    guides = {role: around(guide) for role, guide in frame.guides.items()}
    size = frame.guide_size
    if size is not None:
        size = size[0] + 2 * margin * size[0] // width, size[1]
    parts = {name: around(part) for name, part in frame.parts.items()}
    return frame.copy_with(planes=planes, guides=guides, guide_size=size, parts=parts)


def crop(result: Frame, given: Frame, plan: Plan) -> Frame:
    """The result of a widened frame without its margin. Guides are those of the given frame."""
    width = plan.output.width

    def own(array: np.ndarray) -> np.ndarray:
        beyond = (array.shape[1] - width) // 2
        return np.ascontiguousarray(array[:, beyond : beyond + width])

    planes = {role: own(plane) for role, plane in result.planes.items()}
    parts = {name: own(part) for name, part in result.parts.items()}
    held = bool(result.guides) or result.guide_size is not None
    return result.copy_with(planes=planes, parts=parts, guides=given.guides if held else {},
                            guide_size=given.guide_size if held else None)


def _widened_spec(spec: FrameSpec, margin: int) -> FrameSpec:
    guides = spec.guides
    wider = guides and replace(guides, width=guides.width + 2 * margin * guides.width // spec.width)
    return replace(spec, width=spec.width + 2 * margin, guides=wider)
