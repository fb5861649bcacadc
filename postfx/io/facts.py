"""What the headers of a frame's files say, by the names that a profile gives to header
attributes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from operator import itemgetter
from typing import Any

import numpy as np

from postfx.frame import pixel_aspect, stops_of_factor
from postfx.io.colours import INTEROP, gather_attributes, is_given
from postfx.io.convert import Camera
from postfx.io.image_file import ImageFile
from postfx.io.profile import Profile
from postfx.io.windows import Part

WORLD_TO_CAMERA_NUMBERS = 16
"""Of a matrix 4x4."""


def merge_headers(files: Iterable[ImageFile]) -> dict[str, Any]:
    """Header attributes of all parts. If several have one, the smallest part's counts, and of those
    the first's.

    A larger part's jitter belongs to guides. Beside a picture that postfx wrote, other parts do not
    count.
    """
    opened = tuple(files)
    merged: dict[str, Any] = {}
    for place, index in _find_order(*[file.parts for file in opened]):
        merged = {**opened[place].headers[index], **merged}
    return merged


@lru_cache(64)
def _find_order(*files: tuple[Part, ...]) -> tuple[tuple[int, int], ...]:
    """Place of the file and index of the part whose header counts most, then of the others."""
    parts = [(part.display.width * part.display.height, place, part)
             for place, parts in enumerate(files) for part in parts]
    parts = [entry for entry in parts if entry[2].is_picture] or parts
    return tuple((place, part.index) for _, place, part in sorted(parts, key=itemgetter(0)))


def tell_colours(merged: Mapping[str, Any], file: ImageFile, part: int) -> dict[str, Any]:
    """Merged attributes in which those about colours are of the colour's own part of its file."""
    found = gather_attributes(file.headers[part], file.headers.values())
    kept = {
        name: value for name, value in merged.items() if name != INTEROP and is_given(name, value)
    }
    return kept | found


@dataclass(frozen=True)
class Facts:
    """Header attributes by the names that a profile gives them; `layer` stands for {layer} in
    these."""

    profile: Profile
    layer: str
    attributes: Mapping[str, Any]

    def numbers(self, key: str, count: int) -> np.ndarray | None:
        """The first attribute of this meaning, `count` numbers as float64; None when there is none
        or it is something else."""
        names = (name.replace("{layer}", self.layer) for name in self.profile.header.get(key, ()))
        value = next((self.attributes[name] for name in names if name in self.attributes), None)
        if value is None:
            return None
        try:
            numbers = np.asarray(value, np.float64).ravel()
        except (TypeError, ValueError):
            return None
        return numbers if numbers.size == count and np.isfinite(numbers).all() else None

    def number(self, key: str, default: float | None = None) -> float | None:
        """Attribute of one number, or the default."""
        numbers = self.numbers(key, 1)
        return default if numbers is None else float(numbers[0])

    def jitter(self) -> tuple[float, float]:
        """Sample position minus 0.5 in pixels, x right, y down."""
        found = self.numbers("jitter", 2)
        return (0.0, 0.0) if found is None else (float(found[0]), float(found[1]))

    def exposure(self) -> float | None:
        """The author's exposure in stops. Versions before wrote a factor."""
        stops, factor = self.number("exposure_ev"), self.number("exposure")
        return stops if stops is not None or factor is None else stops_of_factor(factor)

    def camera(self) -> Camera:
        """The camera, with the profile's numbers where the header says none."""
        profile, matrix = self.profile, self.numbers("world_to_camera", WORLD_TO_CAMERA_NUMBERS)
        if matrix is not None:
            matrix = matrix.reshape(4, 4)
            matrix = matrix.T if profile.column_vectors else matrix
        return Camera(
            world_to_camera=matrix,
            fov_x=self.number("fov_x") or profile.fov_x,
            jitter=self.jitter(),
            near=self.number("near", profile.near),
            far=self.number("far", profile.far),
            max_velocity=self.number("max_velocity", profile.max_velocity),
            shutter=self.number("shutter", profile.shutter),
            pixel_aspect=pixel_aspect(self.attributes),
        )
