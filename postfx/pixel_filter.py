"""Pixel filters that add each sample to all pixels around it, as Mitsuba's gaussian does.

Noise of pixels beside each other is then alike, which networks that saw other noise in training
take for detail. The width of the filter is found in the noise itself; the filter is undone, which
makes the noise of each pixel its own again; and what was denoised is spread as before.

A filter is taken as a gaussian whose samples lie anywhere in a pixel. Pixels at a distance of d
have noise whose correlation is then exp(-d^2 / (4 stddev^2)), by rows and by columns.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

import numpy as np

from postfx.compiled.calls import whole
from postfx.compiled.library import Rows
from postfx.errors import PassOptionError
from postfx.frame import Role
from postfx.planes import Divide

# Finding a filter.

NOISE_WINDOW_PX = 960, 540
"""Most columns and rows, in the middle of the picture, that are looked at."""
NOISE_CELL_PX = 12
"""Side of the cells whose noise is compared."""
LEAST_NOISE = 0.05
"""Square of what `SHARPEST` leaves in a cell, in squares of the cell's mean light, from which on
noise is looked at: 4 % of noise that is not spread."""
LEAST_NOISY_CELLS = 8
"""Noisy cells without which nothing is said."""
CLEAN_CELLS_SHARE = 0.1
"""Share of the noisy cells, those with the least structure, that is always taken."""
FEWEST_CLEAN_CELLS = 16
"""Cells that are taken, if there are so many."""
CLEAN_CELL = 1.5
"""Other cells are taken that have at most this times the structure of noise alone."""
SURE_STRUCTURE = 1.7
"""The cleanest cells may have at most this times the structure of noise alone, or detail, which
looks like noise that is spread, is part of what is compared."""
MOST_STRUCTURE = 4.0
"""Beyond this many times nothing is said."""
LEAST_UNSURE_PX = 0.4
"""Standard deviation in pixels below which it may all be detail there: independent noise of 64
samples among leaves tells up to 0.38."""
UNSURE_SHARE = 0.93
"""Share of the standard deviation that is taken there, as detail makes it larger."""
ROUNDS = 3
"""How often cells are chosen by the width that those before told."""
MOST_LIGHT = 1e9
"""Light above this is taken as this much, so that sums stay finite."""
MOST_NOISY_SAMPLES = 32
"""Known samples a pixel beyond which detail is more than noise."""
LEAST_FOUND_PX = 0.3
"""Standard deviation in pixels below which noise counts as independent. Thirteen kinds of content
with independent noise tell up to 0.26."""
TABLE_SIZE = 111
"""Widths that are told apart."""

SHARPEST = (1, -2, 1)
SHARP = (1, 0, -1)
SMOOTH = (1, 2, 1)
"""Weights of three pixels in a row for three bands of frequency, the highest first."""

# Filters.

LEAST_STDDEV_PX, MOST_STDDEV_PX = 0.2, 0.75
"""Standard deviations that a filter may have, in pixels. One of 0.2 spreads nothing; beyond 0.75
too little is left of what is fine."""
SPREAD_REACH_PX = 2
"""Pixels to each side to which light is spread."""
UNDO_REACH_PX = 4
"""Pixels to each side that are looked at to undo it."""
MOST_GAIN = 6.0
"""How much undoing amplifies a frequency at most, in one direction."""
FREQUENCIES = 256
"""Frequencies by which weights are computed."""

NORMALS = (Role.NORMAL, Role.DENOISING_NORMAL)
FILTERED_ROLES = (Role.COLOUR, Role.OPAQUE_COLOUR, Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO,
                  Role.DENOISING_ALBEDO, *NORMALS)
"""Planes that renderers filter, of those that help to denoise."""

_spread_plane = Rows("spread_plane")
_undo_spread = Rows("undo_spread")
_approach_spread = Rows("approach_spread")
_finish_spread = Rows("finish_spread")


class PixelFilter:
    """A gaussian pixel filter.

    Args:
        stddev: its standard deviation, in pixels; limited to 0.2 to 0.75.
        divide: divides the work by rows, see `postfx.planes.Divide`; None for this thread alone.

    All planes are float32 (height, width, channels), without gaps. Beyond their edges, the pixels
    at the edge go on.
    """

    def __init__(self, stddev: float, divide: Divide | None = None) -> None:
        self.stddev = float(np.clip(stddev, LEAST_STDDEV_PX, MOST_STDDEV_PX))
        self._divide = divide

    def spread(self, plane: np.ndarray, output: np.ndarray) -> None:
        """What the filter makes of a plane whose pixels are independent; its mean stays."""
        self._run(_spread_plane, plane, self._spreading, output)

    def undo(self, plane: np.ndarray, output: np.ndarray) -> None:
        """A plane of any sign before the filter spread it."""
        self._run(_spread_plane, plane, self._undoing, output)

    def without(self, planes: Mapping[Role, np.ndarray]) -> dict[Role, np.ndarray]:
        """Planes of a frame before the filter; light and albedos as by `undo_light`."""
        found = {role: np.empty(plane.shape, np.float32) for role, plane in planes.items()}
        for role, output in found.items():
            plane = whole(planes[role], np.float32)
            if role in NORMALS:
                self.undo(plane, output)
            else:
                self.undo_light(plane, output, np.empty_like(output))
        return found

    def undo_light(self, light: np.ndarray, output: np.ndarray, between: np.ndarray) -> None:
        """Light before the filter spread it; none is below 0 that was not, nor farther below.

        What that leaves out beside bright pixels is then brought back: twice the result comes
        nearer to light that gives the ``light`` when it is spread. ``between`` has the same shape
        and is overwritten.
        """
        self._run(_undo_spread, light, self._undoing, output)
        self._run(_approach_spread, light, output, self._spreading, between)
        self._run(_approach_spread, light, between, self._spreading, output)

    def finish(self, light: np.ndarray, undone: np.ndarray, denoised: np.ndarray,
               output: np.ndarray) -> None:
        """The picture that was made of ``undone`` light, spread as the ``light`` was; all have
        three channels.

        Undoing cannot explain all of the light, as beside a lamp. The rest is added, as far as the
        denoised picture is as bright as the undone one there: not beside a firefly.
        """
        self._run(_finish_spread, light, undone, denoised, self._spreading, output)

    def _run(self, rows: Rows, *arrays: np.ndarray) -> None:
        height = arrays[-1].shape[0]
        if self._divide is None:
            rows(0, height, *arrays)
        else:
            self._divide(rows.bind(arrays), height, arrays[-1].nbytes)

    @cached_property
    def _amplitude(self) -> np.ndarray:
        """What the filter leaves of each frequency, 1 of the lowest: the root of its noise's
        power."""
        apart = np.arange(FREQUENCIES)
        apart = np.minimum(apart, FREQUENCIES - apart)
        power = np.fft.fft(correlation(apart, self.stddev)).real.clip(0)
        amplitude: np.ndarray = np.sqrt(power / power[0])
        return amplitude

    @cached_property
    def _spreading(self) -> np.ndarray:
        return _weights_of(self._amplitude, SPREAD_REACH_PX)

    @cached_property
    def _undoing(self) -> np.ndarray:
        spread = np.zeros(FREQUENCIES)
        spread[:SPREAD_REACH_PX + 1] = self._spreading
        spread[-SPREAD_REACH_PX:] = self._spreading[:0:-1]
        left = np.fft.fft(spread).real
        return _weights_of(1 / np.maximum(left, 1 / MOST_GAIN), UNDO_REACH_PX)


def _weights_of(amplitude: np.ndarray, reach: int) -> np.ndarray:
    """Weights of a pixel and of those up to ``reach`` beside it, whose sum over both sides is 1."""
    weights = np.fft.ifft(amplitude).real[:reach + 1]
    weights /= weights[0] + 2 * weights[1:].sum()
    return weights.astype(np.float32)


def correlation(apart: np.ndarray, stddev: float | np.ndarray) -> np.ndarray:
    """How alike the noise of pixels is that are some pixels apart, 1 if it is the same."""
    found: np.ndarray = np.exp(-np.square(apart / (2 * np.asarray(stddev, float))))
    return found


def find_stddev(colour: np.ndarray, samples: float | None = None) -> float | None:
    """The standard deviation, in pixels, of the gaussian pixel filter that spread a picture's
    noise; None where the noise is independent, or too little of it is seen to tell.

    Cells of the picture are compared in which there is little but noise: what changes from pixel to
    pixel in both directions, against what does in one direction and more slowly in the other.

    Args:
        colour: (height, width, 3), light.
        samples: a pixel, if that is known.
    """
    if (samples or 0) > MOST_NOISY_SAMPLES:
        return None
    stddev = _measure(colour)
    return None if stddev is None or stddev < LEAST_FOUND_PX else round(stddev, 3)


def _measure(colour: np.ndarray) -> float | None:
    """What the noise of a picture tells of the filter's standard deviation; None for nothing."""
    light = _window_of(colour)
    if min(light.shape) < NOISE_CELL_PX + len(SHARPEST):
        return None
    sharpest, beside, below, slow_down, slow_across = (
        _means_of_cells(np.square(_along(_along(light, down, 0), across, 1)))
        for down, across in ((SHARPEST, SHARPEST), (SHARPEST, SHARP), (SHARP, SHARPEST),
                             (SMOOTH, SHARP), (SHARP, SMOOTH)))
    mean = _means_of_cells(light[1:-1, 1:-1])
    noisy = (mean > 0) & (sharpest > LEAST_NOISE * np.square(mean))
    count = int(np.count_nonzero(noisy))
    if count < LEAST_NOISY_CELLS:
        return None
    noise = (sharpest + beside + below)[noisy]
    shares = [(band[noisy] / noise) for band in (sharpest, beside, below)]
    structured = (slow_down + slow_across)[noisy] / noise
    fewest: int = max(int(CLEAN_CELLS_SHARE * count), min(FEWEST_CLEAN_CELLS, count))
    always = float(np.sort(structured)[fewest - 1])
    widths, ratios, structures = _table()
    most = always
    for _ in range(ROUNDS):
        clean = structured <= most
        highest, across, down = (float(share[clean].mean()) for share in shares)
        stddev = float(np.interp(-highest / min(across, down), -ratios, widths))
        alone = float(np.interp(stddev, widths, structures))
        most = max(always, CLEAN_CELL * alone)
    if always <= SURE_STRUCTURE * alone:
        return stddev
    is_spread = always <= MOST_STRUCTURE * alone and stddev >= LEAST_UNSURE_PX
    return UNSURE_SHARE * stddev if is_spread else None


