"""Scene cuts, found by comparing each frame with the one before it, warped by its motion.

Two frames are compared on a coarse grid, by the correlation of their light and of their albedo,
normals and depth; near 1 they show the same scene. Structure that is wider than a fifth of the
picture ("layout") is left out: unrelated pictures have sky above ground, too. A changing exposure
does not count. Noise lowers a correlation: it is measured in each frame by the two halves of its
cells, and corrected for (Spearman 1904, correction for attenuation).

If that says that another shot begins, three more looks may say otherwise: guides of things thinner
than the samples are left out, detail between drops or flakes is compared, and, if nothing could be
compared, windows are searched for in the frame before. Frames without evidence count as related.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from postfx.frame import DEPTH_MISS, Frame, Role
from postfx.kernels.statistics import (
    band_of,
    depth_doublings,
    half_means,
    pair_means,
    pick_light,
    relate_cells,
)
from postfx.sampling import bilinear

SAME_SHOT_CORRELATION = 0.65
"""Correlation from which two frames are of one shot; see docs/howto/integration.md."""

# The coarse grid

MOST_CELLS = 80
"""Cells along a picture's longer side, at most."""
LEAST_BLOCK = 4
"""Pixels along the side of a cell, at least."""
LEAST_COMPARED = 48
"""Cells that must be compared: fewer do not tell one picture from another."""
LEAST_OVERLAP = 0.1
"""Share of the cells that must lead into the frame before."""
BAND_CELLS = 3, 17
"""Cells over which the finest noise is smoothed, and beyond which structure is layout."""
LEAST_MISS = DEPTH_MISS / 8
"""Mean depth of a pair of pixels from which one of them is a miss."""
LEAST_RELIABILITY = 0.5
"""Share of a plane's variance that must not be noise."""
BLACK_LIGHT_RATIO = 1e-2
"""Light over the mean light, below which it counts as black."""
LEAST_BAND_SPREAD = {"light": 0.1, Role.DIFFUSE_ALBEDO: 0.01, Role.NORMAL: 0.02, Role.DEPTH: 0.02}
"""Standard deviation below which a plane tells nothing: in stops, reflectance, parts of unit
vectors, doublings."""
LEAST_CELLS = 0.1
"""Share of the cells that hold a guide's structure, below which it may be that of one thing that
has moved, such as a wire; water has 0.11, other scenes 0.14 and more."""
LEAST_SAMPLED = 0.9
"""Correlation of a guide's samples with the means of all pixels, below which things are thinner
than the samples and the guide tells nothing: 0.98 and more in nine renders, 0.5 to 0.85 with wires
of a pixel."""

# Detail between drops or flakes

DARK_PLACES = 3
"""The darkest of so many rows and columns of pixels of a cell is looked at."""
SAME_DETAIL = 0.02
"""Relative difference of light up to which a pixel is the same in both frames, and from which it is
detail beside its neighbours."""
REGION_CELLS = 5
"""Cells along the side of a region. Each cell has four places where detail is looked at."""
LEAST_DETAIL = 12
"""Places with detail that a region must have to tell, and regions that must tell."""
SAME_SHARE = 0.04
"""Share of a region's detail that must be the same for the region to be the same."""
SAME_REGIONS = 0.5
"""Share of the regions that must be the same for frames to be of one shot: 0.8 and more in rain
that covers two thirds of each frame, up to 0.2 in two shots."""

# Windows that are searched for

WINDOW_PX = 32
"""Side of a window."""
SEARCHED_PX = 48
"""Pixels in each direction in which it is searched for."""
SEARCHED_SIDE_PX = WINDOW_PX + 2 * SEARCHED_PX
"""Side of a window with the pixels around it."""
WINDOWS = 3, 4
"""Rows and columns of windows."""
FIREFLY_LIGHT_RATIO = 16
"""Light over the middle light of windows, above which it is cut."""
LEAST_SMOOTH = 0.6
"""Correlation of neighbouring pixels in a window, below which it is noise, or too fine."""
LEAST_WINDOWS = 6
"""Windows that must tell."""
FOUND_CORRELATION = 0.48
"""Median of how well windows are found, from which frames are of one shot: 0.66 and more where the
camera pans, zooms or turns, 0.51 and more in dissolves, 0.2 to 0.47 for two walls, 0.55 for
waves."""

