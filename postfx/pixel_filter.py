"""Pixel filters of renderers, which add each sample to all pixels around it, as Mitsuba's gaussian
does: found, undone, and applied again.

With such a filter the noise of neighbouring pixels is alike, and networks that were trained on
independent noise take it for detail. The width of the filter is found in the noise itself. Undoing
the filter makes the noise of each pixel independent again, and the denoised picture is filtered as
the render was.

A filter is taken as a gaussian whose samples lie anywhere in a pixel. The noise of pixels at a
distance of d then has the correlation exp(-d^2 / (4 stddev^2)), along rows and along columns.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

import numpy as np

from postfx.compiled.calls import whole
from postfx.compiled.library import Rows
from postfx.errors import PassOptionError
from postfx.frame import ALBEDOS, Role
from postfx.planes import Divide

# Finding a filter.

NOISE_WINDOW_PX = 960, 540
"""Columns and rows, in the middle of the picture, that are looked at, at most."""
NOISE_CELL_PX = 12
"""Side of the cells whose noise is compared."""
LEAST_NOISE = 0.002
"""Power of a cell's noise in the band `SHARPEST`, over the square of its mean light, from which the
cell is looked at: 0.7 % of noise that is independent."""
LEAST_NOISE_ALONE = 0.05
"""`LEAST_NOISE` for frames without planes that tell detail from noise: 4 %."""
LEAST_LIT = 1e-4
"""Light of a cell over the brightest one's, below which it is not looked at."""
MOST_TEXTURE = 0.1
"""Change of albedo and normal in a cell over the change of its light, up to which it is even."""
LEAST_TEXTURE_LIGHT = 1e-4
"""Squared albedo that changes are divided by, at least."""
LEAST_NOISY_CELLS = 8
"""Noisy cells that are needed to tell anything."""
LEAST_NOISY_SHARE = 0.5
"""Share of the even cells that must be noisy: else the picture has detail that no plane shows."""
CLEAN_CELLS_SHARE = 0.1
"""Share of the noisy cells that is always taken: those with the least structure."""
FEWEST_CLEAN_CELLS = 8
"""Number of cells that are always taken, if there are so many."""
CLEAN_CELL = 1.5
"""Structure of a cell over that of noise alone, up to which other cells are taken, too."""
MOST_STRUCTURE = 1.5
"""Structure of the cleanest cells over that of noise alone, above which nothing is told: they show
detail, which looks like filtered noise. Undoing a filter that is not there costs 4 to 12 dB."""
ROUNDS = 3
"""Times that cells are chosen anew by the width that was found before."""
MOST_LIGHT = 1e9
"""Light above this is cut to it, so that sums stay finite."""
LEAST_FOUND_PX = 0.34
"""Standard deviation in pixels below which noise counts as independent. Thirteen kinds of content
with independent noise, at 4 to 1024 samples, give up to 0.28."""
TABLE_SIZE = 111
"""Number of widths that are told apart."""

SHARPEST = (1, -2, 1)
SHARP = (1, 0, -1)
SMOOTH = (1, 2, 1)
"""Weights of three pixels in a row for three bands of frequency, the highest first."""

# Filters.

LEAST_STDDEV_PX = 0.2
"""Least standard deviation of a filter, which spreads nothing."""
MOST_STDDEV_PX = 0.75
"""Largest standard deviation of a filter: beyond it too little is left of fine detail."""
SPREAD_REACH_PX = 2
"""Pixels to each side to which light is spread."""
UNDO_REACH_PX = 4
"""Pixels to each side that are looked at to undo that."""
MOST_GAIN = 6.0
"""Factor by which undoing amplifies a frequency, at most, in one direction."""
FREQUENCIES = 256
"""Number of frequencies by which weights are computed."""

