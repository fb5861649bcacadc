"""Motion: sign, axes, scale and jitter, found by warping the previous frame onto this one with every variant."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from postfx.doctor.findings import Finding, error, info
from postfx.doctor.geometry import motion_of_camera
from postfx.doctor.material import Material
from postfx.doctor.motion_variants import RELATED, VARIANTS, Variant, Warped, score_offset
from postfx.doctor.statistics import correlation
from postfx.frame import Role

BETTER, BETTER_BY_JITTER, BETTER_THAN_NONE = 0.85, 0.95, 0.65
"""Parts of the score as it is that another variant must stay below."""
MOST_PAIRS_AGREE = 0.75
TELLING = 0.05  # misfit, in units of what a pixel costs: below, motion is right
ALIKE = 1.03
SEARCHED = 12  # pixels each way
CLEARLY_MOVED = 0.75
LEAST_CAMERA_MOTION = 0.1  # pixels
JITTER_CODES = ("motion-jitter", "jitter-sign")


def motion_variant(material: Material) -> Iterator[Finding]:
    """The variant that fits clearly better than the motion as it is."""
    shots = [warped for warped in material.shots if warped.moved > 0]
    if not shots:
        yield from _untested(material)
        return
    best = best_variant(shots)
    if best is None:
        return
    code, cause, mend = best.code, best.cause, best.mend
    if code == "motion-jitter" and not _follows_jitter(shots):
        code, cause = "jitter-unused", "the header gives a jitter that the samples do not have"
        mend = "leave postfx:jitter out where samples are spread over the pixel"
    role = "sequence" if code.startswith("jitter") else Role.MOTION
    yield error(role, code, _evidence(shots, best), cause, mend)


def motion_zero(material: Material) -> Iterator[Finding]:
    """Motion that is 0 everywhere though the camera or the picture moves."""
    for warped in [warped for warped in material.warped if not warped.now.reset and warped.moved == 0][:2]:
        if evidence := _by_camera(warped) or _by_picture(warped):
            cause = "written without motion: the vector pass is off, or the previous camera was not kept"
            yield error(Role.MOTION, "motion-zero", f"frame {warped.now.number}: all motion is 0, {evidence}", cause,
                        "render real motion or leave the plane out")
            return


def _by_camera(warped: Warped) -> str:
    moved = motion_of_camera(warped.before, warped.now)
    if moved is None or not len(moved) or (mean := float(np.linalg.norm(moved, axis=-1).mean())) < LEAST_CAMERA_MOTION:
        return ""
    return f"but by worldToCamera and depth the camera moves surfaces by {mean:.2f} pixels in the mean"


def _by_picture(warped: Warped) -> str:
    offsets = list(product(range(-SEARCHED, SEARCHED + 1), repeat=2))
    scores = {at: score_offset(warped.features, np.add(at, warped.jitter)) for at in offsets}
    best = min(scores, key=lambda at: scores[at])
    if scores[best] >= min(CLEARLY_MOVED * scores[0, 0], RELATED * warped.unrelated):
        return ""
    return f"but the frame before fits better ({scores[best]:.3g}, not {scores[0, 0]:.3g}) when moved by {best} pixels"


def best_variant(shots: list[Warped]) -> Variant | None:
    """The simplest of the variants that fit best; None when the motion as it is does."""
    ratios = {variant: _ratio(shots, variant) for variant in VARIANTS if variant.code}
    good = {variant: ratio for variant, ratio in ratios.items() if _is_better(shots, variant, ratio)}
    if not good:
        return None
    least = min(good.values())
    return min((v for v in good if good[v] <= ALIKE * least), key=lambda v: (v.priority, good[v]))


def _ratio(shots: list[Warped], variant: Variant) -> float:
    scores = [warped.scores[variant] for warped in shots]
    stored = [min(warped.as_it_is, warped.unrelated) for warped in shots]
    return float(np.sum(scores) / max(np.sum(stored), 1e-9))


def _is_better(shots: list[Warped], variant: Variant, ratio: float) -> bool:
    wins = np.mean([warped.scores[variant] < warped.as_it_is for warped in shots])
    least = BETTER_BY_JITTER if variant.code in JITTER_CODES else BETTER
    least = BETTER_THAN_NONE if variant.code == "motion-worse-than-none" else least
    telling = np.mean([warped.as_it_is for warped in shots]) > TELLING
    return bool(telling and ratio < least and wins >= MOST_PAIRS_AGREE)


def _evidence(shots: list[Warped], best: Variant) -> str:
    stored, fitting = (float(np.mean([min(w.scores[v], w.unrelated) for w in shots])) for v in (VARIANTS[0], best))
    roles = ", ".join(str(role) for role in shots[0].by_role[best])
    ranking = sorted((v for v in VARIANTS if v is not best), key=lambda v: _ratio(shots, v))
    return (f"the frame before, warped, fits {stored / max(fitting, 1e-9):.3g} times better if the motion is "
            f"{best.name}: misfit {fitting:.3g} instead of {stored:.3g} "
            f"(chance {np.mean([w.unrelated for w in shots]):.3g}), over {len(shots)} pairs by {roles}; of "
            f"{len(VARIANTS)} variants the next is '{ranking[0].name}'")


def _follows_jitter(shots: list[Warped]) -> bool:
    """Whether the motion of the whole picture jumps with the jitter; taken for granted with too few frames."""
    if len(shots) < 4:
        return True
    motion = np.array([np.median(warped.now[Role.MOTION].reshape(-1, 2), axis=0) for warped in shots])
    jitter = np.array([warped.jitter for warped in shots])
    return abs(correlation(np.diff(motion, axis=0), np.diff(jitter, axis=0))) > 0.8


def _untested(material: Material) -> Iterator[Finding]:
    if Role.MOTION in material.middle and material.pairs and not any(w.moved == 0 for w in material.warped):
        yield info(Role.MOTION, "motion-untested", "sign, axes and scale of the motion cannot be told",
                   "no pair of frames that belong together and show contrast", "give more frames of one shot")
