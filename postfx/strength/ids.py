"""Strength from planes of whole-number ids, one a pixel."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from postfx.errors import StrengthError
from postfx.strength.entries import Entry

_RANGE = re.compile(r"(-?\d+)(?:-(-?\d+))?")


def range_of(entry: Entry) -> tuple[int, int]:
    """First and last id of an entry such as '7' or '7-9'; StrengthError for anything else."""
    found = _RANGE.fullmatch(entry.name)
    if found is None:
        raise StrengthError(f"'{entry.name}' of plane {entry.plane}: give an id, or first and last, such as 7-9")
    first, last = int(found[1]), int(found[2] or found[1])
    if first > last:
        raise StrengthError(f"'{entry.name}' of plane {entry.plane}: write the smaller id first, {last}-{first}")
    return first, last


def strength_from_ids(ids: np.ndarray, strengths: Mapping[int | tuple[int, int], float]) -> np.ndarray:
    """Strength (height, width, 1) from ids (height, width) or (height, width, 1), of whole numbers in any data type.

    strengths: id, or first and last id -> 0 leave as it is .. 1 denoise fully; the last that fits counts, and 1 where
    none does. What is no whole number, as between two ids that were averaged, is denoised fully. StrengthError for
    strengths outside 0..1.
    """
    if not all(0 <= value <= 1 for value in strengths.values()):
        raise StrengthError(f"strengths {min(strengths.values()):g} to {max(strengths.values()):g}: give 0 to 1")
    ids = ids.reshape(ids.shape[:2])
    strength = np.ones(ids.shape, np.float32)
    for key, value in strengths.items():
        strength[within(ids, key if isinstance(key, tuple) else (key, key))] = value
    return strength[:, :, None]


def within(ids: np.ndarray, span: tuple[int, int]) -> np.ndarray:
    """Where ids are whole numbers from a first to a last one: (height, width) of bool."""
    found = (ids >= span[0]) & (ids <= span[1])
    return found if np.issubdtype(ids.dtype, np.integer) else found & (ids == np.rint(ids))
