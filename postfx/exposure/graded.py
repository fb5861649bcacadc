"""Frames that went through a tone mapper or a grade elsewhere: a chart that tells its curve, and boards handed back."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from postfx.errors import ExposureError
from postfx.exposure.metering import KEY, USED
from postfx.exposure.response import STEPS_EV, Calibration, Response, calibrate, known_curves
from postfx.exposure.views import luma
from postfx.frame import Frame, Role
from postfx.io.image_file import reason_of
from postfx.io.pattern import locate
from postfx.io.writer import write_frame
from postfx.passes.exposure_tool import board_area, cells

STEP, CHART_HEIGHT = 16, 270
"""Pixels of a step of the chart, and its rows."""
UNEVEN, LEAST = 0.35, 0.01
"""Spread of a board's greys, as part of their difference, and the least that counts: JPEG and dither make some."""


def write_chart(path: str | PathLike[str]) -> Path:
    """Write the chart as an EXR: mid grey times 2^-8 to 2^8 in steps of a quarter stop from left to right.

    Its header says that its exposure is 1. Raises WriteError.
    """
    steps = np.repeat(KEY * np.exp2(STEPS_EV), STEP).astype(np.float32)
    colour = np.ascontiguousarray(np.broadcast_to(steps[None, :, None], (CHART_HEIGHT, steps.size, 3)))
    frame = Frame({Role.COLOUR: colour}, metadata={"postfx:exposure": 1.0})
    return write_frame(path, frame, bits=32, provenance={USED: 1.0})


def read_response(path: str | PathLike[str]) -> Calibration:
    """By what frames are judged that went through the same tone mapper as the chart, which was told to leave its light
    as it is. Raises ExposureError for what is no picture of the chart."""
    level = luma(load_picture(Path(path)))
    height, width = level.shape
    if width < 4 * STEPS_EV.size:
        raise ExposureError(f"{path}: {width} pixels for {STEPS_EV.size} steps of the chart: hand it back at its size")
    edges = np.linspace(0, width, STEPS_EV.size + 1)
    middle = slice(height // 4, max(height // 4 + 1, height * 3 // 4))
    columns = [slice(round(first + (last - first) / 4), round(last - (last - first) / 4))
               for first, last in zip(edges, edges[1:], strict=False)]
    steps = np.array([level[middle, column].mean() for column in columns])
    if (np.diff(steps) < -LEAST).any():
        raise ExposureError(f"{path}: gets darker where the chart gets brighter: hand back the chart that --chart "
                            "wrote, through the tone mapper and nothing else")
    board = (steps[:-2] + steps[2:]) / 2  # whose greys are a quarter stop below and above
    return calibrate(Response(STEPS_EV[1:-1], board), known_curves())


class GradedBoards:
    """Pictures of a sequence's boards after they left the chain.

    source: pattern of PNG, TIFF, JPEG or EXR files with display code values, numbered like the render.
    """

    def __init__(self, source: str) -> None:
        self.pattern, _ = locate(source)
        self._files = {number: next(iter(files.values())) for number, files in self.pattern.found().items()}
        if not self._files:
            raise ExposureError(f"{source}: no such file: check the folder and the frame pattern")

    def level(self, number: int) -> float:
        """Level of mid grey on a frame's board. Raises ExposureError where it is missing or shows no board."""
        if number not in self._files:
            raise ExposureError(f"{self.pattern.path(number)}: frame {number} is missing: grade it, or leave it out "
                                "with --frames")
        path = self._files[number]
        return board_level(load_picture(path), str(path))


def board_level(picture: np.ndarray, name: str) -> float:
    """Mean of the levels of a board's two greys, whichever form it has; picture: (height, width, 3).

    Raises ExposureError where no board is seen.
    """
    level = luma(picture)
    halves = [_halves(level[board_area(level.shape[0], level.shape[1], part)]) for part in (True, False)]
    for dark, light in halves:
        greys = float(np.median(dark)), float(np.median(light))
        spread = max(np.percentile(np.abs(half - grey), 75) for half, grey in zip((dark, light), greys, strict=True))
        if greys[1] - greys[0] > LEAST and spread <= max(UNEVEN * (greys[1] - greys[0]), LEAST):
            return (greys[0] + greys[1]) / 2
    if np.ptp(level) <= 2 * LEAST:  # all black or all white
        return float(level.mean())
    raise ExposureError(f"{name}: shows no checkerboard: hand back what became of the frames of "
                        "'POSTFX_EXPOSURE_TOOL=1 postfx run', not cropped")


def _halves(level: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Levels of the board's dark cells and of its light ones."""
    rows, columns = cells(level.shape[0], level.shape[1])
    is_dark = rows[:, None] == columns[None, :]
    return level[is_dark], level[~is_dark]


def load_picture(path: Path) -> np.ndarray:
    """A picture's code values, (height, width, 3) float32, 0..1 where the file holds whole numbers."""
    image = oiio.ImageInput.open(str(path))
    if image is None:
        raise ExposureError(f"{path}: cannot be read: {reason_of(oiio.geterror)}; give a PNG, TIFF, JPEG or EXR")
    pixels = image.read_image(0, 0, 0, min(3, image.spec().nchannels), oiio.FLOAT)
    reason = image.geterror()
    image.close()
    if pixels is None:
        raise ExposureError(f"{path}: broken file: {reason}; grade this frame again")
    found: np.ndarray = np.nan_to_num(pixels if pixels.shape[2] == 3 else np.repeat(pixels[..., :1], 3, 2))
    return found
