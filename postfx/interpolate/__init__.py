"""Frames between frames: what a sequence shows at times at which no frame was rendered.

    between = postfx.Interpolator()
    for frame in postfx.read_sequence("shot/clean.####.exr"):
        between.push(frame)
        if between.ready:
            show(between.frame(0.5))

Four steps: `paths` lead every pixel of two frames through the time between them and are splatted to the time that is
asked for; `flow` estimates motion where vectors tell nothing; `blend` chooses between the paths that meet and takes the
picture from both frames. `timing` says which times, numbers and time codes a sequence gets. docs/interpolation.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache, cached_property
from typing import Any, TypeAlias

import numpy as np

from postfx.cuts import CutDetector
from postfx.errors import FrameError
from postfx.frame import DEPTH_MISS, Frame, Role
from postfx.interpolate.blend import choose_paths, compose, fill_holes, find_overlay, merge_sides, misfits
from postfx.interpolate.flow import consistent_motion, estimate_motion
from postfx.interpolate.paths import Paths, paths_of, splat_paths
from postfx.sampling import local_sum
from postfx.system import usable_cores
from postfx.temporal.reverse_motion import invert_motion

LIGHT = (Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO, Role.ROUGHNESS, Role.ALPHA)
"""Planes that are mixed from both frames, as the colour is."""
DATA = (Role.DEPTH, Role.NORMAL, Role.SPECULAR_HIT_DISTANCE, Role.STRENGTH, Role.REACTIVE)
"""Planes that are taken from one frame's nearest pixel."""
LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
COVERED = 0.98
"""Coverage from which an overlay hides the picture."""
LONGEST = 64
"""Pixels by which an overlay that was found in the picture is grown, at most."""
Pair: TypeAlias = tuple[np.ndarray, np.ndarray]
"""A plane of both frames."""
OVERLAYS = ("mix", "hold")
CAMERA = ("worldToCamera", "worldToNDC")
"""Attributes of a camera, of which the first one is made for the time."""
CUT, STILL = "another shot begins", "nothing changes"


