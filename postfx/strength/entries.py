"""What is said about the strength of named things: the text after `--leave`."""

from __future__ import annotations

from dataclasses import dataclass
from fnmatch import fnmatchcase

from postfx.errors import StrengthError

AUTO = "auto"
"""The name that stands for sky and misses."""
CONVERGED = "converged"
"""The word that stands for what has converged, before : and a threshold."""


@dataclass(frozen=True)
class Entry:
    """A name and the strength of what it stands for.

    Attributes:
        name: of an object or material, * ? and [] being wildcards; an id such as 7, 7-9 or, in a Cryptomatte,
            0x1a2b3c4d; 'auto' for sky and misses; 'converged:0.01' or 'converged:256spp' for
            what has converged.
        plane: Cryptomatte or plane of ids to look in; None for all Cryptomattes of the file.
        strength: 0 leave as it is .. 1 denoise fully.
    """

    name: str
    plane: str | None = None
    strength: float = 0.0

    def __str__(self) -> str:
        plane = f"@{self.plane}" if self.plane else ""
        return f"{self.name}{plane}" + (f"={self.strength:g}" if self.strength else "")

    @property
    def is_auto(self) -> bool:
        """Whether it is about sky and misses."""
        return self.name == AUTO and self.plane is None

    @property
    def is_converged(self) -> bool:
        """Whether it is about what has converged."""
        return self.name.partition(":")[0] == CONVERGED

    def matched(self, names: list[str]) -> list[str]:
        """Those of some names that it stands for: the very name, or else all that fit the wildcards."""
        return [self.name] if self.name in names else [name for name in names if fnmatchcase(name, self.name)]


def parse_leave(text: str) -> tuple[Entry, ...]:
    """Entries of a text: NAME, NAME=STRENGTH, NAME@PLANE or NAME@PLANE=STRENGTH, parted by commas.

    'auto,logo,glass_*=0.5,7-9@id' leaves sky and misses, the logo and the ids 7 to 9 of the plane id alone and denoises
    glass by half; 'converged:0.01' leaves alone what has a relative error of at most 1 %. A name that holds a comma or
    @ is written with ? in its place. StrengthError for an empty name and a strength outside 0 to 1.
    """
    return tuple(_entry(word.strip(), text) for word in text.split(","))


def _entry(word: str, text: str) -> Entry:
    name, strength = word, 0.0
    head, equals, tail = word.rpartition("=")
    if equals:
        try:
            name, strength = head, float(tail)
        except ValueError:
            name = word  # the name itself holds the sign
    if not 0 <= strength <= 1:
        raise StrengthError(f"leave '{text}': strength {strength:g} of '{name}': give 0 (as it is) to 1 (fully)")
    name, _, plane = name.strip().rpartition("@") if "@" in name else (name.strip(), "", "")
    if not name:
        raise StrengthError(f"leave '{text}': a name is missing: give names such as auto,sky_*,logo=0.5,7@id")
    return Entry(name, plane or None, strength)
