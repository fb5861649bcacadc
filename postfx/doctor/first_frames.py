"""A look at the first frames of a run, for those who run before they inspect: checks that take
milliseconds, each with its fix in a line."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from postfx.doctor import (
    Finding,
    Level,
    geometry_checks,
    most_important_first,
    motion_checks,
    noise_checks,
    plane_checks,
)
from postfx.doctor.material import Material
from postfx.frame import Frame, Role

Check = Callable[[Material], Iterator[Finding]]

OF_ONE_FRAME: tuple[Check, ...] = (
    plane_checks.check_light_outside,
    plane_checks.check_uniform_planes,
    geometry_checks.check_depth_misses,
    geometry_checks.check_normal_encoding,
    geometry_checks.check_roughness_range,
    motion_checks.check_motion_coded,
)
"""Checks that take no more than one frame."""

OF_SEVERAL: tuple[Check, ...] = (
    partial(motion_checks.check_samples_stay, least=0.3),  # fine moving texture comes to 0.25
    motion_checks.check_motion_at_a_glance,
)
"""Checks that compare frames of a shot: one seed for all, vectors of the wrong sign, axes or
unit."""

COMPARED_FRAMES = 3
"""Frames of a shot that are compared with each other."""
COMPARED_WINDOW_PX = 640, 360
"""Most columns and rows, in the middle of the picture, that are compared: more tell little and take
long."""
MOST_SEEN = 12
"""Frames after which no more are waited for, as where every frame is a shot of its own."""
READ_FOR_CHECKS = (Role.COLOUR, Role.MOTION, Role.DEPTH, Role.NORMAL, Role.DIFFUSE_ALBEDO,
                   Role.SPECULAR_ALBEDO)
"""Planes that the checks of several frames read."""


class FirstFrames:
    """Sees the frames of a run in order and says what is plainly wrong with them.

    Args:
        channels: role -> the plane's names in the file.
        enable: role -> where the user switches the plane on in the renderer.
        on_gpu: whether frames are denoised there, where light outside the gamut is cut.
        copies: whether the arrays of a frame may hold another one by the next call.
        leaves_filters: whether what a pixel filter did to the noise stays.

    Attributes:
        is_done: whether no further frame is looked at.
    """

    def __init__(self, channels: Mapping[Role, str] | None = None,
                 enable: Mapping[Role, str] | None = None,
                 on_gpu: bool = False, copies: bool = False,
                 leaves_filters: bool = False) -> None:
        self._channels = channels or {}
        self._enable = enable or {}
        self._on_gpu = on_gpu
        self._copies = copies
        self._seen, self._kept, self._size = 0, list[Frame](), (0, 0)
        self._is_black = True  # all that was seen
        self._leaves_filters = leaves_filters
        self.is_done = False

    def look(self, frame: Frame, is_alone: bool = False) -> list[str]:
        """What this frame and those before it show, a line each: errors and warnings.

        is_alone: whether there is no other frame, so that motion helps nothing.
        """
        if self.is_done:
            return []
        self._seen += 1
        self.is_done = self._seen >= MOST_SEEN
        found = self._of_first(frame, is_alone) if self._seen == 1 else []
        self._is_black = self._is_black and not np.any(frame.planes.get(Role.COLOUR, False))
        if self._is_black and self._seen == (1 if is_alone else COMPARED_FRAMES):
            found.append(plane_checks.black_colour(self._seen))
        if self._kept and (frame.reset or _size(frame) != self._size):
            self._kept.clear()
        planes = {role: self._keep(plane)
                  for role, plane in frame.planes.items() if role in READ_FOR_CHECKS}
        self._size = _size(frame)
        self._kept.append(replace(frame, planes=planes, guides={}, guide_size=None, parts={},
                                  views={}))
        if len(self._kept) == COMPARED_FRAMES:
            material = Material(self._kept, whole=_size(frame))
            found += [finding for check in OF_SEVERAL for finding in check(material)]
            self._kept, self.is_done = [], True
        return [self._line(one, frame) for one in most_important_first(found) if self._matters(one)]

    def _of_first(self, frame: Frame, is_alone: bool) -> list[Finding]:
        checks = (*OF_ONE_FRAME,
                  *((noise_checks.check_pixel_filter,) if self._leaves_filters else ()))
        found = [finding for check in checks for finding in check(Material([frame]))]
        held = {role: plane for role, plane in frame.planes.items()
                if not self._channels or role in self._channels}
        read = replace(frame, planes=held)  # without motion that was estimated
        frames = [read] if is_alone else [read, read]  # a single one needs no motion
        material = Material(frames, enable=dict(self._enable))
        return found + [one for one in plane_checks.check_missing_planes(material)
                        if Role(one.role) in self._enable]

    def _keep(self, plane: np.ndarray) -> np.ndarray:
        height, width = plane.shape[:2]
        columns, rows = min(width, COMPARED_WINDOW_PX[0]), min(height, COMPARED_WINDOW_PX[1])
        left, top = (width - columns) // 2, (height - rows) // 2
        window = plane[top : top + rows, left : left + columns]
        return window.copy() if self._copies else window

    def _matters(self, one: Finding) -> bool:
        return (one.level is not Level.INFO or one.code == noise_checks.NOISE_SPREAD_CODE
                or (self._on_gpu and one.code == plane_checks.OUTSIDE_GAMUT))

    def _line(self, one: Finding, frame: Frame) -> str:
        fix, evidence = one.fix.partition("; as a file")[0], one.evidence.partition("; of ")[0]
        fix += "; 'postfx inspect' prints that profile" if fix.startswith("in a profile") else ""
        evidence = evidence.partition(": misfit ")[0]  # `inspect` has the figures
        if one.role not in set(Role):
            return f"{evidence}; likely: {one.cause}; fix: {fix}"
        if one.code.startswith("missing-"):
            return f"AOV {one.role}: {evidence}; fix: {fix}"
        names = self._channels.get(Role(one.role))
        of_file = f" ({names})" if names else ""
        return (f"AOV {one.role}{of_file}, frame {frame.number}: {evidence}; likely: {one.cause}; "
                f"fix: {fix}")


def _size(frame: Frame) -> tuple[int, int]:
    return frame.spec.width, frame.spec.height
