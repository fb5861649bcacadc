"""A plane full of fine detail that pans past the camera, known exactly at every point: no renderer is needed.

Coordinates are in pixels of render size, x to the right, y down; the world lies on the first frame. It has three PARTS,
each PART pixels wide: the pattern in the diffuse albedo under even light; the same pattern in the light (as of shadows)
on even albedo; and shadows COARSE times as large, of which only the edges are finer than render size.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numba
import numpy as np

from postfx.frame import Frame, Role
from training.sampling import radical_inverse

PATCH = 64
PARTS = ("albedo", "light", "shadow edges")
PART = 2 * PATCH
SIZE = (PART, len(PARTS) * PART)
COARSE = 4
SCALE = 2
SUBSAMPLES = 8
SPOKES = 72
CHIRP = 0.9 / 32
BARS = (0.55, 0.65, 0.75, 0.85)
STROKE = 0.75
DIGITS = (0x7B6F, 0x2C97, 0x73E7, 0x73CF, 0x5BC9, 0x79CF, 0x79EF, 0x7292, 0x7BEF, 0x7BCF)
SPECULAR = 0.04
DEPTH = 4.0

Texture = Callable[[np.ndarray, np.ndarray], np.ndarray]


@numba.njit(cache=True)
def _bar(wave):
    return 1.0 if wave > 0 else 0.0


@numba.njit(cache=True)
def _glyph(u, v):
    """Digits of 3x5 strokes, in cells of 4x6 strokes."""
    column, row = int(math.floor(u / STROKE)), int(math.floor(v / STROKE))
    cell = (column // 4) * 7 + (row // 6) * 5 + (column // 4) * (row // 6) % 3
    x, y = column % 4, row % 6
    if x > 2 or y > 4:
        return 1.0
    return 1.0 - ((DIGITS[cell % 10] >> (14 - 3 * y - x)) & 1)


@numba.vectorize(["float64(float64, float64)"], cache=True)
def pattern(x, y):
    """0..1 at a point: patches of PATCH pixels with a star, a zone plate, slanted bars and digits.

    Detail finer than the render size can hold (0.5 cycles a pixel): the star within 23 pixels of its centre, the zone
    plate beyond 18, all bars (BARS cycles a pixel) and the digits, whose strokes are STROKE pixels wide.
    """
    column, row = math.floor(x / PATCH), math.floor(y / PATCH)
    u, v = x - (column + 0.5) * PATCH, y - (row + 0.5) * PATCH
    kind, radius = int(column) % 2 + 2 * (int(row) % 2), math.sqrt(u * u + v * v)
    if kind == 0:
        return 0.5 if radius < 6 or radius > 31 else _bar(math.cos(SPOKES * math.atan2(v, u)))
    if kind == 1:
        return 0.5 + 0.5 * math.cos(math.pi * CHIRP * radius * radius) if radius < 31 else 0.5
    if kind == 2:
        line = int((v + PATCH / 2) / (PATCH / 4))
        angle = 0.2 + 0.5 * math.pi * (line % 2)
        return _bar(math.cos(2 * math.pi * BARS[line] * (u * math.cos(angle) + v * math.sin(angle))))
    return _glyph(u + PATCH / 2, v + PATCH / 2)


class Surface(NamedTuple):
    """Diffuse albedo (h, w, 3) and noise-free light (h, w, 1) at points."""

    albedo: np.ndarray
    light: np.ndarray

    @property
    def colour(self) -> np.ndarray:
        """Radiance towards the viewer, (h, w, 3)."""
        return (self.albedo + SPECULAR) * self.light


class View(NamedTuple):
    """One frame: as rendered, the same without noise, and the truth (H, W, 3) at output size."""

    noisy: Frame
    clean: Frame
    reference: np.ndarray


@dataclass(frozen=True)
class Scene:
    """A scene that moves by `pan` (x, y) pixels a frame to the left and up.

    Attributes:
        noise: standard deviation of a pixel's light over its mean: 1 is that of one light path whose contribution is
            exponentially distributed, 0.5 of four of them.
        texture: 0..1 at points (x, y) of the world.
    """

    pan: tuple[float, float] = (0.31, 0.13)
    noise: float = 0.5
    size: tuple[int, int] = SIZE
    texture: Texture = pattern

    def view(self, t: int) -> View:
        """Frame `t`, counted from 0; the same whenever it is asked for."""
        jitter, noise = halton(t), self.noise
        surface = self.sampled(t, self.size, jitter)
        rng, light = np.random.default_rng([t, 1]), surface.light
        if noise:
            light = light * rng.gamma(noise**-2, noise**2, light.shape)
        noisy = self._frame(t, Surface(surface.albedo, light), jitter)
        return View(noisy, self._frame(t, surface, jitter), self.reference(t))

    def sampled(self, t: int, size: tuple[int, int], offset: tuple[float, float]) -> Surface:
        """The surface at one point of every pixel of a picture of `size`, `offset` (x, y) of its pixels off centre."""
        height, width = size
        x = (np.arange(width) + 0.5 + offset[0]) * self.size[1] / width + t * self.pan[0]
        y = (np.arange(height)[:, None] + 0.5 + offset[1]) * self.size[0] / height + t * self.pan[1]
        wide = x >= 2 * PART
        u, v = 0.75 * PATCH + (x - 2 * PART) / COARSE, 1.25 * PATCH + y / COARSE  # bars beside digits
        detail = self.texture(np.where(wide, u, x), np.where(wide, v, y))[..., None]
        lit = x[:, None] >= PART
        even = 1 + 0.2 * np.sin(2 * np.pi * y / 97)[..., None]
        return Surface(np.where(lit, 0.6, 0.06 + 0.74 * detail) * np.array([1, 0.92, 0.8]),
                       np.where(lit, 0.15 + 0.85 * detail, 0.7) * even)

    def reference(self, t: int) -> np.ndarray:
        """Radiance (H, W, 3) at output size, the mean over each pixel's area."""
        steps = (np.arange(SUBSAMPLES) + 0.5) / SUBSAMPLES - 0.5
        size = (SCALE * self.size[0], SCALE * self.size[1])
        return np.mean([self.sampled(t, size, (x, y)).colour for x in steps for y in steps], 0).astype(np.float32)

    def bounds(self, t: int) -> list[tuple[float, float]]:
        """Where each of PARTS begins and ends in frame `t`, pixels from the frame's left."""
        ends = [i * PART - t * self.pan[0] for i in range(1, len(PARTS))]
        return list(pairwise([0, *ends, self.size[1]]))

    def _frame(self, t: int, surface: Surface, jitter: tuple[float, float]) -> Frame:
        shape = self.size
        planes = {Role.COLOUR: surface.colour, Role.DIFFUSE_ALBEDO: surface.albedo,
                  Role.SPECULAR_ALBEDO: np.full((*shape, 3), SPECULAR), Role.ROUGHNESS: np.ones((*shape, 1)),
                  Role.NORMAL: np.broadcast_to([0.0, 0.0, 1.0], (*shape, 3)), Role.DEPTH: np.full((*shape, 1), DEPTH),
                  Role.MOTION: np.broadcast_to(self.pan, (*shape, 2))}
        return Frame(planes, number=t + 1, jitter=jitter)


