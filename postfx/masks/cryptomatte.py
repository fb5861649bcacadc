"""Cryptomatte: which part of a pixel belongs to which named object or material.

A pixel holds pairs of an id and its share of the pixel, ranked by share. The id is the name's MurmurHash3, its bits
read as a float (Friedman and Jones 2015, "Fully automatic id mattes with support for motion blur and transparency"; the
Cryptomatte specification, version 1.2.0).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import TypeVar

import numpy as np

from postfx.errors import StrengthError
from postfx.masks.entries import Entry

LEAST = 1e-3
"""Strengths this close to 0 or 1 become 0 or 1, because shares do not add up to exactly 1."""
NEAREST = 5
_BITS = 0xFFFFFFFF
Key = TypeVar("Key")


def id_of_name(name: str) -> int:
    """Id of a name, 32 bits: MurmurHash3_x86_32 of its UTF-8 with seed 0 (Appleby 2011), changed where it would be a
    denormal, infinite or NaN float, as the specification demands."""
    found = _murmur3(name.encode("utf-8"))
    exponent = found >> 23 & 255
    return found ^ (1 << 23) if exponent in (0, 255) else found


@dataclass(frozen=True)
class Cryptomatte:
    """One Cryptomatte, as a header describes it.

    Attributes:
        name: such as 'CryptoObject'.
        manifest: name -> id, or None if the file has none: then only whole names can be looked up.
        where: file, for messages.
    """

    name: str
    manifest: Mapping[str, int] | None
    where: str

    def ids_of(self, entry: Entry) -> list[int]:
        """Ids that an entry selects; none if no name of the manifest matches.

        Raises StrengthError if the manifest's id of a name is not its hash, and for wildcards without a manifest.
        """
        if entry.name.lower().startswith("0x"):
            return [_parse_id(entry.name)]
        if self.manifest is None:
            if set("*?[") & set(entry.name):
                raise StrengthError(f"{self.where}: Cryptomatte {self.name} has no manifest, so nothing tells which "
                                    f"names match '{entry.name}': give whole names")
            return [id_of_name(entry.name)]
        return [self._check(name, self.manifest[name]) for name in entry.select(list(self.manifest))]

    def nearest(self, entry: Entry) -> list[str]:
        """Names of the manifest that are most like an entry's, best first."""
        from difflib import get_close_matches  # for messages only

        names = list(self.manifest or ())
        folded = {name.lower(): name for name in names}
        return [folded[name] for name in get_close_matches(entry.name.lower(), folded, NEAREST, 0.4)]

    def _check(self, name: str, found: int) -> int:
        """The id that the manifest gives a name, if it is the name's hash."""
        hashed = id_of_name(name)
        if found != hashed:
            raise StrengthError(f"{self.where}: Cryptomatte {self.name}: the manifest gives '{name}' the id "
                                f"{found:08x}, its hash is {hashed:08x}: it may be another file's; give the id that is "
                                f"in the pixels, 0x{found:08x} or 0x{hashed:08x}")
        return found


def _parse_id(text: str) -> int:
    wrong = StrengthError(f"'{text}' is not an id of a Cryptomatte: give 0x and 8 hexadecimal digits")
    try:
        found = int(text, 16)
    except ValueError:
        raise wrong from None
    if found > _BITS:
        raise wrong
    return found


def strength_from_cryptomatte(
    ranks: np.ndarray | Sequence[np.ndarray], strengths: Mapping[str | int, float]
) -> np.ndarray:
    """Strength (height, width, 1), 0..1: 1 minus (1 - strength) of each thing times its share of the pixel.

    ranks: (height, width, 2 n) float32, id and share in turn, as the channels R, G, B, A of the planes 00, 01, ... hold
    them; or a sequence of 2 n such planes (height, width). Ids must have all 32 bits. strengths: name or id -> 0 (leave
    as it is) to 1 (denoise fully); the rest is denoised fully. Edges are as soft as the shares. StrengthError for
    half a pair and strengths outside 0..1.
    """
    planes = list(np.moveaxis(ranks, -1, 0)) if isinstance(ranks, np.ndarray) else list(ranks)
    if not planes or len(planes) % 2:
        raise StrengthError(f"{len(planes)} planes of a Cryptomatte: give id and share for each rank")
    table = {id_of_name(key) if isinstance(key, str) else int(key) & _BITS: value for key, value in strengths.items()}
    if not all(0 <= value <= 1 for value in table.values()):
        raise StrengthError(f"strengths {min(table.values()):g} to {max(table.values()):g}: give 0 to 1")
    lost = share_of(planes, {key: 1 - value for key, value in table.items()})
    return snap(1 - lost)[:, :, None]


def share_of(planes: Sequence[np.ndarray], weights: Mapping[int, float]) -> np.ndarray:
    """Share (height, width) of each pixel that belongs to some ids, times a weight of each; 0 .. largest weight.

    planes: ids and shares in turn, (height, width) float32 each.
    """
    total = np.zeros(planes[0].shape, np.float32)
    if not weights:
        return total
    ids = np.array(sorted(weights), np.uint32)
    factors = np.array([weights[int(key)] for key in ids], np.float32)
    for name, share in zip(planes[::2], planes[1::2], strict=True):
        bits = np.ascontiguousarray(name, np.float32).view(np.uint32)
        at = np.minimum(np.searchsorted(ids, bits), ids.size - 1)
        known = np.clip(np.nan_to_num(share, nan=0.0), 0, 1)
        total += np.where(ids[at] == bits, factors[at] * known, np.float32(0))
    capped: np.ndarray = np.minimum(total, factors.max())
    return capped


def split_shares(owned: Sequence[Mapping[Key, np.ndarray]], keys: Sequence[Key]) -> Iterator[tuple[Key, np.ndarray]]:
    """Each key and its share (height, width) of every pixel, over several Cryptomattes of a picture; last key first.

    owned: for each Cryptomatte, key -> share of the ids that belong to this key there. A later key takes its part of a
    pixel from the earlier ones, in all Cryptomattes. How things of two of them overlap within a pixel is unknown: the
    largest possible overlap is assumed.
    """
    later: list[np.ndarray | float] = [0.0] * len(owned)
    for key in reversed(keys):
        most = reduce(np.maximum, later)
        yield key, reduce(np.maximum, (np.maximum(own[key] - (most - taken), 0)
                                       for own, taken in zip(owned, later, strict=True) if key in own))
        later = [taken + own.get(key, 0.0) for own, taken in zip(owned, later, strict=True)]


def snap(strength: np.ndarray) -> np.ndarray:
    """Strengths clipped to 0..1, those close to 0 or 1 moved there; float32 of any shape."""
    strength = np.clip(strength, 0, 1).astype(np.float32)
    strength[strength < LEAST] = 0
    strength[strength > 1 - LEAST] = 1
    return strength


def _murmur3(data: bytes) -> int:
    found, whole = 0, len(data) // 4 * 4
    for at in range(0, whole, 4):
        found = _rotate(found ^ _mix(int.from_bytes(data[at:at + 4], "little")), 13) * 5 + 0xE6546B64 & _BITS
    found ^= _mix(int.from_bytes(data[whole:], "little")) ^ len(data)
    found = (found ^ found >> 16) * 0x85EBCA6B & _BITS
    found = (found ^ found >> 13) * 0xC2B2AE35 & _BITS
    return found ^ found >> 16


def _mix(word: int) -> int:
    return _rotate(word * 0xCC9E2D51 & _BITS, 15) * 0x1B873593 & _BITS


def _rotate(word: int, count: int) -> int:
    return (word << count | word >> 32 - count) & _BITS
