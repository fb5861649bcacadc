"""Depth, normals, albedos and roughness: find what each plane holds by comparing it with the
others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import permutations, product
from typing import NamedTuple

import numpy as np

from postfx.colour import luminance
from postfx.colour.displays import srgb_decode
from postfx.doctor import (
    Finding,
    correlation,
    error,
    finite,
    info,
    largest,
    noise_level,
    percent,
    warning,
)
from postfx.doctor.geometry import (
    CAMERA_AXES,
    DEPTH_VARIANTS,
    SAME_AXES_DEGREES,
    DepthKind,
    Fit,
    are_scaled,
    are_unit,
    fit_depth_kinds,
    fit_depth_scale,
    fit_rotation,
    fit_roughness,
    is_hit,
    is_unsigned,
    lengths_of,
    normals_of_depth,
    smooth_points,
    surface_normals,
    unit_normals,
    world_axes,
)
from postfx.doctor.material import Material
from postfx.frame import ALBEDOS, DEPTH_MISS, Frame, Role
from postfx.sampling import local_mean

FAR_AWAY_RATIO = 50.0
"""Depth that stands for misses is this many times as far as 95 % of the surfaces."""


def check_depth_misses(material: Material) -> Iterator[Finding]:
    """Misses that are not 1e10, and negative depth."""
    if Role.DEPTH not in material.middle:
        return
    depth = np.nan_to_num(material.middle[Role.DEPTH][..., 0], nan=DEPTH_MISS)
    below = depth < 0
    if percent(below) > 0.1:
        evidence = f"{percent(below):.3g} % of the pixels negative, least {depth.min():.4g}"
        yield error(Role.DEPTH, "depth-negative", evidence,
                    "a camera that looks along -z, or -1 for misses",
                    "negate it; misses are 1e10 (in a profile scale = [-1], miss = VALUE)")
    share = percent(depth == 0)
    if share > 0.1:
        yield warning(Role.DEPTH, "depth-miss-zero", f"{share:.3g} % of the pixels exactly 0",
                    "misses stored as 0",
                    "store 1e10 where nothing was hit, or give --depth planar,miss=0 (in a profile "
                    "miss = 0.0)")
    yield from _far_misses(material.middle, depth)


def _far_misses(frame: Frame, depth: np.ndarray) -> Iterator[Finding]:
    """Misses stored as one depth far behind all surfaces. depth: (height, width)."""
    is_there = is_hit(depth[..., None])
    hit = depth[is_there]
    if hit.size < 100:
        return
    farthest = float(hit.max())
    same = hit == farthest
    others = hit[~same]
    if not others.size or percent(same) <= 0.5:
        return
    is_far = farthest > FAR_AWAY_RATIO * np.percentile(others, 95)
    if is_far and not _have_normals(frame, is_there & (depth == farthest)):
        evidence = (f"{percent(same):.3g} % of the hits are exactly {farthest:.6g}, the others "
                    f"below {others.max():.4g}")
        yield warning(Role.DEPTH, "depth-miss-far", evidence,
                      "misses stored as the far plane or the largest half float",
                      f"store 1e10 where nothing was hit, or in a profile miss = {farthest:.6g}")


def _have_normals(frame: Frame, there: np.ndarray) -> bool:
    """Whether pixels show a surface, such as a backdrop that faces the camera: they have normals of
    unit length."""
    if Role.NORMAL not in frame:
        return False
    lengths = np.linalg.norm(np.nan_to_num(frame[Role.NORMAL][there]), axis=-1)
    return percent(np.abs(lengths - 1) < 0.1) > 90


# Degrees between the normals that depth gives and the stored ones: from the first on depth is not
# what it is said to be, below the second another kind explains it.
WRONG_DEGREES = 1.5
EXPLAINED_DEGREES = 5.0

OTHER_KIND_SHARE = 0.4
"""Another kind of depth must leave less than this share of the angle."""
OTHER_FOV_SHARE = 0.5
"""Another field of view must leave less than this share of the angle of the best kind."""
TRIED_FOV_DEGREES = tuple(range(20, 122, 2))


def check_depth_kind(material: Material) -> Iterator[Finding]:
    """Ray distance, reversed or buffer depth, and a wrong field of view, found by the normals that
    depth gives."""
    frame = material.middle
    if Role.DEPTH not in frame or is_unsigned(frame):
        return
    fits = fit_depth_kinds(frame)
    if DEPTH_VARIANTS[0] not in fits:
        yield info(Role.DEPTH, "depth-untested",
                   "depth may be planar, ray distance or reversed: not tested",
                   "it needs normals and some hundred pixels of smooth surfaces",
                   "look at its picture (--pictures)")
        return
    stored = fits[DEPTH_VARIANTS[0]].angle
    kind = min(fits, key=lambda kind: fits[kind].angle)
    if stored < WRONG_DEGREES:
        return
    enough = min(OTHER_KIND_SHARE * stored, EXPLAINED_DEGREES)
    other_fov = fit_rotation(frame, TRIED_FOV_DEGREES) if frame.fov_x else None
    if other_fov and other_fov.angle < OTHER_FOV_SHARE * fits[kind].angle:
        if other_fov.angle < enough:
            evidence = f"{_facing(other_fov, stored)}; the header says {frame.fov_x:.4g}"
            yield warning("sequence", "fov-mismatch", evidence,
                          "vertical field of view, or another camera's",
                          "write the horizontal field of view in degrees to postfx:fovX")
    elif fits[kind].angle < enough:
        yield error(Role.DEPTH, kind.code, _facing(fits[kind], stored, kind), kind.cause, kind.fix)


def _facing(fit: Fit, stored: float, kind: DepthKind = DEPTH_VARIANTS[0]) -> str:
    """How well depth of a kind explains the normals. stored: degrees as it is."""
    return (f"surfaces face within {fit.angle:.2g} degrees of their normals if depth is "
            f"{kind.name} and the field of view {fit.fov_x:.4g} degrees; {stored:.3g} degrees as "
            "it is")


UNDERSTOOD_DEGREES = 4.0
"""Largest angle between the normals that depth gives and the stored ones, turned: beyond, nothing
is said of their space."""
FEWEST_POINTS = 500
"""Points on smooth surfaces that tell mixed normals."""
LEAST_MIXED_PERCENT = 4.0
"""Percent of the normals that must be in each of two spaces."""

# Motion by camera and depth confirms a matrix: its least length, and its error in parts of that.
LEAST_MOTION_PX = 0.1
RIGHT_MOTION_ERROR = 0.1

# Cosines of the angle to a normal in one space: from the first on it is of that space, below the
# second it is not.
SAME_SPACE_COSINE = np.cos(np.radians(5))
OTHER_SPACE_COSINE = np.cos(np.radians(15))

_FLIPS = [np.diag(signs) for signs in product((-1.0, 1.0), repeat=3)]


def check_normal_encoding(material: Material) -> Iterator[Finding]:
    """Normals stored as 0..1."""
    if Role.NORMAL not in material.middle:
        return
    normal = surface_normals(material.middle)
    if len(normal) < 16:
        return
    if is_unsigned(material.middle):
        decoded = np.median(lengths_of(2 * normal - 1))
        evidence = (f"no value below {normal.min():.2g}, and 2 n - 1 has length {decoded:.3f} in "
                    "the median")
        yield error(Role.NORMAL, "normal-unsigned", evidence,
                    "normals stored as colours, (n + 1) / 2",
                    "store signed values, or in a profile offset = [-0.5, -0.5, -0.5], scale = [2, "
                    "2, 2]")
    elif not are_unit(normal) or are_scaled(normal):
        lengths = np.percentile(lengths_of(normal), (5, 50, 95))
        evidence = (f"lengths {lengths[0]:.3g} / {lengths[1]:.3g} / {lengths[2]:.3g} (5th, 50th, "
                    "95th percentile)")
        if are_scaled(normal):
            yield error(Role.NORMAL, "normal-length", evidence, "scaled, or not a normal",
                        "write unit normals, or scale them in a profile")
        else:
            yield info(Role.NORMAL, "normal-averaged", evidence,
                       "each pixel's normal is the mean of samples that missed or saw several "
                       "surfaces: fur, leaves, volumes, motion blur, depth of field",
                       "nothing: postfx uses such a normal as a hint")


def check_normal_space(material: Material) -> Iterator[Finding]:
    """Camera space, inverted normals, or a matrix that does not fit, found by the normals that
    depth gives."""
    frame, fit = material.middle, material.fit
    if Role.NORMAL not in frame or is_unsigned(frame):
        return
    if fit is None or fit.angle > UNDERSTOOD_DEGREES:
        yield info(Role.NORMAL, "normal-space-untested", "the space of the normals was not tested",
                   "it needs depth along the view axis and smooth surfaces",
                   "look at its picture (--pictures): world normals keep their colours when the "
                   "camera turns")
        return
    camera = min(_turn(fit.matrix, flip) for flip in _FLIPS)
    if frame.world_to_camera is None:
        yield from _without_matrix(camera)
        return
    if material.picture_to_world is not None:
        return
    worlds = world_axes(frame)
    off = min(_turn(fit.matrix, world) for world in worlds)
    inverted = min(_turn(fit.matrix, -world) for world in worlds)
    transposed = min(_turn(fit.matrix, axes @ frame.world_to_camera[:3, :3])
                     for axes in CAMERA_AXES)
    evidence = (f"normals are turned by {off:.3g} degrees from the world of worldToCamera, "
                f"by {camera:.2g} degrees from the camera's axes")
    if camera < SAME_AXES_DEGREES:
        yield error(Role.NORMAL, "normal-camera-space", evidence, "normals are in camera space",
                    "write world normals, or in a profile space = \"camera\"")
    elif inverted < SAME_AXES_DEGREES:
        evidence = (f"negated, they are within {inverted:.2g} degrees of the normals that depth "
                    "and camera give")
        yield error(Role.NORMAL, "normal-inverted", evidence, "normals point away from the viewer",
                    "negate them, in a profile scale = [-1, -1, -1]")
    elif transposed < SAME_AXES_DEGREES and not _is_right(material):
        yield error("sequence", "matrix-transposed", evidence,
                    "worldToCamera stored for column vectors, or inverted",
                    "store it for row vectors (p_camera = p_world M)")
    elif other := _other_axes(frame, fit):
        evidence = (f"with {other[0]} they are within {other[1]:.2g} degrees of the normals that "
                    "depth and camera give")
        yield error(Role.NORMAL, "normal-axes", evidence,
                    "the normals and worldToCamera use different world axes: channels swapped, one "
                    "negated, or y up and z up mixed",
                    "write normals and worldToCamera in the same world, or reorder the channels in "
                    "a profile")
    else:
        yield warning("sequence", "matrix-mismatch", evidence,
                      "worldToCamera of another frame or with other axes",
                      "give the matrix of this frame, for row vectors (p_camera = p_world M)")


def check_normal_mixed(material: Material) -> Iterator[Finding]:
    """Some normals in world space and some in camera space."""
    frame = material.middle
    if (frame.world_to_camera is None or Role.NORMAL not in frame or Role.DEPTH not in frame
        or is_unsigned(frame)):
        return
    points = smooth_points(frame[Role.DEPTH])
    fov = frame.fov_x or (material.fit.fov_x if material.fit else None)
    if fov is None or points.rows.size < FEWEST_POINTS:
        return
    is_explained = material.fit is not None and material.fit.angle < UNDERSTOOD_DEGREES
    if is_explained and material.picture_to_world is None:
        return  # all normals are in one space, though not in the world's
    seen = normals_of_depth(frame, fov, points)[0]
    stored = unit_normals(frame, points)
    by_world = [((seen @ matrix) * stored).sum(-1) for matrix in world_axes(frame)]
    by_camera = [((seen @ flip) * stored).sum(-1) for flip in _FLIPS]
    world = max(by_world, key=lambda cosines: percent(cosines > SAME_SPACE_COSINE))
    is_elsewhere = world < OTHER_SPACE_COSINE
    in_camera = max(percent((cosines > SAME_SPACE_COSINE) & is_elsewhere) for cosines in by_camera)
    shares = percent(world > SAME_SPACE_COSINE), in_camera
    if min(shares) > LEAST_MIXED_PERCENT:
        yield error(Role.NORMAL, "normal-mixed",
                    f"{shares[0]:.3g} % of the normals are in world space, {shares[1]:.3g} % in "
                    "camera space", "shaders or objects that write different spaces",
                    "write all in world space")


def check_normal_facing(material: Material) -> Iterator[Finding]:
    """Some normals point away from the viewer."""
    frame, fit = material.middle, material.fit
    if fit is None or fit.angle > UNDERSTOOD_DEGREES or is_unsigned(frame):
        return
    points = smooth_points(frame[Role.DEPTH])
    seen, _ = normals_of_depth(frame, fit.fov_x, points)
    explained = material.picture_to_world
    cosines = ((seen @ (fit.matrix if explained is None else explained))
               * unit_normals(frame, points)).sum(-1)
    if (share := percent(cosines < -0.7)) > 1:
        yield warning(Role.NORMAL, "normal-facing",
                      f"{share:.3g} % of the pixels point away from the viewer",
                      "normals of the geometry, not turned towards the viewer",
                      "negate the normals with normal . view > 0")


def _is_right(material: Material) -> bool:
    """Whether worldToCamera explains the stored motion: a transposed matrix may explain normals
    with other axes."""
    fits = [fit for pair in material.pairs
            if (fit := fit_depth_scale(*pair)) and fit.length > LEAST_MOTION_PX]
    return bool(fits) and all(fit.error_as_it_is < RIGHT_MOTION_ERROR * fit.length for fit in fits)


def _other_axes(frame: Frame, fit: Fit) -> tuple[str, float] | None:
    """Order and signs of the channels that make normals fit the camera, in words, and the angle
    that remains."""
    found = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            changed = np.eye(3)[:, order] * signs
            angle = min(_turn(fit.matrix, world @ changed.T) for world in world_axes(frame))
            names = [("-" if sign < 0 else "") + "xyz"[axis]
                     for axis, sign in zip(order, signs, strict=True)]
            found.append((angle, ", ".join(names)))
    angle, name = min(found)
    return (f"channels in the order {name}", angle) if angle < SAME_AXES_DEGREES else None


def _without_matrix(camera: float) -> Iterator[Finding]:
    """The finding for a frame without worldToCamera. camera: degrees between its normals and the
    camera's axes."""
    if camera < SAME_AXES_DEGREES:
        evidence = (f"normals are within {camera:.2g} degrees of the camera's axes; certain only "
                    "with worldToCamera")
        yield warning(Role.NORMAL, "normal-camera-space", evidence,
                      "normals are in camera space, or the camera looks along an axis of the world "
                      "and stands still", "write world normals and a worldToCamera header")


