"""Strength of pixels that have converged: 0 where the renderer reports little enough noise.

Renderers with adaptive sampling estimate the variance of each pixel. The standard error of a pixel's mean is the root
of the variance of its samples over their number. Divided by the mean it does not depend on exposure, so one threshold
fits a whole picture. An estimate from few samples is noisy, and one that missed a rare spike is too low: so squares of
pixels are pooled, and the largest error of the neighbourhood counts.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from postfx.colour import luminance
from postfx.errors import StrengthError
from postfx.frame import ERROR_ROLES, VARIANCES, Role
from postfx.masks.cryptomatte import Entry, snap
from postfx.sampling import bands, local_maximum, local_mean, local_sum

READS = (Role.COLOUR, *ERROR_ROLES)
"""Planes that are read if the frame has them."""

POOLED = 2
"""Radius of the squares over which variance and light are averaged."""
SOFT = 2
"""Radius by which unconverged pixels are grown, and then averaged."""


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
        """The planes that decide, in words, for a frame with these roles and the header's number of samples.

        StrengthError if there are none.
        """
        counted = f"plane '{Role.SAMPLE_COUNT}'" if Role.SAMPLE_COUNT in roles else f"{samples} samples a pixel"
        is_counted = bool(Role.SAMPLE_COUNT in roles or samples)
        if self.samples and not is_counted:
            raise StrengthError(f"the number of samples is unknown: render the plane '{Role.SAMPLE_COUNT}', or give "
                                f"postfx:spp in the header")
        if self.samples:
            return counted
        role = _variance(roles)
        if role is None:
            raise StrengthError(f"the error is unknown: render a plane {', '.join(VARIANCES)}, or name it in a "
                                "profile (--profile FILE.toml)")
        if role is not Role.VARIANCE_OF_MEAN and not is_counted:
            raise StrengthError(f"plane '{role}' gives the error only with the number of samples: give postfx:spp in "
                                f"the header, or render the plane '{Role.SAMPLE_COUNT}'")
        return f"plane '{role}'" if role is Role.VARIANCE_OF_MEAN else f"plane '{role}' and {counted}"


def parse_threshold(entry: Entry) -> Threshold:
    """Threshold of an entry such as 'converged:0.01' or 'converged:256spp'; StrengthError for anything else."""
    text = entry.name.partition(":")[2]
    try:
        found = Threshold(samples=int(text[:-3])) if text.endswith("spp") else Threshold(error=float(text))
    except ValueError:
        found = Threshold()
    if not 0 < (found.error or found.samples or 0) < np.inf or entry.plane:
        raise StrengthError(f"'{entry}': give a relative error, such as converged:0.01, or a number of samples, such "
                            "as converged:256spp")
    return found


def strength_of_converged(
    planes: Mapping[Role, np.ndarray], threshold: Threshold, samples: int | None = None
) -> np.ndarray:
    """Strength (height, width, 1), 0..1: 0 where a frame has converged, 1 where its error is twice the threshold's.

    planes: those of a frame, (height, width, channels), of which `READS` are used. samples: of each pixel, for
    frames without a plane of sample counts. For a threshold of N samples, the error of n samples is the root of N / n:
    strength is 1 up to N / 4 samples. Errors are those of luminance if noise is alike in all channels, which is the
    largest they can be. Where light and variance are 0, the error is 0; where one is not finite, strength is 1.
    Strength is 1 up to two pixels from pixels that have not converged, and soft within six. StrengthError if the
    planes do not suffice.
    """
    threshold.basis(planes, samples)
    return np.concatenate([strength for _, strength in strength_in_bands(planes, threshold, samples)])


def strength_in_bands(
    planes: Mapping[Role, np.ndarray], threshold: Threshold, samples: int | None,
    relax: Callable[[], None] | None = None,
) -> Iterator[tuple[slice, np.ndarray]]:
    """`strength_of_converged` in bands: rows, and their strength (rows, width, 1).

    relax: called after each band.
    """
    unit = _unit(planes.get(Role.SAMPLE_COUNT), samples)
    seen = {role: planes[role] for role in READS if role in planes}
    for first, last, top, bottom in bands(planes[Role.COLOUR].shape[0], POOLED + 2 * SOFT):
        band = {role: plane[top:bottom] for role, plane in seen.items()}
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            count = band[Role.SAMPLE_COUNT][:, :, 0] * unit if Role.SAMPLE_COUNT in band else unit
            error = np.sqrt(threshold.samples / count) if threshold.samples else _error(band, count) / threshold.error
            error = np.broadcast_to(error, band[Role.COLOUR].shape[:2])
            found = np.where(np.isfinite(error), np.clip(error - 1, 0, 1), 1)
        soft = local_mean(local_maximum(found, SOFT)[:, :, None], SOFT)
        yield slice(first, last), snap(soft[first - top:last - top])
        if relax:
            relax()


def _variance(roles: Collection[Role]) -> Role | None:
    return next((role for role in VARIANCES if role in roles), None)


def _unit(count: np.ndarray | None, samples: int | None) -> np.float32:
    """Number of samples for the value 1 in the plane of counts: the header's number if the plane holds shares of it, as
    Cycles may write, or if there is no plane."""
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
