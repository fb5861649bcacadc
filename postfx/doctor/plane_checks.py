"""Check single planes: missing planes, broken values, overlays, the reactive mask, exposure."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from difflib import SequenceMatcher
from typing import NamedTuple

import numpy as np

from postfx.colour import luminance
from postfx.doctor import Finding, correlation, error, finite, info, largest, percent, warning
from postfx.doctor.alignment import ALIGNED_PLANES, compare_edges
from postfx.doctor.geometry import is_hit
from postfx.doctor.material import Material
from postfx.doctor.motion_convention import plane_lines
from postfx.exposure import measure
from postfx.frame import ALBEDOS, Frame, Role
from postfx.io.channels import COLOUR_FILES
from postfx.kernels.statistics import OUTSIDE, light_outside
from postfx.motion import MOTION_SOURCES
from postfx.sampling import local_mean

_MAY_BE = {role: re.compile(words, re.IGNORECASE) for role, words in {
    Role.DIFFUSE_ALBEDO: r"albedo|diff\w*[ _]?(filter|col)|base[ _]?col", Role.ROUGHNESS: r"rough",
    Role.SPECULAR_ALBEDO: r"spec\w*[ _]?albedo|refl\w*[ _]?filter|gloss\w*[ _]?col",
    Role.NORMAL: r"norm|(^|[._ ])n(n|s|g|world)?\.",
    Role.DEPTH: r"depth|(^|[._ ]|hit)p?z$"}.items()}
"""Names of layers that may be a plane. Motion has a check of its own, which measures."""

_REFLECTED = re.compile(r"spec|refl|gloss", re.IGNORECASE)
"""Names of layers that are no diffuse albedo."""
_WORDS = {Role.DIFFUSE_ALBEDO: ("albedo",), Role.NORMAL: ("normal", "normals"),
          Role.DEPTH: ("depth",), Role.ROUGHNESS: ("roughness",),
          Role.MOTION: ("motion", "velocity", "vectors")}
"""Words that a layer's name may be short for, or misspell."""
_PICTURE_WORDS = (*COLOUR_FILES, "final", "main", "picture", "radiance", "render")
"""Words in the names of layers that are rather the colour than another layer is."""
_LETTERS = {Role.DIFFUSE_ALBEDO: ("R,G,B",), Role.SPECULAR_ALBEDO: ("R,G,B",),
            Role.NORMAL: ("X,Y,Z", "R,G,B"), Role.DEPTH: ("Z", "R", "Y", "V"),
            Role.ROUGHNESS: ("R", "Y", "V"), Role.MOTION: ("X,Y",)}
"""Channels that a layer must have to be read as the plane."""
FEWEST_LETTERS = 3
"""Shorter names say nothing."""
LEAST_SIMILARITY = 0.8
"""Of a misspelt word: 1 is the same."""


class Cost(NamedTuple):
    """Least and greatest loss of PSNR in dB without a plane."""

    least: float
    most: float


COSTS = {
    Role.DIFFUSE_ALBEDO: Cost(0.90, 1.57),
    Role.SPECULAR_ALBEDO: Cost(0.07, 0.29),
    Role.NORMAL: Cost(0.20, 0.36),
    Role.ROUGHNESS: Cost(0.02, 0.05),
    Role.DEPTH: Cost(0.07, 0.37),
    Role.MOTION: Cost(1.14, 2.02),
}
"""Measured by leaving each plane out of three sequences: the table of ablations in
docs/lab/quality.md."""
MATTERS_DB = 0.2
"""A plane whose mean cost is at least this is worth a warning."""

FOLLOWING = (Role.MOTION, Role.DEPTH, Role.NORMAL, Role.ROUGHNESS, Role.DIFFUSE_ALBEDO,
             Role.SPECULAR_ALBEDO)
"""Planes that are needed to follow reflections by their hit distance."""


def check_hit_distance_unused(material: Material) -> Iterator[Finding]:
    """A hit distance without the planes and headers needed to follow reflections."""
    first = material.first
    if Role.SPECULAR_HIT_DISTANCE not in first:
        return
    lacking = [str(role) for role in FOLLOWING if role not in first]
    lacking += ["worldToCamera"] if first.world_to_camera is None else []
    lacking += ["postfx:fovX"] if first.fov_x is None else []
    if lacking:
        yield info(Role.SPECULAR_HIT_DISTANCE, "hit-distance-unused", f"no {', '.join(lacking)}",
                   "AOVs or headers that are not written",
                   "write them: then the history follows reflections")


