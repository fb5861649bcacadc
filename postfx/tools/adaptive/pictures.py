"""Heat maps: where a frame's error is above the quality, and how many more samples its tiles
get."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from postfx.files import write_atomically
from postfx.thumbnails import png
from postfx.tools.adaptive.plan import Quality, Tiles, spread

WIDEST = 480
"""Pixels of the picture's width that are kept."""
HEAT = np.array([[0, 0, 0], [40, 20, 110], [150, 40, 110], [230, 90, 50], [250, 180, 40],
                 [255, 255, 200]], np.float32)
"""Colours from nothing to the most."""
PICTURE_SHARE = 0.35
"""Share of the picture that is seen under the heat."""
COLOUR_RANGE_FACTOR = 16.0
"""Times the quality's error, and times a frame's samples, that have the last colour."""


def thumbnail(codes: np.ndarray) -> np.ndarray:
    """A picture of code values, small enough to be kept for each frame of a shot: uint8 (height,
    width, 3)."""
    step = -(-codes.shape[1] // WIDEST)
    thumb: np.ndarray = np.rint(np.clip(codes[::step, ::step], 0, 1) * 255).astype(np.uint8)
    return thumb


def write_picture(path: Path, thumb: np.ndarray, tiles: Tiles, more: np.ndarray,
                  quality: Quality) -> None:
    """Write a PNG: the frame, its error over the quality's, and its further samples over those that
    it has."""
    step = -(-tiles.size[0] // thumb.shape[1])
    error = (np.log2(1 + np.maximum(tiles.errors / quality.error - 1, 0))
             / np.log2(COLOUR_RANGE_FACTOR))
    samples = np.log2(1 + more / tiles.samples) / np.log2(COLOUR_RANGE_FACTOR)
    panels = [thumb]
    for values in (np.where(tiles.counted > 0, error, 0), samples):
        heat = _colours(spread(tiles, values)[::step, ::step])
        grey = thumb.mean(axis=2, keepdims=True)
        panels.append(np.clip(PICTURE_SHARE * grey + heat * (1 - PICTURE_SHARE), 0, 255)
                      .astype(np.uint8))
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, lambda file: file.write(
        png(np.ascontiguousarray(np.concatenate(panels, axis=1)))
    ))


def _colours(values: np.ndarray) -> np.ndarray:
    """Values 0..1 (height, width) as colours (height, width, 3)."""
    places = np.clip(values, 0, 1) * (len(HEAT) - 1)
    return np.stack([np.interp(places, np.arange(len(HEAT)), HEAT[:, channel])
                     for channel in range(3)], axis=2)
