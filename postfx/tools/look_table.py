"""The global part of a look as a 3-D look-up table, and how much a picture changes when the table
stands in for it.

The look is probed from outside: the colours of a table replace some pixels of a picture, here and
there, and the results are averaged over places and pictures. A network that decides by the rest of
the picture still sees it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from postfx.colour import REC2020, matrix_between, ocio
from postfx.colour.displays import PQ, PQ_NITS, Display, parse_display
from postfx.files import refusal, write_text
from postfx.frame import Frame, Role
from postfx.passes import Pass
from postfx.passes.display import View
from postfx.pipeline import Pipeline
from postfx.runtime import Device

SPACE = "ACEScct"
"""Colour space of a table's input: logarithmic, with the primaries AP1; 0..1 is light up to 222."""
MOST_REPLACED_SHARE = 0.01
"""Largest part of a picture's pixels that is replaced at once."""
TURNS = 4


class LookTable:
    """A table of a look, made from some exposed frames and measured on others.

    Attributes:
        cube: (size, size, size, 3) float64 code values; red, green, blue in ACEScct.
        output: the display that it is for, as a frame's encoding.
    """

    def __init__(self, passes: Sequence[Pass], frames: Iterable[Frame], device: Device,
                 size: int = 33) -> None:
        self._pipeline = Pipeline(passes, device, exposure=0.0, cuts="none")
        self._device = device
        corners = _corners(size)
        total, count = np.zeros(corners.shape), 0
        for frame in frames:
            for turn in range(TURNS):
                total += self._probe(frame, corners, turn)
                count += 1
        self.cube = (total / count).reshape(size, size, size, 3)
        self.output = self._pipeline.explain().output.encoding

    def measure(self, path: Path, frames: Iterable[Frame]) -> Difference:
        """How pictures by a file of the table differ from those by the look itself."""
        by_table = Pipeline([View(view=f"{path},input={SPACE},output={self.output}")], self._device,
                            0.0, "none")
        pairs = [(self._apply(frame), by_table(frame)[Role.COLOUR]) for frame in frames]
        looks, tables = zip(*pairs, strict=True)
        return measure_difference(list(tables), list(looks), parse_display(self.output))

    def write(self, path: Path, notes: Sequence[str]) -> None:
        """Write a .cube file as OpenColorIO, DaVinci Resolve and others read it; WriteError when
        that fails."""
        # red changes fastest
        size, rows = len(self.cube), self.cube.transpose(2, 1, 0, 3).reshape(-1, 3)
        head = [f"# {note}" for note in notes] + [f"# postfx: input={SPACE}, output={self.output}"]
        head += [f'TITLE "{path.stem}"', f"LUT_3D_SIZE {size}"]
        lines = head + [f"{red:.6f} {green:.6f} {blue:.6f}" for red, green, blue in rows]
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            write_text(path, "\n".join(lines) + "\n")
        except OSError as error:
            raise refusal(path, error.strerror or str(error)) from error

    def _probe(self, frame: Frame, corners: np.ndarray, turn: int) -> np.ndarray:
        """The look's results (count, 3) for colours (count, 3) at places that differ from turn to
        turn."""
        picture = _enlarge(frame[Role.COLOUR], len(corners) / MOST_REPLACED_SHARE)
        places = np.random.default_rng(turn).permutation(picture[..., 0].size)[: len(corners)]
        picture.reshape(-1, 3)[places] = corners
        return self._apply(replace(frame, planes={Role.COLOUR: picture})).reshape(-1, 3)[places]

    def _apply(self, frame: Frame) -> np.ndarray:
        return self._pipeline(replace(frame, reset=True))[Role.COLOUR]


def expose_colour(frame: Frame, exposure_factor: float) -> Frame:
    """The frame's colour alone, times an exposure."""
    return Frame({Role.COLOUR: frame[Role.COLOUR] * np.float32(exposure_factor)},
                 number=frame.number)


def _corners(size: int) -> np.ndarray:
    """Light of a table's corners, linear Rec.709 (size^3, 3); colours outside it are negative."""
    axis = np.linspace(0, 1, size)
    codes = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    return ocio.convert(codes, SPACE, "Linear Rec.709 (sRGB)")


def _enlarge(colour: np.ndarray, pixels: float) -> np.ndarray:
    """Repeat pixels until there are at least so many."""
    factor = int(np.ceil(np.sqrt(pixels / colour[..., 0].size)))
    return colour.repeat(factor, 0).repeat(factor, 1)


SDR_WHITE = 100.0
"""Light of an SDR display's white, cd/m2, for Delta E ITP."""
_TO_LMS = np.array([[1688, 2146, 262], [683, 2951, 462], [99, 309, 3688]]) / 4096
# T is half of CT
_TO_ITP = np.array([[2048, 2048, 0], [3305, -6806.5, 3501.5], [17933, -17390, -543]]) / 4096


class Difference(NamedTuple):
    """PSNR in dB, mean Delta E ITP, and the Delta E ITP that 99 % of the pixels stay below
    (`most`)."""

    psnr: float
    mean: float
    most: float

    def __str__(self) -> str:
        return (f"PSNR {self.psnr:.2f} dB, Delta E ITP {self.mean:.2f} (99 % of the pixels below "
                f"{self.most:.2f})")


def to_itp(codes: np.ndarray, display: Display) -> np.ndarray:
    """Code values (..., 3) in ITP: ITU-R BT.2100-2, table 7, with CT halved as in BT.2124."""
    nits = display.decode(np.asarray(codes, np.float64)) * (display.white or SDR_WHITE)
    light = np.maximum(nits @ matrix_between(display.kind.primaries, REC2020).T, 0)
    return PQ.encode(light @ _TO_LMS.T / PQ_NITS) @ _TO_ITP.T


def delta_e_itp(codes: np.ndarray, others: np.ndarray, display: Display) -> np.ndarray:
    """Delta E ITP (ITU-R BT.2124-0, annex 1) of each colour; about 1 can just be seen."""
    distance: np.ndarray = np.sqrt(np.square(to_itp(codes, display) - to_itp(others, display))
                                   .sum(-1))
    return 720 * distance


def measure_difference(codes: list[np.ndarray], others: list[np.ndarray],
                       display: Display) -> Difference:
    """Difference over all pixels between two lists of pictures (height, width, 3) of code
    values."""
    pairs = list(zip(codes, others, strict=True))
    squares = np.concatenate([np.square(a.astype(np.float64) - b).ravel() for a, b in pairs])
    seen = np.concatenate([delta_e_itp(a, b, display).ravel() for a, b in pairs])
    psnr = -10 * np.log10(squares.mean() + 1e-12)
    return Difference(float(psnr), float(seen.mean()), float(np.percentile(seen, 99)))