def check_missing_planes(material: Material) -> Iterator[Finding]:
    """Colour, which is required, and planes that would improve the result."""
    if Role.COLOUR not in material.first:
        yield _missing_colour(material)
    for role, cost in COSTS.items():
        if role in material.first or role in material.first.guides:
            continue
        maybe = _find_similar(material, role)[:MOST_LISTED]
        held = f"in the file, but not read: {'; '.join(maybe)}" if maybe else "not in the file"
        evidence = (f"{held}; without it results were {cost.least:.2f} to {cost.most:.2f} dB worse")
        where = material.enable.get(role, "")
        cause = "another name, or a kind that is not read" if maybe else "not rendered, or renamed"
        fix = (f"switch it on: {where}" if where
               else "render it, or name it in a profile (--profile FILE.toml)")
        if role is Role.MOTION and {*MOTION_SOURCES} & material.first.planes.keys():
            fix += "; until then it is estimated from other AOVs"
        if lines := next(filter(None, (_profile_of(material, role, name) for name in maybe)), ""):
            fix = ("if it is that, write this into a file, for --profile FILE.toml (several AOVs "
                   f"share one line 'extends'):\n{lines}")
        alone = role is Role.MOTION and not material.pairs
        level = warning if (cost.least + cost.most) / 2 >= MATTERS_DB and not alone else info
        yield level(role, f"missing-{role.replace('_', '-')}", evidence, cause, fix)


def _missing_colour(material: Material) -> Finding:
    """The finding for frames without a colour; where a layer may be it, with a profile that reads
    it."""
    layers = _find_pictures(material)
    held = "; ".join(f"{layer}.{','.join(material.pictures[layer])}"
                     for layer in layers[:MOST_LISTED])
    evidence = "no colour AOV was found" + (f"; in the file, but not read: {held}" if held else "")
    fix = "render it, or name it in a profile (--profile FILE.toml)"
    if layers:
        letters = material.pictures[layers[0]]
        lines = plane_lines(material.profile, Role.COLOUR, layers[0], letters[:3])
        if letters[3:]:
            lines += plane_lines(material.profile, Role.ALPHA, layers[0], letters[3:])[1:]
        fix = (f"if it is '{layers[0]}', give --layer '{layers[0]}', or write this into a file, "
               "for --profile FILE.toml:\n" + "\n".join(lines))
    return error(Role.COLOUR, "missing-colour", evidence, "another name or layer", fix)


def _find_pictures(material: Material) -> list[str]:
    """Layers that may be the colour, those named like a picture first, without parts of it and
    layers that may be another plane."""
    taken = {name.rpartition(".")[0] for role in COSTS for name in _find_similar(material, role)}
    layers = [layer for layer in material.pictures
              if layer not in material.known_parts and layer not in taken]
    return sorted(layers, key=lambda layer: not _is_named_like(layer, _PICTURE_WORDS))


def _find_similar(material: Material, role: Role) -> list[str]:
    """Unread layers, with their channels, that may be the plane by their names. Motion that is
    measured has a finding of its own."""
    if role is Role.MOTION and material.unread:
        return []
    others = [name for name in material.other_layers
              if name.rpartition(".")[0] not in material.known_parts
              and not (role is Role.DIFFUSE_ALBEDO and _REFLECTED.search(name))]
    return [name for name in others
            if (role in _MAY_BE and _MAY_BE[role].search(name)) or _is_short_for(role, name)]


def _is_short_for(role: Role, name: str) -> bool:
    """Whether a layer has the channels of the plane, and a name like one of its words: 'nrm.X,Y,Z',
    'albdo.R,G,B'."""
    layer, _, letters = name.rpartition(".")
    if letters.upper() not in _LETTERS[role]:
        return False
    return _is_named_like(layer, _WORDS.get(role, ()))


def _is_named_like(layer: str, words: Sequence[str]) -> bool:
    """Whether a part of a layer's name is like one of some words."""
    return any(_is_like(part, word) for part in re.findall(r"[a-z]+", layer.lower())
               for word in words)


def _is_like(part: str, word: str) -> bool:
    """Whether a part of a name is a word with letters left out, or nearly the word."""
    if len(part) < FEWEST_LETTERS or part[0] != word[0]:
        return False
    rest = iter(word)
    return (all(letter in rest for letter in part)
            or SequenceMatcher(None, part, word).ratio() >= LEAST_SIMILARITY)


def _profile_of(material: Material, role: Role, name: str) -> str:
    """TOML of a profile that reads a layer as a plane; '' if its channels are others."""
    layer, _, letters = name.rpartition(".")
    if not layer or letters.upper() not in _LETTERS[role]:
        return ""
    return "\n".join(plane_lines(material.profile, role, layer, letters.split(",")))


