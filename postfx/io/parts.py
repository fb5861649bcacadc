"""Parts of the picture in a frame's files: light groups, passes and other planes, by a profile or
by name."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from postfx.errors import MissingPlaneError, OptionError, suggest
from postfx.frame import ADDITIVE, PART_KINDS, Part, PartSource
from postfx.io.channels import Channel, ChannelIndex, are_together, read_channels
from postfx.io.image_file import ImageFile
from postfx.io.layout import Layout
from postfx.planes import SAMPLED_ROW_STEP, has_negative_light

AUTO_PARTS = "auto"
NAMED_PARTS = "named"
COLOUR_LETTERS = (("R", "G", "B"),)
VECTOR_LETTERS = (("X", "Y", "Z"), ("R", "G", "B"))
NUMBER_LETTERS = (("V",), ("Z",), ("Y",), ("A",), ("X",), ("R",), ("",))
LETTERS_BY_KIND = {"normal": VECTOR_LETTERS, "position": VECTOR_LETTERS, "albedo": COLOUR_LETTERS,
                   "depth": NUMBER_LETTERS}
"""Channels of planes by kind, best first; others have three of colour or one."""
PLANE_KINDS = tuple(kind for kind in PART_KINDS if kind not in (*ADDITIVE, "factor"))
"""Kinds that `--aov-denoise` takes."""
ID_WORDS = ("crypto", "uint", "id", "index", "mask")
"""Words in the names of layers whose values are not amounts, so that means of them mean nothing."""
ID_PREFIX = "crypto"
"""How such a word may also begin: 'CryptoObject00'."""
SHOWN_LAYERS = 16
"""Layers that a message names at most."""


@dataclass(frozen=True)
class PartOptions:
    """What is asked for.

    Attributes:
        names: layers of light, 'auto' for those that a profile knows.
        planes: layer -> kind of planes that are no light.
    """

    names: tuple[str, ...] = ()
    planes: tuple[tuple[str, str], ...] = ()


def parse_parts(aov: str | None, planes: str | None) -> PartOptions | None:
    """Options of texts: 'key,fill' or 'auto', and 'normal=N,mist=Mist'; None without any.

    Raises OptionError for a kind of planes that is not known, and for ids.
    """
    if aov is None and planes is None:
        return None
    names = tuple(word.strip() for word in (aov or "").split(",") if word.strip())
    for name in names:
        refuse_ids(name, f"--aov {name}")
    found = []
    for entry in (planes or "").split(","):
        kind, _, layer = (word.strip() for word in entry.partition("="))
        if not entry.strip():
            continue
        if kind not in PLANE_KINDS or not layer:
            raise OptionError(f"--aov-denoise {entry.strip()}: give KIND=LAYER, with KIND one of "
                              f"{', '.join(PLANE_KINDS)}")
        refuse_ids(layer, f"--aov-denoise {entry.strip()}")
        found.append((layer, kind))
    return PartOptions(names, tuple(found))


def refuse_ids(layer: str, option: str) -> None:
    """OptionError for a layer that holds ids by its name."""
    words = layer.lower().replace("_", " ").replace(".", " ").split()
    if any(word.startswith(ID_PREFIX) or word in ID_WORDS for word in words):
        raise OptionError(f"{option}: '{layer}' holds ids, whose means are other ids: they are "
                          "never filtered")


EXACT_KINDS = ("depth", "position")
"""Kinds whose numbers half floats do not hold."""


@dataclass(frozen=True)
class FoundPart:
    """A part in the files: its kind, its channels, and the part that its values are divided by."""

    part: Part
    channels: tuple[Channel, ...]
    factor: str | None = None

    @property
    def source(self) -> PartSource:
        """How it is named there."""
        return PartSource(tuple(channel.name for channel in self.channels), self.factor,
                          self.part.kind in EXACT_KINDS)


def find_parts(options: PartOptions, index: ChannelIndex, layout: Layout, path: str,
               size: tuple[int, int]) -> dict[str, FoundPart]:
    """The parts by the names of their layers, of those that have the colour's size.

    Raises MissingPlaneError for a layer that is not there, OptionError for one of ids. 'auto' takes
    what is there; a warning of the layout says if that is nothing.
    """
    found: dict[str, FoundPart] = {}
    for name in options.names:
        matches = _by_profile(index, layout, "*" if name == AUTO_PARTS else name)
        if not matches and name != AUTO_PARTS:
            matches = _by_name(index, name)
        if not matches and name == AUTO_PARTS:
            layout.warnings.append("--aov auto: the files hold no light groups or passes that "
                                   f"profile {layout.profile.name} knows; if they hold others, "
                                   "name them, as --aov key,fill")
        elif not matches:
            raise _missing_error(name, index, path, known=_by_profile(index, layout, "*"))
        taken = {part.channels for part in found.values()}
        found |= {layer: part for layer, part in matches.items() if part.channels not in taken}
    for name, kind in options.planes:
        for layer in _layers(index, name)[:1] or [name]:
            refuse_ids(layer, f"--aov-denoise {kind}={name}")
            channels = _channels(index, layer,
                                 LETTERS_BY_KIND.get(kind, (*COLOUR_LETTERS, *NUMBER_LETTERS)))
            if not channels:
                raise _missing_error(name, index, path, f"--aov-denoise {kind}={name}")
            found = {other: part for other, part in found.items() if part.channels != channels}
            found[layer] = FoundPart(Part(layer, kind), channels)
    return {name: part for name, part in found.items() if _size(part.channels) == size}


def find_known_parts(index: ChannelIndex, layout: Layout) -> list[str]:
    """Layers that 'auto' would take: light groups and passes by their profile."""
    found = _by_profile(index, layout, "*")
    factors = {part.factor for part in found.values()}
    return [layer for layer in found if layer not in factors]


def _by_name(index: ChannelIndex, name: str) -> dict[str, FoundPart]:
    """Layers of light by name. Channels that go by two, as those of a layer b beside a channel B
    do, are one part, by the name that was given."""
    found: dict[tuple[Channel, ...], str] = {}
    for layer in _layers(index, name):
        refuse_ids(layer, f"--aov {name}")
        if channels := _channels(index, layer, COLOUR_LETTERS):
            found.setdefault(channels, layer)
    return {layer: FoundPart(Part(layer, "light", NAMED_PARTS), channels)
            for channels, layer in found.items()}


def _layers(index: ChannelIndex, name: str) -> list[str]:
    """Layers by name, the one that is written as it was given before others."""
    return sorted(index.layers_like(name), key=lambda layer: layer != name)


def _by_profile(index: ChannelIndex, layout: Layout, name: str) -> dict[str, FoundPart]:
    """Parts that the profile knows, of which `name` is the layer, or what stands for * in it; '*'
    for all."""
    found: dict[str, FoundPart] = {}
    for rule in layout.profile.parts:
        for pattern in (one.replace("{layer}", layout.layer) for one in rule.names):
            wanted = pattern.replace("*", name)
            given = (name.lower(), f"{layout.layer}{name}".lower())
            if "*" not in pattern and name != "*" and pattern.lower() not in given:
                continue
            for layer in index.layers_like(wanted, whole=True):
                channels = _channels(index, layer, COLOUR_LETTERS)
                if channels and layer not in found:
                    factor = rule.factor.replace("{layer}", layout.layer)
                    divided = _factor(index, factor, found) if factor else None
                    found[layer] = FoundPart(Part(layer, rule.kind, rule.group, divided or ""),
                                             channels, divided)
    return found


def _factor(index: ChannelIndex, name: str, found: dict[str, FoundPart]) -> str | None:
    """The layer that parts are divided by, added to those found."""
    for layer in index.layers_like(name, whole=True)[:1]:
        if channels := _channels(index, layer, COLOUR_LETTERS):
            found.setdefault(layer, FoundPart(Part(layer, "factor"), channels))
            return layer
    return None


def _channels(index: ChannelIndex, layer: str,
              letters: Iterable[tuple[str, ...]]) -> tuple[Channel, ...] | None:
    named = ([f"{layer}.{letter}" if letter else layer for letter in some] for some in letters)
    found = (index.find(names, are_together) for names in named)
    return next(filter(None, found), None)


def _size(channels: tuple[Channel, ...]) -> tuple[int, int]:
    area = channels[0].part.area
    return area.width, area.height


def _missing_error(name: str, index: ChannelIndex, path: str, option: str = "--aov",
                   known: Container[str] = ()) -> MissingPlaneError:
    """An error that lists the file's layers, light groups and passes (`known`) first."""
    layers = index.contents()
    layers.sort(key=lambda layer: layer.rpartition(".")[0] not in known)
    more = f"; and {len(layers) - SHOWN_LAYERS} more" if len(layers) > SHOWN_LAYERS else ""
    held = "; ".join(layers[:SHOWN_LAYERS]) + more if layers else "nothing"
    meant = suggest(name, (layer.rpartition(".")[0] for layer in layers)) or ":"
    return MissingPlaneError(f"{path}: no layer '{name}' for {option}{meant} it holds {held}")


