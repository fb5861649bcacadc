"""References of a run's frames, and how far results are from them."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import find_spec
from typing import NamedTuple

import numpy as np

from postfx.errors import ReportError
from postfx.frame import Role
from postfx.io.sequence import Sequence

LIBRARIES = {"flip_evaluator": "flip-evaluator", "skimage": "scikit-image"}


class Comparison(NamedTuple):
    """Figures of a frame: 'psnr after', ..., and 'FLIP': its error as a colour (height, width, 3) 0..1."""

    figures: dict[str, float]
    flip: np.ndarray


class References:
    """Noise-free frames at output size; frames without one are not compared.

    Raises SequenceError when there is none, ReportError when their size is not (width, height) or a library is missing.
    """

    def __init__(self, source: str, size: tuple[int, int]) -> None:
        for module, package in LIBRARIES.items():
            if find_spec(module) is None:
                raise ReportError(f"{package} is not installed, which --reference needs: pip install 'postfx[bench]'")
        self._sequence, self._size = Sequence(source), size
        with self._sequence.open(self._sequence.numbers[0]) as files:
            spec = files.spec()
        self._check(spec.width, spec.height)

    def colour(self, number: int) -> np.ndarray | None:
        """Light of a frame's reference, (height, width, 3); None where there is no file."""
        if number not in self._sequence.present():
            return None
        colour = self._sequence.read(number, [Role.COLOUR], [])[Role.COLOUR]
        self._check(*colour.shape[1::-1])
        return colour

    def _check(self, width: int, height: int) -> None:
        if (width, height) != self._size:
            sizes = f"{width}x{height}, the output {self._size[0]}x{self._size[1]}"
            raise ReportError(f"{self._sequence.pattern}: references are {sizes}: give them at the size of the output")


def compared(codes: Mapping[str, np.ndarray]) -> Comparison:
    """Errors of 'before' and 'after' against 'reference', all code values (height, width, 3) 0..1.

    PSNR is of both, FLIP of 'after' only.
    """
    from postfx.bench.metrics import flip_map, psnr  # libraries of the extra 'bench'

    flip, colours = flip_map(codes["after"], codes["reference"])
    figures = {f"psnr {name}": psnr(codes[name], codes["reference"]) for name in ("before", "after")}
    return Comparison({**figures, "flip after": flip}, colours)