def _turn(one: np.ndarray, other: np.ndarray) -> float:
    """Degrees between two orthogonal matrices; 180 where one mirrors and the other does not."""
    sine = np.linalg.norm(one - other) / (2 * np.sqrt(2))
    return 2 * float(np.degrees(np.arcsin(min(sine, 1.0))))


# Albedo. Noise and brightness are in parts of white, shares in percent of the pixels.

MOST_ABOVE_ONE_PERCENT = 5.0
NOISY_ALBEDO = 0.012
NOISY_ALBEDO_SHARE = 0.02
"""Noise that counts, in parts of the albedo's mean."""
SAME_NOISE_CORRELATION = 0.5
"""Albedo whose noise is correlated with the colour's by more is lit."""
BRIGHT_METAL = 0.5
"""Specular albedo of metal is larger."""

# An encoded albedo. Slopes are those of `Slopes`.
FEWEST_LIT_SQUARES = 20
TOO_STEEP = 1.2
"""Upper quartile of the slope of brightness that no linear albedo has; its most is 1."""
SWAPPED_SLOPE = -0.2
"""Median slope of red over blue below which the channels of one plane are swapped."""
ENCODED_DARK = 0.2
"""Largest channel of the darkest albedos (2nd percentile): a dark albedo of 0.04 is encoded as
0.22."""
MOST_TOO_BRIGHT_PERCENT = 0.3


