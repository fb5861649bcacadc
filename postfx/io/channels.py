"""Every channel of a frame's files under all its names, part by part, so that those of one part
stay together.

A channel goes by its own name ('albedo.R'), by its part's name before it ('albedo' and 'R'), and by
its file's name where every plane has one. Nuke's and Clarisse's red, green, blue and alpha count as
R, G, B and A, and letter case does not count. Of stereo files one view is read. Views are told by
an attribute of parts, by their names ('rgba.left', 'rgba_left') or by the last but one word of a
channel's name ('left.R', 'forward.left.u').
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from fnmatch import fnmatchcase
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np

from postfx.frame import Role
from postfx.io.image_file import ImageFile
from postfx.io.profile import load_profile, profile_names
from postfx.io.windows import Part
from postfx.streams import make_printable

COLOUR_FILES = ("beauty", "rgba", "rgb", "colour", "color", "combined", "image", "noisy")
"""Words that stand for the colour plane where every plane has its own file."""
_SHORT_LETTERS = {"red": "r", "green": "g", "blue": "b", "alpha": "a"}
_VIEW_WORDS = ("main", "left", "right")
"""Views that parts are named after where no attribute tells views."""
_NUMBER = re.compile(r"[ ._-]?\d+$")
"""At the end of names that are otherwise alike."""
_DATA = re.compile(
    r"crypto|matte|mask|normal|depth|position|point|motion|vector|velocity|albedo|roughness|"
    r"variance|(^|[._ ])(n|ng|ns|nn|p|pref|pworld|z|ids?|uv|st)([._ ]|$)|(?-i:[a-z]ID$)",
    re.IGNORECASE,
)
"""Names of parts whose R, G and B are not colours."""


def is_plane_word(word: str) -> bool:
    """Whether a word in file or part names stands for a plane: one for the colour, or a layer that
    a profile names."""
    return bool(word) and word.lower() in _plane_words()


@cache
def _plane_words() -> frozenset[str]:
    """In lower case. Single letters, which are channels as well, count as the generic profile has
    them."""
    named = {name for rule in load_profile("generic").planes for name in rule.names}
    for profile in map(load_profile, profile_names()):
        named |= {name for rule in profile.planes if rule.role not in (Role.COLOUR, Role.ALPHA)
                  for name in rule.names if len(name) > 1 and "*" not in name and "{" not in name}
    return frozenset({*COLOUR_FILES, *(name.lower() for name in named if name)})


Parts = tuple[Part, ...]
"""All parts of one file."""
Names = tuple[tuple[str, str], ...]
"""Full names of channels, each in lower case and as it is written."""


class Channel(NamedTuple):
    """One channel of one part of one of a frame's files, which is told by its word: files that are
    alike share their parts."""

    word: str
    part: Part
    name: str


@dataclass(eq=False)
class _Source:
    """One part of a file, seen from one view: full name in lower case -> the name as it is written,
    and the channel. `name` is that of the part, or else the file's word."""

    name: str
    rank: _Rank
    channels: dict[str, tuple[str, Channel]] = field(default_factory=dict)
    is_preferred: bool = False

    @property
    def order(self) -> tuple[bool, _Rank]:
        """The part that is looked at first has the smallest."""
        return not self.is_preferred, self.rank

    def add(self, name: str, channel: Channel) -> None:
        self.channels.setdefault(name.lower(), (name, channel))

    def holds(self, channel: Channel) -> bool:
        """Whether a channel is one of its own."""
        return any(channel == own for _, own in self.channels.values())

    def find(self, names: Iterable[str]) -> tuple[Channel, ...] | None:
        """Channels by full name in lower case; None unless all are there."""
        found = []
        for name in names:
            if "*" in name:
                name = next((key for key in self.channels if fnmatchcase(key, name)), name)
            if name not in self.channels:
                return None
            found.append(self.channels[name][1])
        return tuple(found)


class _Rank(IntEnum):
    """How likely a part's R, G and B are the frame's colour, the likeliest first."""

    PICTURE = 0
    """That postfx wrote."""
    COLOUR = 1
    """By its name."""
    UNKNOWN = 2
    """Its name tells of nothing else."""
    NAMED = 3
    """It tells of something else: its channels are found by the name of the part only."""


