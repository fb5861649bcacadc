"""Sequences broken on purpose: each integration mistake as a function of frames, and the code it
must be found by."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from postfx.colour.displays import srgb_encode
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
        frames: how many it takes to find it.
        whole: whether it takes the whole picture to find it, not only the middle.
    """

    name: str
    code: str
    role: str
    apply: Callable[[Frames], Frames | None]
    consequences: tuple[str, ...] = ()
    frames: int = 2
    whole: bool = False


def plane(role: Role, change: Change, *needs: str) -> Callable[[Frames], Frames | None]:
    """Changes one plane of every frame; None where it or an attribute named in `needs` is
    absent."""

    def apply(frames: Frames) -> Frames | None:
        if role not in frames[0] or any(getattr(frames[0], name) is None for name in needs):
            return None
        return [replace(f, planes={**f.planes, role: change(f[role], f).astype(np.float32)})
                for f in frames]

    return apply


def noise(size: float) -> Change:
    def add(pixels: np.ndarray, frame: Frame) -> np.ndarray:
        return np.abs(pixels + np.random.default_rng(frame.number)
                      .normal(0, size, pixels.shape) * (pixels > 0))

    return add


def filtered(pixels: np.ndarray, frame: Frame) -> np.ndarray:
    """As by a gaussian pixel filter of half a pixel."""
    for axis in (0, 1):
        beside = np.roll(pixels, 1, axis) + np.roll(pixels, -1, axis)
        pixels = 0.787 * pixels + 0.1065 * beside
    return pixels


def lit(pixels: np.ndarray, frame: Frame) -> np.ndarray:
    return np.clip(frame[Role.COLOUR], 0, 1)


def base_colour(pixels: np.ndarray, frame: Frame) -> np.ndarray:
    return np.where(frame[Role.SPECULAR_ALBEDO].max(2, keepdims=True) > 0.5,
                    frame[Role.SPECULAR_ALBEDO], pixels)


def base_colour_of_metal(frames: Frames) -> Frames | None:
    if (frames[0][Role.SPECULAR_ALBEDO].max(2) > 0.5).mean() < 0.01:
        return None
    return plane(Role.DIFFUSE_ALBEDO, base_colour)(frames)


def camera_space(pixels: np.ndarray, frame: Frame) -> np.ndarray:
    if frame.world_to_camera is not None:
        return pixels @ frame.world_to_camera[:3, :3]
    fit = fit_rotation(frame)
    assert fit is not None, "normals and depth tell how the camera is turned"
    return pixels @ fit.matrix.T


def hits(change: Change, miss: float = DEPTH_MISS) -> Change:
    """Changes depth where something was hit, and stores `miss` elsewhere."""
    return lambda pixels, frame: np.where(pixels < DEPTH_MISS,
                                          change(pixels.astype(np.float64), frame), miss)


def ray_distance(depth: np.ndarray, frame: Frame) -> np.ndarray:
    ray = rays(frame, frame.fov_x or GARAGE_FOV, *np.indices(depth.shape[:2]))
    return depth * np.linalg.norm(ray, axis=-1, keepdims=True)


def depth_buffer(depth: np.ndarray, frame: Frame, near: float = 0.1,
                 far: float = 100.0) -> np.ndarray:
    return (far - near * far / depth) / (far - near)


def misses_at(value: float) -> Callable[[Frames], Frames | None]:
    def apply(frames: Frames) -> Frames | None:
        if not (frames[0][Role.DEPTH] >= DEPTH_MISS).mean() > 0.005:
            return None
        return plane(Role.DEPTH, hits(lambda depth, frame: depth, value))(frames)

    return apply


def per_image(part: float, offset: float = 0.0) -> Change:
    return (lambda pixels, frame: pixels * part
            / np.array((frame.spec.width, frame.spec.height), np.float32) + offset)


def jittered_motion(frames: Frames) -> Frames | None:
    if not any(any(frame.jitter) for frame in frames):
        return None
    changes = [np.zeros(2),
               *(np.subtract(b.jitter, a.jitter) for a, b in zip(frames, frames[1:], strict=False))]
    return [replace(frame, planes={**frame.planes,
                                   Role.MOTION: frame[Role.MOTION] + change.astype(np.float32)})
            for frame, change in zip(frames, changes, strict=True)]