def check_albedo_above_one(material: Material) -> Iterator[Finding]:
    """Reflectance above 1: more light leaves than arrives."""
    for role in ALBEDOS:
        if role not in material.middle:
            continue
        plane = finite(material.middle[role]).max(2)
        share = percent(plane > 1.001)
        if share > 0:
            evidence = f"{share:.3g} % of the pixels above 1, largest {plane.max():.3g}"
            cause = ("the AOV shows a light or a reflection, holds lit colour instead of "
                     "reflectance, or is scaled")
            fix = "write reflectance without light; values above 1 are cut off"
            level = error if share > MOST_ABOVE_ONE_PERCENT else warning if share > 0.1 else info
            yield level(role, "albedo-above-one", evidence, cause, fix)


def check_albedo_noisy(material: Material) -> Iterator[Finding]:
    """Noise in flat areas of an albedo."""
    for role in ALBEDOS:
        if role not in material.middle:
            continue
        plane = _reflectance(material.middle[role])
        level = noise_level(plane)
        used = plane.max(2) > 0
        if level is None:
            continue
        if level < max(NOISY_ALBEDO, NOISY_ALBEDO_SHARE * float(plane[used].mean())):
            continue
        shared = _shared_noise(material.middle, plane)
        evidence = (f"noise of {level:.3g} in the flattest quarter of the picture, mean "
                    f"{plane[used].mean():.3g}; ")
        evidence += f"{shared:.2f} correlated with the colour's noise"
        lit = shared > SAME_NOISE_CORRELATION and not _is_averaged(material.middle)
        cause = ("the AOV holds lit colour" if lit
                 else "depth of field, motion blur or rough layers in the AOV")
        fix = ("write reflectance without light" if lit
               else "write it at the first hit, or with more samples")
        yield warning(role, "albedo-is-lit" if lit else "albedo-noisy", evidence, cause, fix)


