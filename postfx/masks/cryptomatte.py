"""Named things: the text after `--leave`, whole-number ids, Cryptomatte, and how much of a frame
they cover.

A Cryptomatte tells which part of a pixel belongs to which named object or material: a pixel holds
pairs of an id and its share, ranked by share. The id is the name's MurmurHash3, its bits read as a
float (Friedman and Jones 2015, "Fully automatic id mattes with support for motion blur and
transparency"; the Cryptomatte specification, version 1.2.0).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from functools import reduce
from typing import Any, TypeVar

import numpy as np

from postfx.errors import StrengthError, find_nearest

AUTO = "auto"
"""The name that stands for sky and misses."""
CONVERGED = "converged"
"""The word for converged pixels, before : and a threshold."""
_NUMBER_RANGE = re.compile(r"(-?\d+)(?:-(-?\d+))?")


@dataclass(frozen=True)
class Entry:
    """A name, and the strength of the pixels that it selects.

    Attributes:
        name: of an object or material, with the wildcards * ? and []; an id such as 7, 7-9 or, in a
            Cryptomatte, 0x1a2b3c4d; 'auto' for sky and misses; 'converged:0.01' or
            'converged:256spp' for converged pixels.
        plane: Cryptomatte or plane of ids to look in; None for all Cryptomattes of the file.
        strength: 0 (leave as it is) to 1 (denoise fully).
    """

    name: str
    plane: str | None = None
    strength: float = 0.0

    def __str__(self) -> str:
        plane = f"@{self.plane}" if self.plane else ""
        return f"{self.name}{plane}" + (f"={self.strength:g}" if self.strength else "")

    @property
    def is_auto(self) -> bool:
        """Whether it selects sky and misses."""
        return self.name == AUTO and self.plane is None

    @property
    def is_converged(self) -> bool:
        """Whether it selects converged pixels."""
        return self.name.partition(":")[0] == CONVERGED

    def select(self, names: list[str]) -> list[str]:
        """The names that it selects: exactly its own, or else all that match its wildcards."""
        return ([self.name] if self.name in names
                else [name for name in names if fnmatchcase(name, self.name)])


def parse_leave(text: str) -> tuple[Entry, ...]:
    """Entries of a text: NAME, NAME=STRENGTH, NAME@PLANE or NAME@PLANE=STRENGTH, separated by
    commas.

    'auto,logo,glass_*=0.5,7-9@id' leaves sky and misses, the logo, and ids 7 to 9 of the plane id
    as they are, and denoises glass by half. 'converged:0.01' leaves pixels with a relative error of
    at most 1 % as they are. Write ? for a comma or @ in a name. StrengthError for an empty name and
    a strength outside 0 to 1.
    """
    return tuple(_parse_entry(word.strip(), text) for word in text.split(","))


def _parse_entry(word: str, text: str) -> Entry:
    """One word of --leave: a name, perhaps with the plane it is of and its strength. StrengthError
    for a strength outside 0..1."""
    name, strength = word, 0.0
    head, equals, tail = word.rpartition("=")
    if equals:
        try:
            name, strength = head, float(tail)
        except ValueError:
            name = word  # the sign is part of the name
    if not 0 <= strength <= 1:
        raise StrengthError(f"leave '{text}': strength {strength:g} of '{name}': give 0 (as it is) "
                            "to 1 (fully)")
    name, _, plane = name.strip().rpartition("@") if "@" in name else (name.strip(), "", "")
    if not name:
        raise StrengthError(f"leave '{text}': a name is missing: give names such as "
                            "auto,sky_*,logo=0.5,7@id")
    return Entry(name, plane or None, strength)


def id_range(entry: Entry) -> tuple[int, int]:
    """First and last id of an entry such as '7' or '7-9'; StrengthError for anything else."""
    found = _NUMBER_RANGE.fullmatch(entry.name)
    if found is None:
        raise StrengthError(f"'{entry.name}' of AOV {entry.plane}: give an id, or first and last, "
                            "such as 7-9")
    first, last = int(found[1]), int(found[2] or found[1])
    if first > last:
        raise StrengthError(f"'{entry.name}' of AOV {entry.plane}: write the smaller id first, "
                            f"{last}-{first}")
    return first, last


def strength_from_ids(ids: np.ndarray,
                      strengths: Mapping[int | tuple[int, int], float]) -> np.ndarray:
    """Strength (height, width, 1) from whole-number ids (height, width) or (height, width, 1) of
    any data type.

    strengths: id, or first and last id -> 0 (leave as it is) to 1 (denoise fully). The last
    matching key counts. Pixels without one are denoised fully, and so are ids that are not whole
    numbers, such as averages of two ids. StrengthError for strengths outside 0..1.
    """
    if not all(0 <= value <= 1 for value in strengths.values()):
        raise StrengthError(f"strengths {min(strengths.values()):g} to "
                            f"{max(strengths.values()):g}: give 0 to 1")
    ids = ids.reshape(ids.shape[:2])
    strength = np.ones(ids.shape, np.float32)
    for key, value in strengths.items():
        strength[is_in_range(ids, key if isinstance(key, tuple) else (key, key))] = value
    return strength[:, :, None]


def is_in_range(ids: np.ndarray, span: tuple[int, int]) -> np.ndarray:
    """Where ids are whole numbers from a first to a last one: (height, width) of bool."""
    found = (ids >= span[0]) & (ids <= span[1])
    return found if np.issubdtype(ids.dtype, np.integer) else found & (ids == np.rint(ids))


@dataclass
class Coverage:
    """How much of some frames is not denoised, by entry: sums over the frames of shares of pixels,
    0..1.

    Attributes:
        frames: number of frames.
        alone: share of pixels of strength 0.
        covered: entry -> share that it covers; a partly covered pixel counts in part.
        missed: share of misses; None if they were not looked for.
        basis: entry -> the plane that decides what it covers, in words.
    """

    frames: int = 0
    alone: float = 0.0
    covered: dict[str, float] = field(default_factory=dict)
    missed: float | None = None
    basis: dict[str, str] = field(default_factory=dict)

    def add(self, other: Coverage) -> None:
        """Add other frames."""
        self.frames += other.frames
        self.alone += other.alone
        self.basis |= other.basis
        for name, share in other.covered.items():
            self.covered[name] = self.covered.get(name, 0.0) + share
        if other.missed is not None:
            self.missed = (self.missed or 0.0) + other.missed

    def as_dict(self) -> dict[str, Any]:
        """Means over the frames, of which there must be at least one, in plain types."""
        covered = {name: round(share / self.frames, 4) for name, share in self.covered.items()}
        missed = {} if self.missed is None else {"misses": round(self.missed / self.frames, 4)}
        basis = {"basis": self.basis} if self.basis else {}
        share = round(self.alone / self.frames, 4)
        return {"frames": self.frames, "share": share, "covered": covered, **missed, **basis}

    def __str__(self) -> str:
        means = self.as_dict()
        parts = [f"{name} covers {_percent(share)}{self._by(name)}"
                 for name, share in means["covered"].items()]
        if "misses" in means:
            parts.append(f"{_percent(means['misses'])} are misses, of which edges and noisy ones "
                         "are denoised")
        return (f"{_percent(means['share'])} of the pixels are not denoised at all: "
                f"{', '.join(parts)}")

    def _by(self, name: str) -> str:
        return f" by {self.basis[name]}" if name in self.basis else ""


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"


ROUNDED_STRENGTH = 1e-3
"""Strengths this close to 0 or 1 become 0 or 1, because shares do not add up to exactly 1."""
MOST_SUGGESTED_NAMES = 5
"""Names that an error suggests in place of one that is not there."""
_HASH_MASK = 0xFFFFFFFF
"""Names have hashes of 32 bits."""
Key = TypeVar("Key")


def id_of_name(name: str) -> int:
    """Id of a name, 32 bits: MurmurHash3_x86_32 of its UTF-8 with seed 0 (Appleby 2011), changed
    where it would be a denormal, infinite or NaN float, as the specification demands."""
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

        Raises StrengthError if the manifest's id of a name is not its hash, and for wildcards
        without a manifest.
        """
        if entry.name.lower().startswith("0x"):
            return [_parse_id(entry.name)]
        if self.manifest is None:
            if set("*?[") & set(entry.name):
                raise StrengthError(f"{self.where}: Cryptomatte {self.name} has no manifest, so "
                                    f"nothing tells which names match '{entry.name}': give whole "
                                    "names")
            return [id_of_name(entry.name)]
        return [self._check(name, self.manifest[name])
                for name in entry.select(list(self.manifest))]

    def nearest(self, entry: Entry) -> list[str]:
        """Names of the manifest that are most like an entry's, best first."""
        return find_nearest(entry.name, self.manifest or (), MOST_SUGGESTED_NAMES, 0.4)

    def _check(self, name: str, found: int) -> int:
        """The id that the manifest gives a name, if it is the name's hash."""
        hashed = id_of_name(name)
        if found != hashed:
            raise StrengthError(f"{self.where}: Cryptomatte {self.name}: the manifest gives "
                                f"'{name}' the id {found:08x}, its hash is {hashed:08x}: it may be "
                                f"another file's; give the id that is in the pixels, 0x{found:08x} "
                                f"or 0x{hashed:08x}")
        return found