MANY_PERCENT = 50.0
"""Percent of a plane's values: with more wrong ones, the whole AOV is broken."""
UNSEEN_NEGATIVE = 1e-4
"""Share of a plane's light: less below 0 is rounding. DWA at its usual level leaves 2e-6."""
NEVER_NEGATIVE = (Role.COLOUR, Role.ALPHA, *ALBEDOS, Role.ROUGHNESS, Role.SPECULAR_HIT_DISTANCE,
                  Role.STRENGTH, Role.REACTIVE, Role.OPAQUE_COLOUR)
IN_UNIT_RANGE = (Role.ALPHA, Role.STRENGTH, Role.REACTIVE)
"""Masks, whose values are 0 to 1."""
OUTSIDE_GAMUT = "light-outside"
"""Code of the finding that light is negative because its primaries cannot hold it."""
MOST_LISTED = 8
"""Names or frame numbers that a line lists; the rest is an ellipsis."""


def check_finite_values(material: Material) -> Iterator[Finding]:
    """NaN and infinities; an infinite depth is a miss."""
    for role, values in material.stored.items():
        infinite = 0 if role is Role.DEPTH else values.infinite
        share = 100 * (values.nan + infinite) / values.total
        if share == 0:
            continue
        evidence = f"{values.nan} NaN, {infinite} infinite of {values.total} values ({share:.3g} %)"
        cause = "division by zero in a shader or light, or an AOV that was never written"
        fix = ("find the material with a picture of the AOV (--pictures); values that are not "
               "finite count as 0")
        yield (error if share > MANY_PERCENT else warning)(role, "not-finite", evidence, cause, fix)


UNIFORM = (*ALBEDOS, Role.NORMAL, Role.DEPTH, Role.ROUGHNESS)
"""Planes that always vary where a picture shows surfaces."""
BLACK_VALUE = 1e-4
"""Planes without a larger magnitude are black."""


def check_uniform_planes(material: Material) -> Iterator[Finding]:
    """Planes that are black or hold a single value, though the picture shows something."""
    for role in UNIFORM:
        frames = [frame for frame in material.frames if role in frame and _shows_surfaces(frame)]
        black = [frame.number for frame in frames if _is_black(frame[role])]
        if black:
            if role is not Role.DEPTH:
                yield _black(role, black, len(frames), _may_be_black(role, material.middle))
        elif frames and (value := _only_value(role, frames)):
            yield _constant(role, value, len(frames))


def check_in_all_frames(material: Material) -> Iterator[Finding]:
    """AOVs that some frames have and others lack: a run ends at a frame without one of the
    first's."""
    for role in dict.fromkeys(role for frame in material.frames for role in frame.planes):
        without = [frame.number for frame in material.frames if role not in frame]
        if without:
            level = error if role in material.frames[0] else warning
            yield level(role, "not-in-all-frames",
                        f"not in frame{'s' * (len(without) > 1)} {_list(without)}",
                        "rendered with other settings, or by another version",
                        "render these frames again, or choose others (--frames)")


def _black(role: Role, black: Sequence[int], examined: int, may_be: bool) -> Finding:
    """The finding for a plane that is black in the frames of these numbers, of all that were
    examined. may_be: whether a scene can look so."""
    evidence = (f"0 everywhere in frame{'s' * (len(black) > 1)} {_list(black)}; {examined} were "
                "examined")
    cause = ("switched off, or nothing in view has such a value" if may_be
             else "the pass is switched off or was never written")
    level = info if may_be else error
    return level(role, "black", evidence, cause,
                 "render it, or delete the AOV: a black one misleads")


def _may_be_black(role: Role, frame: Frame) -> bool:
    """Whether a scene can be 0 everywhere: its normals cannot, its diffuse albedo can if all in
    view is metal."""
    if role is Role.DIFFUSE_ALBEDO:
        return _is_metal(frame)
    return role is not Role.NORMAL


def _only_value(role: Role, frames: Sequence[Frame]) -> str:
    """The one value that a plane has in all pixels of all frames, or the one normal of each frame;
    '' if there are several."""
    if role is Role.NORMAL:
        if not all(_is_one_value(frame[role]) for frame in frames):
            return ""
        axes = ", ".join(f"{axis:.4g}" for axis in frames[0][role][0, 0])
        return f"({axes})"
    values = {value for frame in frames for value in _extremes(frame[role])}
    return f"{values.pop():.4g}" if len(values) == 1 else ""


def _constant(role: Role, value: str, frames: int) -> Finding:
    level = info if role in (Role.ROUGHNESS, Role.SPECULAR_ALBEDO) else warning
    return level(role, "constant", f"{value} everywhere in {frames} frame{'s' * (frames > 1)}",
                 "a default instead of the pass, or an override material",
                 "render it, or delete the AOV")


def _shows_surfaces(frame: Frame) -> bool:
    """Whether the picture is lit and its depth, if it has any, shows surfaces."""
    if Role.COLOUR in frame and _is_black(frame[Role.COLOUR]):
        return False
    if Role.DEPTH not in frame or not frame[Role.DEPTH].any():
        return True
    return percent(is_hit(frame[Role.DEPTH])) > 1


