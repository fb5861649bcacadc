"""Checks that compare frames: motion, tried in every variant by warping; cuts, jitter and noise
that repeats."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from postfx.colour import luminance
from postfx.doctor import Finding, correlation, error, finite, info, noise_level, warning
from postfx.doctor.alignment import find_movers
from postfx.doctor.geometry import DepthScale, fit_depth_scale, motion_of_camera
from postfx.doctor.material import Material
from postfx.doctor.motion_convention import measure_convention
from postfx.doctor.motion_variants import (
    RELATED_SCORE_RATIO,
    VARIANTS,
    PairScores,
    Variant,
    scaled_variants,
    score_offset,
    score_variants,
)
from postfx.frame import Frame, Role
from postfx.repeats import ONE_SEED, RepeatDetector
from postfx.sampling import local_mean

# Scores are errors of warped pictures, see `motion_variants`.

# Another variant is right if it scores below this part of the stored motion's score; likewise one
# of the jitter alone, and none at all.
BETTER_SCORE_RATIO = 0.85
BETTER_JITTER_SCORE_RATIO = 0.95
BETTER_NONE_SCORE_RATIO = 0.65

AGREEING_PAIR_SHARE = 0.75
"""Share of the pairs of frames in which it must score lower."""
TELLING_SCORE = 0.05
"""Stored motion that scores lower is right."""

# Scores up to this many times the best one count as equal; the second holds for a colour if
# motion lies in 0..1.
ALIKE_SCORE_RATIO = 1.03
ALIKE_COLOUR_SCORE_RATIO = 1.15

TRIED_MOTION_PX = 12
"""Pixels each way that a picture without motion is moved by."""
MOVED_SCORE_RATIO = 0.75
"""It has moved if that scores below this part of the score where it is."""
LEAST_CAMERA_MOTION_PX = 0.1
JITTER_CODES = ("motion-jitter", "jitter-sign", "jitter-unit")
USEFUL_SCORE_RATIO = 0.7
"""Right motion scores below this part of the score without motion."""
SOME_PAIRS = 2
"""Pairs that are enough for what takes long."""

LEAST_COMPARED_MOTION_PX = 0.2
"""Median length of motion that the cameras' is compared with, at least."""
# Differences in parts of that length: the cameras disagree, and a factor explains it.
DISAGREEING_SHARE = 0.3
EXPLAINED_SHARE = 0.1

UNDERSTOOD_DEPTH_DEGREES = 5.0
"""Largest angle between the normals of depth and the stored ones for which depth is understood."""
RIGHT_UNIT_SCORE_RATIO = 0.9
"""A unit by the cameras scores below this part of the stored motion's score."""
FEWEST_MOVED_BLOCKS = 4
NO_JITTER_PX = 0.02
MOST_JITTER_PX = 0.501
"""Samples lie within half a pixel; the rest is rounding."""
NOISE_SCORE = 1.0
"""Planes have no more structure than noise when the score of chance is below this."""


def check_motion_variant(material: Material) -> Iterator[Finding]:
    """The variant that fits clearly better than the stored motion."""
    shots = [warped for warped in material.shots if warped.moved > 0]
    if not shots:
        yield from _untested(material)
        return
    best = best_variant(shots)
    if best is None:
        yield from _by_other_means(material, shots)
        return
    yield from _of_variant(material, shots, best)


def check_motion_at_a_glance(material: Material) -> Iterator[Finding]:
    """Vectors of the wrong sign, axes or unit: the part of `check_motion_variant` that takes little
    time."""
    shots = [warped for warped in material.shots if warped.moved > 0]
    best = best_variant(shots) if shots else None
    if best and best.code not in JITTER_CODES:
        yield from _of_variant(material, shots, best)


def _of_variant(material: Material, shots: list[PairScores], best: Variant) -> Iterator[Finding]:
    if (best.code in JITTER_CODES
        and (unit := _unit_by_cameras(_camera_fits(material, shots), shots))):
        yield unit  # without its motion, a picture seems to move by the jitter alone
        return
    code, cause, fix = best.code, best.cause, best.fix
    if code == "motion-worse-than-none" and (scaled := best_scale(shots)):
        best, code, cause, fix = scaled, scaled.code, scaled.cause, scaled.fix
    if code == "motion-jitter" and not _follows_jitter(shots):
        code, cause = "jitter-unused", "the header gives a jitter that the samples do not have"
        fix = "remove postfx:jitter where samples are spread over the pixel"
    role = "sequence" if code.startswith("jitter") else Role.MOTION
    yield error(role, code, _evidence(shots, best), cause, _with_lines(material, best, fix))