def _parse_id(text: str) -> int:
    wrong = StrengthError(f"'{text}' is not an id of a Cryptomatte: give 0x and 8 hexadecimal "
                          "digits")
    try:
        found = int(text, 16)
    except ValueError:
        raise wrong from None
    if found > _HASH_MASK:
        raise wrong
    return found


def strength_from_cryptomatte(
    ranks: np.ndarray | Sequence[np.ndarray], strengths: Mapping[str | int, float]
) -> np.ndarray:
    """Strength (height, width, 1), 0..1: 1 minus (1 - strength) of each thing times its share of
    the pixel.

    ranks: (height, width, 2 n) float32, id and share in turn, as the channels R, G, B, A of the
    planes 00, 01, ... hold them; or a sequence of 2 n such planes (height, width). Ids must have
    all 32 bits. strengths: name or id -> 0 (leave as it is) to 1 (denoise fully); the rest is
    denoised fully. Edges are as soft as the shares. StrengthError for half a pair and strengths
    outside 0..1.
    """
    planes = list(np.moveaxis(ranks, -1, 0)) if isinstance(ranks, np.ndarray) else list(ranks)
    if not planes or len(planes) % 2:
        raise StrengthError(f"{len(planes)} AOVs of a Cryptomatte: give an id and its coverage for "
                            "each rank")
    table = {id_of_name(key) if isinstance(key, str) else int(key) & _HASH_MASK: value
             for key, value in strengths.items()}
    if not all(0 <= value <= 1 for value in table.values()):
        raise StrengthError(f"strengths {min(table.values()):g} to {max(table.values()):g}: give 0 "
                            "to 1")
    lost = share_of(planes, {key: 1 - value for key, value in table.items()})
    return snap(1 - lost)[:, :, None]