def _is_black(plane: np.ndarray) -> bool:
    return float(np.abs(finite(plane)).max(initial=0)) < BLACK_VALUE


def _is_metal(frame: Frame) -> bool:
    """Whether the surfaces in view reflect so much specularly that their diffuse albedo may
    be 0."""
    return (Role.SPECULAR_ALBEDO in frame
            and float(np.median(largest(finite(frame[Role.SPECULAR_ALBEDO])))) > 0.3)


def _extremes(plane: np.ndarray) -> tuple[float, float]:
    """The least and the largest finite value of a plane."""
    return float(finite(plane).min()), float(finite(plane).max())


def _is_one_value(plane: np.ndarray) -> bool:
    return bool((plane == plane[:1, :1]).all())


def _list(numbers: Sequence[int]) -> str:
    return ", ".join(map(str, numbers[:MOST_LISTED])) + " ..." * (len(numbers) > MOST_LISTED)


ENLARGING_FILTERS = {"repetition": (1, -1), "linear interpolation": (-0.5, 1.5, -1.5, 0.5)}
"""Differences that are 0 at every other place of a plane that was enlarged to twice its size."""
LEAST_SIDE_PX = 32
"""Smaller planes are not tested."""
LEAST_ROWS = 12
"""Rows, or columns, that must show differences."""
EXACT_ENLARGED_SHARE = 0.08
"""A plane was enlarged where the differences at every other place are below this share of those
between."""


def check_enlarged_planes(material: Material) -> Iterator[Finding]:
    """Planes of half the resolution, enlarged to the size of the others."""
    for role in (Role.COLOUR, *ALIGNED_PLANES):
        if role in material.middle and (how := _enlarged_how(material.middle[role])):
            yield error(role, "half-resolution",
                        f"1 pixel in 2 along rows and columns follows by {how}",
                        "rendered at half the resolution and enlarged",
                        "write it at the size of the colour")


def _enlarged_how(plane: np.ndarray) -> str:
    """'repetition', 'linear interpolation', or '' for a plane of full resolution."""
    plane = np.where(np.isfinite(plane), np.clip(plane, -1e4, 1e4), 0).astype(np.float32)
    if min(plane.shape[:2]) < LEAST_SIDE_PX:
        return ""
    for how, taps in ENLARGING_FILTERS.items():
        both_ways = (_phase_ratio(along, np.array(taps, np.float32))
                     for along in (plane, plane.swapaxes(0, 1)))
        if all(ratio < EXACT_ENLARGED_SHARE for ratio in both_ways):
            return how
    return ""


def _phase_ratio(plane: np.ndarray, taps: np.ndarray) -> float:
    """Differences down the columns in those rows, the even or the odd ones, where they are smaller,
    over those in the others: 0 to 1, and 1 where fewer than `LEAST_ROWS` rows have any."""
    count = len(plane) - len(taps) + 1
    size = np.abs(sum(tap * plane[at : at + count] for at, tap in enumerate(taps)))
    by_row = np.minimum(size, 10 * size.mean()).mean(axis=(1, 2))
    is_telling = by_row > 0.01 * by_row.mean()
    even, odd = is_telling[0::2].sum(), is_telling[1::2].sum()
    if even + odd < LEAST_ROWS:
        return 1.0
    if min(even, odd) == 0:
        return 0.0
    low, high = sorted((float(by_row[0::2].mean()), float(by_row[1::2].mean())))
    return low / max(high, 1e-12)


# A plane is misplaced where its outlines fit other ones clearly better than those of its own
# frame: correlations, and how many times as large they must be, and by how much larger.
FLIP_RATIO = 1.5
FLIP_MARGIN = 0.13
OTHER_FRAME_RATIO = 1.15
OTHER_FRAME_MARGIN = 0.03
LEAST_OTHER_CORRELATION = 0.12

LEAST_OFF_SHARE = 0.6
"""Share of the frames that must fit another one better."""
FEWEST_OUTLINED_FRAMES = 3


def check_misplaced_planes(material: Material) -> Iterator[Finding]:
    """Planes of another frame, and flipped planes, found by their outlines."""
    frames = [frame for frame in material.frames if frame.spec.width == material.first.spec.width
              and frame.spec.height == material.first.spec.height]
    frozen = _find_frozen(frames)
    for role in frozen:
        yield error(role, "other-frame",
                    f"identical in frames {_list([f.number for f in frames])}, while other AOVs "
                    "change", "the AOV of one frame was written to all",
                    "write each frame's own AOV")
    for role, placement in compare_edges(frames).items():
        flip = max(placement.flips, key=lambda name: placement.flips[name])
        if placement.flips[flip] > FLIP_RATIO * max(placement.own, 0) + FLIP_MARGIN:
            yield error(role, "flipped",
                        "its outlines fit those of the other AOVs with a correlation of "
                        f"{placement.own:.2f}, but {placement.flips[flip]:.2f} when {flip}",
                        "rows or columns written the other way round",
                        "write all AOVs from the upper left corner")
        elif role not in frozen and len(placement.at) >= FEWEST_OUTLINED_FRAMES:
            yield from _of_other_frame(role, placement.frames,
                                       [frames[at].number for at in placement.at])


