"""Sequences broken on purpose: each integration mistake as a function of frames, and the code it must be found by."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from postfx.doctor.geometry import fit_rotation, rays
from postfx.frame import DEPTH_MISS, Frame, Role
from postfx.sampling import local_mean
from tests.doctor import covers

Frames = list[Frame]
Change = Callable[[np.ndarray, Frame], np.ndarray]
GARAGE_FOV = 76.0  # the renderer's files do not say it; about that of its camera


@dataclass(frozen=True)
class Breakage:
    """One mistake.

    Attributes:
        name: what was done, in words.
        code: finding that must name it.
        role: the role of that finding.
        apply: frames -> broken frames, or None where the sequence lacks what is to be broken.
        consequences: other errors that rightly follow from it.
    """

    name: str
    code: str
    role: str
    apply: Callable[[Frames], Frames | None]
    consequences: tuple[str, ...] = ()


def plane(role: Role, change: Change, *needs: str) -> Callable[[Frames], Frames | None]:
    """Changes one plane of every frame; None where it or an attribute named in `needs` is absent."""

    def apply(frames: Frames) -> Frames | None:
        if role not in frames[0] or any(getattr(frames[0], name) is None for name in needs):
            return None
        return [replace(f, planes={**f.planes, role: change(f[role], f).astype(np.float32)}) for f in frames]

    return apply


def noise(size: float) -> Change:
    def add(pixels: np.ndarray, frame: Frame) -> np.ndarray:
        return np.abs(pixels + np.random.default_rng(frame.number).normal(0, size, pixels.shape) * (pixels > 0))

    return add


def lit(pixels: np.ndarray, frame: Frame) -> np.ndarray:
    return np.clip(frame[Role.COLOUR], 0, 1)


def base_colour(pixels: np.ndarray, frame: Frame) -> np.ndarray:
    return np.where(frame[Role.SPECULAR_ALBEDO].max(2, keepdims=True) > 0.5, frame[Role.SPECULAR_ALBEDO], pixels)


def base_colour_of_metal(frames: Frames) -> Frames | None:
    if (frames[0][Role.SPECULAR_ALBEDO].max(2) > 0.5).mean() < 0.01:
        return None
    return plane(Role.DIFFUSE_ALBEDO, base_colour)(frames)


def camera_space(pixels: np.ndarray, frame: Frame) -> np.ndarray:
    if frame.world_to_camera is not None:
        return pixels @ frame.world_to_camera[:3, :3]
    return pixels @ fit_rotation(frame).matrix.T


def hits(change: Change, miss: float = DEPTH_MISS) -> Change:
    """Changes depth where something was hit, and stores `miss` elsewhere."""
    return lambda pixels, frame: np.where(pixels < DEPTH_MISS, change(pixels.astype(np.float64), frame), miss)


def ray_distance(depth: np.ndarray, frame: Frame) -> np.ndarray:
    ray = rays(frame, frame.fov_x or GARAGE_FOV, *np.indices(depth.shape[:2]))
    return depth * np.linalg.norm(ray, axis=-1, keepdims=True)


def depth_buffer(depth: np.ndarray, frame: Frame, near: float = 0.1, far: float = 100.0) -> np.ndarray:
    return (far - near * far / depth) / (far - near)


def with_misses(frames: Frames) -> Frames | None:
    if not (frames[0][Role.DEPTH] >= DEPTH_MISS).mean() > 0.005:
        return None
    return plane(Role.DEPTH, hits(lambda depth, frame: depth, 0.0))(frames)


def per_image(part: float, offset: float = 0.0) -> Change:
    return lambda pixels, frame: pixels * part / np.float32((frame.spec.width, frame.spec.height)) + offset


def jittered_motion(frames: Frames) -> Frames | None:
    if not any(any(frame.jitter) for frame in frames):
        return None
    changes = [np.zeros(2), *(np.subtract(b.jitter, a.jitter) for a, b in zip(frames, frames[1:], strict=False))]
    return [replace(frame, planes={**frame.planes, Role.MOTION: frame[Role.MOTION] + change.astype(np.float32)})
            for frame, change in zip(frames, changes, strict=True)]


def jitter(x: float, y: float) -> Callable[[Frames], Frames | None]:
    def apply(frames: Frames) -> Frames | None:
        if not any(any(frame.jitter) for frame in frames):
            return None
        return [replace(frame, jitter=(x * frame.jitter[0], y * frame.jitter[1])) for frame in frames]

    return apply


def unused_jitter(frames: Frames) -> Frames | None:
    if any(any(frame.jitter) for frame in frames):
        return None
    positions = np.random.default_rng(3).uniform(-0.5, 0.5, (len(frames), 2))
    return [replace(frame, jitter=tuple(at)) for frame, at in zip(frames, positions, strict=True)]


def mirrored_second_half(frames: Frames) -> Frames:
    """A cut: from the third frame on everything is mirrored upside down, with motion that fits among those frames."""
    return frames[:2] + [_upside_down(frame) for frame in frames[2:]]


def _upside_down(frame: Frame) -> Frame:
    planes = {role: np.ascontiguousarray(pixels[::-1, ::-1]) for role, pixels in frame.planes.items()}
    planes[Role.MOTION] = -planes[Role.MOTION]
    matrix = frame.world_to_camera
    turned = None if matrix is None else matrix @ np.diag([-1, -1, 1, 1])
    return replace(frame, planes=planes, jitter=(-frame.jitter[0], -frame.jitter[1]), world_to_camera=turned)


def without(role: Role) -> Callable[[Frames], Frames | None]:
    def apply(frames: Frames) -> Frames | None:
        if role not in frames[0]:
            return None
        return [replace(f, planes={r: pixels for r, pixels in f.planes.items() if r != role}) for f in frames]

    return apply


def fixed_seed(frames: Frames) -> Frames:
    """The first frame's noise, as a factor on the local mean, in every frame."""
    factor = frames[0][Role.COLOUR] / np.maximum(local_mean(frames[0][Role.COLOUR], 2), 1e-3)
    return [replace(f, planes={**f.planes, Role.COLOUR: (local_mean(f[Role.COLOUR], 2) * factor).astype(np.float32)})
            for f in frames]


