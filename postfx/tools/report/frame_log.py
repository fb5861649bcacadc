"""Collect a report's data while a sequence is processed: curves over all frames, pictures of a few.

The curves show the change along the motion and, with references, the errors against them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np

from postfx.colour.displays import srgb_encode
from postfx.colour.views import to_codes
from postfx.errors import ReportError
from postfx.frame import Role
from postfx.io.sequence import Sequence as FrameSequence
from postfx.sampling import Curve, bilinear, is_inside, motion_at
from postfx.thumbnails import png_uri, shrink
from postfx.tools.report.pictures import encode_light, pack_codes
from postfx.version import pip_install

LONGEST_SIDE_PX = 800
"""Longest side of a picture in pixels; larger ones are reduced."""
WHITE_STOPS = 6
"""Stops above 1 at which light is white in a picture that is not for a display."""


Pixels = Mapping[str, np.ndarray]
Motion = np.ndarray | None | Mapping[str, np.ndarray | None]


@dataclass(frozen=True)
class Look:
    """How light is shown: scene-linear light is exposed and compressed by x / (1 + x), display
    light is not changed."""

    display: bool

    @property
    def highest(self) -> float:
        """Exposed light above which a page does not distinguish values."""
        return 1.0 if self.display else 2.0**WHITE_STOPS

    def expose(self, light: np.ndarray, exposure_factor: float) -> np.ndarray:
        """Light as the page stores it."""
        return light if self.display else light * np.float32(exposure_factor)

    def codes(self, light: np.ndarray, exposure_factor: float) -> np.ndarray:
        """Code values 0..1."""
        return (srgb_encode(np.minimum(np.nan_to_num(light), 1)) if self.display
                else to_codes(light, exposure_factor))


@dataclass
class Row:
    """Numbers of one frame. `readings`: name of a curve -> value or None."""

    number: int
    cut: bool
    readings: dict[str, float | None]


@dataclass
class Sight:
    """One frame's pictures: name -> codes of `encode_light`; `maps`: name -> sRGB (height,
    width, 3) uint8."""

    exposure_factor: float
    size: tuple[int, int]
    pictures: dict[str, np.ndarray]
    maps: dict[str, np.ndarray] = field(default_factory=dict)


class FrameLog:
    """Keeps the figures of every frame, and pictures of four: the first, the middle, the last and
    the least steady one.

    numbers: numbers of the coming frames, in order. judged: name of the picture whose change along
    the motion decides which frame is least steady. The pictures of the previous frame are kept as
    well, at full size.
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
        self, number: int, pictures: Pixels, exposure_factor: float, motion: Motion = None,
        cut: bool = False,
        readings: Mapping[str, float | None] | None = None, maps: Pixels | None = None,
    ) -> None:
        """Add a frame: `pictures` by name, light (height, width, 3) of one size; `motion`, (h,
        w, 2) in its own pixels, of all or by the name of the picture, ignored at a `cut`; `maps` by
        name, colours (height, width, 3) 0..1.
        """
        motions = motion if isinstance(motion, Mapping) else dict.fromkeys(pictures, motion)
        changes = {name: self._change(name, light, exposure_factor, None if cut else motions[name])
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
            self._sights[number] = self._sight(pictures, exposure_factor, maps or {})

    def frames(self) -> list[dict[str, Any]]:
        """The kept frames, in order, for the page's viewer."""
        return [self._frame(number, sight) for number, sight in sorted(self._sights.items())]

    def _change(self, name: str, light: np.ndarray, exposure_factor: float,
                motion: np.ndarray | None) -> float | None:
        if motion is None or name not in self._before:
            return None
        return measure_change(self._before[name], light, motion,
                              lambda part: self.look.codes(part, exposure_factor))

    def _sight(self, pictures: Pixels, exposure_factor: float, maps: Pixels) -> Sight:
        def codes(light: np.ndarray) -> np.ndarray:
            return encode_light(shrink(self.look.expose(light, exposure_factor), LONGEST_SIDE_PX),
                                self.look.highest)

        size = next(iter(pictures.values())).shape[1::-1]
        small = {name: np.rint(255 * np.clip(shrink(one, LONGEST_SIDE_PX), 0, 1)).astype(np.uint8)
                 for name, one in maps.items()}
        return Sight(exposure_factor, size,
                     {name: codes(light) for name, light in pictures.items()}, small)

    def _frame(self, number: int, sight: Sight) -> dict[str, Any]:
        why = [self._wanted[number]] if number in self._wanted else []
        why += ["least steady"] if self._worst and self._worst[1] == number else []
        return {
            "number": number,
            "why": ", ".join(why),
            "exposure_ev": float(np.log2(sight.exposure_factor)),
            "size": sight.size,
            "pictures": {name: pack_codes(codes, self.look.highest)
                         for name, codes in sight.pictures.items()},
            "maps": {name: png_uri(pixels) for name, pixels in sight.maps.items()},
        }


LIBRARIES = {"flip_evaluator": "flip-evaluator", "skimage": "scikit-image"}


class Comparison(NamedTuple):
    """Figures of a frame: 'psnr after', ..., and 'FLIP': its error as a colour (height, width, 3)
    0..1."""

    figures: dict[str, float]
    flip: np.ndarray


class References:
    """Noise-free references at output size; frames without one are not compared.

    views: those that each frame has, where there are several. Raises SequenceError if there are
    none, ReportError if their size is not (width, height), a view has none, or a library is
    missing.
    """

    def __init__(self, source: str, size: tuple[int, int], views: Sequence[str] = ()) -> None:
        for module, package in LIBRARIES.items():
            if find_spec(module) is None:
                raise ReportError(f"{package} is not installed, and --reference needs it: "
                                  f"{pip_install('bench')}")
        self._sequence, self._size = FrameSequence(source), size
        with self._sequence.open(self._sequence.numbers[0]) as files:
            spec = files.spec()
            held = {*files.views, self._sequence.view, *self._sequence.views}
        if absent := [view for view in views if view not in held]:
            raise ReportError(f"{self._sequence.pattern}: references have no view '{absent[0]}': "
                              "give them for all views, or choose one with --view NAME")
        self._check(spec.width, spec.height)

    def colour(self, number: int, view: str | None = None) -> np.ndarray | None:
        """Light of a frame's reference, (height, width, 3), of one of the views if there are
        several; None if it has no file."""
        if not self._sequence.holds(number):
            return None
        colour = self._sequence.reader(view).read(number, [Role.COLOUR], [])[Role.COLOUR]
        self._check(*colour.shape[1::-1])
        return colour

    def _check(self, width: int, height: int) -> None:
        if (width, height) != self._size:
            sizes = f"{width}x{height}, the output {self._size[0]}x{self._size[1]}"
            raise ReportError(f"{self._sequence.pattern}: references are {sizes}: give them at the "
                              "size of the output")


def measure_errors(codes: Mapping[str, np.ndarray]) -> Comparison:
    """Errors of 'before' and 'after' against 'reference', all code values (height, width, 3) 0..1.

    PSNR for both, FLIP for 'after' only.
    """
    from postfx.tools.bench.metrics import flip_map, psnr  # libraries of the extra 'bench'

    flip, colours = flip_map(codes["after"], codes["reference"])
    figures = {f"psnr {name}": psnr(codes[name], codes["reference"])
               for name in ("before", "after")}
    return Comparison({**figures, "flip after": flip}, colours)


MOST_MEASURED_POINTS = 40_000
"""Pixels of a frame that flicker is measured at, about."""
FEWEST_MEASURED_POINTS = 100
"""Pixels that motion must lead into the frame before: with fewer, flicker is not known."""
CALMEST = 0.8
"""Share of the pixels, those that change least, that flicker is the mean of: others are
uncovered."""


def measure_change(before: np.ndarray, now: np.ndarray, motion: np.ndarray,
                   curve: Curve) -> float | None:
    """1000 times the mean absolute difference to the previous frame along the motion: how unsteady
    the picture is.

    before, now: light (height, width, 3), which `curve` turns into code values 0..1; motion: (h,
    w, 2) in its own pixels. Takes an even grid of up to 40000 pixels, leaves out those that come
    from outside the picture, and uses the calmest 80 % of the rest, to leave out disoccluded
    pixels. None if too few pixels are left or the sizes differ. Moving reflections and shadows
    count, so even a clean picture is above 0: compare pictures of the same frames.
    """
    height, width = now.shape[:2]
    if before.shape != now.shape:
        return None
    step = max(1, math.ceil(math.sqrt(height * width / MOST_MEASURED_POINTS)))
    rows, columns = np.arange(step // 2, height, step), np.arange(step // 2, width, step)
    moved = motion_at(motion, rows, columns, height, width)
    x, y = (columns + moved[..., 0]).ravel(), (rows[:, None] + moved[..., 1]).ravel()
    inside = is_inside(before, x, y)
    if inside.sum() < FEWEST_MEASURED_POINTS:
        return None
    current = curve(now[rows[:, None], columns]).reshape(-1, 3)[inside]
    differences = np.abs(current - bilinear(before, x[inside], y[inside], curve)).mean(1)
    return float(1000 * np.sort(differences)[: int(CALMEST * differences.size)].mean())