def _of_other_frame(role: Role, table: np.ndarray, numbers: list[int]) -> Iterator[Finding]:
    """The finding for a plane whose outlines fit those of other frames. table: (frames, frames) of
    correlations, as in `Placement`. numbers: of these frames."""
    own = np.diag(table)
    other = table - 2 * np.eye(len(table))  # below all others on the diagonal
    source = other.argmax(1)
    least = np.maximum(OTHER_FRAME_RATIO * own, own + OTHER_FRAME_MARGIN)
    off = other.max(1) > np.maximum(least, LEAST_OTHER_CORRELATION)
    if off.mean() > LEAST_OFF_SHARE and len(set(source[off])) >= 2:
        fits = ", ".join(f"frame {numbers[source[at]]} holds frame {numbers[at]}'s"
                         for at in np.nonzero(off)[0][:3])
        evidence = (f"by its outlines {fits} (correlation {other.max(1)[off].mean():.2f}, with its "
                    f"own frame's AOVs {own[off].mean():.2f})")
        yield error(role, "other-frame", evidence,
                    "the AOV was written a frame late or early, or frames are in another order",
                    "write each frame's own AOV")


def _find_frozen(frames: Sequence[Frame]) -> list[Role]:
    """Planes that show something and never change, although most others do."""
    if len(frames) < 2:
        return []
    pairs = list(zip(frames, frames[1:], strict=False))
    shown = [role for role in (*ALIGNED_PLANES, Role.COLOUR)
             if all(role in frame for frame in frames) and not _is_one_value(frames[0][role])]
    still = [role for role in shown
             if all(np.array_equal(a[role], b[role], equal_nan=True) for a, b in pairs)]
    changing = [role for role in shown if role not in still and role is not Role.COLOUR]
    if len(changing) < max(2, len(still)):
        return []
    return [role for role in still if role is not Role.COLOUR]


def check_negative_values(material: Material) -> Iterator[Finding]:
    """Negative values in planes that cannot hold any."""
    for role in NEVER_NEGATIVE:
        values = material.stored.get(role)
        if values is None or values.negative == 0:
            continue
        share = 100 * values.negative / values.total
        lowest = float(np.nanmin(material.first[role]))
        evidence = (f"{values.negative} of {values.total} values below 0 ({share:.3g} %), least "
                    f"{lowest:.3g}")
        cause = ("a filter with negative lobes, a conversion of primaries, or an AOV of another "
                 "meaning")
        fix = "render with a positive pixel filter, and linear Rec.709"
        if _negative_share(material.first[role]) < UNSEEN_NEGATIVE:
            yield info(role, "negative", f"{evidence}, too little to be seen",
                       "rounding, as of lossy compression (dwa)", "none needed")
            continue
        level = error if share > MANY_PERCENT else warning if share > 0.1 else info
        yield level(role, "negative", evidence, cause, fix)


def _negative_share(plane: np.ndarray) -> float:
    """Share of what is below 0 in the sum of a plane's absolute values."""
    values = plane[np.isfinite(plane)].astype(np.float64)
    whole = float(np.abs(values).sum())
    return float(-values[values < 0].sum()) / whole if whole else 0.0


def check_light_outside(material: Material) -> Iterator[Finding]:
    """So much negative light that a pixel filter is not the reason, but colours that the primaries
    cannot hold."""
    share = light_outside(material.first[Role.COLOUR]) if Role.COLOUR in material.first else 0.0
    if share > OUTSIDE:
        evidence = (f"{100 * share:.2g} % of the light is outside the gamut, below 0: a CPU "
                    "denoises it in wider primaries; on a GPU it counts as 0 in each noisy pixel, "
                    "and colours come out paler and brighter")
        yield info(Role.COLOUR, OUTSIDE_GAMUT, evidence,
                   "saturated lights in primaries that cannot hold them",
                   "for a GPU, render in ACEScg; of files in ACEScg write EXR first, and pictures "
                   "of that by --no-denoise (docs/howto/display.md)")