def share_of(planes: Sequence[np.ndarray], weights: Mapping[int, float]) -> np.ndarray:
    """Share (height, width) of each pixel that belongs to some ids, times a weight of each; 0 ..
    largest weight.

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


def split_shares(owned: Sequence[Mapping[Key, np.ndarray]],
                 keys: Sequence[Key]) -> Iterator[tuple[Key, np.ndarray]]:
    """Each key and its share (height, width) of every pixel, over several Cryptomattes of a
    picture; last key first.

    owned: for each Cryptomatte, key -> share of the ids that belong to this key there. A later key
    takes its part of a pixel from the earlier ones, in all Cryptomattes. How things of two of them
    overlap within a pixel is unknown: the largest possible overlap is assumed.
    """
    later: list[np.ndarray | float] = [0.0] * len(owned)
    for key in reversed(keys):
        most = reduce(np.maximum, later)
        yield key, reduce(np.maximum,
                          (np.maximum(own[key] - (most - taken), 0)
                           for own, taken in zip(owned, later, strict=True) if key in own))
        later = [taken + own.get(key, 0.0) for own, taken in zip(owned, later, strict=True)]


def snap(strength: np.ndarray) -> np.ndarray:
    """Strengths clipped to 0..1, those close to 0 or 1 moved there; float32 of any shape."""
    strength = np.clip(strength, 0, 1).astype(np.float32)
    strength[strength < ROUNDED_STRENGTH] = 0
    strength[strength > 1 - ROUNDED_STRENGTH] = 1
    return strength


def _murmur3(data: bytes) -> int:
    found, whole = 0, len(data) // 4 * 4
    for at in range(0, whole, 4):
        found = (_rotate(found ^ _mix(int.from_bytes(data[at:at + 4], "little")), 13) * 5
                 + 0xE6546B64 & _HASH_MASK)
    found ^= _mix(int.from_bytes(data[whole:], "little")) ^ len(data)
    found = (found ^ found >> 16) * 0x85EBCA6B & _HASH_MASK
    found = (found ^ found >> 13) * 0xC2B2AE35 & _HASH_MASK
    return found ^ found >> 16


def _mix(word: int) -> int:
    return _rotate(word * 0xCC9E2D51 & _HASH_MASK, 15) * 0x1B873593 & _HASH_MASK


def _rotate(word: int, count: int) -> int:
    return (word << count | word >> 32 - count) & _HASH_MASK