def transposed(frames: Frames) -> Frames | None:
    if frames[0].world_to_camera is None:
        return None
    return [replace(frame, world_to_camera=frame.world_to_camera.T) for frame in frames]


def other_fov(frames: Frames) -> Frames | None:
    return None if frames[0].fov_x is None else [replace(frame, fov_x=frame.fov_x / 2) for frame in frames]


def reset_everywhere(frames: Frames) -> Frames:
    return [replace(frame, reset=True) for frame in frames]


def added(role: Role, make: Callable[[Frame], np.ndarray]) -> Callable[[Frames], Frames]:
    """A plane that no sequence has."""
    return lambda frames: [replace(f, planes={**f.planes, role: make(f).astype(np.float32)}) for f in frames]


def inverted_mask(frame: Frame) -> np.ndarray:
    mask = np.ones_like(frame[Role.COLOUR][..., :1])
    mask[10:20, 10:20] = 0
    return mask


def other_samples(frame: Frame) -> np.ndarray:
    """Colour before transparency with as much noise of its own as a few samples leave."""
    colour = frame[Role.COLOUR]
    return colour * np.random.default_rng(frame.number).gamma(0.5, 2.0, colour.shape)


def holes(pixels: np.ndarray, frame: Frame) -> np.ndarray:
    broken = pixels.copy()
    broken[::7, ::5] = np.nan
    return broken


def times(factor: float | list[float]) -> Change:
    return lambda pixels, frame: pixels * np.float32(factor)


ALBEDO, NORMAL, ROUGH, DEPTH, MOTION = Role.DIFFUSE_ALBEDO, Role.NORMAL, Role.ROUGHNESS, Role.DEPTH, Role.MOTION