def halton(t: int) -> tuple[float, float]:
    """Jitter (x, y) of frame `t`, -0.5..0.5 pixels: the Halton sequence 2, 3."""
    return radical_inverse(t + 1, 2) - 0.5, radical_inverse(t + 1, 3) - 0.5


class Kept:
    """The mean of all noise-free samples so far that lie in each output pixel, each at its exact place.

    What the frames hold, if nothing were lost on the way from frame to frame. Pixels without a sample are filled from
    elsewhere.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._frames: list[Frame] = []

    def __call__(self, view: View, filling: np.ndarray) -> np.ndarray:
        """Picture (H, W, 3) of a view, in order; `filling` is as large."""
        self._frames.append(view.clean)
        height, width = filling.shape[:2]
        total, count = np.zeros((height * width, 3)), np.zeros(height * width)
        for frame in self._frames:
            at, inside = self._places(frame, view.clean.number, height, width)
            np.add.at(total, at, frame[Role.COLOUR].reshape(-1, 3)[inside])
            np.add.at(count, at, 1)
        mean = (total / np.maximum(count, 1)[:, None]).reshape(filling.shape)
        return np.where(count.reshape(height, width, 1) > 0, mean, filling).astype(np.float32)

    def _places(self, frame: Frame, now: int, height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
        h, w = frame[Role.COLOUR].shape[:2]
        moved = [frame.jitter[i] - (now - frame.number) * self._scene.pan[i] for i in range(2)]
        x = np.floor((np.arange(w) + 0.5 + moved[0]) * width / w).astype(int)
        y = np.floor((np.arange(h)[:, None] + 0.5 + moved[1]) * height / h).astype(int)
        inside = ((x >= 0) & (x < width) & (y >= 0) & (y < height)).ravel()
        return (y * width + x).ravel()[inside], inside
