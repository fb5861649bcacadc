"""Cryptomattes among a frame's channels: where their ranks are, and their manifests."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from postfx.errors import StrengthError
from postfx.files import parse_json, read_text
from postfx.io.layout import Channel, ChannelIndex
from postfx.strength.cryptomatte import Cryptomatte

_PREFIX = "cryptomatte/"
_LETTERS = (("R", "G", "B", "A"), ("red", "green", "blue", "alpha"))
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
        """Whether this is its name, or the last part of it, such as CryptoObject of ViewLayer.CryptoObject."""
        own = self.name.lower()
        return name.lower() in (own, own.rpartition(".")[2])


def cryptomattes(index: ChannelIndex, attributes: Mapping[str, Any], path: Path) -> list[CryptomattePlanes]:
    """All that the header names, in the order of their keys.

    Raises StrengthError for one without channels, with ids in half floats or by another hash, and for a manifest that
    cannot be read.
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
        raise StrengthError(f"{where}: no channels {header['name']}00.R, G, B, A: keep them beside the header")
    for channel in channels[::2]:
        if channel.part.formats[channel.part.channels.index(channel.name)] != "float":
            raise StrengthError(f"{where}: channel {channel.name} has ids that are not whole: write 32-bit floats")
    for field, expected in _EXPECTED.items():
        if header.get(field, expected).lower() != expected.lower():
            raise StrengthError(f"{where}: {field} {header[field]} is not known: render it with {expected}")
    return CryptomattePlanes(Cryptomatte(header["name"], _manifest(header, path, where), str(path)), channels)


def _ranks(index: ChannelIndex, name: str) -> tuple[Channel, ...]:
    for letters in _LETTERS:
        channels: list[Channel] = []
        while found := index.find([f"{name}{len(channels) // 4:02d}.{letter}" for letter in letters]):
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
            raise StrengthError(f"{where}: its manifest {source} cannot be read: copy it beside the frame") from None
    if not text:
        return None
    try:
        return {name: int(value, 16) for name, value in parse_json(text).items()}
    except (ValueError, TypeError, AttributeError):
        raise StrengthError(f"{source}: the manifest is not JSON of names and ids: render it again") from None
