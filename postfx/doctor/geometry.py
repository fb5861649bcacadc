"""Surfaces as depth describes them, and whether the other planes agree.

Depth gives normals in camera space and view angles; with two cameras it gives motion too. Stored
depth, normals and roughness can each mean several things; the meaning that fits the other planes is
the right one. Camera space here is the picture's: x right, y down, z along the view axis.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from postfx.depth import ray_slopes
from postfx.doctor import finite, largest
from postfx.errors import IntegrationError
from postfx.frame import DEPTH_MISS, Frame, Role, pixel_aspect
from postfx.integrate.camera import motion_from_depth, perspective, project, view_rays
from postfx.integrate.surfaces import split_sum

CAMERA_AXES = tuple(map(np.diag,
                        ((-1.0, -1.0, 1.0), (1.0, -1.0, -1.0), (1.0, -1.0, 1.0), (1.0, 1.0, 1.0))))
"""Matrices to the picture's axes from the axes that worldToCamera may have: x left, y up, z
forward; x right, y up, z back; x right, y up, z forward; x right, y down, z forward."""
NEIGHBOUR_STEP_PX = 2

# Largest relative difference in depth between neighbours on one surface, and largest second
# difference.
LARGEST_DEPTH_STEP = 0.05
LARGEST_DEPTH_BEND = 0.01

PLANE_POINTS = 5000
"""Points that a rotation is fitted to, at most; below the next number none is."""
FEWEST_FITTED_POINTS = 500
LIKELY_FOV_DEGREES = tuple(range(20, 121, 10))
"""Horizontal fields of view that are tried where the header gives none."""
AGREEING = 0.75
"""Share of the points that a fit must explain."""
ONE_LENGTH = 0.2
"""Normals are scaled, not averaged, when more than this share of them has the greatest length."""
SAME_AXES_DEGREES = 3.0  # degrees
NEAR_PLANES = tuple(0.0025 * 1.6**step for step in range(12))
"""Distances of the near plane that are tried for scaled depth, in parts of the far plane's."""
DEPTH_SCALES = 10.0 ** np.linspace(-5, 5, 161)
"""Factors on depth that are tried to explain motion by the cameras."""
SCALE_POINTS = 1000
"""Points that they are tried with."""
RIGHT_SCALE_ERROR = 0.05
"""Difference from the cameras' motion, in parts of the motion, with which depth needs no factor."""


class Points(NamedTuple):
    """Pixels inside smooth surfaces."""

    rows: np.ndarray
    columns: np.ndarray


class Fit(NamedTuple):
    """An orthogonal matrix that turns normals computed from depth into the stored ones (row
    vectors).

    `angle`: degrees within which three quarters of the normals agree; `fov_x`: the field of view
    that was assumed.
    """

    matrix: np.ndarray
    angle: float
    fov_x: float


class DepthScale(NamedTuple):
    """How the cameras' motion differs from the stored motion; lengths are medians in pixels.

    Attributes:
        scale: factor on depth that fits best.
        error, error_as_it_is: differences with this factor and without it.
        length: length of the longer of the two motions.
        factor: factor on the cameras' motion that fits the stored motion best.
        rest: difference that remains with `factor`.
        axes: of `CAMERA_AXES`, those by which the cameras come nearest to the stored motion.
    """

    scale: float
    error: float
    error_as_it_is: float
    length: float
    factor: float
    rest: float
    axes: np.ndarray


def is_hit(depth: np.ndarray) -> np.ndarray:
    """(height, width): whether a pixel shows a surface at a positive distance."""
    result: np.ndarray = (np.isfinite(depth[..., 0]) & (depth[..., 0] > 0)
                          & (depth[..., 0] < DEPTH_MISS))
    return result


