"""Where a frame's colour came from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Stored:
    """Where a frame's colour is in the file that it was read from.

    Attributes:
        part: which part of the file, counted from 0.
        channels: names there of red, green and blue.
        attributes: header attributes as they were read.
    """

    part: int
    channels: tuple[str, ...]
    attributes: Mapping[str, Any]