def _reflectance(plane: np.ndarray) -> np.ndarray:
    """The plane with reflectance in 0..4, and 0 for what is not finite."""
    result: np.ndarray = np.clip(finite(plane), 0, 4)
    return result


def _is_averaged(frame: Frame) -> bool:
    """Whether planes are means of few samples that saw different surfaces: then they have the
    colour's noise."""
    normals = surface_normals(frame) if Role.NORMAL in frame else np.zeros((0, 3))
    return len(normals) > 0 and not are_scaled(normals) and percent(lengths_of(normals) < 0.9) > 20


def check_albedo_encoded(material: Material) -> Iterator[Finding]:
    """Albedo stored with a display curve, with red and blue swapped, or multiplied into the colour
    twice."""
    frames = [frame
              for frame in material.frames if Role.COLOUR in frame and Role.DIFFUSE_ALBEDO in frame]
    if not frames or _is_averaged(material.middle):
        return
    contrast, tint = measure_slopes(frames)
    darkest = _darkest_albedo(frames)
    if contrast and contrast.squares >= FEWEST_LIT_SQUARES and contrast.upper > TOO_STEEP:
        yield _too_steep(contrast, darkest)
    elif darkest > ENCODED_DARK:
        yield from _nothing_dark(material.middle, darkest)
    is_telling = tint is not None and tint.squares >= FEWEST_LIT_SQUARES
    if tint and is_telling and tint.median < SWAPPED_SLOPE and tint.upper < 0:
        yield warning(Role.DIFFUSE_ALBEDO, "albedo-channels",
                      f"where the albedo turns red, colour turns blue (slope {tint.median:.2f}, "
                      f"{tint.squares} squares)",
                      "channels in the order B, G, R, of albedo or of colour",
                      'swap them, in a profile channels = ["BGR"]')


