"""Masks of --leave found in a frame's files: the strength of named things, misses and converged
pixels."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from postfx.errors import StrengthError
from postfx.files import parse_json, read_text
from postfx.frame import Role
from postfx.io.channels import Channel, ChannelIndex, read_channels
from postfx.io.image_file import ImageFile
from postfx.io.layout import Layout
from postfx.masks.cryptomatte import (
    AUTO,
    Coverage,
    Cryptomatte,
    Entry,
    id_range,
    is_in_range,
    share_of,
    snap,
    split_shares,
)
from postfx.masks.noise import (
    ERROR_READS,
    MISS_READS,
    converged_in_bands,
    misses_in_bands,
    parse_threshold,
)
from postfx.system import Scratch

_PREFIX = "cryptomatte/"
_RGBA_LETTERS = (("R", "G", "B", "A"), ("red", "green", "blue", "alpha"))
_EXPECTED = {"hash": "MurmurHash3_32", "conversion": "uint32_to_float32"}


@dataclass(frozen=True, eq=False)
class CryptomattePlanes:
    """One Cryptomatte of a frame, and its channels: id and share in turn."""

    about: Cryptomatte
    channels: tuple[Channel, ...]

    @property
    def name(self) -> str:
        """Name in the header."""
        return self.about.name

    def is_called(self, name: str) -> bool:
        """Whether this is its name, or the last part of it, such as CryptoObject of
        ViewLayer.CryptoObject."""
        own = self.name.lower()
        return name.lower() in (own, own.rpartition(".")[2])


def cryptomattes(index: ChannelIndex, attributes: Mapping[str, Any],
                 path: Path) -> list[CryptomattePlanes]:
    """All that the header names, in the order of their keys.

    Raises StrengthError for one without channels, with ids in half floats or by another hash, and
    for a manifest that cannot be read.
    """
    headers: dict[str, dict[str, str]] = {}
    for name, value in attributes.items():
        if name.lower().startswith(_PREFIX) and name.count("/") == 2:
            _, key, field = name.split("/")
            headers.setdefault(key, {})[field.lower()] = str(value)
    return [_planes(index, headers[key], path) for key in sorted(headers) if "name" in headers[key]]


def _planes(index: ChannelIndex, header: Mapping[str, str], path: Path) -> CryptomattePlanes:
    where = f"{path}: Cryptomatte {header['name']}"
    channels = _ranks(index, header["name"])
    if not channels:
        raise StrengthError(f"{where}: no channels {header['name']}00.R, G, B, A: keep them beside "
                            "the header")
    for channel in channels[::2]:
        if channel.part.formats[channel.part.channels.index(channel.name)] != "float":
            raise StrengthError(f"{where}: channel {channel.name} has ids that are not whole: "
                                "write 32-bit floats")
    for field, expected in _EXPECTED.items():
        if header.get(field, expected).lower() != expected.lower():
            raise StrengthError(f"{where}: {field} {header[field]} is not known: render it with "
                                f"{expected}")
    return CryptomattePlanes(Cryptomatte(header["name"], _manifest(header, path, where), str(path)),
                             channels)


def _ranks(index: ChannelIndex, name: str) -> tuple[Channel, ...]:
    for letters in _RGBA_LETTERS:
        channels: list[Channel] = []
        while found := index.find([f"{name}{len(channels) // 4:02d}.{letter}"
                                   for letter in letters]):
            channels += found
        if channels:
            return tuple(channels)
    return ()


def _manifest(header: Mapping[str, str], path: Path, where: str) -> dict[str, int] | None:
    """Names and ids, from the header or a file beside the frame's; None when there is neither."""
    source, text = where, header.get("manifest")
    if not text and header.get("manif_file"):
        source = str(path.parent / header["manif_file"])
        try:
            text = read_text(Path(source))
        except (OSError, ValueError):
            raise StrengthError(f"{where}: its manifest {source} cannot be read: copy it beside "
                                "the frame") from None
    if not text:
        return None
    try:
        return {name: int(value, 16) for name, value in parse_json(text).items()}
    except (ValueError, TypeError, AttributeError):
        raise StrengthError(f"{source}: the manifest is not JSON of names and ids: render it "
                            "again") from None


MOST_LISTED_NAMES = 8
"""Names that an error lists at most."""