LAYER_SUM_TOLERANCE = 3e-3
"""Layers add up to the picture if their sum differs by less than this share of its light."""

_MOST_COMBINED_LAYERS = 14
"""More layers are not tried in all combinations."""


def find_sets(picture: np.ndarray, parts: Mapping[str, np.ndarray]) -> list[tuple[str, ...]]:
    """Layers (h, w, 1 or 3) in sets that each add up to the picture, none of them in two; the
    smallest come first.

    Layers that are in no set are left out.
    """
    seen = picture[::SAMPLED_ROW_STEP]
    rows = [np.broadcast_to(part[::SAMPLED_ROW_STEP], seen.shape) for part in parts.values()]
    is_known = np.isfinite(seen) & np.logical_and.reduce([np.isfinite(part) for part in rows])
    layers = np.stack([part[is_known] for part in rows]).astype(np.float64)
    target = seen[is_known].astype(np.float64)
    light = np.abs(target).sum()

    # A layer that is in a set is left out of larger ones.
    names, found = tuple(parts), []
    left = list(range(min(len(names), _MOST_COMBINED_LAYERS)))
    for size in range(1, len(left) + 1):
        for chosen in combinations(tuple(left), size):
            if (set(chosen) <= set(left) and np.abs(layers[list(chosen)].sum(axis=0) - target)
                .sum() <= LAYER_SUM_TOLERANCE * light):
                found.append(tuple(names[index] for index in chosen))
                left = [index for index in left if index not in chosen]
    return found


