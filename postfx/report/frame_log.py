"""What a page shows of a sequence's frames, gathered while they pass: curves of all, pictures of a few."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from postfx.colour.curves import srgb_encode
from postfx.exposure.views import shown
from postfx.report.flicker import change
from postfx.report.light import coded, packed
from postfx.report.pictures import png_uri, reduced

LONGEST = 800
"""Pixels of a picture's longer side; larger ones are reduced."""
WHITE_STOPS = 6


Pixels = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Look:
    """How light is shown: scene-linear light exposed and compressed by x / (1 + x), a display's light as it is."""

    display: bool

    @property
    def highest(self) -> float:
        """Exposed light above which a page need not tell values apart."""
        return 1.0 if self.display else 2.0**WHITE_STOPS

    def exposed(self, light: np.ndarray, exposure: float) -> np.ndarray:
        """Light as the page holds it."""
        return light if self.display else light * np.float32(exposure)

    def codes(self, light: np.ndarray, exposure: float) -> np.ndarray:
        """Code values 0..1."""
        return srgb_encode(np.minimum(np.nan_to_num(light), 1)) if self.display else shown(light, exposure)


@dataclass
class Row:
    """Numbers of one frame. `readings`: name of a curve -> value, None where there is none."""

    number: int
    cut: bool
    readings: dict[str, float | None]


@dataclass
class Sight:
    """One frame's pictures: name -> codes of `postfx.report.light`; `maps`: name -> sRGB (height, width, 3) uint8."""

    exposure: float
    size: tuple[int, int]
    pictures: dict[str, np.ndarray]
    maps: dict[str, np.ndarray] = field(default_factory=dict)


class FrameLog:
    """Keeps the numbers of every frame, and the pictures of the first, the middle, the last and the least steady one.

    numbers: of the frames that will come, in order. judged: name of the picture whose change along the motion tells the
    least steady frame. Besides, the pictures of the frame before are kept, at full size.
    """

    def __init__(self, numbers: Sequence[int], look: Look, judged: str) -> None:
        places = {"middle": len(numbers) // 2, "last": -1, "first": 0}
        self._wanted = {numbers[place]: name for name, place in places.items()} if numbers else {}
        self.look, self._judged = look, judged
        self._sights: dict[int, Sight] = {}
        self._worst: tuple[float, int] | None = None
        self._before: dict[str, np.ndarray] = {}
        self.rows: list[Row] = []

    def add(
        self, number: int, pictures: Pixels, exposure: float, motion: np.ndarray | None = None, cut: bool = False,
        readings: Mapping[str, float | None] | None = None, maps: Pixels | None = None,
    ) -> None:
        """Look at a frame: `pictures` by name, light (height, width, 3) of one size, and `motion`, (h, w, 2) in its own
        pixels, which is not followed at a `cut`; `maps` by name are colours (height, width, 3) 0..1.
        """
        changes = {name: self._change(name, light, exposure, None if cut else motion)
                   for name, light in pictures.items()}
        self._before = dict(pictures)
        named = {f"change {name}": value for name, value in changes.items()}
        self.rows.append(Row(number, cut, named | dict(readings or {})))
        worst = changes.get(self._judged)
        is_worst = False
        if worst is not None and (self._worst is None or worst > self._worst[0]):
            is_worst = True
            if self._worst and self._worst[1] not in self._wanted:
                del self._sights[self._worst[1]]
            self._worst = worst, number
        if is_worst or number in self._wanted:
            self._sights[number] = self._sight(pictures, exposure, maps or {})

    def frames(self) -> list[dict[str, Any]]:
        """The frames that were kept, in order, for the page's viewer."""
        return [self._frame(number, sight) for number, sight in sorted(self._sights.items())]

    def _change(self, name: str, light: np.ndarray, exposure: float, motion: np.ndarray | None) -> float | None:
        if motion is None or name not in self._before:
            return None
        return change(self._before[name], light, motion, lambda part: self.look.codes(part, exposure))

    def _sight(self, pictures: Pixels, exposure: float, maps: Pixels) -> Sight:
        def codes(light: np.ndarray) -> np.ndarray:
            return coded(reduced(self.look.exposed(light, exposure), LONGEST), self.look.highest)

        size = next(iter(pictures.values())).shape[1::-1]
        small = {name: np.rint(255 * np.clip(reduced(one, LONGEST), 0, 1)).astype(np.uint8)
                 for name, one in maps.items()}
        return Sight(exposure, size, {name: codes(light) for name, light in pictures.items()}, small)

    def _frame(self, number: int, sight: Sight) -> dict[str, Any]:
        why = [self._wanted[number]] if number in self._wanted else []
        why += ["least steady"] if self._worst and self._worst[1] == number else []
        return {
            "number": number,
            "why": ", ".join(why),
            "exposure_ev": float(np.log2(sight.exposure)),
            "size": sight.size,
            "pictures": {name: packed(codes, self.look.highest) for name, codes in sight.pictures.items()},
            "maps": {name: png_uri(pixels) for name, pixels in sight.maps.items()},
        }