def _darkest_albedo(frames: Sequence[Frame]) -> float:
    """2nd percentile of the largest channel of diffuse albedo, where it is not black; 0 where all
    is."""
    albedo = np.concatenate([largest(finite(frame[Role.DIFFUSE_ALBEDO])).ravel()
                             for frame in frames])
    lit = albedo[albedo > 0.004]
    return float(np.percentile(lit, 2)) if lit.size else 0.0


def _too_steep(contrast: Slopes, darkest: float) -> Finding:
    """The finding for textures that change colour more than the albedo says."""
    evidence = (f"textures change colour {contrast.upper:.2f} times as much as the albedo "
                f"(logarithms, upper quartile of {contrast.squares} squares), where at most 1 is "
                "possible")
    if darkest <= ENCODED_DARK:
        return warning(Role.COLOUR, "colour-times-albedo", evidence,
                       "colour was multiplied by albedo twice", "multiply light by albedo once")
    return warning(Role.DIFFUSE_ALBEDO, "albedo-encoded",
                   f"{evidence}; and its darkest area is {darkest:.2f}",
                   "albedo stored with the sRGB curve, as a picture",
                   "write it linear, or decode it: an encoded albedo leaves textures in the noise")


def _nothing_dark(frame: Frame, darkest: float) -> Iterator[Finding]:
    """Albedo without anything dark, whose pixels reflect too much unless it is decoded."""
    share = _too_bright(frame)
    if share > MOST_TOO_BRIGHT_PERCENT:
        yield warning(Role.DIFFUSE_ALBEDO, "albedo-encoded",
                      f"nothing is darker than {darkest:.2f}, and {share:.3g} % of the pixels "
                      "reflect more than 1.03 in sum; decoded from sRGB, nearly none do",
                      "albedo stored with the sRGB curve, as a picture", "write it linear")