def rays(frame: Frame, fov_x: float, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """(..., 3) directions through the samples of pixels, with z = 1; fov_x in degrees."""
    spec = frame.spec
    size = spec.width, spec.height
    x, y = ray_slopes(columns, rows, size, fov_x, frame.jitter, pixel_aspect(frame.metadata))
    return np.stack([x, y, np.ones_like(x)], -1)


def smooth_points(depth: np.ndarray) -> Points:
    """Up to 5000 pixels whose neighbours two pixels away lie on the same surface."""
    z = np.where(is_hit(depth), depth[..., 0], np.nan).astype(np.float64)
    if min(z.shape) < 2 * NEIGHBOUR_STEP_PX + 1:
        return Points(np.zeros(0, int), np.zeros(0, int))
    middle = z[NEIGHBOUR_STEP_PX:-NEIGHBOUR_STEP_PX, NEIGHBOUR_STEP_PX:-NEIGHBOUR_STEP_PX]
    left = z[NEIGHBOUR_STEP_PX:-NEIGHBOUR_STEP_PX, : -2 * NEIGHBOUR_STEP_PX]
    right = z[NEIGHBOUR_STEP_PX:-NEIGHBOUR_STEP_PX, 2 * NEIGHBOUR_STEP_PX :]
    up = z[: -2 * NEIGHBOUR_STEP_PX, NEIGHBOUR_STEP_PX:-NEIGHBOUR_STEP_PX]
    down = z[2 * NEIGHBOUR_STEP_PX :, NEIGHBOUR_STEP_PX:-NEIGHBOUR_STEP_PX]
    with np.errstate(invalid="ignore"):
        # a step to one side only is an edge
        smooth = np.abs(left + right - 2 * middle) < LARGEST_DEPTH_BEND * middle
        smooth &= np.abs(up + down - 2 * middle) < LARGEST_DEPTH_BEND * middle
        smooth &= ((np.abs(left - right) < 2 * LARGEST_DEPTH_STEP * middle)
                   & (np.abs(up - down) < 2 * LARGEST_DEPTH_STEP * middle))
    rows, columns = np.nonzero(smooth)
    chosen = np.random.default_rng(4).permutation(rows.size)[:PLANE_POINTS]
    return Points(rows[chosen] + NEIGHBOUR_STEP_PX, columns[chosen] + NEIGHBOUR_STEP_PX)


def normals_of_depth(frame: Frame, fov_x: float, points: Points) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals (count, 3) that face the viewer, and cosines (count,) between them and the way
    to the eye."""
    z = frame[Role.DEPTH][..., 0].astype(np.float64)

    def place(down: int, right: int) -> np.ndarray:
        rows, columns = points.rows + down, points.columns + right
        result: np.ndarray = rays(frame, fov_x, rows, columns) * z[rows, columns][:, None]
        return result

    normal = np.cross(place(0, NEIGHBOUR_STEP_PX) - place(0, -NEIGHBOUR_STEP_PX),
                      place(NEIGHBOUR_STEP_PX, 0) - place(-NEIGHBOUR_STEP_PX, 0))
    normal /= np.maximum(lengths_of(normal), 1e-30)[..., None]
    ray = rays(frame, fov_x, points.rows, points.columns)
    towards = -dots(normal, ray) / lengths_of(ray)
    return normal * np.sign(towards)[:, None], np.abs(towards)


def unit_normals(frame: Frame, points: Points) -> np.ndarray:
    """Stored normals (count, 3) scaled to length 1; (0, 0, 0) where there are none."""
    normal = finite(frame[Role.NORMAL][points.rows, points.columns]).astype(np.float64)
    length = lengths_of(normal)[..., None]
    return np.where(length > 0.1, normal / np.maximum(length, 0.1), 0)


def surface_normals(frame: Frame) -> np.ndarray:
    """(count, 3) stored normals that are finite and not zero; only those of hits if the frame has
    depth."""
    normal = finite(frame[Role.NORMAL])
    used = largest(np.abs(normal)) > 0
    hit = is_hit(frame[Role.DEPTH]) if Role.DEPTH in frame else used
    result: np.ndarray = normal[used & hit] if hit.any() else normal[used]
    return result


def lengths_of(vectors: np.ndarray) -> np.ndarray:
    """Lengths along the last axis."""
    result: np.ndarray = np.sqrt(dots(vectors, vectors))
    return result


def dots(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Scalar products along the last axis, in a fifth of the time of (a * b).sum(-1)."""
    result: np.ndarray = np.einsum("...i,...i->...", a, b)
    return result


def are_unit(normals: np.ndarray) -> bool:
    """Whether the median length is 1 within 3 %."""
    return len(normals) > 0 and 0.97 < float(np.median(lengths_of(normals))) < 1.03


def are_scaled(normals: np.ndarray) -> bool:
    """Whether most normals share one length that is not 1. Means of unit normals have many lengths,
    up to 1."""
    lengths = lengths_of(normals)
    longest = float(np.percentile(lengths, 99.5)) if lengths.size else 1.0
    if longest > 1.03:
        return True
    return longest < 0.97 and float(np.mean(lengths > 0.98 * longest)) > ONE_LENGTH


def is_unsigned(frame: Frame) -> bool:
    """Whether normals are stored as (n + 1) / 2."""
    normal = surface_normals(frame) if Role.NORMAL in frame else np.zeros((0, 3))
    if not len(normal) or np.percentile(normal, 0.1) < -0.01 or normal.max() > 1.01:
        return False
    return are_unit(2 * normal - 1) and not are_unit(normal)


def fit_rotation(frame: Frame, views: Sequence[float] = ()) -> Fit | None:
    """The orthogonal matrix between the normals of depth and the stored ones; None without enough
    smooth surfaces.

    `views` are the fields of view to try: by default the frame's, else all likely ones. The best
    fit is returned. Orthogonal Procrustes (Schoenemann 1966), repeated without the worst quarter.
    """
    points = smooth_points(frame[Role.DEPTH])
    stored = unit_normals(frame, points)
    there = stored.any(-1)
    if there.sum() < FEWEST_FITTED_POINTS:
        return None
    points, stored = Points(points.rows[there], points.columns[there]), stored[there]
    views = views or ((frame.fov_x,) if frame.fov_x else LIKELY_FOV_DEGREES)
    return min((_procrustes(normals_of_depth(frame, view, points)[0], stored, view)
                for view in views),
               key=lambda fit: fit.angle)


def angle_by(frame: Frame, fov_x: float, matrix: np.ndarray) -> float:
    """Degrees within which three quarters of the stored normals agree with the normals of depth
    times `matrix`."""
    points = smooth_points(frame[Role.DEPTH])
    stored = unit_normals(frame, points)
    cosines = dots(normals_of_depth(frame, fov_x, points)[0] @ matrix, stored)[stored.any(-1)]
    return float(np.degrees(np.arccos(np.clip(np.quantile(cosines, 1 - AGREEING), -1, 1))))


def motion_of_camera(before: Frame, now: Frame) -> np.ndarray | None:
    """Motion (count, 2) in pixels that the cameras alone cause at up to 5000 surface points; None
    without cameras.

    Points behind the earlier camera have `postfx.integrate.camera.OUT_OF_SIGHT`.
    """
    if now.fov_x is None or before.fov_x is None or Role.DEPTH not in now:
        return None
    if now.world_to_camera is None or before.world_to_camera is None:
        return None
    points, fit = smooth_points(now[Role.DEPTH]), fit_depth_scale(before, now)
    axes = CAMERA_AXES[0] if fit is None else fit.axes
    try:
        cameras = _world_to_clip(now, axes), _world_to_clip(before, axes)
        motion = motion_from_depth(now[Role.DEPTH], *cameras, now.jitter)
    except IntegrationError:  # a matrix of zeros, or an angle that no camera has
        return None
    result: np.ndarray = motion[points.rows, points.columns]
    return result


def world_axes(frame: Frame) -> list[np.ndarray]:
    """Matrices from the picture's axes to the world's, one for each of `CAMERA_AXES`; none without
    a camera."""
    if frame.world_to_camera is None:
        return []
    rotation = frame.world_to_camera[:3, :3]
    rotation = rotation / np.maximum(np.linalg.norm(rotation, axis=0, keepdims=True), 1e-12)
    return [(rotation @ axes).T for axes in CAMERA_AXES]


def explain_by_camera(frame: Frame, fit: Fit) -> np.ndarray | None:
    """The header's matrix, if it turns the normals of depth into the stored ones nearly as well as
    the best fit does.

    Where one plane fills the picture, the best fit may be turned about that plane's normal.
    """
    found = {angle_by(frame, fit.fov_x, matrix): matrix for matrix in world_axes(frame)}
    return found[min(found)] if found and min(found) < fit.angle + SAME_AXES_DEGREES else None


def fit_depth_scale(before: Frame, now: Frame) -> DepthScale | None:
    """The factor on depth with which the cameras explain the stored motion best, by the axes that
    they have likely; None without cameras or surfaces."""
    if now.fov_x is None or before.fov_x is None or Role.DEPTH not in now or Role.MOTION not in now:
        return None
    points = smooth_points(now[Role.DEPTH])
    if (now.world_to_camera is None or before.world_to_camera is None
        or points.rows.size < FEWEST_FITTED_POINTS):
        return None
    chosen = Points(points.rows[:SCALE_POINTS], points.columns[:SCALE_POINTS])
    try:
        fits = [_fit_depth_scale(before, now, axes, chosen) for axes in CAMERA_AXES]
    except IntegrationError:  # a matrix of zeros, or an angle that no camera has
        return None
    return min(fits, key=lambda fit: min(fit.error, fit.error_as_it_is, fit.rest))


def _fit_depth_scale(before: Frame, now: Frame, axes: np.ndarray, chosen: Points) -> DepthScale:
    """The same for cameras with these axes, by some points."""
    width, height = now.spec.width, now.spec.height
    clip, earlier = _world_to_clip(now, axes), _world_to_clip(before, axes)
    eye, directions = view_rays(width, height, clip, now.jitter)
    way = directions[chosen] * now[Role.DEPTH][chosen].astype(np.float64)
    at = np.stack([chosen.columns, chosen.rows], -1) + 0.5 + np.asarray(now.jitter)
    stored = now[Role.MOTION][chosen]

    def motion(scale: float) -> np.ndarray:
        result: np.ndarray = np.nan_to_num(project(eye + scale * way, earlier, width, height) - at,
                                           nan=1e4)
        return result

    def error(scale: float) -> float:
        return _typical_length(motion(scale) - stored)

    camera = motion(1.0)
    factor = float(np.vdot(camera, stored) / max(float(np.vdot(camera, camera)), 1e-12))
    as_it_is = error(1.0)
    rest = _typical_length(factor * camera - stored)
    length = max(_typical_length(stored), _typical_length(camera))
    scale = 1.0 if as_it_is < RIGHT_SCALE_ERROR * length else float(min(DEPTH_SCALES, key=error))
    return DepthScale(scale, error(scale), as_it_is, length, factor, rest, axes)


def _typical_length(vectors: np.ndarray) -> float:
    return float(np.median(lengths_of(vectors)))


def _world_to_clip(frame: Frame, axes: np.ndarray) -> np.ndarray:
    """Of the frame's camera, which it must know, with axes of `CAMERA_AXES`. Raises
    IntegrationError for an angle that no camera has."""
    assert frame.world_to_camera is not None and frame.fov_x is not None
    x, y, z = ("-" if sign < 0 else "+" for sign in np.diag(axes) * (1, -1, 1))
    to_clip = perspective(frame.fov_x, frame.spec.width, frame.spec.height, right=f"{x}x",
                          up=f"{y}y", forward=f"{z}z", pixel_aspect=pixel_aspect(frame.metadata))
    matrix: np.ndarray = frame.world_to_camera @ to_clip
    return matrix


def _procrustes(seen: np.ndarray, stored: np.ndarray, fov_x: float) -> Fit:
    keep = np.ones(len(seen), bool)
    for _ in range(4):
        u, _, v = np.linalg.svd(seen[keep].T @ stored[keep])
        cosines = dots(seen @ (u @ v), stored)
        worst = np.quantile(cosines, 1 - AGREEING)
        keep = cosines >= worst
    return Fit(u @ v, float(np.degrees(np.arccos(np.clip(worst, -1, 1)))), fov_x)


@dataclass(frozen=True)
class DepthKind:
    """What stored depth may mean, and how depth along the view axis follows from it.

    `planar` takes stored values (height, width) and the cosine between ray and axis, and returns
    depth. A kind that is `in_unit` makes sense for values within 0..1 only.
    """

    code: str
    name: str
    cause: str
    fix: str
    planar: Callable[[np.ndarray, np.ndarray], np.ndarray]
    in_unit: bool = False


def _unscale(near: float) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Depth, in units of the far plane, from depth that was scaled to 0..1 between the near and the
    far plane."""
    return lambda d, cosine: near + d * (1 - near)


DEPTH_VARIANTS = (
    DepthKind("", "depth along the view axis", "", "", lambda d, cosine: d),
    DepthKind("depth-ray", "distance from the eye",
              "ray distance was written instead of depth along the view axis",
              "multiply by the cosine between ray and axis, or give --depth ray,fov=DEGREES (in a "
              "profile kind = \"ray\" and fov_x)", lambda d, cosine: d * cosine),
    DepthKind("depth-reversed", "1 / depth (near large, far 0)",
              "reversed depth buffer or disparity",
              "write linear depth: near / value of a reversed buffer, or give --depth "
              "reversed,near=DISTANCE", lambda d, cosine: 1 / d),
    DepthKind("depth-hyperbolic", "a depth buffer 0..1", "the depth buffer was written as it is",
              "write linear depth: near far / (far - value (far - near)), or give --depth "
              "device,near=...,far=...", lambda d, cosine: 1 / (1 - d), True),
    *(DepthKind("depth-normalised",
                f"(depth - near) / (far - near) with near about {near:.2g} times far",
                "depth was scaled to 0..1 between a near and a far distance",
                "write depth in scene units: near + value (far - near), or give --depth "
                "normalised,near=...,far=...", _unscale(near), True) for near in NEAR_PLANES),
    DepthKind("depth-reversed", "1 - depth / far (near 1, far 0)",
              "depth scaled to 0..1 with near white",
              "write depth in scene units: (1 - value) far, or give --depth "
              "normalised-reversed,near=0,far=...", lambda d, cosine: 1 - d, True),
)


def fit_depth_kinds(frame: Frame) -> dict[DepthKind, Fit]:
    """How well normals agree with each kind of depth that can be tried; empty without normals or
    enough surfaces."""
    if Role.DEPTH not in frame or Role.NORMAL not in frame:
        return {}
    kinds = [kind for kind in DEPTH_VARIANTS if not kind.in_unit or _within_one(frame)]
    fits = {kind: _fit_depth_kind(frame, kind) for kind in kinds}
    return {kind: fit for kind, fit in fits.items() if fit}


def _within_one(frame: Frame) -> bool:
    hit = is_hit(frame[Role.DEPTH])
    return bool(hit.any()) and float(frame[Role.DEPTH][hit].max()) <= 1


def _fit_depth_kind(frame: Frame, kind: DepthKind) -> Fit | None:
    if not kind.code:
        return fit_rotation(frame)
    views: tuple[float | None, ...] = (frame.fov_x,)
    if not frame.fov_x:
        # only a ray's distance depends on the view
        views = LIKELY_FOV_DEGREES if kind.code == "depth-ray" else (None,)
    fits = [fit_rotation(_reread(frame, kind, view)) for view in views]
    return min(filter(None, fits), key=lambda fit: fit.angle, default=None)


def _reread(frame: Frame, kind: DepthKind, fov_x: float | None) -> Frame:
    depth = frame[Role.DEPTH]
    hit = is_hit(depth)
    cosine = np.ones(())
    if fov_x is not None:
        cosine = 1 / lengths_of(rays(frame, fov_x, *np.indices(hit.shape)))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        planar = kind.planar(np.where(hit, depth[..., 0], 0.5).astype(np.float64), cosine)
    planar = np.where(hit & np.isfinite(planar) & (planar > 0), planar, DEPTH_MISS)
    return replace(frame, planes={Role.DEPTH: planar[..., None].astype(np.float32),
                                  Role.NORMAL: frame[Role.NORMAL]},
                   fov_x=fov_x, guides={}, guide_size=None)


Model = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]

# Reflectance at normal incidence that a material may have: from about water's to all.
LEAST_F0 = 0.015
MOST_F0 = 1.0

LEAST_PIXELS = 150
"""Pixels of one roughness that are fitted together, at least."""
LEAST_FIT_ERROR = 2e-4
"""Errors of specular albedo below this count as this: they are rounding."""
FOLLOWS_ANGLE_SHARE = 0.5
"""Specular albedo follows the view angle where the model leaves less than this share of the error
of one that does not."""


@dataclass(frozen=True)
class RoughnessKind:
    """What stored roughness may mean, and how linear roughness follows from it."""

    code: str
    name: str
    cause: str
    fix: str
    linear: Callable[[np.ndarray], np.ndarray]


ROUGHNESS_KINDS = (
    RoughnessKind("", "linear roughness", "", "", lambda stored: stored),
    RoughnessKind("roughness-squared", "squared roughness (alpha)",
                  "alpha of the microfacet model was written",
                  "write the square root of alpha", np.sqrt),
    RoughnessKind("roughness-root", "the square root of roughness",
                  "linear roughness was taken for alpha, or display-encoded",
                  "write it without the square root or transfer curve", np.square),
    RoughnessKind("roughness-smoothness", "smoothness", "smoothness or glossiness was written",
                  "write 1 - smoothness, or in a profile scale = [-1], offset = [-1]",
                  lambda stored: 1 - stored),
    RoughnessKind("roughness-smoothness", "smoothness of squared roughness",
                  "smoothness was written as 1 - alpha",
                  "write the square root of 1 - smoothness", lambda stored: np.sqrt(1 - stored)),
)


@dataclass(frozen=True)
class RoughnessFit:
    """How well each kind of roughness explains specular albedo.

    Split-sum directional albedo (Karis 2014, "Physically based shading on mobile"): specular = F0
    scale + bias, where scale and bias follow from roughness and the cosine of the view angle. On
    surfaces of one material F0 is constant, so with the right kind one F0, no less than water's,
    explains all angles.

    Attributes:
        errors: kind -> median error of specular albedo.
        without_angle: the error of a model in which specular albedo does not depend on the view
            angle.
        pixels: number of pixels used.
    """

    errors: dict[RoughnessKind, float]
    without_angle: float
    pixels: int

    @property
    def as_it_is(self) -> float:
        """Error of the plane as linear roughness."""
        return self.errors[ROUGHNESS_KINDS[0]]

    @property
    def best(self) -> RoughnessKind:
        """The kind with the least error."""
        return min(self.errors, key=lambda kind: self.errors[kind])

    @property
    def is_telling(self) -> bool:
        """Whether specular albedo follows the view angle as the model says; some renderers write
        one that does not."""
        error = max(self.errors[self.best], LEAST_FIT_ERROR)
        return error < FOLLOWS_ANGLE_SHARE * self.without_angle

    @property
    def certainty(self) -> float:
        """0 when the best kind fits no better than the plane as it is, 1 when it leaves no
        error."""
        best = max(self.errors[self.best], LEAST_FIT_ERROR)
        return max(0.0, 1 - best / max(self.as_it_is, LEAST_FIT_ERROR))


def environment_brdf(roughness: np.ndarray, cosine: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Scale and bias of F0 in the directional albedo (Karis 2014); all arrays of one shape,
    0..1."""
    x, y = 1 - roughness, 0.0425 - 0.0275 * roughness
    z, w = 1.04 - 0.572 * roughness, -0.04 + 0.022 * roughness
    a = np.minimum(x * x, np.exp2(-9.28 * cosine)) * x + y
    return z - 1.04 * a, w + 1.04 * a


def fit_roughness(frame: Frame) -> RoughnessFit | None:
    """Errors of all kinds; None without the planes, a field of view or enough smooth surfaces."""
    needed = (Role.SPECULAR_ALBEDO, Role.DEPTH)
    if frame.fov_x is None or any(role not in frame for role in needed):
        return None
    points = smooth_points(frame[Role.DEPTH])
    _, cosine = normals_of_depth(frame, frame.fov_x, points)
    stored = finite(frame[Role.ROUGHNESS])[points.rows, points.columns, 0].astype(np.float64)
    specular = (finite(frame[Role.SPECULAR_ALBEDO])
                .min(2)[points.rows, points.columns].astype(np.float64))
    known = (specular > 0.005) & (stored >= 0) & (stored <= 1) & (cosine > 0.05)
    groups = _groups(stored[known])
    if not groups:
        return None
    values = stored[known], specular[known], cosine[known]
    errors = {kind: _error(kind, groups, *values) for kind in ROUGHNESS_KINDS}
    without = [np.median(np.abs(values[1][group] - np.median(values[1][group])))
               for group in groups]
    sizes = [group.size for group in groups]
    return RoughnessFit(errors, float(np.average(without, weights=sizes)), sum(sizes))


def _groups(stored: np.ndarray) -> list[np.ndarray]:
    """Indices of pixels by groups whose roughness is the same to 1/256; small groups are left
    out."""
    steps = np.rint(stored * 256).astype(int)
    counts = np.bincount(steps, minlength=257)
    return [np.nonzero(steps == step)[0] for step in np.nonzero(counts >= LEAST_PIXELS)[0]]


MODELS = (environment_brdf, split_sum)
"""Renderers use either, and the two differ by more than a wrong kind of roughness may change."""


def _error(kind: RoughnessKind, groups: list[np.ndarray], *planes: np.ndarray) -> float:
    """Error of the model that fits better."""
    return min(_error_by(model, kind, groups, *planes) for model in MODELS)


def _error_by(model: Model, kind: RoughnessKind, groups: list[np.ndarray], stored: np.ndarray,
              specular: np.ndarray, cosine: np.ndarray) -> float:
    """Mean over the groups of the median error of specular albedo, with the F0 that suits most
    pixels."""
    errors = []
    for group in groups:
        scale, bias = model(kind.linear(stored[group]), cosine[group])
        f0 = np.clip(np.median((specular[group] - bias) / scale), LEAST_F0, MOST_F0)
        errors.append(np.median(np.abs(f0 * scale + bias - specular[group])))
    return float(np.average(errors, weights=[group.size for group in groups]))