def _table() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Standard deviations in pixels; for each the power of noise that changes fastest in both
    directions, over that in one; and the power that is slow in one, over all that is not."""
    widths = np.linspace(LEAST_STDDEV_PX, MOST_STDDEV_PX, TABLE_SIZE)
    one, two = (correlation(np.asarray(apart), widths) for apart in (1, 2))
    sharpest, sharp, smooth = 6 - 8 * one + 2 * two, 2 - 2 * two, 6 + 8 * one + 2 * two
    return (widths, sharpest / sharp,
            2 * smooth * sharp / (np.square(sharpest) + 2 * sharpest * sharp))


def _window_of(colour: np.ndarray) -> np.ndarray:
    """The mean of the channels in the middle of a picture."""
    height, width = colour.shape[:2]
    columns, rows = min(width, NOISE_WINDOW_PX[0]), min(height, NOISE_WINDOW_PX[1])
    left, top = (width - columns) // 2, (height - rows) // 2
    window = np.nan_to_num(colour[top:top + rows, left:left + columns], posinf=0.0, neginf=0.0)
    light: np.ndarray = window.clip(0.0, MOST_LIGHT).mean(axis=2, dtype=np.float64)
    return light


def _along(plane: np.ndarray, weights: tuple[int, ...], axis: int) -> np.ndarray:
    """Sums of three pixels in a row of a plane (rows, columns), where there are three."""
    length = plane.shape[axis] - len(weights) + 1
    first, middle, last = (weight * plane.take(range(at, at + length), axis)
                           for at, weight in enumerate(weights))
    found: np.ndarray = first + middle + last
    return found


def _means_of_cells(plane: np.ndarray) -> np.ndarray:
    """Means of whole cells of a plane (rows, columns)."""
    rows, columns = (side // NOISE_CELL_PX for side in plane.shape)
    whole = plane[:rows * NOISE_CELL_PX, :columns * NOISE_CELL_PX]
    cells: np.ndarray = whole.reshape(rows, NOISE_CELL_PX, columns, NOISE_CELL_PX).mean(axis=(1, 3))
    return cells


def parse_stddev(given: object) -> float | None:
    """The option for a pixel filter: None for 'auto', 0 for 'none', else its standard deviation in
    pixels. Raises PassOptionError for anything else."""
    if given == "auto":
        return None
    if given == "none":
        return 0.0
    try:
        stddev = float(given)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        stddev = -1.0
    if not LEAST_STDDEV_PX <= stddev <= MOST_STDDEV_PX:
        raise PassOptionError(f"pixel filter {given!r}: give auto, none, or the standard deviation "
                              f"of a gaussian, {LEAST_STDDEV_PX:g} to {MOST_STDDEV_PX:g} pixels")
    return stddev