class ChannelIndex:
    """Channels of a frame's files by full name.

    `files` maps a plane's word ('' where one file holds all planes) to its file's parts. A channel
    R without more is that of the picture that postfx wrote, else of a part named after the colour,
    else of the first part that is not named after something else. `view` is one of `views`, or None
    for the first. `layer` is a layer whose channels also go by their names without it, and come
    first.

    Attributes:
        views: of the first file, the one that is looked at first; empty where the file is not of
            several.
    """

    def __init__(self, files: Mapping[str, Parts], view: str | None = None,
                 layer: str = "") -> None:
        self._files = files
        self.views = _views(next(iter(files.values())))
        view = view or (self.views[0] if self.views else "")
        self.views = tuple(sorted(self.views, key=lambda own: own != view))
        found = [source for word, parts in files.items() for source in _sources(word, parts, view)]
        self._sources = sorted(found, key=lambda source: source.order)
        if layer:
            self._prefer(layer)

    def find(
        self, names: Iterable[str], fits: Callable[[tuple[Channel, ...]], bool] = lambda _: True
    ) -> tuple[Channel, ...] | None:
        """Channels by full name, * matching anything, all of one part; None unless all are there,
        () without names.

        The first part counts whose channels fit. They may be spread over parts only where no part
        has them all.
        """
        wanted = [name.lower() for name in names]
        if not wanted:
            return ()
        spread = self._everything.find(wanted)
        if spread is None:
            return None
        found = (source.find(wanted) for source in self._sources)
        return next((channels for channels in (*found, spread) if channels and fits(channels)),
                    None)

    def matching(self, name: str) -> list[Channel]:
        """A channel or those of a layer, by full name or the end of it, * matching anything; each
        once."""
        everything = self._everything.channels.items()
        for pattern in (name, f"{name}.*", f"*.{name}", f"*.{name}.*"):
            found = [channel
                     for key, (_, channel) in everything if fnmatchcase(key, pattern.lower())]
            if found:
                return list(dict.fromkeys(found))
        return []

    def layers_like(self, name: str, whole: bool = False) -> list[str]:
        """Layers by full name, or else the end of it unless only the `whole` name counts, *
        matching anything."""
        names = [full for full, _ in self._everything.channels.values()]
        layers = list(dict.fromkeys(full.rpartition(".")[0] or full for full in names))
        for pattern in (name,) if whole else (name, f"*.{name}", f"*_{name}"):
            found = [layer for layer in layers if fnmatchcase(layer.lower(), pattern.lower())]
            if found:
                return found
        return []

    def find_lone_picture(self) -> str | None:
        """The one layer with R, G and B, or else the only layer, with Y, unless its name tells of
        something else; None where there is none or a choice."""
        layers = [layer for layer in self.layers_like("*", whole=True)
                  if not _DATA.search(layer) and not is_plane_word(layer.rpartition(".")[2])]
        coloured = self._coloured(layers)
        if coloured:
            return next(iter(coloured.values())) if len(coloured) == 1 else None
        only = layers[0] if len(self.layers_like("*", whole=True)) == 1 and layers else None
        return only if only and self.find([f"{only}.Y"]) else None

    def possible_pictures(self) -> dict[tuple[Channel, ...], str]:
        """Channels R, G and B of layers whose names tell of nothing but a picture, and the names of
        these layers."""
        return self._coloured(layer for layer in self.layers_like("*", whole=True)
                              if not _DATA.search(layer)
                              and (not is_plane_word(word := layer.rpartition(".")[2])
                                   or word.lower() in COLOUR_FILES))

    def _coloured(self, layers: Iterable[str]) -> dict[tuple[Channel, ...], str]:
        """Channels R, G and B of layers that have them."""
        # a layer also goes by its part's name before its own
        coloured: dict[tuple[Channel, ...], str] = {}
        for layer in layers:
            if channels := self.find(f"{layer}.{letter}" for letter in "RGB"):
                coloured.setdefault(channels, layer)
        return coloured

    def pictures_beside(self, colour: tuple[Channel, ...],
                        is_named: bool) -> dict[tuple[Channel, ...], str]:
        """Channels of other parts that may as well be the picture as `colour` is, and the names of
        these parts. `is_named`: the colour was looked for by its part's name."""
        found: dict[tuple[Channel, ...], str] = {}
        own = next(source for source in self._sources if source.holds(colour[0]))
        rank = min(own.rank, _Rank.COLOUR) if is_named else own.rank
        for source in self._sources:
            channels = source.find(channel.name.lower() for channel in colour)
            is_numbered = (own.rank > _Rank.PICTURE
                           and _NUMBER.sub("", source.name).lower() in COLOUR_FILES)
            if channels and source is not own and (source.rank <= rank or is_numbered):
                found.setdefault(channels, source.name)
        return found

    def set_aside(self, pictures: Collection[tuple[Channel, ...]]) -> None:
        """Channels of the parts that hold these go by the names of their parts only."""
        for source in self._sources:
            if any(source.holds(channels[0]) for channels in pictures):
                start = f"{source.name.lower()}."
                source.channels = {key: entry for key, entry in source.channels.items()
                                   if key.startswith(start)}
                source.rank = _Rank.NAMED
        self._sources.sort(key=lambda source: source.order)
        self.__dict__.pop("_everything", None)

    def part_name(self, channel: Channel) -> str:
        """Name of a channel's part, or else its file's word."""
        return next(source.name for source in self._sources if source.holds(channel))

    def pairs_like(self, pattern: re.Pattern[str]) -> Iterator[tuple[str, tuple[Channel, ...]]]:
        """Layers whose full name a pattern is found in, and their channels x and y, or the like."""
        # a layer also goes by its part's name before its own
        seen: set[tuple[Channel, ...]] = set()
        for layer in self.layers_like("*", whole=True):
            named = ([f"{layer}.{letter}" for letter in letters] for letters in ("XY", "RG", "UV"))
            channels = (next(filter(None, map(self.find, named)), None) if pattern.search(layer)
                        else None)
            if channels and channels not in seen:
                seen.add(channels)
                yield layer, channels

    @cached_property
    def names(self) -> Names:
        """All full names."""
        return tuple((key, name) for key, (name, _) in self._everything.channels.items())

    def has_layer(self, layer: str) -> bool:
        """Whether a channel's full name begins with this layer."""
        return any(key.startswith(f"{layer.lower()}.") for key in self._everything.channels)

    def layers(self) -> list[str]:
        """First words of full names, each once."""
        names = [name for name, _ in self._everything.channels.values() if "." in name]
        return list(dict.fromkeys(make_printable(name.partition(".")[0]) for name in names))

    def contents(self, without: Iterable[Channel] = (), of_view: bool = False) -> list[str]:
        """What the files hold, layer by layer, except some channels: 'albedo.R,G,B'; with
        `of_view`, also except those of other views than the one that is looked at first."""
        left_out = set(without)
        others = frozenset(self.views[1:]) if of_view else frozenset()
        layers: dict[str, list[str]] = {}
        for word, parts in self._files.items():
            views = _views(parts)
            for part in parts:
                own = _name_and_view(part, views)[1]
                for name in part.channels:
                    seen = _without_view(name, views, own, len(parts) == 1)[1]
                    if Channel(word, part, name) in left_out or seen in others:
                        continue
                    layer, _, letter = name.rpartition(".")
                    layers.setdefault(layer or (part.name if len(parts) > 1 else ""),
                                      []).append(letter)
        return [make_printable(f"{layer}{'.' * bool(layer)}{','.join(letters)}")
                for layer, letters in layers.items()]

    @cached_property
    def _everything(self) -> _Source:
        together = _Source("", _Rank.NAMED)
        for source in self._sources:
            for key, entry in source.channels.items():
                together.channels.setdefault(key, entry)
        return together

    def _prefer(self, layer: str) -> None:
        start = f"{layer.lower()}."
        for source in self._sources:
            inner = {key[len(start):]: entry
                     for key, entry in source.channels.items() if key.startswith(start)}
            source.channels = inner | {key: entry for key, entry in source.channels.items()
                                       if key not in inner}
            source.is_preferred = bool(inner)
        self._sources.sort(key=lambda source: source.order)