def _with_lines(material: Material, variant: Variant, fix: str) -> str:
    """The fix and, if the file's layer is known, the complete profile."""
    lines = (material.read_motion.correct(*variant.change)
             if material.read_motion and variant.change else None)
    return f"{fix}; as a file for --profile FILE.toml:\n{lines}" if lines else fix


def check_motion_unread(material: Material) -> Iterator[Finding]:
    """Motion in a layer that no profile reads, and the convention that the pictures show."""
    for motion in material.unread:
        name = f"{motion.layer}.{','.join(motion.letters)}"
        found = measure_convention(material.frames, motion)
        if found is None or not found.fits:
            yield info(Role.MOTION, "motion-unread",
                       f"{name} is not read, and does not fit the pictures as motion",
                       "it is not motion, or too little in view moves",
                       "try a part of the sequence with more motion")
            continue
        better = found.still / max(found.misfit, 1e-9)
        evidence = (f"{name} is not read; the previous frame, warped by it, fits {better:.3g} "
                    f"times better than without motion if it is in {found.convention}: misfit "
                    f"{found.misfit:.3g} instead of {found.still:.3g}")
        yield warning(Role.MOTION, "motion-unread", evidence,
                      "the renderer's documents do not say how it is stored, or it has another "
                      "name",
                      "write this into a file, for --profile FILE.toml:\n"
                      f"{found.convention.lines(motion)}")


def _by_other_means(material: Material, shots: list[PairScores]) -> Iterator[Finding]:
    """Motion that no usual variant corrects: another unit, depth that does not fit, or objects that
    move alone."""
    if scaled := best_scale(shots):
        yield error(Role.MOTION, scaled.code, _evidence(shots, scaled), scaled.cause,
                    _with_lines(material, scaled, scaled.fix))
        return
    if fits := _camera_fits(material, shots):
        yield _unit_by_cameras(fits, shots) or _cameras_disagree(fits)
        return
    yield from _movers([shots[0], shots[-1]] if len(shots) > 1 else shots)


def _camera_fits(material: Material, shots: list[PairScores]) -> list[DepthScale]:
    """How the cameras' motion differs from the stored motion; empty if it does not, or if depth is
    not understood."""
    if material.fit and material.fit.angle > UNDERSTOOD_DEPTH_DEGREES:
        return []
    found = [fit_depth_scale(pair.before, pair.now) for pair in shots[:SOME_PAIRS]]
    fits = [fit for fit in found if fit and fit.length > LEAST_COMPARED_MOTION_PX]
    disagree = all(fit.error_as_it_is > DISAGREEING_SHARE * fit.length for fit in fits)
    return fits if disagree else []


def _camera_evidence(fits: list[DepthScale]) -> tuple[str, float]:
    """How far the cameras' motion is from the stored one, and the median length of the longer one
    in pixels."""
    length = float(np.median([fit.length for fit in fits]))
    apart = float(np.median([fit.error_as_it_is for fit in fits]))
    text = (f"worldToCamera and depth give motion that differs by {apart:.3g} of {length:.3g} "
            "pixels in the median")
    return text, length


def _unit_by_cameras(fits: list[DepthScale], shots: list[PairScores]) -> Finding | None:
    """Motion that differs from the cameras' by one factor, if the pictures confirm it."""
    if not fits:
        return None
    evidence, length = _camera_evidence(fits)
    factor = float(np.median([fit.factor for fit in fits]))
    rest = float(np.median([fit.rest for fit in fits]))
    if not factor or abs(factor - 1) < 0.1 or rest > EXPLAINED_SHARE * length:
        return None
    scale = np.float32(1 / factor)
    unit = Variant("motion-scale", f"{scale:.3g} times as long",
                   "motion in a unit that is not pixels of the frame",
                   f"in a profile scale = [{scale:.4g}, {scale:.4g}]",
                   lambda motion, size, jitter: motion * scale)
    in_unit = sum(score_variants(pair, [unit])[unit] for pair in shots)
    if in_unit > RIGHT_UNIT_SCORE_RATIO * sum(pair.as_it_is for pair in shots):
        return None
    evidence += f"; {rest:.2g} pixels if motion is {unit.name}"
    return error(Role.MOTION, unit.code, evidence, unit.cause, unit.fix)


