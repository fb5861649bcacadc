"""Channels of a file as planes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from postfx.errors import ReadError
from postfx.frame import ROLES, Role
from postfx.io.channels import Channel, read_channels
from postfx.io.convert import Camera, convert, fill_value
from postfx.io.layout import Match
from postfx.scratch import Scratch


def read_whole(
    matches: Iterable[Match], rows: tuple[int, int] | None = None
) -> dict[Channel, np.ndarray]:
    """Channels of some planes, each once."""
    return read_channels({channel: fill_value(match.rule) for match in matches for channel in match.channels}, rows)


def read_in_pieces(matches: Mapping[Role, Match], camera: Camera, scratch: Scratch) -> dict[Role, np.ndarray]:
    """Planes of one size, some rows of all at a time."""
    width, height = next(iter(matches.values())).size
    planes = {role: scratch.empty((height, width, ROLES[role].channels)) for role in matches}
    # A piece is there as it is read, with channels between the wanted ones, and as it is converted.
    row_bytes = 8 * sum(plane.nbytes for plane in planes.values()) // height
    for rows in scratch.pieces(height, row_bytes):
        pixels = read_whole(matches.values(), rows)
        for role, match in matches.items():
            planes[role][slice(*rows)] = assemble(match, pixels, camera, rows[0], height)
    return planes


def assemble(
    match: Match, pixels: Mapping[Channel, np.ndarray], camera: Camera, first: int = 0, height: int | None = None
) -> np.ndarray:
    """A plane (height, width, channels) out of its channels; of one of another `height`, the rows from `first` on."""
    planes = [pixels[channel] for channel in match.channels]
    if len({plane.shape for plane in planes}) > 1:
        raise ReadError(f"{match.channels[0].file.path}: channels {match.names} differ in size; write them as one part")
    return convert(np.stack(planes, axis=-1), match.rule, camera, first, height)