MOST_PICTURE_SIZES = 8
"""Sizes of pictures for which the places to look at are kept."""


@dataclass(slots=True)
class Picture:
    """One frame on the coarse grid.

    Attributes:
        light: (rows, columns, 2) log2 of the light of both halves of each cell, without layout.
        guides: role -> (rows, columns, 2, channels) with layout: diffuse albedo, normal, log2 of
            depth.
        motion: (rows, columns, 2) in cells, NaN where unknown; None without motion.
        cell: height and width of a cell, as shares of the frame's.
        dark: like `light`, of the darkest of some pixels of each cell.
        detail: (2 rows, 2 columns, 3) light of a pixel, of the one to the right, and of the one
            below, at four places of each cell.
        windows: (windows, rows, columns) light of windows with the pixels around them; small
            pictures have none.
        longest: length in pixels of the longest motion at the windows' middles, 0 if unknown.
        bands: role -> guide without layout, for guides that were compared so far.
    """

    light: np.ndarray
    guides: dict[Role, np.ndarray]
    motion: np.ndarray | None
    cell: tuple[float, float]
    dark: np.ndarray
    detail: np.ndarray
    windows: np.ndarray
    longest: float = 0.0
    bands: dict[Role, np.ndarray] = field(default_factory=dict)

    def band(self, role: Role) -> np.ndarray:
        """A guide without layout."""
        if role not in self.bands:
            self.bands[role] = band_of(self.guides[role], *BAND_CELLS)
        return self.bands[role]


class CutDetector:
    """Stateful: call it with each frame in order; True where a frame is unrelated to the one before
    it.

    It looks only at this frame and at the last one, which may have another size. The first frame is
    no cut. Frames marked with `frame.reset` are not compared: the history is dropped there anyway.

    Attributes:
        relation: correlation of the last two frames, 1 the same scene, about 0 another one; None
            where nothing was compared.
    """

    def __init__(self) -> None:
        self._before: Picture | None = None
        self.relation: float | None = None

    def reset(self) -> None:
        """Forget the past: the next frame is taken as the first."""
        self._before = self.relation = None

    def history(self) -> dict[str, np.ndarray]:
        """The state that the next answer depends on, beside its frame."""
        if self._before is None:
            return {}
        before = self._before
        known = {"light": before.light, "cell": np.array(before.cell, np.float64),
                 "dark": before.dark, "detail": before.detail, "windows": before.windows}
        known |= {f"guide {role}": one for role, one in before.guides.items()}
        return known if before.motion is None else known | {"motion": before.motion}

    def recall(self, history: Mapping[str, np.ndarray]) -> None:
        """Go on as a detector that had this `history`."""
        guides = {Role(name.removeprefix("guide ")): plane
                  for name, plane in history.items() if name[:6] == "guide "}
        self._before = None
        if "windows" in history:  # version 0.1.0 knew none: the next frame is taken as the first
            self._before = Picture(history["light"], guides, history.get("motion"),
                                   tuple(history["cell"].tolist()), history["dark"],
                                   history["detail"], history["windows"])

    def __call__(self, frame: Frame) -> bool:
        """Whether `frame`, whose colour is scene-linear, begins another shot. False without a
        colour."""
        before, self._before = self._before, _picture(frame)
        self.relation = None
        if before and self._before and not frame.reset:
            now = self._before
            on_grid = before if before.cell == now.cell else _on_grid(before, now)
            self.relation = relation(on_grid, now)
            if self.relation is None:
                self.relation = _relation_of_windows(on_grid, now)
                return self.relation is not None and self.relation < FOUND_CORRELATION
            if self.relation < SAME_SHOT_CORRELATION:
                told = _without_thin(now, frame)
                if len(told.guides) < len(now.guides):
                    self.relation = relation(on_grid, told)
            if self.relation is not None and self.relation < SAME_SHOT_CORRELATION:
                self.relation = max(self.relation, _relation_behind(on_grid, now))
        return self.relation is not None and self.relation < SAME_SHOT_CORRELATION


def relation(before: Picture, now: Picture) -> float | None:
    """Correlation of two frames, one warped onto the other; None if nothing tells.

    They are compared along the motion vectors. If these do not fit, which may be their own fault,
    the frames are compared without motion, too. Frames that lack vectors are compared without
    motion there, then shifted as a whole by the shift that fits best.
    """
    still = np.zeros_like(now.light)
    is_whole = now.motion is not None and bool(np.isfinite(now.motion).all())
    first = _compare(before, now, still if now.motion is None else np.nan_to_num(now.motion))
    if first is None or first >= SAME_SHOT_CORRELATION:
        return first
    other = still if is_whole else still + _shift(before, now)
    return max(first, _compare(before, now, other) or 0.0)