def _cameras_disagree(fits: list[DepthScale]) -> Finding:
    """The finding for motion that differs from the cameras', by a factor on depth or otherwise."""
    evidence, length = _camera_evidence(fits)
    scale = float(np.median([fit.scale for fit in fits]))
    least = float(np.median([fit.error for fit in fits]))
    if least < EXPLAINED_SHARE * length and abs(np.log10(scale)) > 0.05:
        return error(Role.DEPTH, "depth-scale",
                     f"{evidence}; {least:.2g} pixels if depth is about {scale:.3g} times as large",
                     "depth in another unit than worldToCamera, or divided by the far plane",
                     "write depth in the unit of the camera's position, or in a profile scale = "
                     f"[{scale:.3g}]")
    return warning(Role.MOTION, "motion-mismatch", evidence,
                   "vectors or camera matrices of another frame, or nothing in view stands still",
                   "write the vectors and the matrix of this frame")


def _movers(shots: list[PairScores]) -> Iterator[Finding]:
    """Objects that move although they have the vectors of the world around them."""
    things = []
    for warped in shots:
        large = [thing for thing in find_movers(warped.before, warped.now)
                 if thing.blocks >= FEWEST_MOVED_BLOCKS]
        things += [(warped.now.number, large[0])] if large else []
    if things and len(things) == len(shots):
        number, thing = max(things, key=lambda one: one[1].blocks)
        evidence = (f"frame {number}: around pixel ({thing.x}, {thing.y}), "
                    f"{thing.blocks} blocks of 8 x 8 pixels come from a place that is {thing.step} "
                    "pixels off the one where their vectors point")
        yield error(Role.MOTION, "motion-of-things", evidence,
                    "only the camera's motion was written: objects that move or deform have the "
                    "vectors of the world behind them",
                    "write vectors that include the animation and deformation of each object")


def check_motion_zero(material: Material) -> Iterator[Finding]:
    """Motion that is 0 everywhere though the camera or the picture moves."""
    without = [warped for warped in material.pair_scores
               if not warped.now.reset and warped.moved == 0]
    for warped in without[:SOME_PAIRS]:
        evidence = _by_camera(warped) or _by_picture(warped)
        if evidence:
            cause = ("written without motion: the vector pass is off, or the previous camera was "
                     "not kept")
            yield error(Role.MOTION, "motion-zero",
                        f"frame {warped.now.number}: all motion is 0, {evidence}", cause,
                        "render real motion, or delete the AOV")
            return


def _by_camera(warped: PairScores) -> str:
    """Evidence that the camera moves; '' if it does not, or nothing tells."""
    moved = motion_of_camera(warped.before, warped.now)
    if moved is None or not len(moved):
        return ""
    mean = float(np.linalg.norm(moved, axis=-1).mean())
    if mean < LEAST_CAMERA_MOTION_PX:
        return ""
    return (f"but worldToCamera and depth say that the camera moves surfaces by {mean:.2f} pixels "
            "in the mean")


def _by_picture(warped: PairScores) -> str:
    """Evidence that the picture as a whole has moved; '' if it has not."""
    offsets = list(product(range(-TRIED_MOTION_PX, TRIED_MOTION_PX + 1), repeat=2))
    scores = {at: score_offset(warped.features, np.add(at, warped.jitter)) for at in offsets}
    best = min(scores, key=lambda at: scores[at])
    enough = min(MOVED_SCORE_RATIO * scores[0, 0], RELATED_SCORE_RATIO * warped.unrelated)
    if scores[best] >= enough:
        return ""
    return (f"but the previous frame fits better ({scores[best]:.3g}, not {scores[0, 0]:.3g}) when "
            f"moved by {best} pixels")


