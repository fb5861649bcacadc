"""Named things and their strength: the text after `--leave`, whole-number ids, and how much of a frame they cover."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from postfx.errors import StrengthError

AUTO = "auto"
"""The name that stands for sky and misses."""
CONVERGED = "converged"
"""The word for converged pixels, before : and a threshold."""
_RANGE = re.compile(r"(-?\d+)(?:-(-?\d+))?")


@dataclass(frozen=True)
class Entry:
    """A name, and the strength of the pixels that it selects.

    Attributes:
        name: of an object or material, with the wildcards * ? and []; an id such as 7, 7-9 or, in a Cryptomatte,
            0x1a2b3c4d; 'auto' for sky and misses; 'converged:0.01' or 'converged:256spp' for converged
            pixels.
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
        return [self.name] if self.name in names else [name for name in names if fnmatchcase(name, self.name)]


def parse_leave(text: str) -> tuple[Entry, ...]:
    """Entries of a text: NAME, NAME=STRENGTH, NAME@PLANE or NAME@PLANE=STRENGTH, separated by commas.

    'auto,logo,glass_*=0.5,7-9@id' leaves sky and misses, the logo, and ids 7 to 9 of the plane id as they are, and
    denoises glass by half. 'converged:0.01' leaves pixels with a relative error of at most 1 % as they are. Write ? for
    a comma or @ in a name. StrengthError for an empty name and a strength outside 0 to 1.
    """
    return tuple(_parse_entry(word.strip(), text) for word in text.split(","))


def _parse_entry(word: str, text: str) -> Entry:
    name, strength = word, 0.0
    head, equals, tail = word.rpartition("=")
    if equals:
        try:
            name, strength = head, float(tail)
        except ValueError:
            name = word  # the sign is part of the name
    if not 0 <= strength <= 1:
        raise StrengthError(f"leave '{text}': strength {strength:g} of '{name}': give 0 (as it is) to 1 (fully)")
    name, _, plane = name.strip().rpartition("@") if "@" in name else (name.strip(), "", "")
    if not name:
        raise StrengthError(f"leave '{text}': a name is missing: give names such as auto,sky_*,logo=0.5,7@id")
    return Entry(name, plane or None, strength)


def id_range(entry: Entry) -> tuple[int, int]:
    """First and last id of an entry such as '7' or '7-9'; StrengthError for anything else."""
    found = _RANGE.fullmatch(entry.name)
    if found is None:
        raise StrengthError(f"'{entry.name}' of plane {entry.plane}: give an id, or first and last, such as 7-9")
    first, last = int(found[1]), int(found[2] or found[1])
    if first > last:
        raise StrengthError(f"'{entry.name}' of plane {entry.plane}: write the smaller id first, {last}-{first}")
    return first, last


def strength_from_ids(ids: np.ndarray, strengths: Mapping[int | tuple[int, int], float]) -> np.ndarray:
    """Strength (height, width, 1) from whole-number ids (height, width) or (height, width, 1) of any data type.

    strengths: id, or first and last id -> 0 (leave as it is) to 1 (denoise fully). The last matching key counts. Pixels
    without one are denoised fully, and so are ids that are not whole numbers, such as averages of two ids.
    StrengthError for strengths outside 0..1.
    """
    if not all(0 <= value <= 1 for value in strengths.values()):
        raise StrengthError(f"strengths {min(strengths.values()):g} to {max(strengths.values()):g}: give 0 to 1")
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
    """How much of some frames is not denoised, by entry: sums over the frames of shares of pixels, 0..1.

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
        parts = [f"{name} covers {_percent(share)}{self._by(name)}" for name, share in means["covered"].items()]
        if "misses" in means:
            parts.append(f"{_percent(means['misses'])} are misses, of which edges and noisy ones are denoised")
        return f"{_percent(means['share'])} of the pixels are not denoised at all: {', '.join(parts)}"

    def _by(self, name: str) -> str:
        return f" by {self.basis[name]}" if name in self.basis else ""


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"