def _too_bright(frame: Frame) -> float:
    """Percent of pixels whose albedos add up to more than 1.03, but to less than 1.01 if the
    diffuse one is decoded."""
    if Role.SPECULAR_ALBEDO not in frame:
        return 0.0
    specular, diffuse = finite(frame[Role.SPECULAR_ALBEDO]), finite(frame[Role.DIFFUSE_ALBEDO])
    bright = largest(specular + diffuse) > 1.03
    decoded = largest(specular + srgb_decode(np.clip(diffuse, 0, 1))) > 1.01
    return percent(bright) if percent(decoded) < 0.1 * percent(bright) else 0.0


def _shared_noise(frame: Frame, albedo: np.ndarray) -> float:
    """Correlation of an albedo's noise (height, width, 3) with the colour's; 0 without colour."""
    if Role.COLOUR not in frame:
        return 0.0
    light, reflected = (np.log(luminance(np.maximum(finite(plane), 0)) + 1e-2)[..., None]
                        for plane in (frame[Role.COLOUR], albedo))
    return correlation(light - local_mean(light, 2), reflected - local_mean(reflected, 2))


def check_bright_metal(material: Material) -> Iterator[Finding]:
    """Diffuse and specular albedo bright in the same pixels: together they reflect more light than
    arrives."""
    if not all(role in material.middle for role in ALBEDOS):
        return
    diffuse, specular = (finite(material.middle[role]) for role in ALBEDOS)
    metal = specular.max(2) > BRIGHT_METAL
    bright = metal & ((diffuse + specular).max(2) > 1.05)
    share, of_metal = percent(bright), 100 * bright.sum() / max(metal.sum(), 1)
    if share > 0.05 and of_metal > 30:
        evidence = (f"{share:.3g} % of the pixels ({of_metal:.0f} % of those with specular albedo "
                    f"above {BRIGHT_METAL}) reflect more than 1.05 in sum, "
                    f"{(diffuse + specular).max(2)[bright].mean():.3g} in the mean")
        yield warning(Role.DIFFUSE_ALBEDO, "metal-diffuse-bright", evidence,
                      "base colour written as diffuse albedo of metals too",
                      "diffuse albedo = base colour x (1 - metallic); metals' colour is specular "
                      "albedo")