def best_variant(shots: list[PairScores]) -> Variant | None:
    """The simplest of the variants that fit best; None if the stored motion fits best."""
    ratios = {variant: _ratio(shots, variant) for variant in VARIANTS if variant.code}
    good = {variant: ratio
            for variant, ratio in ratios.items() if _is_better(shots, variant, ratio)}
    if not good:
        return None
    least = min(good.values())
    of_colour = {variant: ratio for variant, ratio in good.items() if variant.is_colour}
    if of_colour and min(of_colour.values()) <= ALIKE_COLOUR_SCORE_RATIO * least:
        good = of_colour
        least = min(good.values())
    alike = [variant for variant in good if good[variant] <= ALIKE_SCORE_RATIO * least]
    return min(alike, key=lambda variant: (variant.priority, good[variant]))


def best_scale(shots: list[PairScores]) -> Variant | None:
    """An unusual unit of the motion that fits clearly better; None if the stored motion beats no
    motion at all."""
    still = next(variant for variant in VARIANTS if variant.code == "motion-worse-than-none")
    some = shots[:SOME_PAIRS]
    stored = float(np.mean([warped.as_it_is for warped in some]))
    unmoved = float(np.mean([warped.scores[still] for warped in some]))
    if stored < USEFUL_SCORE_RATIO * unmoved:
        return None
    found = [score_variants(warped, scaled_variants()) for warped in some]
    scores = {variant: float(np.mean([one[variant] for one in found]))
              for variant in scaled_variants()}
    best = min(scores, key=lambda variant: scores[variant])
    if scores[best] >= BETTER_SCORE_RATIO * min(stored, unmoved):
        return None
    for warped in shots:
        warped.scores |= score_variants(warped, [best])
        warped.by_role[best] = warped.by_role[VARIANTS[0]]
    return best


def _ratio(shots: list[PairScores], variant: Variant) -> float:
    """A variant's score over that of the stored motion."""
    scores = [warped.scores.get(variant, np.inf) for warped in shots]
    stored = [min(warped.as_it_is, warped.unrelated) for warped in shots]
    return float(np.sum(scores) / max(np.sum(stored), 1e-9))


def _is_better(shots: list[PairScores], variant: Variant, ratio: float) -> bool:
    """Whether a variant fits clearly better than the stored motion, in most pairs. ratio: see
    `_ratio`."""
    enough = BETTER_SCORE_RATIO
    if variant.code in JITTER_CODES:
        enough = BETTER_JITTER_SCORE_RATIO
    elif variant.code == "motion-worse-than-none":
        enough = BETTER_NONE_SCORE_RATIO
    wins = np.mean([warped.scores.get(variant, np.inf) < warped.as_it_is for warped in shots])
    is_telling = np.mean([warped.as_it_is for warped in shots]) > TELLING_SCORE
    return bool(is_telling and ratio < enough and wins >= AGREEING_PAIR_SHARE)


def _evidence(shots: list[PairScores], best: Variant) -> str:
    """How much better the pictures fit if the motion is stored as `best` says."""
    stored, fitting = (float(np.mean([min(w.scores[v], w.unrelated) for w in shots]))
                       for v in (VARIANTS[0], best))
    roles = ", ".join(str(role) for role in shots[0].by_role[best])
    ranking = sorted((v for v in VARIANTS if v is not best), key=lambda v: _ratio(shots, v))
    return (f"the previous frame, warped, fits {stored / max(fitting, 1e-9):.3g} times better if "
            f"the motion is {best.name}: misfit {fitting:.3g} instead of {stored:.3g} (chance "
            f"{np.mean([w.unrelated for w in shots]):.3g}), over {len(shots)} pairs by {roles}; of "
            f"{len(VARIANTS)} variants the next is '{ranking[0].name}'")


def _follows_jitter(shots: list[PairScores]) -> bool:
    """Whether the motion of the whole picture jumps with the jitter; assumed with too few
    frames."""
    if len(shots) < 4:
        return True
    motion = np.array([np.median(warped.now[Role.MOTION].reshape(-1, 2), axis=0)
                       for warped in shots])
    jitter = np.array([warped.jitter for warped in shots])
    return abs(correlation(np.diff(motion, axis=0), np.diff(jitter, axis=0))) > 0.8