BREAKAGES = [
    Breakage("albedo with noise of 0.08", "albedo-noisy", ALBEDO, plane(ALBEDO, noise(0.08)),
             ("albedo-above-one",)),
    Breakage("albedo times 1.8", "albedo-above-one", ALBEDO, plane(ALBEDO, times(1.8))),
    Breakage("noisy colour as albedo", "albedo-is-lit", ALBEDO, plane(ALBEDO, lit)),
    Breakage("base colour of metals as diffuse albedo", "metal-diffuse-bright", ALBEDO, base_colour_of_metal),
    Breakage("normals as (n + 1) / 2", "normal-unsigned", NORMAL, plane(NORMAL, lambda n, f: n / 2 + 0.5)),
    Breakage("normals times 0.5", "normal-length", NORMAL, plane(NORMAL, times(0.5))),
    Breakage("normals in camera space", "normal-camera-space", NORMAL, plane(NORMAL, camera_space)),
    Breakage("normals negated", "normal-inverted", NORMAL, plane(NORMAL, times(-1), "world_to_camera")),
    Breakage("squared roughness", "roughness-squared", ROUGH, plane(ROUGH, lambda r, f: r * r)),
    Breakage("root of roughness", "roughness-root", ROUGH, plane(ROUGH, lambda r, f: np.sqrt(r))),
    Breakage("smoothness", "roughness-smoothness", ROUGH, plane(ROUGH, lambda r, f: 1 - r)),
    Breakage("1 / depth, misses 0", "depth-reversed", DEPTH, plane(DEPTH, hits(lambda d, f: 1 / d, 0.0))),
    Breakage("1 - depth / 40, misses 0", "depth-reversed", DEPTH, plane(DEPTH, hits(lambda d, f: 1 - d / 40, 0.0))),
    Breakage("depth buffer 0..1, misses 1", "depth-hyperbolic", DEPTH, plane(DEPTH, hits(depth_buffer, 1.0))),
    Breakage("ray distance", "depth-ray", DEPTH, plane(DEPTH, hits(ray_distance))),
    Breakage("depth negated", "depth-negative", DEPTH, plane(DEPTH, hits(lambda d, f: -d))),
    Breakage("misses 0", "depth-miss-zero", DEPTH, with_misses),
    Breakage("motion negated", "motion-sign", MOTION, plane(MOTION, times(-1))),
    Breakage("motion x negated", "motion-sign-x", MOTION, plane(MOTION, times([-1, 1]))),
    Breakage("motion y up", "motion-sign-y", MOTION, plane(MOTION, times([1, -1]))),
    Breakage("motion y, x", "motion-axes", MOTION, plane(MOTION, lambda m, f: m[..., ::-1])),
    Breakage("motion in pixels of the output", "motion-scale", MOTION, plane(MOTION, times(2))),
    Breakage("motion in uv", "motion-scale", MOTION, plane(MOTION, per_image(1))),
    Breakage("motion in -1..1", "motion-scale", MOTION, plane(MOTION, per_image(2))),
    Breakage("motion in uv around 0.5", "motion-encoded", MOTION, plane(MOTION, per_image(1, 0.5))),
    Breakage("motion with jitter", "motion-jitter", MOTION, jittered_motion),
    Breakage("motion all 0", "motion-zero", MOTION, plane(MOTION, times(0))),
    Breakage("jitter header missing", "jitter-missing", "sequence", jitter(0, 0)),
    Breakage("jitter header negated", "jitter-sign", "sequence", jitter(-1, -1)),
    Breakage("jitter header with y up", "jitter-sign", "sequence", jitter(1, -1)),
    Breakage("jitter header with x negated", "jitter-sign", "sequence", jitter(-1, 1)),
    Breakage("jitter header though samples are spread", "jitter-unused", "sequence", unused_jitter),
    Breakage("cut without reset", "cut-unmarked", "sequence", mirrored_second_half),
    Breakage("reset in every frame", "reset-needless", "sequence", reset_everywhere),
    Breakage("the same noise in every frame", "samples-correlated", Role.COLOUR, fixed_seed),
    Breakage("no albedo", "missing-diffuse-albedo", ALBEDO, without(ALBEDO)),
    Breakage("no motion", "missing-motion", MOTION, without(MOTION)),
    Breakage("colour times 16, exposure header kept", "exposure-mismatch", "sequence",
             plane(Role.COLOUR, times(16), "exposure")),
    Breakage("NaN in colour", "not-finite", Role.COLOUR, plane(Role.COLOUR, holes)),
    Breakage("negative colour", "negative", Role.COLOUR, plane(Role.COLOUR, lambda c, f: c - np.float32(0.05))),
    Breakage("colour clipped at 1", "colour-clipped", Role.COLOUR, plane(Role.COLOUR, lambda c, f: np.clip(c, 0, 1))),
    Breakage("mask of particles inverted", "reactive-everywhere", Role.REACTIVE, added(Role.REACTIVE, inverted_mask)),
    Breakage("opaque colour of other samples", "opaque-samples", Role.OPAQUE_COLOUR,
             added(Role.OPAQUE_COLOUR, other_samples)),
    Breakage("worldToCamera for column vectors", "matrix-transposed", "sequence", transposed),
    Breakage("overlay of straight colour", "overlay-straight", Role.OVERLAY, covers.over(covers.straight)),
    Breakage("overlay with alpha in percent", "overlay-alpha", Role.OVERLAY, covers.over(covers.in_percent)),
    Breakage("overlay with its background", "overlay-opaque", Role.OVERLAY, covers.over(covers.opaque)),
    Breakage("overlay in the colour already", "overlay-twice", Role.OVERLAY, covers.composited,
             ("samples-correlated",)),
    Breakage("colour with and without transparents, no overlay", "overlay-missing", Role.OVERLAY, covers.two_colours),
    Breakage("half the field of view", "fov-mismatch", "sequence", other_fov),
]
