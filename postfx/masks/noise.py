"""Strength of pixels that are free of noise, 0: of sky and misses, and of those that have
converged.

A pixel whose primary ray misses shows the environment directly, without noise from light paths. But
fog may scatter light in front of it, objects in motion or out of focus may cover part of it, and
some renderers sample it. So the noise of the colour is measured. Pixels that are noisy, near noisy
ones, or too few to be measured keep full strength.

Renderers with adaptive sampling estimate the variance of each pixel. The standard error of a
pixel's mean is the root of the variance of its samples over their number. Divided by the mean it
does not depend on exposure, so one threshold fits a whole picture. An estimate from few samples is
noisy, and one that missed a rare spike is too low: so squares of pixels are pooled, and the largest
error of the neighbourhood counts.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from postfx.colour import luminance
from postfx.errors import StrengthError
from postfx.frame import ALBEDOS, DEPTH_MISS, ERROR_ROLES, VARIANCES, Role
from postfx.masks.cryptomatte import Entry, snap
from postfx.sampling import BAND_ROWS, bands, local_maximum, local_mean, local_sum

SOFT = 2
"""Radius by which pixels that need denoising are grown, and then averaged."""

MISS_READS = (Role.COLOUR, Role.ALPHA, Role.DEPTH, Role.NORMAL, Role.DIFFUSE_ALBEDO,
              Role.SPECULAR_ALBEDO)
"""Planes that are read if the frame has them."""

NOISE_BLOCK_PX = 8
"""Side, in pixels, of the squares in which noise is measured."""
FEWEST_MEASURED_PIXELS = 8
"""Least number of measured pixels for the noise of a square to count."""
SPANS = (1, 2)
"""Distances in pixels at which neighbours are compared: a renderer's filter makes closer ones
alike."""
VISIBLE_NOISE = (0.008, 0.02)
"""Standard deviation over mean, from invisible to visible: the display curve sqrt(y / (1 + y))
turns it into at most 0.0015 to 0.004, as in `postfx.kernels.denoise.output`."""
CROWD = (0.15, 0.35)
"""Share of noisy misses above which all are denoised: sparse noise cannot be measured between its
spikes."""
GROWN = 2
"""Pixels by which everything else than misses is grown."""


def strength_of_misses(planes: Mapping[Role, np.ndarray]) -> np.ndarray:
    """Strength (height, width, 1), 0..1: 0 for misses without noise, 1 for everything else, soft in
    between.

    planes: those of a frame, (height, width, channels), of which `MISS_READS` are used; colour is
    needed. `misses_of` says what counts as a miss. Pixels that are covered in part keep strength 1,
    as do two around them; the seventh has strength 0. Noise is the second difference of luminance
    along both axes, at two distances, squared and averaged over the pixels of a square of 8 around
    which all are misses (after Immerkaer 1996, "Fast noise variance estimation"), its root over
    their mean luminance. A square takes the largest noise of its neighbours.
    """
    return np.concatenate([strength for _, strength, _ in misses_in_bands(planes)])


def misses_in_bands(
    planes: Mapping[Role, np.ndarray], relax: Callable[[], None] | None = None
) -> Iterator[tuple[slice, np.ndarray, int]]:
    """`strength_of_misses` in bands: rows, their strength (rows, width, 1), and how many misses
    they have.

    relax: called after each band.
    """
    height, width = planes[Role.COLOUR].shape[:2]
    see_through = _is_transparent(planes)
    noise = _noise_strength(planes, see_through, relax)
    for first, last, top, bottom in bands(height, GROWN + 2 * SOFT):
        kept = ~_misses({role: plane[top:bottom] for role, plane in planes.items()}, see_through)
        rows, inner = np.arange(top, bottom) // NOISE_BLOCK_PX, slice(first - top, last - top)
        found = np.maximum(local_maximum(kept.astype(np.float32), GROWN),
                           noise[rows][:, np.arange(width) // NOISE_BLOCK_PX])
        soft = local_mean(local_maximum(found, SOFT)[:, :, None], SOFT)
        yield slice(first, last), snap(soft[inner]), kept[inner].size - int(kept[inner].sum())
        if relax:
            relax()


def misses_of(planes: Mapping[Role, np.ndarray]) -> np.ndarray:
    """Pixels whose primary ray hit nothing: (height, width) of bool.

    planes: (height, width, channels) each. A miss has depth 1e10 and normal 0, if the frame has
    these planes; without depth, normal and albedos are 0; without depth and normal, alpha is 0. If
    alpha is below 1 anywhere, misses must have alpha 0, too: a pixel with more is covered in part.
    Without any of these planes, no pixel is a miss.
    """
    return _misses(planes, _is_transparent(planes))


def _is_transparent(planes: Mapping[Role, np.ndarray]) -> bool:
    """Whether alpha means coverage; if it is 1 everywhere, the environment is opaque."""
    return Role.ALPHA in planes and any((planes[Role.ALPHA][top:top + BAND_ROWS] < 1).any()
                                        for top in range(0, planes[Role.ALPHA].shape[0], BAND_ROWS))


def _misses(planes: Mapping[Role, np.ndarray], see_through: bool) -> np.ndarray:
    zero = [Role.NORMAL] if Role.NORMAL in planes else []
    if zero and Role.DEPTH not in planes:
        zero += [role for role in ALBEDOS if role in planes]
    signs = [~planes[role].any(2) for role in zero]
    signs += [planes[Role.DEPTH][:, :, 0] >= DEPTH_MISS] if Role.DEPTH in planes else []
    signs += [planes[Role.ALPHA][:, :, 0] == 0] if see_through else []
    return np.logical_and.reduce(signs) if signs else np.zeros(planes[Role.COLOUR].shape[:2], bool)


def _noise_strength(
    planes: Mapping[Role, np.ndarray], see_through: bool, relax: Callable[[], None] | None
) -> np.ndarray:
    """Strength by the noise of each square's misses: (rows, columns) of squares, 1 where the noise
    is unknown."""
    sums = []
    for first, last, top, bottom in bands(planes[Role.COLOUR].shape[0], max(SPANS)):
        band = {role: plane[top:bottom] for role, plane in planes.items() if role in MISS_READS}
        sums.append(_band_sums(band, _misses(band, see_through), first - top, last - top))
        if relax:
            relax()
    power, count, light, lit = np.concatenate(sums, axis=1)
    broken = ~np.isfinite(power)
    known = (count >= FEWEST_MEASURED_PIXELS) | broken
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(power > 0, np.sqrt(power / count) * lit / np.abs(light), 0)
    noise = np.where(broken, np.inf, np.where(known, ratio, 0))
    strength = np.clip((noise - VISIBLE_NOISE[0]) / (VISIBLE_NOISE[1] - VISIBLE_NOISE[0]), 0, 1)
    crowd = (strength * count).sum() / max(1.0, (count * known).sum())
    least = np.clip((crowd - CROWD[0]) / (CROWD[1] - CROWD[0]), 0, 1)
    near = local_maximum(known.astype(np.float32), 1) > 0
    return np.where(near, np.maximum(local_maximum(strength, 1), least), 1).astype(np.float32)


def _band_sums(band: Mapping[Role, np.ndarray], missed: np.ndarray, first: int,
               last: int) -> np.ndarray:
    """Sums in each square: of noise power, of the pixels it was measured at, of the misses' light
    and of their number.

    Values that are not finite count as infinite noise.
    """
    light = luminance(band[Role.COLOUR])
    broken = missed & ~np.isfinite(light)
    light = np.where(missed & ~broken, light, np.float32(0))
    power = np.where(broken, np.float32(np.inf), np.float32(0))
    count = np.zeros(light.shape, np.float32)
    for span in SPANS:
        inside = (slice(span, -span), slice(span, -span))
        if min(light.shape) <= 2 * span:
            continue
        whole = _sum_across(missed.astype(np.float32), span, (1, 1, 1)) == 9
        found = np.where(whole, _sum_across(light, span, (1, -2, 1)) ** 2 / 36, np.float32(0))
        power[inside] = np.maximum(power[inside], found)
        count[inside] += whole & (span == SPANS[0])
    planes = (power, count, light, (missed & ~broken).astype(np.float32))
    return np.stack([_square_sums(plane[first:last]) for plane in planes])


def _sum_across(plane: np.ndarray, span: int, weights: tuple[int, int, int]) -> np.ndarray:
    """Weighted sums along rows and columns, of pixels that are `span` apart; without a border of
    `span` pixels."""
    before, here, after = weights
    rows = before * plane[:-2 * span] + here * plane[span:-span] + after * plane[2 * span:]
    crossed: np.ndarray = (before * rows[:, :-2 * span] + here * rows[:, span:-span]
                           + after * rows[:, 2 * span:])
    return crossed


def _square_sums(plane: np.ndarray) -> np.ndarray:
    """Sums over squares of `NOISE_BLOCK_PX` pixels, float64; squares at the end may be smaller."""
    missing = [(0, -side % NOISE_BLOCK_PX) for side in plane.shape]
    padded = np.pad(plane.astype(np.float64), missing)
    rows, columns = (side // NOISE_BLOCK_PX for side in padded.shape)
    sums: np.ndarray = padded.reshape(rows, NOISE_BLOCK_PX, columns, NOISE_BLOCK_PX).sum((1, 3))
    return sums


ERROR_READS = (Role.COLOUR, *ERROR_ROLES)
"""Planes that are read if the frame has them."""

POOLED = 2
"""Radius of the squares over which variance and light are averaged."""


@dataclass(frozen=True)
class Threshold:
    """When a pixel counts as converged; give exactly one of the two.

    Attributes:
        error: standard error of the mean over the mean, 0.01 for 1 %.
        samples: number of samples.
    """

    error: float | None = None
    samples: int | None = None

    def basis(self, roles: Collection[Role], samples: int | None) -> str:
        """The planes that decide, in words, for a frame with these roles and the header's number of
        samples.

        StrengthError if there are none.
        """
        counted = (f"AOV '{Role.SAMPLE_COUNT}'" if Role.SAMPLE_COUNT in roles
                   else f"{samples} samples a pixel")
        is_counted = bool(Role.SAMPLE_COUNT in roles or samples)
        if self.samples and not is_counted:
            raise StrengthError("the number of samples is unknown: render the AOV "
                                f"'{Role.SAMPLE_COUNT}', or give postfx:spp in the header")
        if self.samples:
            return counted
        role = _variance(roles)
        if role is None:
            raise StrengthError(f"the error is unknown: render an AOV {', '.join(VARIANCES)}, or "
                                "name it in a profile (--profile FILE.toml)")
        if role is not Role.VARIANCE_OF_MEAN and not is_counted:
            raise StrengthError(f"AOV '{role}' gives the error only with the number of samples: "
                                "give postfx:spp in the header, or render the AOV "
                                f"'{Role.SAMPLE_COUNT}'")
        return f"AOV '{role}'" if role is Role.VARIANCE_OF_MEAN else f"AOV '{role}' and {counted}"


def parse_threshold(entry: Entry) -> Threshold:
    """Threshold of an entry such as 'converged:0.01' or 'converged:256spp'; StrengthError for
    anything else."""
    text = entry.name.partition(":")[2]
    try:
        found = (Threshold(samples=int(text[:-3])) if text.endswith("spp")
                 else Threshold(error=float(text)))
    except ValueError:
        found = Threshold()
    if not 0 < (found.error or found.samples or 0) < np.inf or entry.plane:
        raise StrengthError(f"'{entry}': give a relative error, such as converged:0.01, or a "
                            "number of samples, such as converged:256spp")
    return found


def strength_of_converged(
    planes: Mapping[Role, np.ndarray], threshold: Threshold, samples: int | None = None
) -> np.ndarray:
    """Strength (height, width, 1), 0..1: 0 where a frame has converged, 1 where its error is twice
    the threshold's.

    planes: those of a frame, (height, width, channels), of which `ERROR_READS` are used. samples:
    of each pixel, for frames without a plane of sample counts. For a threshold of N samples, the
    error of n samples is the root of N / n: strength is 1 up to N / 4 samples. Errors are those of
    luminance if noise is alike in all channels, which is the largest they can be. Where light and
    variance are 0, the error is 0; where one is not finite, strength is 1. Strength is 1 up to two
    pixels from pixels that have not converged, and soft within six. StrengthError if the planes do
    not suffice.
    """
    threshold.basis(planes, samples)
    return np.concatenate([strength
                           for _, strength in converged_in_bands(planes, threshold, samples)])


def converged_in_bands(
    planes: Mapping[Role, np.ndarray], threshold: Threshold, samples: int | None,
    relax: Callable[[], None] | None = None,
) -> Iterator[tuple[slice, np.ndarray]]:
    """`strength_of_converged` in bands: rows, and their strength (rows, width, 1).

    relax: called after each band.
    """
    unit = count_unit(planes.get(Role.SAMPLE_COUNT), samples)
    seen = {role: planes[role] for role in ERROR_READS if role in planes}
    for first, last, top, bottom in bands(planes[Role.COLOUR].shape[0], POOLED + 2 * SOFT):
        band = {role: plane[top:bottom] for role, plane in seen.items()}
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            count = band[Role.SAMPLE_COUNT][:, :, 0] * unit if Role.SAMPLE_COUNT in band else unit
            error = (np.sqrt(threshold.samples / count) if threshold.samples
                     else _error(band, count) / threshold.error)
            error = np.broadcast_to(error, band[Role.COLOUR].shape[:2])
            found = np.where(np.isfinite(error), np.clip(error - 1, 0, 1), 1)
        soft = local_mean(local_maximum(found, SOFT)[:, :, None], SOFT)
        yield slice(first, last), snap(soft[first - top:last - top])
        if relax:
            relax()


def _variance(roles: Collection[Role]) -> Role | None:
    return next((role for role in VARIANCES if role in roles), None)


def count_unit(count: np.ndarray | None, samples: int | None) -> np.float32:
    """Number of samples for the value 1 in the plane of counts: the header's number if the plane
    holds shares of it, as Cycles may write, or if there is no plane."""
    is_share = count is None or (bool(samples) and count.max(initial=0) <= 1)
    return np.float32(samples or 0) if is_share else np.float32(1)


def _error(band: Mapping[Role, np.ndarray], count: np.ndarray | np.float32) -> np.ndarray:
    """Standard error of the mean over the mean: (height, width)."""
    role, colour = _variance(band), band[Role.COLOUR]
    assert role is not None  # `Threshold.basis` has checked that
    variance = band[role]
    if role is Role.SECOND_MOMENT:
        variance, count = variance - colour * colour, count - 1
    power = luminance(np.sqrt(np.maximum(variance, 0))) ** 2
    if role is not Role.VARIANCE_OF_MEAN:
        power = np.where(count > 0, power / count, np.inf)
    power, light = local_sum(power, POOLED), local_sum(luminance(colour), POOLED)
    return np.where(power == 0, light * 0, np.sqrt(power * (2 * POOLED + 1) ** 2) / np.abs(light))
