"""Where samples lie in a pixel: jitter sequences, pixel filters, and the drawn styles of a clip's noisy variants."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

TABLE = 1024
FILTERS = ("box", "blackman-harris")


def radical_inverse(index: int, base: int) -> float:
    """Van der Corput radical inverse of `index`, 0..1 (Halton 1960)."""
    value, digit = 0.0, 1.0 / base
    while index:
        value += digit * (index % base)
        index //= base
        digit /= base
    return value


def filter_table(name: str) -> np.ndarray:
    """Inverse cumulative distribution (TABLE,) of a pixel filter: uniform random number -> offset from the corner.

    box: 0..1. blackman-harris: width 1.5 pixels about the centre, as Cycles' default pixel filter.
    """
    position = np.linspace(0, 1, TABLE)
    if name == "box":
        return position.astype(np.float32)
    fine = np.linspace(0, 1, 16 * TABLE)
    a = (0.35875, -0.48829, 0.14128, -0.01168)
    density = sum(c * np.cos(2 * np.pi * k * fine) for k, c in enumerate(a))
    cumulative = np.concatenate([[0], np.cumsum((density[1:] + density[:-1]) / 2)])
    offset = np.interp(position, cumulative / cumulative[-1], fine)
    return (0.5 + 1.5 * (offset - 0.5)).astype(np.float32)


@dataclass(frozen=True)
class Style:
    """How a noisy variant is sampled: `kind` realtime, box or blackman-harris, `spp`, and its jitter a frame (T, 2)."""

    kind: str
    spp: int
    jitter: np.ndarray

    def offsets(self, frame: int, pixels: int, rng: np.random.Generator) -> np.ndarray:
        """Sample positions (pixels, spp, 2) in units of a pixel from its upper left corner."""
        if self.kind == "realtime":
            return np.broadcast_to(0.5 + self.jitter[frame], (pixels, self.spp, 2)).astype(np.float32)
        drawn = rng.random((pixels, self.spp, 2), np.float32)
        table = filter_table(self.kind)
        return np.interp(drawn, np.linspace(0, 1, TABLE), table).astype(np.float32)


def draw_jitter(frames: int, rng: np.random.Generator) -> np.ndarray:
    """Jitter (frames, 2) in -0.5..0.5: mostly Halton 2,3 from a random start, else random or none."""
    pick = rng.random()
    if pick < 0.1:
        return np.zeros((frames, 2), np.float32)
    if pick < 0.25:
        return rng.uniform(-0.5, 0.5, (frames, 2)).astype(np.float32)
    start = int(rng.integers(1, 33))
    halton = [[radical_inverse(start + t, 2), radical_inverse(start + t, 3)] for t in range(frames)]
    return np.array(halton, np.float32) - 0.5


def draw_guide_style(frames: int, pixel_filter: str, rng: np.random.Generator) -> Style:
    """How a clip's guides are sampled: spread like an offline frame, or at one position, jittered or at the centre."""
    still = np.zeros((frames, 2), np.float32)
    if rng.random() < 0.4:
        return Style(pixel_filter, 4, still)
    return Style("realtime", 1, draw_jitter(frames, rng) if rng.random() < 0.8 else still)


def draw_spp(rng: np.random.Generator, most: int | None = None) -> int:
    """Samples a pixel: evenly in stops from 1 to `most`; by default mostly 1 to 8, at most 256."""
    if most is not None:
        return round(2 ** rng.uniform(0, np.log2(most)))
    spp = int(rng.choice([1, 2, 3, 4, 6, 8], p=[0.2, 0.25, 0.1, 0.25, 0.08, 0.12]))
    if rng.random() < 0.25:
        spp = int(rng.choice([16, 32, 64, 128, 256], p=[0.3, 0.25, 0.2, 0.15, 0.1]))
    return spp


def draw_styles(count: int, frames: int, pixel_filter: str, rng: np.random.Generator,
                most_spp: int | None = None) -> list[Style]:
    """Styles of a clip's variants: all share the reference's filter; real-time ones occur with the box filter only."""
    styles = []
    for _ in range(count):
        spp = draw_spp(rng, most_spp)
        if pixel_filter == "box" and rng.random() < 0.6:
            styles.append(Style("realtime", spp, draw_jitter(frames, rng)))
        else:
            styles.append(Style(pixel_filter, spp, np.zeros((frames, 2), np.float32)))
    return styles
