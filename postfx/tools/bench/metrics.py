"""Errors of a picture and of a sequence against a reference.

Pictures are compared as people see them: exposed, brought to 0..1 by x / (1 + x), and sRGB-encoded.
relMSE compares linear light. Colours are (height, width, 3), scene-linear Rec.709, float32.

A reference has noise of its own: with 1,024 samples a pixel it may be further from the truth than a
denoised picture of 64. With a second reference, of different noise, the squared error is the mean
product of the differences to both. Their noise is independent, so it cancels out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import flip_evaluator
import numpy as np
from skimage.metrics import structural_similarity

from postfx.colour.views import to_codes
from postfx.frame import KEY, Frame, Role
from postfx.sampling import bilinear, motion_at

LUMINANCE_WEIGHTS = np.array([0.2126, 0.7152, 0.0722])
TRIMMED = 0.999
"""Share of the pixels, those with the least error, that relMSE is the mean of."""
LEAST_SQUARED_ERROR = 1e-12  # squared: 120 dB
FOLLOWED_DIFFERENCE = 0.1
"""Code values by which the reference may differ from itself a frame before, along the motion, for a
pixel to count for flicker."""
FIGURES = ("psnr", "ssim", "flip", "relmse", "flicker")
"""Names of the figures. More is better for psnr (dB) and ssim (up to 1), less for flip (0..1),
relmse and flicker."""


def grey_factor(colour: np.ndarray) -> float:
    """Multiplier that brings the log-average luminance to 0.18 (Reinhard 2002, with a floor of 0.1
    % of the mean)."""
    luminance = colour @ LUMINANCE_WEIGHTS
    return float(KEY / np.exp(np.mean(np.log(luminance + 1e-3 * luminance.mean()))))


def psnr(picture: np.ndarray, reference: np.ndarray) -> float:
    """Peak signal to noise ratio of code values 0..1, in dB, at most 120."""
    return psnr_of_two(picture, reference, reference)


def psnr_of_two(picture: np.ndarray, reference: np.ndarray, second: np.ndarray) -> float:
    """`psnr` from two references whose noise is independent: their noise does not count."""
    error = ((picture - reference) * (picture - second)).mean()
    return float(-10 * np.log10(max(error, 0.0) + LEAST_SQUARED_ERROR))


def ssim(picture: np.ndarray, reference: np.ndarray) -> float:
    """Structural similarity (Wang 2004) of code values, mean over pixels and channels."""
    return float(structural_similarity(picture, reference, channel_axis=2, data_range=1))


def flip(picture: np.ndarray, reference: np.ndarray) -> float:
    """Mean LDR-FLIP error (Andersson 2020), 0..1, at 67 pixels a degree."""
    return flip_map(picture, reference)[0]


def flip_map(picture: np.ndarray, reference: np.ndarray) -> tuple[float, np.ndarray]:
    """Mean LDR-FLIP error, 0..1, and each pixel's error as a colour (height, width, 3) 0..1, from
    black (none) through red to white."""
    colours, mean, _ = flip_evaluator.evaluate(reference, picture, "LDR")
    return float(mean), colours


def relmse(colour: np.ndarray, reference: np.ndarray, exposure_factor: float) -> float:
    """Mean of (colour - reference)^2 / (reference^2 + 0.01 / exposure_factor^2), without the worst
    0.1 % of pixels."""
    result, wanted = np.nan_to_num(colour).astype(np.float64), reference.astype(np.float64)
    error = np.square(result - wanted) / (np.square(wanted) + 1e-2 / exposure_factor**2)
    pixels = np.sort(error.mean(-1).ravel())
    return float(pixels[: int(pixels.size * TRIMMED)].mean())


def warp(image: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """`image` (H, W, C) sampled where `motion` (H, W, 2), x and y in pixels, points to; bilinear,
    edges repeated."""
    y, x = np.indices(image.shape[:2], np.float32)
    return bilinear(image, (x + motion[..., 0]).ravel(),
                    (y + motion[..., 1]).ravel()).reshape(image.shape)


@dataclass(frozen=True)
class Pictures:
    """A result and its reference in code values."""

    result: np.ndarray
    reference: np.ndarray


def flicker(before: Pictures, now: Pictures, motion: np.ndarray) -> float | None:
    """1000 times the mean absolute error of the change since the frame before, along `motion` (H,
    W, 2).

    Counts pixels where the motion explains the reference (within 0.1); None if there are none.
    """
    result, reference = warp(before.result, motion), warp(before.reference, motion)
    followed = np.abs(reference - now.reference).max(-1) < FOLLOWED_DIFFERENCE
    if not followed.any():
        return None
    return float(1000 * np.abs((now.result - result) - (now.reference - reference))
                 .mean(-1)[followed].mean())


class SequenceScore:
    """Scores frames given in order; `frames` holds their figures, `summary` the means."""

    def __init__(self) -> None:
        self.frames: list[dict[str, Any]] = []
        self._factor: float | None = None
        self._before: Pictures | None = None

    def add(self, result: np.ndarray, reference: Frame, noisy: Frame,
            second: Frame | None = None) -> None:
        """Score a result (H, W, 3) against the reference's colour; `noisy` gives motion, cuts and
        the frame number.

        The exposure is the reference's, or else the one that makes the first reference mid grey.
        With a `second` reference, PSNR is that of both, and the other figures compare with their
        mean.
        """
        first = reference[Role.COLOUR]
        other = first if second is None else second[Role.COLOUR]
        self._factor = self._factor or grey_factor(first)
        factor = reference.exposure_factor or self._factor
        target = (first + other) / 2
        now = Pictures(to_codes(result, factor), to_codes(target, factor))
        self.frames.append({
            "frame": noisy.number,
            "psnr": psnr_of_two(now.result, to_codes(first, factor), to_codes(other, factor)),
            "ssim": ssim(now.result, now.reference),
            "flip": flip(now.result, now.reference),
            "relmse": relmse(result, target, factor),
            "flicker": self._flicker(now, noisy),
            "not_finite": int(result.size - np.isfinite(result).sum()),
        })
        self._before = now

    def summary(self) -> dict[str, float | int | None]:
        """Means over all frames and, with the suffix _late, over the second half; the worst frame;
        broken values."""
        late = self.frames[len(self.frames) // 2 :]
        found: dict[str, float | int | None] = {name: _mean(self.frames, name) for name in FIGURES}
        found |= {f"{name}_late": _mean(late, name) for name in FIGURES}
        worst = min(self.frames, key=lambda row: row["psnr"])
        found |= {"worst_frame": worst["frame"], "worst_psnr": worst["psnr"]}
        return found | {"not_finite": sum(row["not_finite"] for row in self.frames)}

    def _flicker(self, now: Pictures, noisy: Frame) -> float | None:
        if self._before is None or noisy.reset or Role.MOTION not in noisy:
            return None
        height, width = now.reference.shape[:2]
        motion = motion_at(noisy[Role.MOTION], np.arange(height), np.arange(width), height, width)
        return flicker(self._before, now, motion)


def _mean(rows: list[dict[str, Any]], name: str) -> float | None:
    values = [row[name] for row in rows if row[name] is not None]
    return float(np.mean(values)) if values else None
