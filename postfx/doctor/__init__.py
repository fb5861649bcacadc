"""The doctor: finds what is wrong with the planes of a sequence, and says why and how to fix it.

Here is what its checks share: what they find, with the exit code that follows, and statistics of
single planes.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from enum import StrEnum
from functools import reduce

import numpy as np

from postfx.frame import DEPTH_MISS


class Level(StrEnum):
    """How bad a finding is, the worst first."""

    ERROR = "error"
    WARNING = "warning"
    INFO = "info"


EXIT_CODES = {Level.ERROR: 2, Level.WARNING: 1, Level.INFO: 0}


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong, or that the doctor could not check.

    Attributes:
        level: an error spoils the result, a warning costs quality, information is good to know.
        role: the plane concerned, a `Role`, or 'sequence'.
        code: stable name of the mistake.
        evidence: what was measured, with numbers.
        cause: the most likely mistake.
        fix: what to do.
    """

    level: Level
    role: str
    code: str
    evidence: str
    cause: str
    fix: str

    def as_dict(self) -> dict[str, str]:
        """The finding in plain types."""
        return {key: str(value) for key, value in asdict(self).items()}


def error(role: str, code: str, evidence: str, cause: str, fix: str) -> Finding:
    """A finding that spoils the result."""
    return Finding(Level.ERROR, str(role), code, evidence, cause, fix)


def warning(role: str, code: str, evidence: str, cause: str, fix: str) -> Finding:
    """A finding that costs quality."""
    return Finding(Level.WARNING, str(role), code, evidence, cause, fix)


def info(role: str, code: str, evidence: str, cause: str, fix: str) -> Finding:
    """Something good to know."""
    return Finding(Level.INFO, str(role), code, evidence, cause, fix)


def most_important_first(findings: Iterable[Finding]) -> list[Finding]:
    """Findings sorted by level; findings of one level keep their order."""
    levels = list(Level)
    return sorted(findings, key=lambda finding: levels.index(finding.level))


def exit_code(findings: Iterable[Finding]) -> int:
    """0 when there are neither warnings nor errors, 1 for warnings only, 2 with at least one
    error."""
    return max((EXIT_CODES[finding.level] for finding in findings), default=0)


# Statistics of single planes: ranges, counts of odd values, noise, and block means.

MEASURED_BLOCK_PX = 8
FLATTEST = 25
"""Percentile of the noise of all blocks that is taken: the flattest quarter has the least
texture."""


@dataclass(frozen=True)
class Values:
    """Counts of odd values of a plane as it is stored, before reading repairs them; `total` counts
    all values."""

    nan: int
    infinite: int
    negative: int
    total: int


def count_values(plane: np.ndarray) -> Values:
    """Count the odd values of a plane of any shape."""
    with np.errstate(invalid="ignore"):
        negative = int((plane < 0).sum())
    return Values(int(np.isnan(plane).sum()), int(np.isinf(plane).sum()), negative, plane.size)


def sum_values(values: Iterable[Values]) -> Values:
    """Counts of several planes together."""
    return reduce(lambda a, b: Values(a.nan + b.nan, a.infinite + b.infinite,
                                      a.negative + b.negative, a.total + b.total), values)


@dataclass(frozen=True)
class Range:
    """Least and largest finite value of a plane, None without any, and the number of pixels that
    hit nothing."""

    low: float | None
    high: float | None
    misses: int


def range_of(plane: np.ndarray, is_depth: bool) -> Range:
    """Range of a plane; misses of depth do not belong to the range and are counted instead."""
    valid = np.isfinite(plane) & (plane < DEPTH_MISS) if is_depth else np.isfinite(plane)
    misses = int((plane >= DEPTH_MISS).sum()) if is_depth else 0
    if not valid.any():
        return Range(None, None, misses)
    return Range(float(plane.min(where=valid, initial=np.inf)),
                 float(plane.max(where=valid, initial=-np.inf)), misses)


def join_ranges(ranges: Iterable[Range]) -> Range:
    """Range of several planes together."""
    found = list(ranges)
    low, high = ([value for each in found if (value := getattr(each, name)) is not None]
                 for name in ("low", "high"))
    return Range(min(low, default=None), max(high, default=None),
                 sum(each.misses for each in found))


def finite(plane: np.ndarray, miss: float = DEPTH_MISS) -> np.ndarray:
    """The plane with 0 in place of misses and of values that are not finite."""
    return np.where(np.isfinite(plane) & (np.abs(plane) < miss), plane, np.float32(0))


def noise_level(plane: np.ndarray) -> float | None:
    """Standard deviation of pixel noise in the flattest quarter of the picture; None if no block
    can be measured.

    plane: (height, width, C). The Laplacian of Immerkaer 1996 ("Fast noise variance estimation")
    removes edges and slopes; its mean magnitude is taken in blocks of 8 x 8 pixels, of the channel
    where it is largest. Blocks that hold misses, or nothing but 0, are left out.
    """
    if min(plane.shape[:2]) < MEASURED_BLOCK_PX + 2:
        return None
    valid = np.isfinite(plane).all(2) & (np.abs(plane) < DEPTH_MISS).all(2)
    used = blocks(valid[1:-1, 1:-1].astype(np.float32)) == 1
    used &= blocks(np.abs(finite(plane)).max(2)[1:-1, 1:-1]) > 0
    if used.sum() < 4:
        return None
    sizes = blocks(np.abs(_laplacian(finite(plane))).max(2))
    return float(np.sqrt(np.pi / 2) / 6 * np.percentile(sizes[used], FLATTEST))


def blocks(plane: np.ndarray, size: int = MEASURED_BLOCK_PX) -> np.ndarray:
    """Means of whole blocks of a (height, width) plane."""
    rows, columns = plane.shape[0] // size, plane.shape[1] // size
    result: np.ndarray = (plane[: rows * size, : columns * size].reshape(rows, size, columns, size)
                          .mean((1, 3)))
    return result


def largest(values: np.ndarray) -> np.ndarray:
    """Largest value along the last axis, in a tenth of the time of max(-1)."""
    return reduce(np.maximum, np.moveaxis(values, -1, 0))


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Pearson's coefficient of two equally long samples; 0 when one is constant or too short."""
    if a.size < 3 or a.std() < 1e-12 or b.std() < 1e-12:
        return 0.0
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])


def percent(mask: np.ndarray) -> float:
    """Share of true values, in percent; 0 for an empty mask."""
    return 100 * float(mask.mean()) if mask.size else 0.0


def _laplacian(plane: np.ndarray) -> np.ndarray:
    up, middle, down = plane[:-2], plane[1:-1], plane[2:]
    rows = up - 2 * middle + down
    result: np.ndarray = rows[:, :-2] - 2 * rows[:, 1:-1] + rows[:, 2:]
    return result
