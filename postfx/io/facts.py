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
    """What a header says of its frame.

    Attributes:
        camera: with the profile's numbers where the header says none.
        exposure: the author's, in stops, or None.
        begins_shot: whether it says so.
        samples: of a pixel, or None.
    """

    camera: Camera
    exposure: float | None
    begins_shot: bool
    samples: int | None


_COUNTS = {"world_to_camera": 16, "jitter": 2, "fov_x": 1, "near": 1, "far": 1, "max_velocity": 1,
           "shutter": 1, "exposure_ev": 1, "exposure": 1, "reset": 1, "samples": 1}
"""Meaning of a header attribute, as profiles name it -> how many numbers it holds."""


def read_facts(profile: Profile, layer: str, attributes: Mapping[str, Any]) -> Facts:
    """The facts of header attributes by the names that a profile gives them; `layer` stands for
    {layer} in these. Attributes that are something else than numbers, or other numbers than they
    should, do not count."""
    found: dict[str, list[float]] = {}
    for key, count in _COUNTS.items():
        value = None
        for name in profile.header.get(key, ()):
            if value is None:
                value = attributes.get(name.replace("{layer}", layer))
        if value is None:
            continue
        try:
            numbers = np.asarray(value, np.float64).ravel()
        except (TypeError, ValueError):
            continue
        if numbers.size == count and np.isfinite(numbers).all():
            found[key] = numbers.tolist()

    matrix = None
    if "world_to_camera" in found:
        matrix = np.array(found["world_to_camera"]).reshape(4, 4)
        matrix = matrix.T if profile.column_vectors else matrix
    x, y = found.get("jitter", (0.0, 0.0))
    one = {key: numbers[0] for key, numbers in found.items()}
    camera = Camera(
        world_to_camera=matrix,
        fov_x=one.get("fov_x") or profile.fov_x,
        jitter=(x, y),
        near=one.get("near", profile.near),
        far=one.get("far", profile.far),
        max_velocity=one.get("max_velocity", profile.max_velocity),
        shutter=one.get("shutter", profile.shutter),
        pixel_aspect=pixel_aspect(attributes),
    )
    exposure = one.get("exposure_ev")
    if exposure is None and "exposure" in one:  # versions before wrote a factor
        exposure = stops_of_factor(one["exposure"])
    return Facts(camera, exposure, bool(one.get("reset")), int(one.get("samples", 0)) or None)