def check_unit_range(material: Material) -> Iterator[Finding]:
    """Masks above 1."""
    for role in IN_UNIT_RANGE:
        if role in material.first and (share := percent(material.first[role] > 1.001)) > 0:
            evidence = (f"{share:.3g} % of the pixels above 1, largest "
                        f"{np.nanmax(material.first[role]):.3g}")
            yield warning(role, "above-one", evidence, "stored in percent or 0..255",
                          "store 0..1, or scale it in a profile")


def check_colour_clipped(material: Material) -> Iterator[Finding]:
    """Colour that ends at exactly 1, as if made for a display."""
    if Role.COLOUR not in material.first:
        return
    colour = material.first[Role.COLOUR]
    share = percent(colour == 1.0)
    if float(np.nanmax(colour, initial=0.0)) == 1.0 and 0.5 < share < 90:
        evidence = f"the largest value is exactly 1, at {share:.3g} % of the values"
        yield warning(Role.COLOUR, "colour-clipped", evidence,
                      "tone-mapped, clamped or converted for a display",
                      "write scene-linear light without a view transform or clamp")


def check_readable_frames(material: Material) -> Iterator[Finding]:
    """A later frame that cannot be read."""
    if material.unreadable:
        yield error("sequence", "unreadable", material.unreadable,
                    "a broken file, or one without the others' AOVs",
                    "render or copy this frame again")


# Overlays and alpha. Coverage is 0 to 1; pairs of neighbouring pixels are compared.

LEAST_COVERAGE = 0.02
"""Pixels with less are left out."""
LEAST_CHANGE_STOPS = 0.02
"""Pairs of which the coverage changes by less are left out."""
LEAST_NOISY_CHANGE_STOPS = 0.2
"""Pairs that are left out where colour is noisy: larger changes stand out from the noise."""
FEWEST_CHANGED_PIXELS = 200
STRAIGHT_SLOPE = 0.3
"""Colour is not multiplied by coverage where `_slope` is below this; it is 1 if it is."""

# Detail of medium size, and its correlation where colour holds the overlay already.
NARROW_WINDOW_PX = 2
WIDE_WINDOW_PX = 16
HELD_TWICE_CORRELATION = 0.4


def check_overlay_alpha(material: Material) -> Iterator[Finding]:
    """Coverage outside 0..1, or coverage that hides everything."""
    if Role.OVERLAY not in material.middle:
        return
    alpha = finite(material.middle[Role.OVERLAY])[..., 3]
    if (share := percent((alpha < -0.001) | (alpha > 1.001))) > 0:
        evidence = (f"{share:.3g} % of the pixels outside of 0..1, from {alpha.min():.3g} to "
                    f"{alpha.max():.3g}")
        yield warning(Role.OVERLAY, "overlay-alpha", evidence,
                      "stored in percent or 0..255, or layers were added",
                      "write coverage 0..1, and composite layers over each other; other values are "
                      "cut off")
    if (share := percent(alpha > 0.999)) > 99:
        yield warning(Role.OVERLAY, "overlay-opaque", f"alpha is 1 at {share:.4g} % of the pixels",
                      "rendered with its background",
                      "render transparent objects alone, on a transparent background")


def check_overlay_straight(material: Material) -> Iterator[Finding]:
    """Overlay colour that is not multiplied by its coverage."""
    if Role.OVERLAY not in material.middle:
        return
    slope, pairs = _slope(finite(material.middle[Role.OVERLAY]))
    if pairs >= FEWEST_CHANGED_PIXELS and slope < STRAIGHT_SLOPE:
        evidence = (f"where coverage doubles, colour becomes {2**slope:.2f} times as bright, not "
                    f"twice ({pairs} pairs of neighbours)")
        yield warning(Role.OVERLAY, "overlay-straight", evidence,
                      "colour that is not multiplied by alpha",
                      "write premultiplied colour, or multiply it by alpha; else edges are too "
                      "bright")


def check_alpha_straight(material: Material) -> Iterator[Finding]:
    """Colour that is not multiplied by its alpha."""
    frame = material.middle
    if not all(role in frame for role in (Role.COLOUR, Role.ALPHA)):
        return
    slope, pairs = _slope(finite(np.concatenate([frame[Role.COLOUR], frame[Role.ALPHA]], axis=2)),
                          LEAST_NOISY_CHANGE_STOPS)
    if pairs >= FEWEST_CHANGED_PIXELS and slope < STRAIGHT_SLOPE:
        yield warning(Role.COLOUR, "alpha-straight",
                      f"where alpha doubles, colour becomes {2**slope:.2f} times as bright, not "
                      f"twice ({pairs} pairs of neighbours)",
                      "colour that is not multiplied by alpha",
                      "write premultiplied colour: else edges are too bright")