class Between:
    """The time between two frames that follow each other.

    Args:
        before, after: the two frames, scene-linear.
        later: the frame that follows, if there is one. It bends the paths of what turns or speeds up, and so does the
            motion of the frame before.
        flow: whether motion is also estimated where there are vectors, for what does not move along with its surface,
            such as shadows; it takes most of the time. Without vectors it is estimated anyway.
        overlay: 'mix' or 'hold' (keep the earlier one's) the plane overlay.
        composited: whether the overlay is in the colour, too. It is taken out, and put over the result.
        is_cut: whether another shot begins between the two; a frame after that is marked by `reset` says so itself.

    Attributes:
        reason: why there is nothing to interpolate, or None: `frame` then gives the nearer one of the two.

    Raises FrameError for a frame without scene-linear colour.
    """

    def __init__(self, before: Frame, after: Frame, later: Frame | None = None, *, flow: bool = True,
                 overlay: str = "mix", composited: bool = False, is_cut: bool = False) -> None:
        if overlay not in OVERLAYS:
            raise FrameError(f"overlay '{overlay}' between frames: use {' or '.join(OVERLAYS)}")
        for frame in (before, after):
            if Role.COLOUR not in frame or frame.encoding != "scene-linear":
                raise FrameError(f"frame {frame.number} ({frame.source or 'of no file'}) has no scene-linear colour: "
                                 "interpolate before the display transform")
        self.before, self.after, self._later = before, after, later
        self._options: dict[str, Any] = {"flow": flow, "overlay": overlay, "composited": composited}
        self._flow, self._overlay = flow, overlay
        self._composited = composited and self._both_have(Role.OVERLAY)
        self.reason = self._find_reason(is_cut)

    def frame(self, t: float, number: int | None = None, previous: float = 0.0) -> Frame:
        """What is seen at a time t: 0 is the frame before, 1 the one after; those are given as they are.

        number: of the new frame. previous: the time to which the plane motion leads, -1 to t. Planes that only one of
        the two frames has are left out, and so are guides.

        Raises FrameError for another time.
        """
        if not (0 <= t <= 1 and -1 <= previous <= t):
            raise FrameError(f"time {t} with motion to {previous}: give 0 <= t <= 1 and -1 <= previous <= t")
        nearer = self.before if t < 0.5 else self.after
        number = nearer.number if number is None else number
        if self.reason is not None or t in (0, 1):
            return replace(nearer, number=number)
        views = {name: Between(view, self.after.views[name], **self._options).frame(t, number, previous)
                 for name, view in self.before.views.items() if name in self.after.views}
        planes, parts = self._make_planes(t, previous)
        camera = self._camera_at(t)
        metadata = {name: value for name, value in self.before.metadata.items() if name not in CAMERA}
        if camera is not None and CAMERA[0] in self.before.metadata:
            metadata[CAMERA[0]] = tuple(camera.ravel().tolist())
        return replace(self.before, planes=planes, parts=parts, number=number, jitter=(0.0, 0.0), reset=False,
                       metadata=metadata, guides={}, guide_size=None, samples=None, views=views,
                       world_to_camera=camera)

    def motion_of_after(self, previous: float) -> np.ndarray:
        """Motion (h, w, 2) of the frame after to a time between, `previous`: what its plane is once a frame is there.
        """
        _, last = self._paths
        motion: np.ndarray = last.ends[..., :2] * np.float32(1 - previous)
        motion += last.bend * np.float32(previous * (previous - 1))
        return motion

    def _both_have(self, role: Role) -> bool:
        return role in self.before and role in self.after

    def _find_reason(self, is_cut: bool) -> str | None:
        one, other = self.before.spec, self.after.spec
        if (one.width, one.height) != (other.width, other.height):
            return f"sizes differ: {one.width}x{one.height} and {other.width}x{other.height}"
        if is_cut or self.after.reset:
            return CUT
        planes = [role for role in (Role.COLOUR, Role.ALPHA, Role.OVERLAY) if self._both_have(role)]
        same = all(np.array_equal(self.before[role], self.after[role], equal_nan=True) for role in planes)
        return STILL if same else None

    def _camera_at(self, t: float) -> np.ndarray | None:
        """World to camera (4, 4) at a time: turned about one axis, and moved straight. None where there is none."""
        one, other = self.before.world_to_camera, self.after.world_to_camera
        if one is None or other is None:
            return None
        try:
            first, last = np.linalg.inv(one), np.linalg.inv(other)
            turn = np.linalg.inv(first[:3, :3]) @ last[:3, :3]
            angle = math.acos(min(max((np.trace(turn) - 1) / 2, -1), 1))
            if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-3) or angle > 3:
                return None
            axis = (turn - turn.T) / (2 * math.sin(angle)) if angle > 1e-9 else np.zeros((3, 3))
            part = np.eye(3) + math.sin(t * angle) * axis + (1 - math.cos(t * angle)) * axis @ axis  # Rodrigues
            camera = first.copy()
            camera[:3, :3] = first[:3, :3] @ part
            camera[3] = (1 - t) * first[3] + t * last[3]
            found: np.ndarray = np.linalg.inv(camera)
        except np.linalg.LinAlgError:
            return None
        return found

    # What is found once for all times

    @cached_property
    def _overlays(self) -> tuple[np.ndarray, np.ndarray]:
        """Overlays (h, w, 4) that are in the colours."""
        return _finite(self.before[Role.OVERLAY]), _finite(self.after[Role.OVERLAY])

    @cached_property
    def _pictures(self) -> tuple[np.ndarray, np.ndarray]:
        """Colours without overlays."""
        role = Role.OPAQUE_COLOUR if self._both_have(Role.OPAQUE_COLOUR) else Role.COLOUR
        colours = _finite(self.before[role]), _finite(self.after[role])
        if not self._composited:
            return colours
        first, last = (_take_out(colour, overlay) for colour, overlay in zip(colours, self._overlays, strict=True))
        return first, last

    @cached_property
    def _toned(self) -> tuple[np.ndarray, np.ndarray]:
        """Pictures of the range 0 to 1, in which differences are about as visible in the dark as in the light."""
        light = [np.maximum(picture @ LUMINANCE, 0) for picture in self._pictures]
        mean = float(np.mean(light)) + 1e-12
        level = np.float32(4 * math.exp(float(np.mean(np.log(np.stack(light) + np.float32(1e-3 * mean))))))
        first, last = (np.sqrt((bright := np.maximum(picture, 0)) / (bright + level)) for picture in self._pictures)
        return first, last

    @cached_property
    def _matched(self) -> tuple[np.ndarray, np.ndarray]:
        """Grey of the toned pictures (h, w, 1), by which paths are compared."""
        first, last = (toned.mean(-1, keepdims=True) for toned in self._toned)
        return first, last

    @cached_property
    def _known(self) -> tuple[np.ndarray, np.ndarray]:
        """(h, w) of each frame: where it shows the scene, and not an overlay."""
        if self._composited:
            first, last = (overlay[..., 3] < COVERED for overlay in self._overlays)
            return first, last
        known = np.ones(self.before[Role.COLOUR].shape[:2], np.bool_)
        if self._both_have(Role.MOTION) and not self._both_have(Role.OPAQUE_COLOUR):
            motion = _finite(self.after[Role.MOTION])
            size = np.abs(motion).sum(-1)
            find_overlay(*self._pictures, motion, min(LONGEST, math.ceil(float(np.quantile(size, 0.99)))), known)
        return known, known

    @cached_property
    def _estimated(self) -> tuple[np.ndarray, np.ndarray]:
        """Motion (h, w, 2) of both frames to the other one, estimated from the pictures."""
        first, last = (toned.mean(-1) for toned in self._toned)
        ahead, back = _at_once([lambda: estimate_motion(first, last), lambda: estimate_motion(last, first)])
        return ahead, back

    @cached_property
    def _paths(self) -> tuple[Paths, Paths]:
        has_depth = self._both_have(Role.DEPTH)
        motion = self.after[Role.MOTION] if Role.MOTION in self.after else self._estimated[1]
        motion = _without_jumps(motion)
        depths = [_depth(frame) for frame in (self.before, self.after)] if has_depth else self._rank(motion)
        ahead = invert_motion(motion, depths[1], depths[0])
        came = goes = None
        if Role.MOTION in self.after and Role.MOTION in self.before and not self.before.reset:
            came = _without_jumps(self.before[Role.MOTION])
        later = self._later
        if has_depth and later is not None and not later.reset and Role.MOTION in later and Role.DEPTH in later:
            if later[Role.MOTION].shape == motion.shape:
                goes = invert_motion(_without_jumps(later[Role.MOTION]), _depth(later), depths[1])
        first, last = paths_of(motion, ahead, depths[0], depths[1], came, goes)
        for paths, frame in ((first, self.before), (last, self.after)):
            paths.ends += np.array(frame.jitter * 2, np.float32)
        return first, last

    def _rank(self, motion: np.ndarray) -> list[np.ndarray]:
        """What stands for depth where there is none: a path that fits both pictures is in front of one that does not.
        """
        ahead = invert_motion(motion, np.ones((*motion.shape[:2], 1), np.float32),
                              np.ones((*motion.shape[:2], 1), np.float32))
        first, last = self._toned
        return [1 + _difference(first, last, ahead), 1 + _difference(last, first, motion)]

    @cached_property
    def _noise(self) -> np.float32:
        """Misfit of paths that are right, which is noise: the median."""
        _, last = self._paths
        found = np.empty([side // 8 for side in last.seen.shape], np.float32)
        misfits(*self._matched, *self._known, last.ends, last.seen, found)
        found = found[found >= 0]
        return np.float32(np.median(found) if found.size else 0)

    # What is made for a time

    def _choose(self, t: float) -> np.ndarray:
        """Paths (h, w, 6) of the pixels at a time."""
        first, last = self._paths
        (one, near), (other, far) = _at_once([lambda: splat_paths(first, t), lambda: splat_paths(last, t)])
        h, w = near.shape
        fields = np.empty((3, h, w, 6), np.float32)
        merge_sides(one, near, other, far, fields)
        fields[..., :4] -= np.array((*self.before.jitter, *self.after.jitter), np.float32)
        own = fields[0]
        fill_holes(own, np.minimum(near, far))
        flows = np.empty((0, h, w, 6), np.float32)
        if self._flow and Role.MOTION in self.after:
            ahead, back = consistent_motion(*self._estimated)
            seen = np.ones((h, w, 2), np.float32)
            flows = np.stack([np.concatenate([-t * ahead, (1 - t) * ahead, seen], -1, dtype=np.float32),
                              np.concatenate([t * back, (t - 1) * back, seen], -1, dtype=np.float32)])
        chosen: np.ndarray = np.empty((h, w, 6), np.float32)
        _in_bands(h, choose_paths, *self._matched, *self._known, own, fields[1:], flows, self._noise, chosen)
        return chosen

    def _make_planes(self, t: float, previous: float) -> tuple[dict[Role, np.ndarray], dict[str, np.ndarray]]:
        """Planes and parts at a time."""
        before, after = self.before, self.after
        chosen = self._choose(t)
        shared = [name for name, part in before.parts.items()
                  if name in after.parts and part.shape == after.parts[name].shape]
        exact = [name for name in shared if name in before.part_sources and before.part_sources[name].exact]
        light: dict[Role | str, Pair] = {Role.COLOUR: self._pictures}
        light |= {role: (_finite(before[role]), _finite(after[role])) for role in LIGHT if self._both_have(role)}
        light |= {name: (_finite(before.parts[name]), _finite(after.parts[name])) for name in shared
                  if name not in exact}
        data: dict[Role | str, Pair] = {role: (before[role], after[role]) for role in DATA if self._both_have(role)}
        data |= {name: (before.parts[name], after.parts[name]) for name in exact}
        stacks = [_stack([pair[side] for pair in group.values()], chosen.shape[:2])
                  for group in (light, data) for side in (0, 1)]
        mixed, taken = np.empty_like(stacks[0]), np.empty_like(stacks[2])
        _in_bands(len(chosen), compose, *stacks, *self._known, chosen, t, mixed, taken)
        made = _split(mixed, light) | _split(taken, data)
        picture = made[Role.COLOUR]
        made[Role.COLOUR] = self._put_over(picture, t)
        if Role.MOTION in after:
            made[Role.MOTION] = _motion_between(chosen, t, previous)
        if self._both_have(Role.OPAQUE_COLOUR):
            made[Role.OPAQUE_COLOUR] = picture
        if self._both_have(Role.OVERLAY):
            made[Role.OVERLAY] = self._overlay_at(t)
        return ({role: plane for role, plane in made.items() if isinstance(role, Role)},
                {name: plane for name, plane in made.items() if not isinstance(name, Role)})

    def _overlay_at(self, t: float) -> np.ndarray:
        one, other = self._overlays
        mixed: np.ndarray = one + np.float32(0 if self._overlay == "hold" else t) * (other - one)
        return mixed

    def _put_over(self, picture: np.ndarray, t: float) -> np.ndarray:
        """The picture between with what lies over it."""
        if self._composited:
            overlay = self._overlay_at(t)
            covered: np.ndarray = overlay[..., :3] + (1 - overlay[..., 3:]) * picture
            return covered
        one, other = _finite(self.before[Role.COLOUR]), _finite(self.after[Role.COLOUR])
        if self._both_have(Role.OPAQUE_COLOUR):
            clear = _clearness(one, other, *self._pictures)
            mean = self._pictures[0] + np.float32(t) * (self._pictures[1] - self._pictures[0])
            drawn: np.ndarray = one + np.float32(t) * (other - one) + clear * (picture - mean)
            return drawn
        still = ~self._known[0]
        return np.where(still[..., None], one, picture) if still.any() else picture


class Interpolator:
    """Frames between the last two frames of a stream, for live use. Stateful: push frames in order.

    Options are those of `Between`. `push` finds cuts. Motion is bent by the frame before the last two; there is no
    waiting for a later one.

    Attributes:
        between: the time between the last two frames; None before there are two.
    """

    def __init__(self, *, flow: bool = True, overlay: str = "mix", composited: bool = False) -> None:
        self._options: dict[str, Any] = {"flow": flow, "overlay": overlay, "composited": composited}
        self._detector, self._times = CutDetector(), [0.0, 0.0]
        self._last: Frame | None = None
        self.between: Between | None = None

    @property
    def ready(self) -> bool:
        """Whether two frames were pushed."""
        return self.between is not None

    @property
    def reason(self) -> str | None:
        """Why nothing is interpolated between the last two frames; None if it is."""
        return "there are no two frames yet" if self.between is None else self.between.reason

    def push(self, frame: Frame, delta: float = 1.0) -> None:
        """Take the next frame, `delta` after the one before it, in any unit of time above 0."""
        if not delta > 0:
            raise FrameError(f"frame {frame.number} comes {delta} after the one before: give a time above 0")
        is_cut = self._detector(frame)
        if self._last is not None:
            self.between = Between(self._last, frame, is_cut=is_cut, **self._options)
        self._last, self._times = frame, [self._times[1], self._times[1] + delta]

    def frame(self, t: float, number: int | None = None) -> Frame:
        """What is seen at a time between the last two frames, 0 to 1. FrameError before there are two."""
        if self.between is None:
            raise FrameError("nothing to interpolate: push two frames first")
        return self.between.frame(t, number)

    def at(self, time: float, number: int | None = None) -> Frame:
        """Likewise, at a time in the unit of `push`, counted from the first frame's delta on."""
        first, last = self._times
        return self.frame((time - first) / (last - first), number)


def _motion_between(chosen: np.ndarray, t: float, previous: float) -> np.ndarray:
    """Motion to an earlier time of paths at t: Lagrange's polynomial through their places at 0, t and 1."""
    first = np.float32((previous - t) * (previous - 1) / t)
    last = np.float32(previous * (previous - t) / (1 - t))
    motion: np.ndarray = chosen[..., :2] * first + chosen[..., 2:4] * last
    return motion


def _take_out(colour: np.ndarray, overlay: np.ndarray) -> np.ndarray:
    """The picture under an overlay that was composited over it; black where nothing of it is left."""
    clear = 1 - overlay[..., 3:]
    picture = np.zeros_like(colour)
    np.divide(colour - overlay[..., :3], clear, out=picture, where=clear > 1 - COVERED)
    return picture


def _clearness(one: np.ndarray, other: np.ndarray, below: np.ndarray, below_other: np.ndarray) -> np.ndarray:
    """How much of the picture an overlay lets through (h, w, 1), 0 to 1, by the difference of two frames with and
    without it: least squares of colour = overlay + clearness * picture over 5x5 pixels, for an overlay that stands
    still. 1 where the picture does not change, as it makes no difference there."""
    change, seen = below_other - below, other - one
    product, square = (local_sum((change * by).sum(-1), 2) for by in (seen, change))
    clear = np.divide(product, square, out=np.ones_like(square), where=square > 0).clip(0, 1)
    still = (seen == 0).all(-1) & (change != 0).any(-1)
    clear[still] = 0  # to the pixel, where nothing comes through
    found: np.ndarray = clear[..., None]
    return found


def _finite(plane: np.ndarray) -> np.ndarray:
    """The plane with 0 for what is not finite; itself if everything is."""
    return plane if np.isfinite(plane).all() else np.nan_to_num(plane, nan=0, posinf=0, neginf=0)


def _without_jumps(motion: np.ndarray) -> np.ndarray:
    """Motion with NaN for what leads out of any picture: nothing follows it."""
    most = np.float32(4 * max(motion.shape[:2]))
    wrong = ~(np.abs(motion).max(-1) <= most)
    if not wrong.any():
        return motion
    found = motion.copy()
    found[wrong] = np.nan
    return found


def _depth(frame: Frame) -> np.ndarray:
    """Depth (h, w, 1) between 0 and a miss; what is not a number counts as a miss."""
    depth: np.ndarray = np.nan_to_num(frame[Role.DEPTH], nan=DEPTH_MISS, posinf=DEPTH_MISS, neginf=DEPTH_MISS)
    depth = np.clip(depth, np.float32(1e-6), np.float32(DEPTH_MISS))
    return depth


def _difference(one: np.ndarray, other: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Mean difference (h, w, 1) of a toned picture to another one where its motion leads; 1 where it leads nowhere."""
    h, w = motion.shape[:2]
    y, x = np.mgrid[:h, :w]
    u, v = x + 0.5 + motion[..., 0], y + 0.5 + motion[..., 1]
    inside = (u >= 0) & (u < w) & (v >= 0) & (v < h)
    rows, columns = np.where(inside, v, 0).astype(np.intp), np.where(inside, u, 0).astype(np.intp)
    found = np.where(inside, np.abs(one - other[rows, columns]).mean(-1), 1)
    return found[..., None].astype(np.float32)


def _stack(planes: list[np.ndarray], size: tuple[int, ...]) -> np.ndarray:
    """All channels (h, w, n) of planes of this size, of which there may be none."""
    return np.concatenate(planes, -1, dtype=np.float32) if planes else np.empty((*size, 0), np.float32)


def _split(stack: np.ndarray, group: dict[Role | str, Pair]) -> dict[Role | str, np.ndarray]:
    """The planes in a stack of them."""
    ends = np.cumsum([pair[0].shape[2] for pair in group.values()])
    return {key: stack[..., end - pair[0].shape[2]:end] for (key, pair), end in zip(group.items(), ends, strict=True)}


@cache
def _threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(usable_cores(), "postfx interpolate")


def _at_once(tasks: Iterable[Callable[[], Any]]) -> list[Any]:
    """Results of functions that run side by side."""
    return [task.result() for task in [_threads().submit(task) for task in tasks]]


def _in_bands(height: int, kernel: Callable[..., None], *arguments: Any) -> None:
    """Run a kernel on all rows, in bands side by side: small ones, as some rows take longer than others."""
    band = max(8, -(-height // (8 * usable_cores())))
    _at_once([lambda first=first: kernel(first, min(height, first + band), *arguments)  # type: ignore[misc]
              for first in range(0, height, band)])