NORMALS = (Role.NORMAL, Role.DENOISING_NORMAL)
FILTERED_ROLES = (Role.COLOUR, Role.OPAQUE_COLOUR, *ALBEDOS, Role.DENOISING_ALBEDO, *NORMALS)
"""Planes that networks read and renderers filter."""

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
        """Apply the filter to a plane. The mean of its pixels stays."""
        self._run(_spread_plane, plane, self._spreading, output)

    def undo(self, plane: np.ndarray, output: np.ndarray) -> None:
        """Undo the filter in a plane whose values may have any sign."""
        self._run(_spread_plane, plane, self._undoing, output)

    def without(self, planes: Mapping[Role, np.ndarray]) -> dict[Role, np.ndarray]:
        """Planes of a frame with the filter undone: light and albedos by `undo_light`, normals by
        `undo`."""
        found = {role: np.empty(plane.shape, np.float32) for role, plane in planes.items()}
        for role, output in found.items():
            plane = whole(planes[role], np.float32)
            if role in NORMALS:
                self.undo(plane, output)
            else:
                self.undo_light(plane, output, np.empty_like(output))
        return found

    def undo_light(self, light: np.ndarray, output: np.ndarray, between: np.ndarray) -> None:
        """Undo the filter in light. No pixel becomes negative that was not, nor more negative.

        That bound loses light beside bright pixels. Two further steps bring the result nearer to
        the light that gives ``light`` when the filter is applied. ``between`` has the same shape
        and is overwritten.
        """
        self._run(_undo_spread, light, self._undoing, output)
        self._run(_approach_spread, light, output, self._spreading, between)
        self._run(_approach_spread, light, between, self._spreading, output)

    def finish(self, light: np.ndarray, undone: np.ndarray, denoised: np.ndarray,
               output: np.ndarray) -> None:
        """Apply the filter to the picture that was ``denoised`` from ``undone`` light; all have
        three channels.

        The filter does not explain all of the ``light``, as beside a lamp. The rest is added as far
        as the denoised picture is as bright there as the undone light: not beside a firefly.
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
        """The filter's amplitude at each frequency, 1 at the lowest: the root of the power of noise
        that it filtered."""
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
    """Weights of a pixel and of its neighbours up to ``reach`` on one side; with those of the other
    side their sum is 1."""
    weights = np.fft.ifft(amplitude).real[:reach + 1]
    weights /= weights[0] + 2 * weights[1:].sum()
    return weights.astype(np.float32)


def correlation(apart: np.ndarray, stddev: float | np.ndarray) -> np.ndarray:
    """Correlation of the noise of pixels that are some pixels ``apart``."""
    found: np.ndarray = np.exp(-np.square(apart / (2 * np.asarray(stddev, float))))
    return found


def find_stddev(colour: np.ndarray, planes: Mapping[Role, np.ndarray] | None = None
                ) -> float | None:
    """The standard deviation, in pixels, of the gaussian pixel filter that spread a picture's
    noise; None if the noise is independent, or there is too little of it to tell.

    In cells of the picture that show little but noise, the power of changes from pixel to pixel in
    both directions is compared with that of changes that are slower in one direction.

    Args:
        colour: (height, width, 3), light.
        planes: of the frame. Albedos and normal tell where light has detail.
    """
    stddev = _measure(colour, planes or {})
    return None if stddev is None or stddev < LEAST_FOUND_PX else round(stddev, 3)


def _measure(colour: np.ndarray, planes: Mapping[Role, np.ndarray]) -> float | None:
    """The filter's standard deviation, in pixels, by the noise of a picture; None if the noise does
    not tell."""
    light = _window_of(colour).clip(0.0, MOST_LIGHT).mean(axis=2)
    if min(light.shape) < NOISE_CELL_PX + len(SHARPEST):
        return None
    sharpest, beside, below, slow_down, slow_across = (
        _power(light, down, across)
        for down, across in ((SHARPEST, SHARPEST), (SHARPEST, SHARP), (SHARP, SHARPEST),
                             (SMOOTH, SHARP), (SHARP, SMOOTH)))
    noisy = _noisy_cells(light, sharpest, planes)
    count = int(np.count_nonzero(noisy))
    if not count:
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
    return stddev if always <= MOST_STRUCTURE * alone else None


def _noisy_cells(light: np.ndarray, sharpest: np.ndarray,
                 planes: Mapping[Role, np.ndarray]) -> np.ndarray:
    """Marks cells that show noise and no texture; none if too few of the cells without texture show
    noise."""
    mean = _means_of_cells(light[1:-1, 1:-1])
    lit = mean > max(LEAST_LIT * mean.max(), 0.0)
    change = np.divide(sharpest, np.square(mean), out=np.zeros_like(mean), where=lit)
    texture = _texture(planes)
    least = LEAST_NOISE_ALONE if texture is None else LEAST_NOISE
    even = lit if texture is None else lit & (texture <= MOST_TEXTURE * np.maximum(change, least))
    noisy: np.ndarray = even & (change > least)
    enough = max(LEAST_NOISY_CELLS, LEAST_NOISY_SHARE * np.count_nonzero(even))
    return noisy if np.count_nonzero(noisy) >= enough else np.zeros_like(noisy)


def _texture(planes: Mapping[Role, np.ndarray]) -> np.ndarray | None:
    """Mean square of the change of albedo and normal from pixel to pixel in each cell, the albedo
    relative to its mean; None without both."""
    found = []
    albedos = [planes[role] for role in ALBEDOS if role in planes]
    if albedos:
        albedo = sum(_window_of(one).mean(axis=2) for one in albedos)
        mean = _means_of_cells(albedo[1:-1, 1:-1])
        found.append(_power(albedo, SHARPEST, SHARPEST)
                     / np.maximum(np.square(mean), LEAST_TEXTURE_LIGHT))
    if Role.NORMAL in planes:
        normal = _window_of(planes[Role.NORMAL])
        found.append(np.sum([_power(normal[..., axis], SHARPEST, SHARPEST) for axis in range(3)],
                            axis=0))
    return np.maximum.reduce(found) if found else None


def _table() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Standard deviations in pixels, and two ratios of the power of noise for each: fastest in both
    directions over fastest in one; slow in one direction over all others."""
    widths = np.linspace(LEAST_STDDEV_PX, MOST_STDDEV_PX, TABLE_SIZE)
    one, two = (correlation(np.asarray(apart), widths) for apart in (1, 2))
    sharpest, sharp, smooth = 6 - 8 * one + 2 * two, 2 - 2 * two, 6 + 8 * one + 2 * two
    return (widths, sharpest / sharp,
            2 * smooth * sharp / (np.square(sharpest) + 2 * sharpest * sharp))


def _window_of(plane: np.ndarray) -> np.ndarray:
    """The middle of a plane (height, width, channels); what is not finite is 0."""
    height, width = plane.shape[:2]
    columns, rows = min(width, NOISE_WINDOW_PX[0]), min(height, NOISE_WINDOW_PX[1])
    left, top = (width - columns) // 2, (height - rows) // 2
    window = plane[top:top + rows, left:left + columns].astype(np.float64)
    known: np.ndarray = np.nan_to_num(window, posinf=0.0, neginf=0.0)
    return known


def _power(plane: np.ndarray, down: tuple[int, ...], across: tuple[int, ...]) -> np.ndarray:
    """Mean squares, by cells, of a band of a plane (rows, columns)."""
    return _means_of_cells(np.square(_along(_along(plane, down, 0), across, 1)))


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