def _untested(material: Material) -> Iterator[Finding]:
    """Motion that no pair of frames tells anything about, unless all of it is 0."""
    is_zero = any(warped.moved == 0 for warped in material.pair_scores)
    if Role.MOTION in material.middle and material.pairs and not is_zero:
        yield info(Role.MOTION, "motion-untested",
                   "sign, axes and scale of the motion cannot be told",
                   "no pair of frames that belong together and show contrast",
                   "give more frames of one shot")


CODED_OFFSET = 0.2
"""How far the median of coded motion may be from 0.5, which stands for none."""


def check_motion_coded(material: Material) -> Iterator[Finding]:
    """Motion that is read as pixels, but holds colours 0..1 with 0.5 for none, which a single frame
    shows."""
    if Role.MOTION not in material.first:
        return
    motion = material.first[Role.MOTION].reshape(-1, 2)
    typical = np.abs(np.median(motion, axis=0))
    has_one_sign = ((motion.min(0) >= 0) | (motion.max(0) <= 0)).all()
    is_coded = (has_one_sign and np.abs(motion).max(initial=0) <= 1
                and (np.abs(typical - 0.5) < CODED_OFFSET).all())
    # a finding of the pictures says more
    if is_coded and all(found.code != "motion-encoded" for found in check_motion_variant(material)):
        evidence = (f"all between 0 and 1 pixel, of one sign, around {typical[0]:.2g}, "
                    f"{typical[1]:.2g}")
        yield warning(Role.MOTION, "motion-coded", evidence, "colours around 0.5, not pixels",
                      "write vectors in pixels, or in a profile offset = [-0.5, -0.5] and their "
                      "unit (docs/reference/renderers.md)")


LEAST_TEXTURE_MOTION_PX = 1.0
"""Below, a texture that stays in place looks like noise that stays in place."""
REPEATED_CORRELATION = 0.15
"""How much more noise that repeats is correlated in the same pixel than in those nearby."""
NEARBY_OFFSETS = ((0, 1), (0, -1), (1, 0), (-1, 0), (0, 2), (0, -2), (2, 0), (-2, 0))
SEARCH_STEPS_PX = (0.25, 0.125)

# Shifts that tell a jitter: pixels, root mean square, and the part of the stored motion's score
# that they score below; in how many pairs they are looked for.
LEAST_SHIFT_PX = 0.12
SHIFTED_SCORE_RATIO = 0.82
MOST_SHIFTED_PAIRS = 5


def check_frame_count(material: Material) -> Iterator[Finding]:
    """Too few frames for checks that compare frames."""
    if not material.pairs:
        count = len(material.frames)
        found, remedy = (("one frame to look at", "give a sequence") if count == 1 else
                         (f"{count} frames to look at, of which no two follow each other at one "
                          "size", "give consecutive frames of one size"))
        yield info("sequence", "one-frame", found,
                   "motion, jitter, cuts and repeated noise need two consecutive frames of one "
                   "size", remedy)


def check_frame_sizes(material: Material) -> Iterator[Finding]:
    """Frames of several sizes: with a scale the output has several, too, and the history ends at
    each change."""
    sizes = list(dict.fromkeys(f"{frame.spec.width}x{frame.spec.height}"
                               for frame in material.frames))
    if len(sizes) > 1:
        yield info("sequence", "sizes-change", f"frames are {', '.join(sizes)}",
                   "dynamic resolution",
                   "give the output a fixed size (--size): then the history continues")


def check_cut_unmarked(material: Material) -> Iterator[Finding]:
    """A frame that has nothing in common with the frame before it, to which its motion points."""
    new = [w for w in material.pair_scores if not w.now.reset and not w.is_related]
    if not new:
        return
    if all(w.unrelated < NOISE_SCORE for w in new):
        yield info(Role.MOTION, "motion-untested",
                   "sign, axes and scale of the motion cannot be told",
                   "the AOVs are mostly noise, as in fog or thick fur",
                   "render them with more samples")
        return
    scores = ", ".join(f"frame {w.now.number}: {min(w.scores.values()) / w.unrelated:.2f}"
                       for w in new[:4])
    evidence = ("the previous frame, warped by any variant of the motion, fits hardly better than "
                f"chance (1): {scores}")
    if len(new) == len(material.pair_scores) and len(new) > 1:
        yield error(Role.MOTION, "motion-no-fit", evidence,
                    "meaningless motion, or frames of different shots",
                    "look at the picture of the motion (--pictures), write the renderer's motion "
                    "vectors")
    else:
        yield warning("sequence", "cut-unmarked", evidence,
                      "a cut whose first frame has motion vectors as if the shot continued",
                      "write postfx:reset = 1 in that frame, or process the shots one by one")