def check_overlay_twice(material: Material) -> Iterator[Finding]:
    """Colour that already holds the overlay."""
    frame = material.middle
    if not all(role in frame for role in (Role.COLOUR, Role.OVERLAY)):
        return
    overlay, light = finite(frame[Role.OVERLAY]), luminance(finite(frame[Role.COLOUR]))
    change = _detail(luminance(overlay[..., :3]) - overlay[..., 3] * np.median(light))
    used = np.abs(change) > np.percentile(np.abs(change), 80)
    shared = correlation(_detail(np.minimum(light, np.percentile(light, 90)))[used], change[used])
    if used.sum() >= FEWEST_CHANGED_PIXELS and shared > HELD_TWICE_CORRELATION:
        yield warning(Role.OVERLAY, "overlay-twice",
                      f"detail of the colour is {shared:.2f} correlated with what the overlay "
                      "changes", "the colour already holds the overlay, so it would appear twice",
                      "write the colour before transparents, as colour or beside it as 'opaque', "
                      "or give --overlay ignore")


def check_overlay_missing(material: Material) -> Iterator[Finding]:
    """Two colours, with and without transparents, and no overlay."""
    frame = material.middle
    colours = (Role.COLOUR, Role.OPAQUE_COLOUR)
    if (all(role in frame for role in colours)
        and Role.OVERLAY not in (*frame.planes, *frame.guides)):
        share = percent((frame[Role.COLOUR] != frame[Role.OPAQUE_COLOUR]).any(2))
        evidence = (f"colours with and without transparents differ at {share:.3g} % of the pixels, "
                    "but there is no overlay: the colour with transparents is denoised")
        yield info(Role.OVERLAY, "overlay-missing", evidence,
                   "an overlay's four channels do not follow from three differences",
                   "write transparent objects as 'overlay', premultiplied RGBA")


def _slope(overlay: np.ndarray, least_change: float = LEAST_CHANGE_STOPS) -> tuple[float, int]:
    """Slope of the logarithm of light over the logarithm of coverage from pixel to pixel, and the
    number of pairs used.

    overlay: (height, width, 4). least_change: of coverage within a pair, in stops. The slope is 1
    for premultiplied colour and 0 for straight colour.
    """
    light, alpha = luminance(np.maximum(overlay[..., :3], 0)), overlay[..., 3]
    used = (alpha > LEAST_COVERAGE) & (light > 1e-4)
    logs = [np.log2(np.where(used, plane, 1)) for plane in (light, alpha)]
    lit, covered = (np.concatenate([np.diff(log, axis=axis).ravel() for axis in (0, 1)])
                    for log in logs)
    both = np.concatenate([(used[1:] & used[:-1]).ravel(), (used[:, 1:] & used[:, :-1]).ravel()])
    both &= np.abs(covered) > least_change
    lit, covered = lit[both], covered[both]
    return float(np.median(lit / covered)) if both.any() else 1.0, int(both.sum())


def _detail(plane: np.ndarray) -> np.ndarray:
    """Detail of medium size: without noise, which is finer, and shading, which is coarser."""
    result: np.ndarray = (local_mean(plane[..., None], NARROW_WINDOW_PX)
                          - local_mean(plane[..., None], WIDE_WINDOW_PX))
    return result


MOST_REACTIVE_PERCENT = 90.0
"""Percent of pixels that may ignore more than half of their history."""

# Colours are of different samples where more pixels than this differ by a tenth, and fewer pairs of
# neighbours than this are both brighter or both darker.
LEAST_DIFFERENT_PERCENT = 25.0
ALIKE_NEIGHBOURS_PERCENT = 65.0


def check_reactive_everywhere(material: Material) -> Iterator[Finding]:
    """A mask that drops the history nearly everywhere."""
    frame = material.middle
    if Role.REACTIVE not in frame:
        return
    share = percent(frame[Role.REACTIVE] > 0.5)
    if share > MOST_REACTIVE_PERCENT:
        evidence = f"{share:.3g} % of the pixels ignore more than half of their history"
        yield warning(Role.REACTIVE, "reactive-everywhere", evidence,
                      "stored the other way round, 1 where the history is used",
                      "store 0 to use the history and 1 to ignore it")


def check_opaque_samples(material: Material) -> Iterator[Finding]:
    """Colour before transparency with other noise than the colour: it is brighter here and darker
    next to it, where a transparent object would change neighbours alike."""
    frame = material.middle
    if Role.COLOUR not in frame or Role.OPAQUE_COLOUR not in frame:
        return
    before = frame[Role.OPAQUE_COLOUR].sum(axis=2)
    change = frame[Role.COLOUR].sum(axis=2) - before
    sign = np.where(np.abs(change) > 0.1 * np.abs(before), np.sign(change), 0)
    both = (sign[:, 1:] != 0) & (sign[:, :-1] != 0)
    share = percent(sign != 0)
    alike = percent((sign[:, 1:] == sign[:, :-1])[both]) if both.any() else 100.0
    if share > LEAST_DIFFERENT_PERCENT and alike < ALIKE_NEIGHBOURS_PERCENT:
        evidence = (f"{share:.3g} % of the pixels differ from the colour by more than a tenth, and "
                    f"{alike:.3g} % of neighbours in the same direction")
        yield warning(Role.OPAQUE_COLOUR, "opaque-samples", evidence,
                      "rendered with other samples than the colour, so the reactive mask holds "
                      "noise",
                      "write both colours from the same samples, or an AOV 'reactive'; --reactive "
                      "none ignores it")


