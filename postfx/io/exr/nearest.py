"""Channels of an input at the size of a larger picture, each pixel that of the nearest pixel of the input."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from postfx.frame import Frame
from postfx.io.exr.container import Rows
from postfx.io.image_file import ImageFile
from postfx.io.windows import AREA, Part, Window, cover, output_windows


@dataclass(frozen=True)
class Enlargement:
    """From the rectangle that an input's planes cover to that of a picture made of them."""

    source: Window
    target: Window

    @property
    def scale(self) -> tuple[float, float]:
        """Width and height of a pixel of the input, in pixels of the picture."""
        return self.target.width / self.source.width, self.target.height / self.source.height

    def window(self, data: Window) -> Window:
        """Data window of channels that have this one in the input."""
        return cover(data, self.scale)

    def nearest(self, data: Window) -> tuple[np.ndarray, np.ndarray]:
        """Row and column of the input's data window, counted from its corner, for each row and column of `window`."""
        larger, found = self.window(data), []
        for axis in (1, 0):
            places = np.arange(larger[axis], larger[axis + 2] + 1) - self.target[axis] + 0.5
            places = np.floor(places / self.scale[axis]).astype(int) + self.source[axis] - data[axis]
            found.append(places.clip(0, data[axis + 2] - data[axis]))
        return found[0], found[1]


def enlargement_of(frame: Frame) -> Enlargement | None:
    """How a frame was enlarged since it was read; None where it has its input's size, or is of no file."""
    if "displayWindow" not in frame.metadata:
        return None
    source = Window(*frame.metadata.get(AREA, frame.metadata["displayWindow"]))
    size = frame.spec.width, frame.spec.height
    return None if (source.width, source.height) == size else Enlargement(source, output_windows(frame).area)


def enlarged_rows(
    file: ImageFile, part: Part, names: list[str], enlargement: Enlargement, pixels: Mapping[str, int]
) -> Rows:
    """Reads channels of a part at the picture's size, in the order of `names`.

    `pixels` are those whose values are distances in pixels, with their axis, 0 across and 1 down: they grow, too.
    """
    lines, columns = enlargement.nearest(part.data)

    def rows(first: int, last: int) -> list[np.ndarray]:
        wanted = lines[first:last]
        stored = file.read_stored(part, names, int(wanted[0]), int(wanted[-1]) + 1)
        planes = {name: plane[wanted - wanted[0]][:, columns] for name, plane in zip(names, stored, strict=True)}
        for name in pixels.keys() & planes.keys():
            if planes[name].dtype.kind == "f":
                planes[name] = (planes[name] * np.float32(enlargement.scale[pixels[name]])).astype(planes[name].dtype)
        return [planes[name] for name in names]

    return rows