def check_roughness_range(material: Material) -> Iterator[Finding]:
    """Roughness above 1."""
    if Role.ROUGHNESS in material.middle:
        plane = finite(material.middle[Role.ROUGHNESS])
        if (share := percent(plane > 1.001)) > 0.1:
            yield error(Role.ROUGHNESS, "roughness-range",
                        f"{share:.3g} % above 1, largest {plane.max():.3g}",
                        "a gloss exponent or 0..255",
                        "write linear roughness 0..1, or scale it in a profile")


def check_roughness_kind(material: Material) -> Iterator[Finding]:
    """Squared roughness, its root, or smoothness, found by the specular albedo."""
    frame = material.middle
    if Role.ROUGHNESS not in frame:
        return
    fit = fit_roughness(frame)
    if fit is None or not fit.is_telling:
        yield info(Role.ROUGHNESS, "roughness-untested",
                   "roughness may be linear, squared or smoothness: not tested",
                   "it needs specular albedo that depends on roughness and view angle, depth and "
                   "fov_x, and smooth surfaces",
                   "look at its picture (--pictures): mirrors are black, plaster is white")
        return
    kind, certain = fit.best, fit.certainty
    if kind.code and certain > 0:
        evidence = (f"specular albedo is explained with an error of {fit.errors[kind]:.3g} if the "
                    f"AOV is {kind.name}, of {fit.as_it_is:.3g} as linear roughness ({fit.pixels} "
                    f"pixels); certainty {certain:.0%}")
        level = error if certain >= 0.5 else warning
        yield level(Role.ROUGHNESS, kind.code, evidence, kind.cause, kind.fix)


# Albedo by the colour: across a texture on one surface, both change together.
#
# A picture is cut into squares of 8 x 8 pixels. Squares that show one smooth surface with a texture
# are split into the third with the least albedo and the third with the most. Both thirds receive
# nearly the same light, so the ratio of their colours equals the ratio of their albedos, or is
# smaller where a gloss adds light: the slope between the logarithms is at most 1. An albedo stored
# with a display curve has too little contrast, which doubles the slope or so.

SQUARE_SIDE_PX = 8
LEAST_LOG_RATIO = 0.2
"""Least logarithm of the ratio of the two thirds' albedos."""
FEWEST_TEXTURED_SQUARES = 5
FIREFLY_RATIO = 4.0
"""Colour is cut off at this many times the median of its square."""
DARK_SQUARE_RATIO = 0.02
"""Squares whose median is below this part of the picture's mean are too noisy to use."""

# On one surface the mean normal is at least this long, and the ratio of depths is at most this
# large.
ALIGNED_NORMAL_LENGTH = 0.97
FLAT_DEPTH_RATIO = 1.15


class Slopes(NamedTuple):
    """Quartiles of the slope, weighted by the albedo's contrast, and the count of squares."""

    lower: float
    median: float
    upper: float
    squares: int


