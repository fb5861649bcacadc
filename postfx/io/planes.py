"""Channels of a file as planes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from functools import partial

import numpy as np
import OpenImageIO as oiio

from postfx.errors import ReadError
from postfx.frame import ROLES, Role
from postfx.io.convert import Camera, convert, fill_value
from postfx.io.layout import Channel, Match, read_channels
from postfx.system import Scratch

_ROWS = 64, 256
"""Rows that are read at once, with few threads and with many: so few that they are still in the cache when they are
sorted into planes, and a chunk of ZIP for every thread."""


def read_planes(
    matches: Mapping[Role, Match], camera: Camera, scratch: Scratch | None = None
) -> dict[Role, np.ndarray]:
    """Planes at the sizes that they have, some rows of all at a time, in arrays of `scratch` if it is given."""
    for match in matches.values():
        _check(match)
    new = scratch.empty if scratch else partial(np.empty, dtype=np.float32)
    planes = {role: new((match.size[1], match.size[0], ROLES[role].channels)) for role, match in matches.items()}
    for size in {match.size for match in matches.values()}:
        alike = {role: match for role, match in matches.items() if match.size == size}
        channels = {channel: fill_value(match.rule) for match in alike.values() for channel in match.channels}
        # A piece is there as it is read, with channels between the wanted ones, and as it is converted.
        row_bytes = 8 * sum(planes[role].nbytes for role in alike) // size[1]
        for first, last in scratch.pieces(size[1], row_bytes) if scratch else _pieces(size[1], channels):
            pixels = read_channels(channels, (first, last))
            for role, match in alike.items():
                piece = np.stack([pixels[channel] for channel in match.channels], axis=-1)
                planes[role][first:last] = convert(piece, match.rule, camera, first, size[1])
    return planes


def _check(match: Match) -> None:
    areas = [channel.part.area for channel in match.channels]
    if len({(area.width, area.height) for area in areas}) > 1:
        raise ReadError(f"{match.channels[0].file.path}: channels {match.names} differ in size; write them as one part")


def _pieces(height: int, channels: Iterable[Channel]) -> Iterator[tuple[int, int]]:
    """Rows of planes, whole chunks of files at once."""
    chunk = max(channel.part.chunk for channel in channels)
    rows = min(max(_ROWS[0], 16 * oiio.get_int_attribute("threads")), _ROWS[1])
    rows = -(-rows // chunk) * chunk
    return ((first, min(height, first + rows)) for first in range(0, height, rows))