def jitter(x: float, y: float) -> Callable[[Frames], Frames | None]:
    def apply(frames: Frames) -> Frames | None:
        if not any(any(frame.jitter) for frame in frames):
            return None
        return [replace(frame, jitter=(x * frame.jitter[0], y * frame.jitter[1]))
                for frame in frames]

    return apply


def unused_jitter(frames: Frames) -> Frames | None:
    if any(any(frame.jitter) for frame in frames):
        return None
    positions = np.random.default_rng(3).uniform(-0.5, 0.5, (len(frames), 2))
    return [replace(frame, jitter=tuple(at)) for frame, at in zip(frames, positions, strict=True)]


def mirrored_second_half(frames: Frames) -> Frames:
    """A cut: from the third frame on everything is mirrored upside down, with motion that fits
    among those frames."""
    return frames[:2] + [_upside_down(frame) for frame in frames[2:]]


def _upside_down(frame: Frame) -> Frame:
    planes = {role: np.ascontiguousarray(pixels[::-1, ::-1])
              for role, pixels in frame.planes.items()}
    planes[Role.MOTION] = -planes[Role.MOTION]
    matrix = frame.world_to_camera
    turned = None if matrix is None else matrix @ np.diag([-1, -1, 1, 1])
    return replace(frame, planes=planes, jitter=(-frame.jitter[0], -frame.jitter[1]),
                   world_to_camera=turned)


def without(role: Role) -> Callable[[Frames], Frames | None]:
    def apply(frames: Frames) -> Frames | None:
        if role not in frames[0]:
            return None
        return [replace(f, planes={r: pixels for r, pixels in f.planes.items() if r != role})
                for f in frames]

    return apply


def fixed_seed(frames: Frames) -> Frames:
    """The first frame's noise, as a factor on the local mean, in every frame."""
    factor = frames[0][Role.COLOUR] / np.maximum(local_mean(frames[0][Role.COLOUR], 2), 1e-3)
    return [replace(f, planes={
        **f.planes, Role.COLOUR: (local_mean(f[Role.COLOUR], 2) * factor).astype(np.float32)
    })
            for f in frames]


def transposed(frames: Frames) -> Frames | None:
    return [replace(frame, world_to_camera=frame.world_to_camera.T) for frame in frames
            if frame.world_to_camera is not None] or None


def other_fov(frames: Frames) -> Frames | None:
    return [replace(frame, fov_x=frame.fov_x / 2) for frame in frames
            if frame.fov_x is not None] or None


def reset_everywhere(frames: Frames) -> Frames:
    return [replace(frame, reset=True) for frame in frames]


def added(role: Role, make: Callable[[Frame], np.ndarray]) -> Callable[[Frames], Frames]:
    """A plane that no sequence has."""
    return lambda frames: [replace(f, planes={**f.planes, role: make(f).astype(np.float32)})
                           for f in frames]


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
    return lambda pixels, frame: pixels * np.asarray(factor, np.float32)


def swapped_frames(role: Role, step: int = 1) -> Callable[[Frames], Frames | None]:
    """The plane of a later frame, or of an earlier one, in every frame."""

    def apply(frames: Frames) -> Frames | None:
        if role not in frames[0]:
            return None
        return [replace(frame,
                        planes={**frame.planes, role: frames[(at + step) % len(frames)][role]})
                for at, frame in enumerate(frames)]

    return apply


def frozen(role: Role) -> Callable[[Frames], Frames | None]:
    """The first frame's plane in every frame."""
    return lambda frames: [replace(f, planes={**f.planes, role: frames[1][role]}) for f in frames]


def reversed_frames(role: Role) -> Callable[[Frames], Frames]:
    return lambda frames: [replace(frame, planes={**frame.planes, role: other[role]})
                           for frame, other in zip(frames, frames[::-1], strict=True)]


def repeated_pixels(pixels: np.ndarray, frame: Frame) -> np.ndarray:
    return pixels[::2, ::2].repeat(2, 0).repeat(2, 1)[: pixels.shape[0], : pixels.shape[1]]