def measure_slopes(frames: Sequence[Frame]) -> tuple[Slopes | None, Slopes | None]:
    """Slopes of brightness, and of red over blue; None where fewer than 5 squares show a texture.

    frames: with colour and diffuse albedo. Fireflies are cut off in each square.
    """
    brightness, tint = [], []
    for frame in frames:
        if min(frame.spec.width, frame.spec.height) < SQUARE_SIDE_PX:
            continue
        squares = _one_surface(frame)
        colour, albedo = (_squares(np.maximum(finite(frame[role]), 0))[squares]
                          for role in (Role.COLOUR, Role.DIFFUSE_ALBEDO))
        if not len(colour):
            continue
        middle = np.median(colour, axis=1, keepdims=True)
        lit = (middle[:, 0] > DARK_SQUARE_RATIO * colour.mean()).all(1)
        colour, albedo = np.minimum(colour, FIREFLY_RATIO * middle)[lit], albedo[lit]
        brightness.append(_ratios(colour.sum(-1), albedo.sum(-1), albedo.sum(-1)))
        key = np.log((albedo[..., 0] + 1e-3) / (albedo[..., 2] + 1e-3))
        red, blue = (_ratios(colour[..., channel], albedo[..., channel], key) for channel in (0, 2))
        tint.append(red - blue)
    if not brightness:
        return None, None
    return _slopes(np.concatenate(brightness)), _slopes(np.concatenate(tint))


def _one_surface(frame: Frame) -> np.ndarray:
    """(squares,): whether normals agree and depth hardly changes."""
    rows, columns = frame.spec.height // SQUARE_SIDE_PX, frame.spec.width // SQUARE_SIDE_PX
    found = np.ones(rows * columns, bool)
    if Role.NORMAL in frame:
        normals = _squares(finite(frame[Role.NORMAL]))
        mean = np.linalg.norm(normals.mean(1), axis=-1)
        found &= ((mean > ALIGNED_NORMAL_LENGTH * np.linalg.norm(normals, axis=-1).mean(1))
                  & (mean > 0.3))
    if Role.DEPTH in frame:
        hits = is_hit(frame[Role.DEPTH])[..., None]
        depth = _squares(np.where(hits, frame[Role.DEPTH], np.inf))[..., 0]
        found &= np.isfinite(depth).all(1) & (depth.max(1) < FLAT_DEPTH_RATIO * depth.min(1))
    return found


def _squares(plane: np.ndarray) -> np.ndarray:
    """Whole squares (count, 64, C) of a plane (height, width, C)."""
    rows, columns = plane.shape[0] // SQUARE_SIDE_PX, plane.shape[1] // SQUARE_SIDE_PX
    whole = plane[: rows * SQUARE_SIDE_PX, : columns * SQUARE_SIDE_PX]
    cut = whole.reshape(rows, SQUARE_SIDE_PX, columns, SQUARE_SIDE_PX, -1)
    return cut.swapaxes(1, 2).reshape(rows * columns, SQUARE_SIDE_PX * SQUARE_SIDE_PX, -1)


def _ratios(colour: np.ndarray, albedo: np.ndarray, key: np.ndarray) -> np.ndarray:
    """(squares, 2): logarithms of the ratios of colours and of albedos, between the thirds with the
    most and least key.

    All arguments are (squares, 64).
    """
    order = np.argsort(key, axis=1)
    third = SQUARE_SIDE_PX * SQUARE_SIDE_PX // 3
    found = []
    for plane, offset in ((colour, 1e-4), (albedo, 1e-3)):
        most = np.take_along_axis(plane, order[:, -third:], 1).mean(1)
        least = np.take_along_axis(plane, order[:, :third], 1).mean(1)
        found.append(np.log((most + offset) / (least + offset)))
    return np.stack(found, -1)


def _slopes(ratios: np.ndarray) -> Slopes | None:
    """Quartiles of the slopes of (squares, 2) logarithms, of colours and of albedos; None with too
    few squares."""
    used = ratios[ratios[:, 1] > LEAST_LOG_RATIO]
    if len(used) < FEWEST_TEXTURED_SQUARES:
        return None
    slopes, weights = used[:, 0] / used[:, 1], used[:, 1]
    order = np.argsort(slopes)
    shares = np.cumsum(weights[order]) / weights.sum()
    lower, median, upper = (float(slopes[order][np.searchsorted(shares, share)])
                            for share in (0.25, 0.5, 0.75))
    return Slopes(lower, median, upper, len(used))