def before(names: Names, ending: str) -> list[str]:
    """What stands before this ending in full names, each once, '' included."""
    ending = ending.lower()
    found = [name for key, name in names if f".{key}".endswith(f".{ending}")]
    return list(dict.fromkeys(name[: len(name) - len(ending)] for name in found))


def are_together(channels: Iterable[Channel]) -> bool:
    """Whether channels are of one part of one file."""
    first, *others = channels
    return all(channel[:2] == first[:2] for channel in others)


def has_siblings(channel: Channel, letters: Iterable[str]) -> bool:
    """Whether a channel's part holds channels of these letters in the same layer."""
    layer = channel.name.rpartition(".")[0]
    names = {name.lower() for name in channel.part.channels}
    return all((f"{layer}.{letter}" if layer else letter).lower() in names for letter in letters)


def read_channels(
    files: Mapping[str, ImageFile], fills: Mapping[Channel, float],
    rows: tuple[int, int] | None = None
) -> dict[Channel, np.ndarray]:
    """Every channel, or some of its rows, with one read of each part that holds any. `fills` gives
    the value for pixels without data; `files` are the open ones of a frame, by their words."""
    wanted: dict[tuple[str, Part], list[Channel]] = {}
    for channel in fills:
        wanted.setdefault((channel.word, channel.part), []).append(channel)
    pixels: dict[Channel, np.ndarray] = {}
    for (word, part), channels in wanted.items():
        values = {channel.name: fills[channel] for channel in channels}
        read = files[word].read(part, values, rows)
        pixels.update({channel: read[channel.name] for channel in channels})
    return pixels


