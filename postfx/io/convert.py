"""Stored values to postfx's one convention: planes by a profile's rules, depth by `--depth`."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from postfx.depth import depth_from_device, depth_from_normalised, depth_from_ray, normals_to_world
from postfx.errors import DepthOptionError, ProfileError, offer
from postfx.frame import DEPTH_MISS, Role
from postfx.io.profile import PlaneRule
from postfx.motion.camera import (
    apply_homography,
    camera_equations,
    centre_positions,
    fit_camera,
    skew_of,
)
from postfx.planes import largest_bits_of


@dataclass(frozen=True)
class Camera:
    """What a header says about the camera.

    Attributes:
        world_to_camera: 4x4, row vectors (p_camera = p_world @ M), or None.
        fov_x: horizontal field of view in degrees, or None.
        jitter: sample position minus 0.5 in pixels, x right, y down.
        pixel_aspect: width of a pixel over its height.
        display_size: width and height of the display window, which the field of view and motion in
            parts of the image refer to; None where the planes cover just that.
        shift: from the centre of the display window to that of the planes, in pixels, x right, y
            down.
        near, far: distances of the near and far plane, or None.
        max_velocity: pixels that motion in unit velocity is 1 for, or None.
        shutter: how long the shutter is open, in frames, or None.
    """

    world_to_camera: np.ndarray | None = None
    fov_x: float | None = None
    jitter: tuple[float, float] = (0.0, 0.0)
    pixel_aspect: float = 1.0
    near: float | None = None
    far: float | None = None
    max_velocity: float | None = None
    shutter: float | None = None
    display_size: tuple[int, int] | None = None
    shift: tuple[float, float] = (0.0, 0.0)

    def fov_over(self, width: int) -> float | None:
        """Horizontal field of view, in degrees, of planes of a width."""
        if self.fov_x is None or self.display_size is None:
            return self.fov_x
        return math.degrees(2 * math.atan(math.tan(math.radians(self.fov_x) / 2) * width
                                          / self.display_size[0]))


_NO_VECTOR = 65000.0
"""Stored motion from here on is unknown, as NaN is: renderers write the largest half float, or
1e10. So is what is longer than the picture, as 9999."""


def convert(
    plane: np.ndarray, rule: PlaneRule, camera: Camera, first: int = 0, height: int | None = None
) -> np.ndarray:
    """Stored values (height, width, channels) of one plane in postfx's convention, float32; the
    input may be reused.

    Motion that stands for none becomes NaN, both channels. Of a plane of another `height` these are
    the rows from the `first` on.
    """
    height = plane.shape[0] if height is None else height
    if rule.role is Role.DEPTH:
        return _depth(plane, rule, camera, first, height)
    missed = (plane == 0).all(axis=-1) if rule.role is Role.NORMAL and any(rule.offset) else None
    is_none = _not_below(plane, _NO_VECTOR) if rule.role is Role.MOTION else None
    if rule.is_affine:
        plane = _affine(plane, rule)
    if missed is not None:
        plane[missed] = 0
    if rule.role is Role.MOTION:
        size = camera.display_size or (plane.shape[1], height)
        if not rule.is_per_pixel:
            plane = _motion_pixels(plane, rule, camera, *size)
        is_longer = _not_below(plane, max(size) + 1)
        for unknown in (is_none, is_longer):
            if unknown is not None:
                plane[unknown] = np.nan
    if rule.role is Role.NORMAL and rule.space != "world":
        assert camera.world_to_camera is not None, ("the AOV is not used without a worldToCamera "
                                                    "header")
        if rule.space == "view" and np.linalg.det(camera.world_to_camera[:3, :3]) < 0:
            plane = plane * np.array([1, 1, -1], np.float32)  # the header's camera looks along +z
        plane = normals_to_world(plane, camera.world_to_camera)
    if rule.clamp is not None:
        plane = np.clip(plane, *rule.clamp, out=plane)
    return np.ascontiguousarray(plane, np.float32)


def is_converted(rule: PlaneRule) -> bool:
    """Whether `convert` may change stored values."""
    if rule.role in (Role.DEPTH, Role.MOTION) or (rule.role is Role.NORMAL
                                                  and rule.space != "world"):
        return True
    return rule.is_affine or rule.clamp is not None


def fill_value(rule: PlaneRule) -> float:
    """Stored value that means 'nothing here', for pixels outside the data window."""
    if rule.role is Role.DEPTH:
        return _empty(rule) if rule.miss is None else rule.miss
    return -rule.offset[0] if rule.role is Role.MOTION else 0.0


def _affine(plane: np.ndarray, rule: PlaneRule) -> np.ndarray:
    if any(rule.offset):
        plane = plane + np.asarray(rule.offset, np.float32)
    return (plane * np.asarray(rule.scale, np.float32) if any(scale != 1 for scale in rule.scale)
            else plane)


def _depth(stored: np.ndarray, rule: PlaneRule, camera: Camera, first: int,
           height: int) -> np.ndarray:
    as_stored = rule.kind == "planar" and rule.miss is None and not rule.is_affine
    # surfaces everywhere
    if (as_stored and stored.min(initial=1) > 0 and stored.max(initial=0) < DEPTH_MISS):
        return stored
    missed = ~np.isfinite(stored)
    if rule.miss is not None:
        missed |= stored == np.float32(rule.miss)
    if rule.kind in ("planar", "ray") and not any(rule.offset):
        # no surface lies in the eye: many renderers write this where nothing was hit
        missed |= stored == 0
    if missed.any():
        stored[missed] = 0
    plane = _affine(stored, rule) if rule.is_affine else stored
    missed |= plane >= DEPTH_MISS
    found = plane
    if rule.kind != "planar":
        found = _planar(plane, rule, camera, first, height)
    if missed.any():
        found[missed] = DEPTH_MISS
    return np.ascontiguousarray(found, np.float32)


def _planar(plane: np.ndarray, rule: PlaneRule, camera: Camera, first: int,
            height: int) -> np.ndarray:
    """Depth along the view axis. Numbers of the camera that it needs are checked when the plane is
    found."""
    if rule.kind == "ray" and (fov := camera.fov_over(plane.shape[1])) is not None:
        sample = (camera.jitter[0] + camera.shift[0], camera.jitter[1] + camera.shift[1])
        return depth_from_ray(plane, fov, sample, camera.pixel_aspect, first, height)
    if rule.kind == "device":
        assert camera.near is not None
        return depth_from_device(plane, camera.near, camera.far or math.inf, rule.reversed)
    if rule.kind == "normalised":
        assert camera.near is not None and camera.far is not None
        return depth_from_normalised(plane, camera.near, camera.far, rule.reversed)
    return plane


def _empty(rule: PlaneRule) -> float:
    """Stored value of a pixel without a surface, where the profile names none."""
    return math.inf if rule.kind in ("planar", "ray") else 0.0 if rule.reversed else 1.0


def _motion_pixels(plane: np.ndarray, rule: PlaneRule, camera: Camera, width: int,
                   height: int) -> np.ndarray:
    """Motion from frame to frame in pixels."""
    most = camera.max_velocity or 1.0
    sizes = {"pixels": (1.0, 1.0), "uv": (width, height), "ndc": (width / 2, height / 2),
             "width": (width, width), "velocity": (most, most)}
    frames = (camera.shutter or 1.0) if rule.per == "shutter" else 1.0
    factors = [size / frames for size in sizes[rule.unit]]
    return plane if factors == [1, 1] else plane * np.asarray(factors, np.float32)


def _not_below(motion: np.ndarray, limit: float) -> np.ndarray | None:
    """Pixels of motion (height, width, 2) with a channel that is NaN, or from the limit on without
    its sign; None where there are none, which takes little time to tell."""
    if largest_bits_of(motion) < np.float32(limit).view(np.uint32):
        return None
    unknown: np.ndarray = ~(np.abs(motion) < limit).all(axis=-1)
    return unknown


# Motion of the background -------------------------------------------------------------------------

_POINTS = 2000
"""Points that the fit takes."""
_LEAST_POINTS = 64
"""Points that the fit needs at least."""
_ROWS = 16
"""Rows that are filled at once."""
_STILL_PX = 1e-3
"""Motion of a camera at rest."""
_MOST_ERROR_PX = 0.1
"""The most error that a fit may have."""
_LEAST_FITTING = 0.6
"""Share of the points that the fit must explain."""
_MOST_SKEW = 0.005
"""How far the fit may be from a turn, in matrix entries."""
_LEAST_UNMOVED = 0.75
"""Least share of the misses that must be without motion."""


def fill_background_motion(motion: np.ndarray, depth: np.ndarray) -> bool:
    """Give misses the motion of a background that is infinitely far, in place; whether any was
    given.

    motion: (height, width, 2); depth: (height, width, 1), along the view axis, misses 1e10. Cycles
    writes zeros where a ray hits nothing, even under a camera that turns. The surfaces show how the
    background moves: a point (x, y, 1) at depth z was at H (x, y, 1) + e / z, where H is the
    homography of the plane at infinity and e the epipole (Hartley and Zisserman, Multiple View
    Geometry, 2nd edition, 13.4). The fit gives little weight to things that move by themselves.
    Misses that have motion keep it, and NaN is none. Nothing is filled where the fit is not sure,
    or where many misses have motion: fog is seen there, and it moves like something nearer.
    """
    height, width = motion.shape[:2]
    depth = depth.reshape(height, width)
    beyond = np.flatnonzero(depth >= DEPTH_MISS)
    stored = motion.reshape(-1, 2)[beyond]
    unmoved = beyond[((stored == 0) | np.isnan(stored)).all(axis=1)]
    if unmoved.size < max(_LEAST_UNMOVED * beyond.size, 1):
        return False
    step = max(1, round(math.sqrt(depth.size / _POINTS)))
    thin = depth[::step, ::step]
    is_known = np.isfinite(motion[::step, ::step]).all(axis=-1)
    places = step * np.argwhere((thin > 0) & (thin < DEPTH_MISS) & is_known)
    rows, columns = places[:, 0], places[:, 1]
    moved = motion[rows, columns].astype(np.float64)
    if rows.size < _LEAST_POINTS or np.abs(moved).max() < _STILL_PX:
        return False
    missed = np.zeros(depth.shape, bool)
    missed.reshape(-1)[unmoved] = True
    now = centre_positions(rows, columns, height, width)
    near = np.median(depth[rows, columns]) / depth[rows, columns].astype(np.float64)
    found, covariance, error, share = fit_camera(now, now[:, :2] + moved / width, near, 1 / width)
    places = np.argwhere(missed[::step, ::step])
    now = centre_positions(step * places[:, 0], step * places[:, 1], height, width)
    across = camera_equations(now, np.stack(apply_homography(found, now[:, 0], now[:, 1]), -1),
                              np.zeros(len(now)))
    doubt = (float(np.sqrt(np.einsum("ij,jk,ik->i", across, covariance, across)).max(initial=0))
             * width)
    if share < _LEAST_FITTING or max(error, doubt) > _MOST_ERROR_PX or skew_of(found) > _MOST_SKEW:
        return False
    columns = centre_positions(np.zeros(width), np.arange(width), height,
                               width)[None, :, 0].astype(np.float32)
    rows = centre_positions(np.arange(height), np.zeros(height), height,
                            width)[:, 1, None].astype(np.float32)
    for first in range(0, height, _ROWS):  # so few rows that they stay in the cache
        some = slice(first, first + _ROWS)
        if missed[some].any():
            x, y = np.broadcast_arrays(columns, rows[some])
            earlier = apply_homography(found.astype(np.float32), x, y)
            for axis, (before, here) in enumerate(zip(earlier, (x, y), strict=True)):
                np.copyto(motion[some, :, axis], (before - here) * width, where=missed[some],
                          casting="same_kind")
    return True


# The option --depth -------------------------------------------------------------------------------

DEPTH_KIND_WORDS = {
    "planar": ("planar", False),
    "ray": ("ray", False),
    "device": ("device", False),
    "reversed": ("device", True),
    "normalised": ("normalised", False),
    "normalised-reversed": ("normalised", True),
}
"""Words of `--depth` -> kind of the plane, and whether near is 1 instead of 0."""

_NUMBERS = ("near", "far", "fov", "miss", "scale")
_ENDLESS = ("far", "miss")


@dataclass(frozen=True)
class DepthOption:
    """What a depth plane holds. Numbers that are None come from headers or the profile.

    Attributes:
        kind: planar, ray, device or normalised, as in profiles.
        reversed: whether device or normalised depth is 1 at the near plane.
        near, far: distances of the planes; without a far plane of a device it is infinitely far.
        fov: horizontal field of view in degrees, for ray distance.
        miss: stored value of pixels that hit nothing.
        scale: factor of stored values, such as -1 for the z of a camera that looks along -z.
    """

    kind: str
    reversed: bool
    near: float | None = None
    far: float | None = None
    fov: float | None = None
    miss: float | None = None
    scale: float | None = None

    def rule(self, rule: PlaneRule) -> PlaneRule:
        """A profile's rule for depth, with this in place of its own meaning."""
        scale = (1.0,) if self.scale is None else (self.scale,)
        return replace(rule, kind=self.kind, reversed=self.reversed, miss=self.miss, scale=scale,
                       offset=(0.0,))

    def camera(self, camera: Camera) -> Camera:
        """A header's camera, with the numbers given here in place of its own."""
        return replace(
            camera,
            near=camera.near if self.near is None else self.near,
            far=camera.far if self.far is None else self.far,
            fov_x=camera.fov_x if self.fov is None else self.fov,
        )