def group_parts(parts: Iterable[Part], picture: np.ndarray, pixels: Mapping[str, np.ndarray]
                ) -> tuple[tuple[Part, ...], list[str]]:
    """Parts in groups by what a frame shows, and what the user should know of it.

    Layers that were named one by one stay one group where they are no brighter than the picture
    together. Else each set that adds up to the picture is a group, and every other layer one of its
    own, as nothing else tells its light.
    """
    parts = tuple(parts)
    named = [part for part in parts
             if part.is_light and part.group == NAMED_PARTS and part.name in pixels]
    seen = picture[::SAMPLED_ROW_STEP]
    total = sum((pixels[part.name][::SAMPLED_ROW_STEP] for part in named), np.zeros_like(seen))
    excess = np.maximum(total - seen, 0)
    light = np.abs(seen)
    is_known = np.isfinite(excess) & np.isfinite(light)
    lights = [part.name for part in parts if part.is_light and part.name in pixels]
    below = [name for name in lights if has_negative_light(pixels[name], picture)]
    notes = ([f"layers {', '.join(below)} have light below 0: it is denoised apart, and stays"]
             if below else [])
    if (not named or excess[is_known].sum(dtype=np.float64)
        <= LAYER_SUM_TOLERANCE * light[is_known].sum(dtype=np.float64)):
        return parts, notes

    # Together they are brighter than the picture.
    sets = find_sets(picture, {part.name: pixels[part.name] for part in named})
    groups = {name: ",".join(names) for names in sets for name in names}
    alone = [part.name for part in named if part.name not in groups]
    if len(sets) > 1:
        notes.append(f"layers {' and '.join(map(', '.join, sets))} each add up to the picture: "
                     f"they are taken as {len(sets)} sets")
    if alone:
        notes.append(f"layers {', '.join(alone)} do not add up to the picture with others: each is "
                     "filtered on its own")
    grouped = tuple(replace(part, group=groups.get(part.name, part.name)) if part in named else part
                    for part in parts)
    return grouped, notes


def read_parts(files: Mapping[str, ImageFile],
               found: Mapping[str, FoundPart]) -> dict[str, np.ndarray]:
    """Parts (height, width, 1 or 3) at render size, in radiance: those stored divided are
    multiplied again."""
    wanted = {channel: 0.0 for part in found.values() for channel in part.channels}
    pixels = read_channels(files, wanted)
    stored = {name: np.stack([pixels[channel] for channel in part.channels], axis=-1)
              for name, part in found.items()}
    return {name: stored[name] * stored[part.factor] if part.factor else stored[name]
            for name, part in found.items()}