def interpolated(pixels: np.ndarray, frame: Frame) -> np.ndarray:
    """Half the resolution, enlarged by linear interpolation between pixel centres."""
    for axis in (0, 1):
        small = np.moveaxis(pixels, axis, 0)
        small = (small[0::2] + small[1::2]) / 2
        before = np.concatenate([small[:1], small[:-1]])
        after = np.concatenate([small[1:], small[-1:]])
        large = np.stack([0.75 * small + 0.25 * before, 0.75 * small + 0.25 * after], 1)
        pixels = np.moveaxis(large.reshape(-1, *small.shape[1:]), 0, axis)
    return pixels


def upside_down(pixels: np.ndarray, frame: Frame) -> np.ndarray:
    return pixels[::-1]


def encoded(pixels: np.ndarray, frame: Frame) -> np.ndarray:
    return srgb_encode(np.clip(pixels, 0, 1))


def nan_block(pixels: np.ndarray, frame: Frame) -> np.ndarray:
    """NaN in a block, from the second frame on."""
    broken = pixels.copy()
    if frame.number > 1:
        broken[20:36, 24:40] = np.nan
    return broken


def one_value(value: float) -> Change:
    return lambda pixels, frame: np.full_like(pixels, value)


def facing(pixels: np.ndarray, frame: Frame) -> np.ndarray:
    return np.broadcast_to(np.array((0, 0, 1), np.float32), pixels.shape)


def partly_camera_space(pixels: np.ndarray, frame: Frame) -> np.ndarray:
    """Camera space in the left part of the picture."""
    mixed, part = pixels.copy(), 2 * pixels.shape[1] // 5
    mixed[:, :part] = camera_space(pixels, frame)[:, :part]
    return mixed


def moving_thing(frames: Frames) -> Frames:
    """A disc that crosses the picture by (3, 1) pixels a frame, with the vectors of what is behind
    it."""
    found = []
    for at, frame in enumerate(frames):
        height, width = frame.spec.height, frame.spec.width
        y, x = np.indices((height, width)) - np.array((height / 2 + at,
                                                       width / 2 + 3 * at))[:, None, None]
        normal = np.stack([x, y, -np.sqrt(np.maximum(196.0 - x * x - y * y, 0))], -1) / 14
        albedo = np.stack([0.5 + 0.3 * np.sin(0.9 * x), 0.4 + 0 * x, 0.3 + 0.2 * np.cos(0.7 * y)],
                          -1)
        shown = {Role.DIFFUSE_ALBEDO: albedo, Role.NORMAL: normal,
                 Role.DEPTH: 1.5 + 0 * x[..., None]}
        planes = {role: np.where((x * x + y * y < 196)[..., None], plane, frame[role])
                        .astype(np.float32) for role, plane in shown.items() if role in frame}
        found.append(replace(frame, planes={**frame.planes, **planes}))
    return found


def between_planes(depth: np.ndarray, frame: Frame) -> np.ndarray:
    """(depth - near) / (far - near)."""
    return (depth - 0.5) / (40.0 - 0.5)


def scaled_depth(factor: float) -> Callable[[Frames], Frames | None]:
    return plane(Role.DEPTH, hits(lambda depth, frame: factor * depth), "world_to_camera")


def jitter_of_image(frames: Frames) -> Frames | None:
    width, height = frames[0].spec.width, frames[0].spec.height
    return jitter(1 / width, 1 / height)(frames)


def shifted_jitter(frames: Frames) -> Frames | None:
    if not any(any(frame.jitter) for frame in frames):
        return None
    return [replace(frame, jitter=(frame.jitter[0] + 0.5, frame.jitter[1] + 0.5))
            for frame in frames]


def flashes(pixels: np.ndarray, frame: Frame) -> np.ndarray:
    """Every third frame is twice as bright."""
    return pixels * np.float32(2.5 if frame.number % 3 == 0 else 1)


def exposure_jumps(frames: Frames) -> Frames | None:
    return [replace(frame, exposure=frame.exposure + (2 if frame.number > 2 else 0))
            for frame in frames if frame.exposure is not None] or None


def straight_alpha(frames: Frames) -> Frames:
    """Colour with the alpha of soft discs, not multiplied by it."""
    return [covers.with_plane(frame, Role.ALPHA, covers.puffs(frame)[..., 3:]) for frame in frames]


def colour_again(frames: Frames) -> Frames | None:
    """None where nothing is dark: there an albedo with the sRGB curve would look the same."""
    albedo = frames[0][Role.DIFFUSE_ALBEDO].max(2)
    if np.percentile(albedo[albedo > 0.004], 2) > 0.1:
        return None
    return plane(Role.COLOUR, lambda pixels, frame: pixels * frame[Role.DIFFUSE_ALBEDO])(frames)