HALF_TURN = 180.0
"""Degrees: every field of view is smaller."""


def parse_depth(text: str) -> DepthOption:
    """Option of a text: one of `DEPTH_KIND_WORDS`, then near=, far=, fov= (degrees), miss= or
    scale=, parted by commas.

    'reversed,near=0.1' is a reversed depth buffer with an infinite far plane,
    'device,near=0.1,far=100' a usual one, 'ray,fov=54.4,miss=0' the distance from the eye. Raises
    DepthOptionError for anything else.
    """
    kind, *pairs = [word.strip() for word in text.split(",")]
    if kind not in DEPTH_KIND_WORDS:
        raise DepthOptionError(f"depth '{text}'{offer(kind, DEPTH_KIND_WORDS, 'begin with')}")
    numbers: dict[str, float] = {}
    for pair in pairs:
        name, _, value = pair.partition("=")
        if name in numbers:
            raise DepthOptionError(f"depth '{text}': {name} is given twice: give it once")
        try:
            numbers[name] = float(value)
        except ValueError:
            raise DepthOptionError(f"depth '{text}': '{pair}' is not a number after "
                                   f"{'=, '.join(_NUMBERS)}=") from None
        endless = math.isinf(numbers[name]) and name in _ENDLESS
        if not (math.isfinite(numbers[name]) or endless) or (name == "scale" and not numbers[name]):
            raise DepthOptionError(f"depth '{text}': {name} cannot be {value}")
        if name == "fov" and not 0 < numbers[name] < HALF_TURN:
            raise DepthOptionError(f"depth '{text}': fov cannot be {value}: give degrees between 0 "
                                   "and 180")
    unknown = sorted(set(numbers) - set(_NUMBERS))
    if unknown:
        raise DepthOptionError(f"depth '{text}': unknown '{unknown[0]}'"
                               f"{offer(unknown[0], _NUMBERS)}")
    near, far, fov, miss, scale = map(numbers.get, _NUMBERS)
    return DepthOption(*DEPTH_KIND_WORDS[kind], near, far, fov, miss, scale)


def missing_number(rule: PlaneRule, camera: Camera) -> str | None:
    """What is needed to convert a depth plane and not known: 'near', 'far' or 'fov'; None when
    nothing is."""
    if rule.kind == "ray":
        is_known = camera.fov_x is not None and 0 < camera.fov_x < HALF_TURN
        return None if is_known else "fov"
    if rule.kind in ("device", "normalised") and camera.near is None:
        return "near"
    return "far" if rule.kind == "normalised" and camera.far is None else None


def missing_error(path: object, names: str, rule: PlaneRule, number: str) -> ProfileError:
    """The error for a number that a depth plane needs, and how to give it."""
    meaning = {"ray": "distance from the eye", "device": "a depth buffer",
               "normalised": "normalised"}[rule.kind]
    wanted = {"near": "near plane", "far": "far plane", "fov": "horizontal field of view"}[number]
    key = "fov_x" if number == "fov" else number
    return ProfileError(
        f"{path}: AOV 'depth' ({names}) is {meaning} and its {wanted} is not known: give {number}= "
        f"after --depth, {key} under [camera] in a profile, or the header postfx:{_header(key)}"
    )


def _header(key: str) -> str:
    return "fovX" if key == "fov_x" else key