# Stops: between the header's exposure and what metering wants; between two frames of one shot; and
# of what metering wants at all, from 0.
MISMATCH_EV = 2.0
JUMP_EV = 0.75
UNUSUAL_EV = 8.0


def _exposure_jumps(frames: list[Frame], metered: dict[int, float]) -> Iterator[Finding]:
    """The first frame of a shot that is suddenly brighter or darker, by colour or by the header's
    exposure. metered: frame number -> stops that metering wants."""
    exposures = {frame.number: _header_exposure(frame) for frame in frames}
    for before, now in zip(frames, frames[1:], strict=False):
        if now.reset or before.number not in metered or now.number not in metered:
            continue
        header = exposures[now.number] - exposures[before.number]
        colour = metered[before.number] - metered[now.number]
        if abs(header + colour) > JUMP_EV:
            role = "sequence" if abs(header) > abs(colour) else Role.COLOUR
            yield warning(role, "exposure-jump",
                          f"from frame {before.number} to {now.number} the picture becomes "
                          f"{header + colour:+.2f} EV brighter ({colour:+.2f} by its colour, "
                          f"{header:+.2f} by the header)",
                          "a light was switched, the renderer exposes automatically, or the header "
                          "does not follow the colour",
                          "render with one exposure; mark a cut with postfx:reset = 1")
            return


def _header_exposure(frame: Frame) -> float:
    """Stops of the header; 0 where there are none, or no number."""
    exposure = frame.exposure
    return exposure if exposure is not None and math.isfinite(exposure) else 0.0


def black_colour(frames: int) -> Finding:
    """What is to be said of frames, as many as these, none of which has light."""
    count = f"all {frames} frames" if frames > 1 else "the frame"
    return warning(Role.COLOUR, "colour-black", f"black in {count}",
                   "lights off, or another layer's colour",
                   "check that the colour AOV is the beauty pass")


def check_exposure_mismatch(material: Material) -> Iterator[Finding]:
    """An exposure in the header that differs from metering, which brings the picture to mid
    grey."""
    frames = [frame for frame in material.frames if Role.COLOUR in frame]
    measured = {frame.number: measure(frame[Role.COLOUR]) for frame in frames}
    metered = {number: ev for number, ev in measured.items() if ev is not None}
    if frames and not metered:
        yield black_colour(len(frames))
    yield from _exposure_jumps(frames, metered)
    headers = {frame.number: frame.exposure for frame in frames if frame.exposure is not None}
    if any(not math.isfinite(value) for value in headers.values()):
        yield error("sequence", "exposure-invalid",
                    f"exposure in the header: {next(iter(headers.values()))} EV",
                    "stops were written as postfx:exposure, which is a factor",
                    "write stops as postfx:exposureEV")
    elif headers:
        yield from _header_mismatch(headers, metered)
    elif metered:
        yield from _unusual_exposure(float(np.median(list(metered.values()))))


def _header_mismatch(headers: dict[int, float], metered: dict[int, float]) -> Iterator[Finding]:
    """Headers whose exposure is far from what metering wants: frame number -> stops, of both."""
    both = [number for number in metered if number in headers]
    if not both:
        return
    off = float(np.median([headers[number] - metered[number] for number in both]))
    if abs(off) <= MISMATCH_EV:
        return
    evidence = (f"the header's exposure is {headers[both[0]]:+.2f} EV, metering wants "
                f"{metered[both[0]]:+.2f} EV: {off:+.2f} EV")
    result = "bright" if off > 0 else "dark"
    yield warning("sequence", "exposure-mismatch", evidence,
                  f"pictures would be too {result}: colour was scaled after the exposure was set, "
                  "or the exposure belongs to another camera",
                  "write the stops that bring mid grey to 0.18, or use --exposure auto")


def _unusual_exposure(ev: float) -> Iterator[Finding]:
    """Light so bright or dark that its unit is another one, where no header says an exposure."""
    if abs(ev) > UNUSUAL_EV:
        yield info("sequence", "exposure-unusual", f"metering wants {ev:+.2f} EV",
                   "physical light units without a camera's exposure",
                   "nothing to do with --exposure auto; else write postfx:exposureEV")