ALBEDO = Role.DIFFUSE_ALBEDO
NORMAL = Role.NORMAL
ROUGH = Role.ROUGHNESS
DEPTH = Role.DEPTH
MOTION = Role.MOTION
COLOUR, SPECULAR = Role.COLOUR, Role.SPECULAR_ALBEDO

BREAKAGES = [
    Breakage("a gaussian pixel filter", "noise-spread", COLOUR, plane(COLOUR, filtered)),
    Breakage("albedo with noise of 0.08", "albedo-noisy", ALBEDO, plane(ALBEDO, noise(0.08)),
             ("albedo-above-one",)),
    Breakage("albedo times 1.8", "albedo-above-one", ALBEDO, plane(ALBEDO, times(1.8))),
    Breakage("noisy colour as albedo", "albedo-is-lit", ALBEDO, plane(ALBEDO, lit)),
    Breakage("base colour of metals as diffuse albedo", "metal-diffuse-bright", ALBEDO,
             base_colour_of_metal),
    Breakage("normals as (n + 1) / 2", "normal-unsigned", NORMAL,
             plane(NORMAL, lambda n, f: n / 2 + 0.5)),
    Breakage("normals times 0.5", "normal-length", NORMAL, plane(NORMAL, times(0.5))),
    Breakage("normals in camera space", "normal-camera-space", NORMAL, plane(NORMAL, camera_space)),
    Breakage("normals negated", "normal-inverted", NORMAL,
             plane(NORMAL, times(-1), "world_to_camera")),
    Breakage("squared roughness", "roughness-squared", ROUGH, plane(ROUGH, lambda r, f: r * r)),
    Breakage("root of roughness", "roughness-root", ROUGH, plane(ROUGH, lambda r, f: np.sqrt(r))),
    Breakage("smoothness", "roughness-smoothness", ROUGH, plane(ROUGH, lambda r, f: 1 - r)),
    Breakage("1 / depth, misses 0", "depth-reversed", DEPTH,
             plane(DEPTH, hits(lambda d, f: 1 / d, 0.0))),
    Breakage("1 - depth / 40, misses 0", "depth-reversed", DEPTH,
             plane(DEPTH, hits(lambda d, f: 1 - d / 40, 0.0))),
    Breakage("depth buffer 0..1, misses 1", "depth-hyperbolic", DEPTH,
             plane(DEPTH, hits(depth_buffer, 1.0))),
    Breakage("ray distance", "depth-ray", DEPTH, plane(DEPTH, hits(ray_distance))),
    Breakage("depth negated", "depth-negative", DEPTH, plane(DEPTH, hits(lambda d, f: -d))),
    Breakage("misses 0", "depth-miss-zero", DEPTH, misses_at(0.0)),
    Breakage("misses 65504, the largest half float", "depth-miss-far", DEPTH, misses_at(65504.0)),
    Breakage("misses at a far plane of 1000", "depth-miss-far", DEPTH, misses_at(1000.0)),
    Breakage("motion negated", "motion-sign", MOTION, plane(MOTION, times(-1))),
    Breakage("motion x negated", "motion-sign-x", MOTION, plane(MOTION, times([-1, 1]))),
    Breakage("motion y up", "motion-sign-y", MOTION, plane(MOTION, times([1, -1]))),
    Breakage("motion y, x", "motion-axes", MOTION, plane(MOTION, lambda m, f: m[..., ::-1])),
    Breakage("motion in pixels of the output", "motion-scale", MOTION, plane(MOTION, times(2))),
    Breakage("motion in uv", "motion-scale", MOTION, plane(MOTION, per_image(1))),
    Breakage("motion in -1..1", "motion-scale", MOTION, plane(MOTION, per_image(2))),
    Breakage("motion in uv around 0.5", "motion-encoded", MOTION, plane(MOTION, per_image(1, 0.5))),
    Breakage("motion with jitter", "motion-jitter", MOTION, jittered_motion, frames=3),
    Breakage("motion all 0", "motion-zero", MOTION, plane(MOTION, times(0))),
    Breakage("jitter header missing", "jitter-missing", "sequence", jitter(0, 0), frames=4),
    Breakage("jitter header negated", "jitter-sign", "sequence", jitter(-1, -1)),
    Breakage("jitter header with y up", "jitter-sign", "sequence", jitter(1, -1)),
    Breakage("jitter header with x negated", "jitter-sign", "sequence", jitter(-1, 1)),
    Breakage("jitter header though samples are spread", "jitter-unused", "sequence", unused_jitter,
             frames=5),
    Breakage("cut without reset", "cut-unmarked", "sequence", mirrored_second_half, frames=3),
    Breakage("reset in every frame", "reset-needless", "sequence", reset_everywhere),
    Breakage("the same noise in every frame", "samples-correlated", Role.COLOUR, fixed_seed),
    Breakage("no albedo", "missing-diffuse-albedo", ALBEDO, without(ALBEDO)),
    Breakage("no motion", "missing-motion", MOTION, without(MOTION)),
    Breakage("colour times 16, exposure header kept", "exposure-mismatch", "sequence",
             plane(Role.COLOUR, times(16), "exposure")),
    Breakage("NaN in colour", "not-finite", Role.COLOUR, plane(Role.COLOUR, holes)),
    Breakage("negative colour", "negative", Role.COLOUR,
             plane(Role.COLOUR, lambda c, f: c - np.float32(0.05))),
    Breakage("colour clipped at 1", "colour-clipped", Role.COLOUR,
             plane(Role.COLOUR, lambda c, f: np.clip(c, 0, 1))),
    Breakage("mask of particles inverted", "reactive-everywhere", Role.REACTIVE,
             added(Role.REACTIVE, inverted_mask)),
    Breakage("opaque colour of other samples", "opaque-samples", Role.OPAQUE_COLOUR,
             added(Role.OPAQUE_COLOUR, other_samples)),
    Breakage("worldToCamera for column vectors", "matrix-transposed", "sequence", transposed,
             frames=4, whole=True),
    Breakage("overlay of straight colour", "overlay-straight", Role.OVERLAY,
             covers.over(covers.straight)),
    Breakage("overlay with alpha in percent", "overlay-alpha", Role.OVERLAY,
             covers.over(covers.in_percent)),
    Breakage("overlay with its background", "overlay-opaque", Role.OVERLAY,
             covers.over(covers.opaque)),
    Breakage("overlay in the colour already", "overlay-twice", Role.OVERLAY, covers.composited,
             ("samples-correlated",)),
    Breakage("colour with and without transparents, no overlay", "overlay-missing", Role.OVERLAY,
             covers.two_colours),
    Breakage("half the field of view", "fov-mismatch", "sequence", other_fov),
    Breakage("colour black", "colour-black", COLOUR, plane(COLOUR, times(0))),
    Breakage("colour of half the resolution", "half-resolution", COLOUR,
             plane(COLOUR, repeated_pixels)),
    Breakage("colour upside down", "flipped", COLOUR, plane(COLOUR, upside_down)),
    Breakage("colour of the next frame", "other-frame", COLOUR, swapped_frames(COLOUR), frames=3),
    Breakage("colour multiplied by albedo twice", "colour-times-albedo", COLOUR, colour_again),
    Breakage("flashes", "exposure-jump", COLOUR, plane(COLOUR, flashes), frames=3),
    Breakage("exposure header jumps", "exposure-jump", "sequence", exposure_jumps, frames=3),
    Breakage("colour not multiplied by alpha", "alpha-straight", COLOUR, straight_alpha),
    Breakage("albedo black", "black", ALBEDO, plane(ALBEDO, times(0))),
    Breakage("albedo 0.8 everywhere", "constant", ALBEDO, plane(ALBEDO, one_value(0.8))),
    Breakage("albedo with the sRGB curve", "albedo-encoded", ALBEDO, plane(ALBEDO, encoded)),
    Breakage("albedo in the order B, G, R", "albedo-channels", ALBEDO,
             plane(ALBEDO, lambda a, f: a[..., ::-1])),
    Breakage("albedo of the frame before", "other-frame", ALBEDO, swapped_frames(ALBEDO, -1),
             frames=3),
    Breakage("albedo of one frame in all", "other-frame", ALBEDO, frozen(ALBEDO)),
    Breakage("albedo of half the resolution", "half-resolution", ALBEDO,
             plane(ALBEDO, interpolated)),
    Breakage("albedo upside down", "flipped", ALBEDO, plane(ALBEDO, upside_down)),
    Breakage("block of NaN in albedo", "not-finite", ALBEDO, plane(ALBEDO, nan_block)),
    Breakage("specular albedo black", "black", SPECULAR, plane(SPECULAR, times(0))),
    Breakage("specular albedo mirrored", "flipped", SPECULAR,
             plane(SPECULAR, lambda s, f: s[:, ::-1])),
    Breakage("normals 0", "black", NORMAL, plane(NORMAL, times(0))),
    Breakage("one normal everywhere", "constant", NORMAL, plane(NORMAL, facing)),
    Breakage("normals with y and z swapped", "normal-axes", NORMAL,
             plane(NORMAL, lambda n, f: n[..., [0, 2, 1]], "world_to_camera")),
    Breakage("normals with x negated", "normal-axes", NORMAL,
             plane(NORMAL, times([-1, 1, 1]), "world_to_camera"), frames=4, whole=True),
    Breakage("normals partly in camera space", "normal-mixed", NORMAL,
             plane(NORMAL, partly_camera_space, "world_to_camera")),
    Breakage("normals of the next frame", "other-frame", NORMAL, swapped_frames(NORMAL), frames=3),
    Breakage("normals of half the resolution", "half-resolution", NORMAL,
             plane(NORMAL, repeated_pixels)),
    Breakage("block of NaN in normals", "not-finite", NORMAL, plane(NORMAL, nan_block)),
    Breakage("roughness 0.5 everywhere", "constant", ROUGH, plane(ROUGH, one_value(0.5))),
    Breakage("roughness 0..255", "roughness-range", ROUGH, plane(ROUGH, times(255))),
    Breakage("roughness of the next frame", "other-frame", ROUGH, swapped_frames(ROUGH), frames=3),
    Breakage("depth 2 everywhere", "constant", DEPTH, plane(DEPTH, one_value(2))),
    Breakage("depth in centimetres", "depth-scale", DEPTH, scaled_depth(100)),
    Breakage("depth over the far plane", "depth-scale", DEPTH, scaled_depth(1 / 64)),
    Breakage("depth 0..1 between near and far", "depth-normalised", DEPTH,
             plane(DEPTH, hits(between_planes)), ("depth-scale",)),
    Breakage("depth of the next frame", "other-frame", DEPTH, swapped_frames(DEPTH), frames=3),
    Breakage("depth of half the resolution", "half-resolution", DEPTH,
             plane(DEPTH, repeated_pixels)),
    Breakage("block of NaN in depth", "not-finite", DEPTH, plane(DEPTH, nan_block)),
    Breakage("motion as v / 64 + 0.5", "motion-encoded", MOTION,
             plane(MOTION, lambda m, f: m / 64 + 0.5)),
    Breakage("motion as v / 100 + 0.5, y up", "motion-encoded", MOTION,
             plane(MOTION, lambda m, f: m * (1, -1) / 100 + 0.5)),
    Breakage("motion for each second", "motion-scale", MOTION, plane(MOTION, times(24))),
    Breakage("motion a tenth as long", "motion-scale", MOTION, plane(MOTION, times(0.1))),
    Breakage("motion of the next frame", "other-frame", MOTION, swapped_frames(MOTION), frames=4),
    Breakage("motion in reversed order", "other-frame", MOTION, reversed_frames(MOTION), frames=4),
    Breakage("motion of one frame in all", "other-frame", MOTION, frozen(MOTION)),
    Breakage("motion of half the resolution", "half-resolution", MOTION,
             plane(MOTION, interpolated)),
    Breakage("motion upside down", "flipped", MOTION, plane(MOTION, upside_down)),
    Breakage("block of NaN in motion", "not-finite", MOTION, plane(MOTION, nan_block)),
    Breakage("objects with the vectors of the world", "motion-of-things", MOTION, moving_thing),
    Breakage("jitter in parts of the image", "jitter-unit", "sequence", jitter_of_image, frames=3),
    Breakage("jitter as a position 0..1", "jitter-offset", "sequence", shifted_jitter),
    Breakage("jitter in -1..1", "jitter-range", "sequence", jitter(2, 2), ("jitter-unit",),
             frames=3),
]
