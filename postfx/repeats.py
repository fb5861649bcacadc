"""Noise that repeats from one frame to the next, as with one random seed for all frames.

Noise that stays in its pixels while the picture hardly moves adds up along the motion like the
picture itself: a history would take it for detail. Small squares spread over the picture are
compared with the frame before, where it moves by less than a pixel. White light is looked at:
colour without what the albedos explain, in parts of the square's own light, so that a lamp that
changes is no difference. Its Laplacian leaves out slopes and edges (Immerkaer 1996, "Fast noise
variance estimation"). A square repeats where this has hardly changed, and is white: in noise
neighbours are independent, in textures they are not. Squares whose noise is new speak against it.
So a picture without noise does not count, nor do many samples of a textured one.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from enum import Enum
from functools import lru_cache

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from postfx.colour import luminance
from postfx.frame import ALBEDOS, Role
from postfx.planes import sampled

# Squares, spread over the picture.
REPEAT_SIDE_PX = 12
MOST_SQUARE_ROWS = 9
MOST_SQUARE_COLUMNS = 14

SLOW_PX = 0.75
"""Motion of a square between two frames, at most: where it is faster, noise meets other noise, and
their mean is worth something."""

# Least standard deviation of noise that may repeat, and of noise that speaks against it, where the
# light of a square is about 1/2.
REPEATING_STDDEV = 0.002
NEW_STDDEV = 0.0005

WHITE_NOISE_ENERGY = 0.5
"""Least energy of the diagonal differences of noise in parts of the others': 0.9 in the median for
4 samples of Cycles, 0.1 to 0.2 for textures and edges."""

# Energy of the change of noise over twice its own energy: below the first it is the same noise,
# above the second it is new.
SAME_NOISE_ENERGY = 0.3
NEW_NOISE_ENERGY = 0.6

# Noise repeats where it does in at least this share of the squares, in so many of them, and in more
# than this many times as many as show new noise.
REPEATING_SQUARE_SHARE = 0.05
FEWEST_REPEATING_SQUARES = 4
REPEATING_TO_NEW_RATIO = 2

BLACK_ALBEDO = np.float32(0.03)
"""Albedo that is darker counts as this, so that light over it stays finite."""
DARK_LIGHT = np.float32(1e-6)
"""Light that is added where it is divided by, which may be 0."""
ONE_SEED = ("the same random seed in every frame",
            "change the seed with the frame number (Blender: the clock beside Seed; Mitsuba: "
            "seed of render)")
"""The likely cause, and the fix."""


def is_same_render(first: np.ndarray, second: np.ndarray) -> bool:
    """Whether two pictures (height, width, channels) are one render, which tells nothing of its
    noise: all their pixels are equal, and not all of one colour."""
    return bool((first != first[:1, :1]).any()) and np.array_equal(first, second, equal_nan=True)


class RepeatDetector:
    """Tells of each frame whether it has the noise of the frame before, where things are slow.

    Attributes:
        share: of the last frame's squares, those that repeat, 0 to 1.
    """

    def __init__(self) -> None:
        self._before: np.ndarray | None = None
        self._size = (0, 0)
        self.share = 0.0

    def reset(self) -> None:
        """Forget the frame before."""
        self._before = None

    def history(self) -> dict[str, np.ndarray]:
        """The state that the next answer depends on, beside its frame."""
        known = {"size": np.array(self._size, np.int64)}
        return {} if self._before is None else known | {"noise": self._before}

    def recall(self, history: Mapping[str, np.ndarray]) -> None:
        """Go on as a detector that had this `history`."""
        self._before = history.get("noise")
        self._size = tuple(history["size"].tolist()) if history else (0, 0)

    def __call__(self, planes: Mapping[Role, np.ndarray]) -> bool:
        """Whether the next frame has the noise of the frame before.

        planes: (height, width, channels) each, finite, with scene-linear colour. Without motion,
        nothing is known to be slow.
        """
        size = planes[Role.COLOUR].shape[:2]
        self.share = 0.0
        if min(size) < REPEAT_SIDE_PX:
            return False
        light = self._light(planes)
        noise = laplacian(light)
        last = self._before if self._size == size else None
        self._before, self._size = noise, size
        if last is None or Role.MOTION not in planes:
            return False
        energy = (np.square(last).mean((-2, -1)) + np.square(noise).mean((-2, -1))) / 2
        change = np.square(noise - last).mean((-2, -1)) / 2
        slow = _mean_lengths(squares(planes[Role.MOTION])) < SLOW_PX
        is_white = whiteness(light) > WHITE_NOISE_ENERGY
        noisy = slow & (energy > REPEATING_STDDEV**2) & is_white
        repeats = (noisy & (change < SAME_NOISE_ENERGY * energy)).sum()
        new = (slow & (change > NEW_NOISE_ENERGY * energy) & (change > NEW_STDDEV**2)).sum()
        self.share = float(repeats / slow.size)
        return bool(repeats >= FEWEST_REPEATING_SQUARES and self.share >= REPEATING_SQUARE_SHARE
                    and repeats > REPEATING_TO_NEW_RATIO * new)

    def _light(self, planes: Mapping[Role, np.ndarray]) -> np.ndarray:
        """White light of the squares (rows, columns, REPEAT_SIDE_PX, REPEAT_SIDE_PX), 0 to 1, about
        1/2 in the middle of each square."""
        albedos = [squares(planes[role]) for role in ALBEDOS if role in planes]
        colour = squares(planes[Role.COLOUR])
        if albedos:
            colour = colour / np.maximum(sum(albedos), BLACK_ALBEDO)
        light = np.maximum(luminance(colour), 0)
        usual = (np.median(light, axis=(-2, -1), keepdims=True)
                 + light.mean((-2, -1), keepdims=True) / 8)
        result: np.ndarray = light / (light + usual + DARK_LIGHT)
        return result


def squares(plane: np.ndarray) -> np.ndarray:
    """(rows, columns, REPEAT_SIDE_PX, REPEAT_SIDE_PX, channels) of a plane (height, width,
    channels), a copy."""
    rows = _places(plane.shape[0], MOST_SQUARE_ROWS)
    columns = _places(plane.shape[1], MOST_SQUARE_COLUMNS)
    anywhere = sliding_window_view(plane, (REPEAT_SIDE_PX, REPEAT_SIDE_PX), (0, 1))
    return np.moveaxis(anywhere[rows[:, None], columns], 2, -1)


def _mean_lengths(motion: np.ndarray) -> np.ndarray:
    """Mean length (rows, columns) of the vectors of squares (rows, columns, side, side, 2)."""
    x, y = np.moveaxis(np.square(motion), -1, 0)
    lengths: np.ndarray = np.sqrt(x + y).mean((-2, -1))
    return lengths


@lru_cache(8)
def _places(side: int, most: int) -> np.ndarray:
    """The first pixels of the squares along a side. They are shared: do not change them."""
    return np.linspace(0, side - REPEAT_SIDE_PX, min(side // REPEAT_SIDE_PX, most)).astype(int)


def laplacian(light: np.ndarray) -> np.ndarray:
    """Laplacian of light (..., height, width), two rows and columns smaller, scaled so that white
    noise keeps its standard deviation."""
    rows = light[..., :-2, :] - 2 * light[..., 1:-1, :] + light[..., 2:, :]
    result: np.ndarray = (rows[..., :-2] - 2 * rows[..., 1:-1] + rows[..., 2:]) / np.float32(6)
    return result


def whiteness(light: np.ndarray) -> np.ndarray:
    """How white the noise of light (..., height, width) is, (...): about 1 for white noise, 0 where
    neighbours are alike."""
    a, b = light[..., :-1, :-1], light[..., :-1, 1:]
    c, d = light[..., 1:, :-1], light[..., 1:, 1:]
    across, down, diagonal = (np.square(one).mean((-2, -1))
                              for one in (a - b + c - d, a + b - c - d, a - b - c + d))
    result: np.ndarray = 2 * diagonal / (across + down + DARK_LIGHT)
    return result


class Alike(Enum):
    """How alike a frame is to the one before: another one, one that agrees in the few pixels that
    are compared, or the same in all."""

    OTHER = 0
    LIKELY = 1
    SAME = 2


SAMPLED_PIXEL_STEP = 31
"""Every so many pixels of a row and of a column tell whether a frame may be the one before."""


class FrameMemory:
    """Finds frames that are the ones before them, bit for bit.

    A frame is copied only where few of its pixels are those of the one before. So others cost
    nothing, and of frames that are alike the third is the first that is known to be the same.
    """

    def __init__(self) -> None:
        self._some: bytes | None = None
        self._facts: tuple[Hashable, ...] = ()
        self._planes: dict[Hashable, np.ndarray] | None = None

    def forget(self) -> None:
        """The next frame is another."""
        self._some = self._planes = None

    def look(self, facts: tuple[Hashable, ...], planes: Mapping[Hashable, np.ndarray]) -> Alike:
        """How alike a frame of these `planes` (height, width, channels) is to the one before;
        `facts` must be equal, too.

        The first plane is the one whose pixels are looked at.
        """
        some = sampled(next(iter(planes.values())), SAMPLED_PIXEL_STEP,
                       SAMPLED_PIXEL_STEP).tobytes()
        before, self._some = self._some, some
        if some != before or facts != self._facts:
            self._facts, self._planes = facts, None
            return Alike.OTHER
        if self._planes is not None and self._is_same(planes):
            return Alike.SAME
        self._planes = {name: plane.copy() for name, plane in planes.items()}
        return Alike.LIKELY

    def _is_same(self, planes: Mapping[Hashable, np.ndarray]) -> bool:
        known = self._planes or {}
        return planes.keys() == known.keys() and all(
            np.array_equal(_bits(plane), _bits(known[name])) for name, plane in planes.items())


def _bits(plane: np.ndarray) -> np.ndarray:
    """A plane as whole numbers, so that NaN is itself and -0 is not 0."""
    return np.ascontiguousarray(plane).view(np.uint8)
