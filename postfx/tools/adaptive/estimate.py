"""The expected squared error of denoised pixels, in display code values: read from files, or
estimated.

A network that predicts it writes a plane `error`. Without one there are two ways,
docs/lab/render_more.md compares them.

Two renders A and B of the frame, with different seeds, measure it. A denoised, D(A), knows nothing
of the noise of B, so (D(A) - B)^2 holds the error of D(A) and the noise of B; (D(B) - A)^2 the
other way round; and (A - B)^2 / 2 holds the noise of both. What is left of the mean of the first
two after taking the last away is the error, noise and bias of the denoiser together, in the mean
over many pixels. Nothing in it is fitted. With M the mean of D(A) and D(B), and d their distance
from it, that is d^2 + d ((A - M) - (B - M)) + (A - M) (B - M), of light times the slope of the
display curve. In one tile that is too noisy where renders are: what counts is its ratio to the
variance of D(A) and D(B), over a tile and those around it, times that variance, which is known
well.

That is the error E of a half. Both together have a smaller one, and how much smaller shows where
they are denoised: C is the squared difference of that picture from M. Their error is near
CHANGE_SHARE E^(1 - CHANGE_POWER) C^CHANGE_POWER. C has less noise than E, too.

One render alone says less: the second differences of its pixels, before and after denoising, in
code values (exposed, x / (1 + x), sRGB), squared and averaged around each pixel. Before, they show
noise and detail together; after, the detail that the denoiser found. Where there is much of both it
errs most. The error of a tile is near SHARE before^BEFORE_POWER after^AFTER_POWER, with constants
that are fitted to tiles of scenes with references.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from postfx.colour.views import to_codes
from postfx.errors import FrameError
from postfx.frame import Frame, Role
from postfx.io.channels import ChannelIndex, read_channels
from postfx.io.image_file import ImageFile
from postfx.sampling import local_mean
from postfx.tools.adaptive.plan import tile_means

ERROR_LAYER = "error"
"""Layer of the predicted error in files."""
AVERAGED_RADIUS_PX = 8
"""Half the side of the squares that differences are averaged over."""
# Of the formula for one render alone.
ERROR_SHARE = 0.66
BEFORE_POWER = 0.714
AFTER_POWER = 0.287
FLAT_MEAN_SQUARE = 1e-7
"""Mean square of differences that counts as flat."""
SLOPE_STEP = 1e-3
"""Share of 1 + light over which the slope of the display curve is taken."""
MOST_NOISE_CODES = 0.5
"""Code values that noise counts for at most: a single firefly would say more than all other pixels
of a tile."""
# Of the formula for two halves.
CHANGE_SHARE = 1.6
CHANGE_POWER = 0.3
LEAST_ERROR_RATIO = 0.5
"""Ratio of the error to the variance of denoised halves below which none falls: noise may leave
less than nothing."""


def read_error(path: Path) -> np.ndarray | None:
    """The plane `error` of a file (height, width), the mean of its channels; None where it has
    none."""
    with ImageFile(path) as file:
        channels = ChannelIndex({"": file.parts}).matching(ERROR_LAYER)
        if not channels:
            return None
        pixels = read_channels({"": file}, dict.fromkeys(channels, 0.0))
        found: np.ndarray = np.mean([pixels[channel] for channel in channels], axis=0)
    return found


def estimate_error(noisy: Frame, denoised: np.ndarray, exposure_factor: float) -> np.ndarray:
    """Expected squared error of each pixel (height, width) of a denoised colour (height, width, 3)
    of a frame's size.

    Raises FrameError where sizes differ.
    """
    colour = noisy[Role.COLOUR]
    if colour.shape != denoised.shape:
        raise FrameError(f"{noisy.source or noisy.number}: is {colour.shape[1]}x{colour.shape[0]}, "
                         f"its denoised frame {denoised.shape[1]}x{denoised.shape[0]}: denoise it "
                         "at the render's size")
    before, after = (_busyness(to_codes(light, exposure_factor)) for light in (colour, denoised))
    found = ERROR_SHARE * before**BEFORE_POWER * after**AFTER_POWER
    error: np.ndarray = found[:, :, 0].astype(np.float32)
    return error


def mean_frame(one: Frame, other: Frame) -> Frame:
    """Two renders of a frame with as many samples each as one; depth and motion are those of the
    first."""
    kept = {Role.DEPTH, Role.MOTION}
    planes = {role: plane if role in kept or role not in other else (plane + other[role]) / 2
              for role, plane in one.planes.items()}
    return replace(one, planes=planes)


def estimate_from_halves(
    halves: tuple[np.ndarray, np.ndarray], denoised: tuple[np.ndarray, np.ndarray, np.ndarray],
    exposure_factor: float, side: int
) -> np.ndarray:
    """Expected squared error of both halves together, denoised: for each pixel (height, width) that
    of its tile.

    halves: colours (height, width, 3) of renders with different seeds, and about as many samples
    each; denoised: each of them denoised alone, then both together; side: of the tiles in pixels.
    Raises FrameError where sizes differ.
    """
    if len({colour.shape for colour in (*halves, *denoised)}) > 1:
        raise FrameError("halves of a shot and their denoised frames have several sizes: render "
                         "both alike, and denoise them at the render's size")
    half = error_of_half(halves, (denoised[0], denoised[1]), exposure_factor, side)
    codes, codes_other, codes_whole = (to_codes(colour, exposure_factor) for colour in denoised)
    change = tile_means(np.square((codes + codes_other) / 2 - codes_whole), side) + FLAT_MEAN_SQUARE
    found = np.float32(CHANGE_SHARE * half ** (1 - CHANGE_POWER) * change**CHANGE_POWER)
    height, width = halves[0].shape[:2]
    return np.ascontiguousarray(found.repeat(side, axis=0).repeat(side, axis=1)[:height, :width])


def error_of_half(
    halves: tuple[np.ndarray, np.ndarray], denoised: tuple[np.ndarray, np.ndarray],
    exposure_factor: float, side: int
) -> np.ndarray:
    """Expected squared error of the tiles (rows, columns) of one of two halves, denoised alone: the
    mean of both."""
    one, other, clean, clean_other = (np.nan_to_num(colour).astype(np.float64) * exposure_factor
                                      for colour in (*halves, *denoised))
    middle = (clean + clean_other) / 2
    light = np.maximum(middle, 0)
    step = SLOPE_STEP * (1 + light)
    slope = (to_codes(light + step, 1.0) - to_codes(light, 1.0)) / step
    apart = slope * (clean - middle)
    noise, noise_other = (np.clip(slope * (half - middle), -MOST_NOISE_CODES, MOST_NOISE_CODES)
                          for half in (one, other))
    error = tile_means(apart**2 + apart * (noise - noise_other) + noise * noise_other, side)
    varies = tile_means(np.square(to_codes(clean, 1.0) - to_codes(clean_other, 1.0)) / 2, side)
    varies = np.maximum(varies, FLAT_MEAN_SQUARE)
    found: np.ndarray = varies * np.maximum(_around(error) / _around(varies), LEAST_ERROR_RATIO)
    return found


def _around(tiles: np.ndarray) -> np.ndarray:
    """Weighted mean of each tile (rows, columns) and the eight around it; those at the border are
    repeated."""
    for axis in (0, 1):
        padded = np.pad(tiles, [(1, 1) if one == axis else (0, 0) for one in (0, 1)], mode="edge")
        first, middle, last = (np.take(padded, np.arange(tiles.shape[axis]) + shift, axis)
                               for shift in (0, 1, 2))
        tiles = (first + 2 * middle + last) / 4
    return tiles


def _busyness(codes: np.ndarray) -> np.ndarray:
    """Second differences along both axes, squared, mean of the channels and the pixels around:
    (height, width, 1); of white noise its variance (Immerkaer 1996, "Fast noise variance
    estimation")."""
    padded = np.pad(codes, ((1, 1), (1, 1), (0, 0)), mode="edge")
    rows = padded[:-2] - 2 * padded[1:-1] + padded[2:]
    found = np.square(rows[:, :-2] - 2 * rows[:, 1:-1] + rows[:, 2:]) / 36
    mean: np.ndarray = np.maximum(local_mean(found.mean(axis=2, keepdims=True), AVERAGED_RADIUS_PX),
                                  FLAT_MEAN_SQUARE)
    return mean