def _sources(word: str, parts: Parts, view: str) -> Iterator[_Source]:
    """The parts of a file that hold channels of a view."""
    views = _views(parts)
    holds_colour = word == "" or word.lower() in COLOUR_FILES
    ranks = (_ranks([_name_and_view(part, views)[0] for part in parts], parts) if holds_colour
             else {})
    is_lone = len(parts) == 1
    for index, part in enumerate(parts):
        name, own = _name_and_view(part, views)
        source = _Source(name or word, ranks.get(index, _Rank.NAMED))
        shorts = [(*_without_view(channel, views, own, is_lone), Channel(word, part, channel))
                  for channel in part.channels]
        named = {short: found for short, seen, found in shorts if seen == "" or len(views) < 2}
        named |= {short: found for short, seen, found in shorts if seen == view}
        for short, found in (*named.items(),
                             *((_with_letter(short), found) for short, found in named.items())):
            for full in _full_names(short, name, word, source.rank < _Rank.NAMED):
                source.add(full, found)
        if source.channels:
            yield source


def _full_names(short: str, part: str, word: str, is_plain: bool) -> list[str]:
    own = [short] if is_plain or "." in short or short.lower() == part.lower() else []
    return own + [f"{head}.{short}"
                  for head in (part, word) if head and not short.startswith(f"{head}.")]


def _ranks(names: list[str], parts: Parts) -> dict[int, _Rank]:
    """Ranks of the parts whose channels go by their bare names as well; of all, where none is
    likely to."""
    ranks = {index: _Rank.PICTURE for index, part in enumerate(parts) if part.is_picture}
    for index, name in enumerate(names):
        words = {name.lower(), name.lower().rpartition(".")[2]}
        if words & {*COLOUR_FILES}:
            ranks.setdefault(index, _Rank.COLOUR)
        elif not is_plane_word(name) and not _DATA.search(name):
            ranks.setdefault(index, _Rank.UNKNOWN)
    return ranks or dict.fromkeys(range(len(parts)), _Rank.UNKNOWN)


def _with_letter(name: str) -> str:
    """'albedo.red' as 'albedo.r'."""
    layer, dot, letter = name.rpartition(".")
    return layer + dot + _SHORT_LETTERS.get(letter.lower(), letter)


def _views(parts: Parts) -> tuple[str, ...]:
    """Views that a file's parts tell, the first one first; of one view or none where it is not of
    several."""
    if parts[0].views is not None:
        return parts[0].views
    told = [part.view for part in parts if part.view]
    ends = [re.split(r"[._]", part.name)[-1] for part in parts]
    shared = len(parts) > 1 and len(set(ends)) == 1 and all("." in part.name for part in parts)
    named = [end for end in ends if end.lower() in _VIEW_WORDS or shared]
    return tuple(dict.fromkeys(told or named))


def _name_and_view(part: Part, views: tuple[str, ...]) -> tuple[str, str]:
    """A part's name without its view, and the view, '' where it tells none."""
    found = re.fullmatch(r"(?:(.+)[._])?([^._]+)", part.name)
    if found and found[2] in ((part.view,) if part.view else views):
        return found[1] or "", found[2]
    return part.name, part.view


def _without_view(channel: str, views: tuple[str, ...], view: str,
                  is_by_name: bool) -> tuple[str, str]:
    """A channel's name without its view, and the view: the part's, else that in its name; '' where
    it is of all.

    Channels without a layer are of the first view where names tell views.
    """
    *layers, letter = channel.split(".")
    if layers and layers[-1] in views and view in ("", layers[-1]):
        return ".".join([*layers[:-1], letter]), layers[-1]
    return channel, view or (views[0] if views and not layers and is_by_name else "")