def check_reset_always(material: Material) -> Iterator[Finding]:
    """Every frame is marked as the first of a shot, though it continues the previous one."""
    marked = [w for w in material.pair_scores if w.now.reset and w.is_related]
    if marked:
        numbers = ", ".join(str(w.now.number) for w in marked[:8])
        evidence = (f"frames {numbers} say postfx:reset, but fit the previous frame "
                   f"({marked[0].as_it_is:.2f} of {marked[0].unrelated:.2f})")
        yield warning("sequence", "reset-needless", evidence,
                      "the header was copied from the first frame",
                      "write postfx:reset at cuts only: it drops the history")


def check_jitter_range(material: Material) -> Iterator[Finding]:
    """Jitter that is not a position within the pixel minus 0.5."""
    jitter = np.array([frame.jitter for frame in material.frames])
    if np.abs(jitter).max() <= MOST_JITTER_PX:
        return
    evidence = f"jitter from {jitter.min():.3g} to {jitter.max():.3g}"
    if jitter.min() >= 0 and jitter.max() <= 1:
        yield error("sequence", "jitter-offset", evidence, "positions within the pixel, 0..1",
                    "write postfx:jitter = position - 0.5")
    else:
        yield warning("sequence", "jitter-range", evidence,
                      "not in pixels, or in pixels of a larger picture",
                      "write the sample's position minus 0.5 in pixels of the frame, -0.5..0.5")


def check_jitter_missing(material: Material) -> Iterator[Finding]:
    """Pictures that shift by fractions of a pixel from frame to frame, without a jitter header."""
    has_jitter = any(max(map(abs, frame.jitter)) > NO_JITTER_PX for frame in material.frames)
    if has_jitter or len(material.shots) < 3:
        return
    shots = material.shots[:MOST_SHIFTED_PAIRS]
    found, scores = np.split(np.array([_shift(warped) for warped in shots]), [2], axis=1)
    erratic = float(np.sqrt(((found - found.mean(0)) ** 2).sum(1).mean()))
    stored = sum(warped.as_it_is for warped in shots)
    if erratic > LEAST_SHIFT_PX and scores.sum() < SHIFTED_SCORE_RATIO * stored:
        shifts = ", ".join(f"({x:.2f}, {y:.2f})" for x, y in found[:4])
        evidence = (f"frames are shifted by {shifts} ... pixels against the motion, {erratic:.2f} "
                    "px around their mean")
        yield warning("sequence", "jitter-missing", evidence,
                      "all samples of a frame are jittered alike and the header does not say how",
                      "write postfx:jitter: sample position minus 0.5 in pixels, x right, y down")


def check_samples_repeat(material: Material) -> Iterator[Finding]:
    """Noise that stays in its place while the picture stands still, or moves."""
    if share := _repeated_share(material):
        yield error(Role.COLOUR, "samples-correlated",
                    "where the picture hardly moves, noise is the same in all frames, in "
                    f"{100 * share:.0f} % of the squares looked at", *ONE_SEED)
        return
    pairs = [(a, b) for a, b in material.pairs if Role.COLOUR in a and Role.COLOUR in b]
    if pairs and all(_identical(*pair) for pair in pairs):
        noise = noise_level(pairs[0][0][Role.COLOUR])
        yield error(Role.COLOUR, "samples-correlated",
                    f"noise of {noise:.3g}, the same to the bit in {len(pairs) + 1} frames",
                    *ONE_SEED)
        return
    yield from check_samples_stay(material)