def _on_grid(before: Picture, now: Picture) -> Picture:
    """The earlier picture, if its frame has another size, on the later one's cells."""
    sides = zip(now.light.shape, before.light.shape, now.cell, before.cell, strict=False)
    rows, columns = (np.clip((np.arange(count) + 0.5) * cell / last_cell - 0.5, 0, last - 1)
                     for count, last, cell, last_cell in sides)
    x, y = np.meshgrid(columns, rows)
    guides = {role: bilinear(plane, x.ravel(), y.ravel()).reshape(*x.shape, *plane.shape[2:])
              for role, plane in before.guides.items()}
    light, dark = (bilinear(one, x.ravel(), y.ravel()).reshape(*x.shape, 2)
                   for one in (before.light, before.dark))
    return Picture(light, guides, None, now.cell, dark, np.zeros_like(now.detail),
                   np.zeros_like(now.windows))


def _picture(frame: Frame) -> Picture | None:
    """A frame's picture; None without a colour, and for a frame of too few cells."""
    planes, colour = frame.planes, frame.planes.get(Role.COLOUR)
    if colour is None:
        return None
    height, width = colour.shape[:2]
    places = _places(height, width)
    block, (rows, columns) = places.block, places.cells
    if rows * columns < LEAST_COMPARED:
        return None
    halves = half_means(colour, block)
    mean = (np.sqrt(halves).sum() / halves.size) ** 2
    black = BLACK_LIGHT_RATIO * mean or 1.0
    light = np.log2(halves + black)
    guides: dict[Role, np.ndarray] = {}
    for role in (Role.DIFFUSE_ALBEDO, Role.NORMAL):
        if role in planes:
            guides[role] = pair_means(planes[role], block)
    if Role.DEPTH in planes:
        guides[Role.DEPTH] = depth_doublings(pair_means(planes[Role.DEPTH], block),
                                             LEAST_MISS)
    motion, longest = None, 0.0
    if Role.MOTION in planes:
        motion = planes[Role.MOTION][block // 2 :: block,
                                     block // 2 :: block][:rows, :columns].astype(float) / block
        motion[np.abs(motion).max(-1) > max(rows, columns)] = np.nan  # stands for none
        longest = block * float(np.nan_to_num(np.abs(motion[places.middles])).max())

    # Light of single pixels.
    some = pick_light(colour, *places.dark).reshape(DARK_PLACES, 2, rows, DARK_PLACES, columns)
    dark = np.log2(np.moveaxis(some.min((0, 3)), 0, -1).astype(np.float64) + black)
    pixels = pick_light(colour, *places.detail).reshape(2, 2 * rows, 2, 2 * columns)
    detail = np.stack([pixels[0, :, 0], pixels[0, :, 1], pixels[1, :, 0]], axis=-1)
    windows = np.empty((0, SEARCHED_SIDE_PX, SEARCHED_SIDE_PX), np.float32)
    if places.windows:
        windows = pick_light(colour, *places.windows).reshape(
            WINDOWS[0], SEARCHED_SIDE_PX, WINDOWS[1], SEARCHED_SIDE_PX
        ).swapaxes(1, 2).reshape(-1, SEARCHED_SIDE_PX, SEARCHED_SIDE_PX)
    return Picture(band_of(light.transpose(1, 2, 0), *BAND_CELLS), guides, motion,
                   (block / height, block / width), band_of(dark, *BAND_CELLS), detail, windows,
                   longest)


Grid = tuple[np.ndarray, np.ndarray]
"""Rows of pixels, and columns of them."""


class Places(NamedTuple):
    """Where pictures of one size are looked at.

    Attributes:
        block: pixels along the side of a cell.
        cells: rows and columns of whole cells.
        middles: cells in the middle of windows.
        dark: pixels of the two halves of each cell, which are its even and its odd rows; rows by
            place, half and cell, columns by place and cell.
        detail: four pixels of each cell, and the ones beside them.
        windows: pixels of windows with those around them, edges repeated; None for small pictures.
    """

    block: int
    cells: tuple[int, int]
    middles: tuple[slice, slice]
    dark: Grid
    detail: Grid
    windows: Grid | None


@lru_cache(MOST_PICTURE_SIZES)
def _places(height: int, width: int) -> Places:
    """The places of pictures of a size."""
    sides = height, width
    block = max(LEAST_BLOCK, math.ceil(max(sides) / MOST_CELLS))
    first_rows, first_columns = (block * np.arange(side // block) for side in sides)
    cells = first_rows.size, first_columns.size
    middle_rows, middle_columns = (
        slice(count // (2 * windows), None, max(count // windows, 1))
        for count, windows in zip(cells, WINDOWS, strict=True)
    )

    inside = block * (2 * np.arange(DARK_PLACES)[:, None] + 1) // (2 * DARK_PLACES)
    halves = np.minimum(inside - inside % 2 + (0, 1), block - 1)
    dark = (halves[:, :, None] + first_rows).ravel(), (inside + first_columns).ravel()

    beside = np.array([[0], [1]]) + np.array([0, block // 2]) + block // 8
    detail_rows, detail_columns = ((beside[:, None] + first[:, None]).ravel()
                                   for first in (first_rows, first_columns))

    windows = None
    if min(sides) >= 3 * WINDOW_PX:
        around = np.arange(-SEARCHED_PX, WINDOW_PX + SEARCHED_PX)
        first = [((side - WINDOW_PX) * (np.arange(count) + 0.5) / count).astype(int)
                 for side, count in zip(sides, WINDOWS, strict=True)]
        window_rows, window_columns = ((places[:, None] + around).clip(0, side - 1).ravel()
                                       for places, side in zip(first, sides, strict=True))
        windows = window_rows, window_columns
    return Places(block, cells, (middle_rows, middle_columns), dark,
                  (detail_rows, detail_columns), windows)


def _relation_of_windows(before: Picture, now: Picture) -> float | None:
    """The median of how well windows are found in the frame before; None if too few tell, or
    motion is longer than the distance that is searched."""
    if now.longest > SEARCHED_PX:
        return None
    inner = slice(SEARCHED_PX, -SEARCHED_PX)
    then, windows = (_in_stops(picture.windows) for picture in (before, now))
    found = [_find(window[inner, inner], around)
             for window, around in zip(windows, then, strict=True)
             if _is_telling(window[inner, inner]) and _is_telling(around[inner, inner])]
    return float(np.median(found)) if len(found) >= LEAST_WINDOWS else None


def _in_stops(windows: np.ndarray) -> np.ndarray:
    """log2 of light, between black and fireflies beside the middle light."""
    middle = float(np.median(windows)) if windows.size else 0.0
    held = np.minimum(windows, FIREFLY_LIGHT_RATIO * middle)
    stops: np.ndarray = np.log2(held + (BLACK_LIGHT_RATIO * middle or 1.0))
    return stops


def _is_telling(window: np.ndarray) -> bool:
    """Whether a window shows more than noise."""
    apart = window - window.mean()
    spread = float(np.square(apart).mean())
    if spread < LEAST_BAND_SPREAD["light"]**2:
        return False
    beside = float((apart[:, 1:] * apart[:, :-1]).mean())
    below = float((apart[1:] * apart[:-1]).mean())
    return min(beside, below) >= LEAST_SMOOTH * spread


def _find(window: np.ndarray, around: np.ndarray) -> float:
    """The largest correlation of a window with any place of its size in the pixels `around` it
    (normalized cross-correlation; Lewis 1995)."""
    shape, size = around.shape, window.size
    apart = window - window.mean()
    of_one, of_window = (np.conj(np.fft.rfft2(one, shape))
                         for one in (np.ones_like(window), apart))
    products, total, squares = (
        np.fft.irfft2(np.fft.rfft2(one) * other, shape)
        for one, other in ((around, of_window), (around, of_one), (around**2, of_one)))
    least = LEAST_BAND_SPREAD["light"]**2 * size  # of a place that tells
    spread = np.maximum(squares - total**2 / size, least)
    whole = tuple(slice(0, side - part + 1)
                  for side, part in zip(shape, window.shape, strict=True))
    return float((products / np.sqrt(spread))[whole].max() / np.linalg.norm(apart))


def _relation_behind(before: Picture, now: Picture) -> float:
    """Correlation of the scene between drops or flakes; 1 if most regions show the same detail."""
    apart = np.abs(now.detail - before.detail) <= SAME_DETAIL / 2 * (now.detail + before.detail)
    slope = np.abs(now.detail[..., 1:] - now.detail[..., :1]).max(-1)
    is_detail = slope > SAME_DETAIL * now.detail[..., 0]
    side = 2 * REGION_CELLS
    rows, columns = (count // side for count in is_detail.shape)
    known, same = (marks[:rows * side, :columns * side].reshape(rows, side, columns, side)
                   .sum((1, 3)) for marks in (is_detail, is_detail & apart.all(-1)))
    tells = known >= LEAST_DETAIL
    if tells.sum() >= LEAST_DETAIL and (
            same[tells] >= SAME_SHARE * known[tells]).mean() >= SAME_REGIONS:
        return 1.0
    dark = [replace(one, light=one.dark, guides={}) for one in (before, now)]
    return relation(dark[0], dark[1]) or 0.0


def _without_thin(picture: Picture, frame: Frame) -> Picture:
    """The picture without the guides whose samples differ from the means of all pixels."""
    guides = {}
    for role, samples in picture.guides.items():
        rows, columns = samples.shape[:2]
        side = round(picture.cell[0] * frame.planes[role].shape[0])
        plane = frame.planes[role][:rows * side, :columns * side, None]
        plane = (depth_doublings(plane, LEAST_MISS) if role is Role.DEPTH
                 else np.nan_to_num(plane)).squeeze(2)
        means = plane.reshape(rows, side, columns, side, -1).mean((1, 3))
        found, wanted = (band.reshape(rows * columns, -1) for band in
                         (band_of(means, *BAND_CELLS), picture.band(role).mean(2)))
        found, wanted = found - found.mean(0), wanted - wanted.mean(0)
        size = float(np.sum(found**2) * np.sum(wanted**2)) ** 0.5
        if size == 0 or np.sum(found * wanted) >= LEAST_SAMPLED * size:
            guides[role] = samples
    return replace(picture, guides=guides)


def _compare(before: Picture, now: Picture, motion: np.ndarray) -> float | None:
    """Correlation under one motion: the light's, or the guides' mean if the light is not related
    and that is higher.

    None if no plane tells anything, 0 if the motion leads out of the frame before.
    """
    cells = now.light.shape[0] * now.light.shape[1]
    light, inside = relate_cells(before.light, now.light, motion, LEAST_BAND_SPREAD["light"],
                                 LEAST_RELIABILITY)
    if inside < max(LEAST_COMPARED, LEAST_OVERLAP * cells):
        return 0.0
    if light is not None and light >= SAME_SHOT_CORRELATION:
        return light
    guides = [relate_cells(before.band(role), now.band(role), motion, LEAST_BAND_SPREAD[role],
                           LEAST_RELIABILITY)[0]
              for role in now.guides if role in before.guides
              and max(_extent(before.band(role)), _extent(now.band(role))) > LEAST_CELLS]
    known = [value for value in guides if value is not None]
    values = ([float(np.mean(known))] if known else []) + ([light] if light is not None else [])
    return max(values) if values else None


def _extent(band: np.ndarray) -> float:
    """Share of the cells over which the variance of a band (rows, columns, 2 halves, channels) is
    spread."""
    cells = band.mean(2).reshape(band.shape[0] * band.shape[1], -1)
    energy = np.square(cells - cells.mean(0)).sum(1)
    return float(energy.sum() ** 2 / max(energy.size * np.square(energy).sum(), 1e-30))


def _shift(before: Picture, now: Picture) -> np.ndarray:
    """Shift (2,) in whole cells, x and y, up to half the picture, that fits its light best
    (cross-correlation)."""
    rows, columns = now.light.shape[:2]
    spectra = [np.fft.rfft2(picture.light.mean(axis=2), (2 * rows, 2 * columns))
               for picture in (before, now)]
    match = np.fft.irfft2(spectra[0] * np.conj(spectra[1]), (2 * rows, 2 * columns))
    match = np.fft.fftshift(match)[rows - rows // 2 : rows + rows // 2 + 1,
                                   columns - columns // 2 :][:, : columns + 1]
    y, x = np.unravel_index(match.argmax(), match.shape)
    return np.array([x - columns // 2, y - rows // 2], float)
