"""Every channel of a frame's files under all the names it may be asked for."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from fnmatch import fnmatchcase
from typing import NamedTuple

import numpy as np

from postfx.io.image_file import ImageFile
from postfx.io.profile import load_profile
from postfx.io.windows import Part

COLOUR_FILES = ("beauty", "rgba", "rgb", "colour", "color", "combined", "image", "noisy")
"""Words that stand for the colour plane where every plane has its own file."""


def is_plane_word(word: str) -> bool:
    """Whether a word in file or part names stands for a plane: one for the colour, or a generic profile's layer."""
    layers = {name for rule in load_profile("generic").planes for name in rule.names if name}
    return word.lower() in {*COLOUR_FILES, *layers}


class Channel(NamedTuple):
    """One channel of one part of one of a frame's files."""

    file: ImageFile
    part: Part
    name: str


class ChannelIndex:
    """Channels by full name: 'albedo.R' is channel R of part or file albedo, or a channel of that very name.

    `files` maps a plane's word ('' where one file holds all planes) to its file. A channel R without more is that of
    a part named after the colour, else of the first part that is not named after another plane. Letter case does not
    count. Parts of another view than the first part's are left out.
    """

    def __init__(self, files: Mapping[str, ImageFile]) -> None:
        self._channels: dict[str, Channel] = {}
        for word, file in files.items():
            parts = [part for part in file.parts if part.view in ("", file.parts[0].view)]
            plain = _plain(parts) if word == "" or word.lower() in COLOUR_FILES else []
            for part in plain + [part for part in parts if part not in plain]:
                self._add(word, file, part, part in plain)

    def find(self, names: Iterable[str]) -> tuple[Channel, ...] | None:
        """Channels by full name, * matching anything; None unless all are there."""
        found = [self._find_one(name.lower()) for name in names]
        return tuple(found) if all(found) else None

    def matching(self, name: str) -> list[Channel]:
        """A channel or those of a layer, by full name or the end of it, * matching anything; each once."""
        for pattern in (name, f"{name}.*", f"*.{name}", f"*.{name}.*"):
            found = [channel for key, channel in self._channels.items() if fnmatchcase(key, pattern.lower())]
            if found:
                return list(dict.fromkeys(found))
        return []

    def ending_in(self, name: str) -> Iterator[Channel]:
        """Channels whose full name ends like this."""
        return (channel for key, channel in self._channels.items() if key.endswith(name.lower()))

    def _find_one(self, name: str) -> Channel | None:
        if "*" not in name:
            return self._channels.get(name)
        return next((channel for key, channel in self._channels.items() if fnmatchcase(key, name)), None)

    def _add(self, word: str, file: ImageFile, part: Part, plain: bool) -> None:
        for name in part.channels:
            full = [name] if plain or "." in name else []
            full += [f"{part.name}.{name}"] if part.name else []
            for key in full + ([f"{word}.{name}"] if word else []):
                self._channels.setdefault(key.lower(), Channel(file, part, name))


def read_channels(
    fills: Mapping[Channel, float], rows: tuple[int, int] | None = None
) -> dict[Channel, np.ndarray]:
    """Every channel once, or some of its rows, with one read of each part that holds any; each with what it is filled
    with where there is no data."""
    wanted: dict[tuple[ImageFile, int], list[Channel]] = {}
    for channel in fills:
        wanted.setdefault((channel.file, channel.part.index), []).append(channel)
    pixels: dict[Channel, np.ndarray] = {}
    for (file, _), channels in wanted.items():
        read = file.read(channels[0].part, {channel.name: fills[channel] for channel in channels}, rows)
        pixels.update({channel: read[channel.name] for channel in channels})
    return pixels


def _plain(parts: list[Part]) -> list[Part]:
    """Parts whose channels go by their bare names as well, best first."""
    colour = [part for part in parts if part.is_picture]
    colour += [part for part in parts if part.name.lower() in COLOUR_FILES and part not in colour]
    return colour + [part for part in parts if not is_plane_word(part.name)] or parts