def check_samples_stay(material: Material,
                       least: float = REPEATED_CORRELATION) -> Iterator[Finding]:
    """Noise that stays in its place while the picture moves, but not along its motion, which the
    denoiser tells. least: how much more it is correlated in the same pixel than nearby."""
    if _repeated_share(material):
        return
    pairs = [(a, b) for a, b in material.pairs if Role.COLOUR in a and Role.COLOUR in b]
    found = [value for pair in pairs
             if not pair[1].reset and (value := _correlate_repeats(*pair)) is not None]
    if not found:
        if pairs:
            yield info(Role.COLOUR, "samples-untested",
                       "noise may repeat from frame to frame: not tested",
                       "it needs motion of more than a pixel",
                       "give frames in which the camera moves")
        return
    same, elsewhere = np.mean([value[0] for value in found]), np.mean([value[1] for value in found])
    if same - elsewhere > least:
        evidence = (f"noise of consecutive frames is {same:.2f} correlated in the same pixel where "
                    f"the picture moves, {elsewhere:.2f} in pixels next to it")
        yield error(Role.COLOUR, "samples-correlated", evidence, *ONE_SEED)


def _repeated_share(material: Material) -> float:
    """Share of the picture whose noise repeats along the motion, 0 unless it does in most pairs of
    frames."""
    detect = RepeatDetector()
    found = []
    for before, now in material.pairs:
        if Role.COLOUR in before and Role.COLOUR in now and not now.reset:
            detect.reset()
            planes = [{role: finite(plane) for role, plane in frame.planes.items()}
                      for frame in (before, now)]
            detect(planes[0])
            found.append(detect.share if detect(planes[1]) else 0.0)
    return float(np.median(found)) if found else 0.0


def _identical(before: Frame, now: Frame) -> bool:
    """Whether colour that holds noise is the same to the bit."""
    colour, level = now[Role.COLOUR], noise_level(now[Role.COLOUR])
    if level is None or level < 0.01 * float(np.abs(finite(colour)).mean()):
        return False
    return np.array_equal(before[Role.COLOUR], colour, equal_nan=True)


def _correlate_repeats(before: Frame, now: Frame) -> tuple[float, float] | None:
    """Correlation of the noise in the same pixel, and the largest in one next to it, on surfaces
    that move: structure that moves by a pixel or two is as much alike there."""
    if min(now[Role.COLOUR].shape[:2]) < 32 or Role.MOTION not in now:
        return None
    moves = np.linalg.norm(finite(now[Role.MOTION]), axis=-1) > LEAST_TEXTURE_MOTION_PX
    one, other = _noise(before), _noise(now)
    used = moves & (one != 0) & (other != 0)
    used[:2] = used[-2:] = used[:, :2] = used[:, -2:] = False
    if used.sum() < 500:
        return None
    shifted = [correlation(np.roll(one, step, (0, 1))[used], other[used])
               for step in NEARBY_OFFSETS]
    return correlation(one[used], other[used]), max(0.0, *shifted)


def _noise(frame: Frame) -> np.ndarray:
    """(height, width): a pixel's difference from its neighbourhood in local standard deviations,
    -3..3."""
    is_finite = np.isfinite(frame[Role.COLOUR]).all(2, keepdims=True).astype(np.float32)
    is_whole = local_mean(is_finite, 3)[..., 0] > 0.999
    light = np.log1p(np.maximum(luminance(finite(frame[Role.COLOUR])), 0) * 4)
    if Role.DIFFUSE_ALBEDO in frame:
        light = light / (luminance(finite(frame[Role.DIFFUSE_ALBEDO])) + np.float32(0.1))
    off = (light[..., None] - local_mean(light[..., None], 2))[..., 0]
    size = np.sqrt(local_mean(off[..., None] ** 2, 3))[..., 0]
    result: np.ndarray = np.clip(off / np.maximum(size, 1e-6), -3, 3) * is_whole
    return result


def _shift(warped: PairScores) -> tuple[float, float, float]:
    """Offset (x, y) in pixels that fits best, searched from coarse to fine, and its score."""
    best = np.zeros(2)
    for step, reach in zip(SEARCH_STEPS_PX, (3, 1), strict=True):
        steps = np.arange(-reach, reach + 1) * step
        offsets = [best + (x, y) for x in steps for y in steps]
        best = min(offsets, key=lambda offset: score_offset(warped.features, offset))
    return float(best[0]), float(best[1]), score_offset(warped.features, best)
