"""Parts of the picture between frames: light groups, each in its own light of the time, and
together the picture.

Parts are mixed along the picture's paths. What else is done to the picture between two frames, such
as to lead its light through four of them, is not done to parts one by one: those that add up to the
picture in both frames share the difference by their light.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, MutableMapping, Sequence
from typing import TypeAlias

import numpy as np

from postfx.interpolate.blend import Pair
from postfx.interpolate.light import change_of_light, enlarge_field
from postfx.io.parts import LAYER_SUM_TOLERANCE, find_sets

LOOKED_AT_COLUMNS = 8
"""One column in so many is looked at for sets."""
Sets: TypeAlias = tuple[tuple[str, ...], ...]
"""Names of parts, in sets that each add up to the picture."""


def changes_of_parts(parts: Mapping[str, Pair], motion: np.ndarray,
                     longest: float) -> dict[str, np.ndarray]:
    """How the light of parts changes, as `light.change_of_light` gives it, of those whose light
    does. motion: (h, w, 2) of the later frame, in pixels."""
    found = {}
    for name, pair in parts.items():
        before, after = (np.broadcast_to(part, (*part.shape[:2], 3)) for part in pair)
        if before.any() and after.any():
            change = change_of_light(before, after, motion, longest)
            if change is not None:
                found[name] = change[..., :pair[0].shape[2]]
    return found


def light_parts(parts: MutableMapping[str, np.ndarray], changes: Mapping[str, np.ndarray],
                t: float, share: np.ndarray) -> None:
    """Bring parts (h, w, n), of which both frames have some, to the light of a time from 0 to 1.
    share: (h, w, 1) of the frame after, which is the time where both frames show a pixel, and then
    nothing is to be done."""
    for name, change in changes.items():
        growth = enlarge_field(np.exp(change) - 1, *share.shape[:2])
        parts[name] = parts[name] * (1 + np.float32(t) * growth) / (1 + share * growth)


def find_common_sets(pictures: Pair, parts: Mapping[str, Pair], known: Sets | None) -> Sets:
    """Sets of parts of three channels that add up to the picture (h, w, 3) of both frames. known:
    those that were found in earlier frames, None for none."""
    coloured = {name: pair for name, pair in parts.items() if pair[0].shape[2] == 3}
    if known is not None and all(_is_set(names, pictures, coloured) for names in known):
        return known
    if not coloured:
        return ()
    picture, *layers = (np.concatenate(pair)[:, ::LOOKED_AT_COLUMNS]
                        for pair in (pictures, *coloured.values()))
    return tuple(find_sets(picture, dict(zip(coloured, layers, strict=True))))


def follow_picture(parts: MutableMapping[str, np.ndarray], sets: Iterable[Sequence[str]],
                   picture: np.ndarray) -> None:
    """Let the parts (h, w, 3) of each set add up to the picture (h, w, 3): they get what is missing
    by their light, and all the same of it where they have none."""
    for names in sets:
        sizes = [np.abs(parts[name]) for name in names]
        size = sum(sizes[1:], sizes[0])
        total = sum((parts[name] for name in names[1:]), parts[names[0]])
        missing, is_dark = picture - total, size == 0
        even = np.float32(1 / len(names))
        for name, own in zip(names, sizes, strict=True):
            share = np.where(is_dark, even, own / np.where(is_dark, np.float32(1), size))
            parts[name] = parts[name] + missing * share


def _is_set(names: Sequence[str], pictures: Pair, parts: Mapping[str, Pair]) -> bool:
    """Whether these parts are there, and add up to the picture of both frames."""
    if not all(name in parts for name in names):
        return False
    return all(_add_up(pictures[side], [parts[name][side] for name in names]) for side in (0, 1))


def _add_up(picture: np.ndarray, parts: Sequence[np.ndarray]) -> bool:
    """Whether parts are the picture together, by some of the columns."""
    seen = np.s_[:, ::LOOKED_AT_COLUMNS]
    total = sum((part[seen] for part in parts[1:]), parts[0][seen])
    apart = np.abs(total - picture[seen]).sum(dtype=np.float64)
    return bool(apart <= LAYER_SUM_TOLERANCE * np.abs(picture[seen]).sum(dtype=np.float64))