class LeftAlone:
    """Entries of `postfx.masks.parse_leave`, found in a frame's files.

    Raises StrengthError when the files hold no Cryptomatte or plane for one, when that has another
    size than the colour, when nothing tells misses or what has converged, and, if `strict`, when no
    name fits; else the thing is only not in this frame.

    Attributes:
        reads: planes that are looked at, of those that the frame has: colour and its own strength
            at least.
        shares: of the last frame that a strength was made for.
    """

    def __init__(
        self, entries: Iterable[Entry], index: ChannelIndex, layout: Layout,
        files: Mapping[str, ImageFile], strict: bool = True
    ) -> None:
        self._entries, self._index, self._files = tuple(entries), index, files
        self._path = path = next(iter(files.values())).path
        self._cryptomattes = (cryptomattes(index, layout.attributes, path) if self._is_looked_up()
                              else [])
        self._size = layout.planes[Role.COLOUR].size if Role.COLOUR in layout.planes else None
        self._named: dict[CryptomattePlanes, dict[int, Entry]] = {}
        self._numbered: dict[Channel, list[Entry]] = {}
        for entry in self._entries:
            if not (entry.is_auto or entry.is_converged):
                self._find(entry, strict)
        self._samples = layout.facts.samples
        self._basis = {entry: self._basis_of(entry, layout)
                       for entry in self._entries if entry.is_converged}
        looked = {Role.COLOUR, Role.STRENGTH, *(MISS_READS if self._auto() else ()),
                  *(ERROR_READS if self._basis else ())}
        self.reads = tuple(role for role in layout.planes if role in looked)
        if self._auto() and not {Role.DEPTH, Role.NORMAL, Role.ALPHA} & set(self.reads):
            raise StrengthError(f"{path}: '{AUTO}' has no AOV to look at: render depth, normals or "
                                "alpha, too")
        self.shares = Coverage()

    def strength(self, planes: Mapping[Role, np.ndarray],
                 scratch: Scratch | None = None) -> np.ndarray:
        """Strength (height, width, 1) of a frame whose planes hold `reads`, times its own; in an
        array of `scratch`."""
        width, height = self._known_size()
        basis = {str(entry): text for entry, text in self._basis.items()}
        self.shares = Coverage(1, 0.0, {str(entry): 0.0 for entry in self._entries}, basis=basis)
        found = (scratch.empty((height, width, 1)) if scratch
                 else np.empty((height, width, 1), np.float32))
        for rows in scratch.pieces(height, self._row_bytes(width)) if scratch else [(0, height)]:
            found[slice(*rows)] = self._of_ids(rows)
        for entry in self._auto():
            self._without_misses(found, entry, planes, scratch)
        for entry in self._basis:
            self._without_converged(found, entry, planes, scratch)
        found *= planes.get(Role.STRENGTH, np.float32(1))
        self.shares.alone = 1 - np.count_nonzero(found) / found.size
        return found

    def _known_size(self) -> tuple[int, int]:
        assert self._size is not None, "a frame without colour is not denoised"
        return self._size

    def _is_looked_up(self) -> bool:
        return any(not (entry.is_auto or entry.is_converged) for entry in self._entries)

    def _auto(self) -> list[Entry]:
        return [entry for entry in self._entries if entry.is_auto][-1:]

    def _basis_of(self, entry: Entry, layout: Layout) -> str:
        """Says which planes show that pixels have converged."""
        threshold = parse_threshold(entry)
        for role in layout.planes.keys() & {*ERROR_READS}:
            self._check_size(f"AOV '{role}'", layout.planes[role].channels[0])
        try:
            return threshold.basis(layout.planes, self._samples)
        except StrengthError as error:
            raise StrengthError(f"{self._path}: '{entry}': {error}") from error

    def _find(self, entry: Entry, strict: bool) -> None:
        """Note where an entry's ids are."""
        layers = [one for one in self._cryptomattes
                  if entry.plane is None or one.is_called(entry.plane)]
        if not layers and entry.plane is not None:
            self._numbered.setdefault(self._plane_of(entry, entry.plane), []).append(entry)
            id_range(entry)
        elif not layers:
            raise StrengthError(f"{self._path}: no Cryptomatte to find '{entry.name}' in: render "
                                "one, or give ids of an AOV, such as 7@id or 7-9@id")
        found = [(layer, key) for layer in layers for key in layer.about.ids_of(entry)]
        for layer, key in found:
            self._check_size(layer.name, layer.channels[0])
            self._named.setdefault(layer, {})[key] = entry
        if layers and not found and strict:
            raise self._unknown_error(entry, layers)

    def _plane_of(self, entry: Entry, plane: str) -> Channel:
        found = self._index.matching(plane)
        if len(found) != 1:
            known = ", ".join(one.name for one in self._cryptomattes) or "none"
            names = ", ".join(channel.name for channel in found[:MOST_LISTED_NAMES])
            what = f"has several channels ({names}): name one" if found else \
                f"is not there: name a channel of ids, or a Cryptomatte (here: {known})"
            raise StrengthError(f"{self._path}: AOV '{plane}' of '{entry}' {what}")
        self._check_size(found[0].name, found[0])
        return found[0]

    def _unknown_error(self, entry: Entry, layers: list[CryptomattePlanes]) -> StrengthError:
        near = dict.fromkeys(name for layer in layers for name in layer.about.nearest(entry))
        every = dict.fromkeys(name for layer in layers for name in layer.about.manifest or ())
        names = [*(near or every)]
        kind = "nearest" if near else "some of its names"
        shown = (", ".join(f"'{name}'" for name in names[:MOST_LISTED_NAMES])
                 or "none, the manifest is empty")
        return StrengthError(f"{self._path}: no '{entry.name}' in Cryptomatte "
                             f"{', '.join(one.name for one in layers)}: {kind}: {shown}")

    def _check_size(self, name: str, channel: Channel) -> None:
        area = channel.part.area
        if self._size is not None and (area.width, area.height) != self._size:
            raise StrengthError(f"{self._path}: {name} is {area.width}x{area.height}, the colour "
                                f"is {self._size[0]}x{self._size[1]}: render both at one size")

    def _row_bytes(self, width: int) -> int:
        """Bytes of a row of all planes of ids, as read and as worked on."""
        shares = sum(len(layer.channels) + len(set(ids.values()))
                     for layer, ids in self._named.items())
        return 8 * width * (2 + len(self._numbered) + shares)

    def _of_ids(self, rows: tuple[int, int]) -> np.ndarray:
        """Strength of some rows by ids alone; what it covers is counted."""
        strength = np.ones((rows[1] - rows[0], self._known_size()[0]), np.float32)
        owned = [self._share_out(layer, rows) for layer in self._named]
        found = [entry for entry in dict.fromkeys(reversed(self._entries))
                 if any(entry in shares for shares in owned)]
        for entry, share in split_shares(owned, found[::-1]):
            strength -= (1 - entry.strength) * share
            self._count(entry, share)
        strength = snap(strength)
        for channel, entries in self._numbered.items():
            ids = self._files[channel.word].read_ids(channel.part, channel.name, rows)
            own = np.ones_like(strength)
            for entry in entries:
                inside = is_in_range(ids, id_range(entry))
                own[inside] = entry.strength
                self._count(entry, inside)
            strength *= own
        return strength[:, :, None]

    def _share_out(self, layer: CryptomattePlanes,
                   rows: tuple[int, int]) -> dict[Entry, np.ndarray]:
        """Shares of some rows, by the entry that counts for an id: the last one."""
        pixels = read_channels(self._files, dict.fromkeys(layer.channels, 0.0), rows)
        ids = self._named[layer]
        ranks = [pixels[channel] for channel in layer.channels]
        return {entry: share_of(ranks, {key: 1.0 for key, owner in ids.items() if owner == entry})
                for entry in dict.fromkeys(ids.values())}

    def _without_misses(
        self, found: np.ndarray, entry: Entry, planes: Mapping[Role, np.ndarray],
        scratch: Scratch | None
    ) -> None:
        seen: dict[Role, np.ndarray] = {role: planes[role]
                                        for role in self.reads if role is not Role.STRENGTH}
        missed = 0
        for rows, strength, count in misses_in_bands(seen, scratch.relax if scratch else None):
            found[rows] *= entry.strength + (1 - entry.strength) * strength
            self._count(entry, 1 - strength)
            missed += count
        self.shares.missed = missed / found.size

    def _without_converged(
        self, found: np.ndarray, entry: Entry, planes: Mapping[Role, np.ndarray],
        scratch: Scratch | None
    ) -> None:
        threshold, relax = parse_threshold(entry), scratch.relax if scratch else None
        for rows, strength in converged_in_bands(planes, threshold, self._samples, relax):
            found[rows] *= entry.strength + (1 - entry.strength) * strength
            self._count(entry, 1 - strength)

    def _count(self, entry: Entry, share: np.ndarray) -> None:
        width, height = self._known_size()
        self.shares.covered[str(entry)] += float(share.sum(dtype=np.float64)) / (width * height)
