"""Kernels of cells, blocks and places are what NumPy says."""

from __future__ import annotations

import numpy as np
import pytest

from postfx.cuts import CutDetector
from postfx.exposure import measure
from postfx.frame import Frame, Role
from postfx.kernels.image import compare_places
from postfx.kernels.statistics import (
    band_of,
    block_means,
    bounds_of_cells,
    coverage_noise,
    depth_doublings,
    half_means,
    mark_positive,
    pair_means,
    pick_light,
    relate_cells,
)
from postfx.planes import INFINITY_BITS, is_blank, is_finite, is_same_plane, largest_bits_of, lend
from postfx.repair import repair_nonfinite
from postfx.sampling import bilinear, is_inside

RANDOM = np.random.default_rng(0)
RED, GREEN, BLUE = 0.2126, 0.7152, 0.0722
"""Weights of luminance, ITU-R BT.709-6, item 3.2."""


def bad_colours(height: int, width: int) -> np.ndarray:
    """Pixels of every sign, some of which are no numbers."""
    colour = RANDOM.normal(0.5, 1, (height, width, 3)).astype(np.float32)
    colour.reshape(-1)[::23] = RANDOM.choice([np.nan, np.inf, -np.inf],
                                             len(colour.reshape(-1)[::23]))
    return colour


def light_of(colour: np.ndarray) -> np.ndarray:
    return np.asarray(colour, np.float64) @ (RED, GREEN, BLUE)


@pytest.mark.parametrize("size", [(1, 1), (5, 7), (16, 24)], ids=str)
def test_block_means(size: tuple[int, int]) -> None:
    colour = bad_colours(*size)
    found = block_means(colour, 4)
    assert found.shape == tuple(-(-side // 4) for side in size)
    for y, x in np.ndindex(found.shape):
        light = light_of(colour[4 * y:4 * y + 4, 4 * x:4 * x + 4]).ravel()
        light = np.sort(np.maximum(light[np.isfinite(light)], 0))
        np.testing.assert_allclose(found[y, x],
                                   light[:-1].mean() if light.size > 1 else light.sum(), rtol=1e-6)


@pytest.mark.parametrize("block", [2, 5])
def test_means_of_even_and_odd_rows(block: int) -> None:
    colour = bad_colours(11, 15)
    found = half_means(colour, block)
    assert found.shape == (2, 11 // block, 15 // block)
    for half, y, x in np.ndindex(found.shape):
        light = light_of(colour[y * block:(y + 1) * block,
                                x * block:(x + 1) * block][half::2]).ravel()
        light = np.sort(np.maximum(np.where(np.isfinite(light), light, 0), 0))
        np.testing.assert_allclose(found[half, y, x], light[:-1].mean(), rtol=1e-6)


@pytest.mark.parametrize("size", [(1, 1), (1, 6), (5, 1), (6, 9)], ids=str)
def test_compared_places(size: tuple[int, int]) -> None:
    before, now = (RANDOM.random((*shape, 2)).astype(np.float32) for shape in (size, (40,)))
    x, y = (RANDOM.uniform(-1, side, (3, 40)).astype(np.float32) for side in size[::-1])
    x[:, 0], y[:, 0] = size[1] - 1, size[0] - 1
    apart, inside = np.empty((3, 40), np.float32), np.empty((3, 40), bool)
    compare_places(before, now, x, y, apart, inside)
    mixed = bilinear(before, x.ravel(), y.ravel()).reshape(3, 40, 2)
    np.testing.assert_allclose(apart, np.abs(mixed - now).max(-1), atol=1e-5)
    np.testing.assert_array_equal(inside, is_inside(before, x, y))
    assert inside[:, 0].all()


@pytest.mark.parametrize("size", [(1, 1, 1), (3, 40, 2), (45, 80, 6)], ids=str)
@pytest.mark.parametrize("widths", [(1, 3), (3, 17)])
def test_bands_are_differences_of_box_means(size: tuple[int, int, int],
                                            widths: tuple[int, int]) -> None:
    planes, wanted = RANDOM.normal(size=size), np.zeros(size)
    for width, sign in zip(widths, (1, -1), strict=True):
        near = width // 2
        padded = np.pad(planes, ((near, near), (near, near), (0, 0)), "edge")
        wanted += (sign * np.lib.stride_tricks.sliding_window_view(padded, (width, width), (0, 1))
                   .mean((3, 4)))
    np.testing.assert_allclose(band_of(planes, *widths), wanted, rtol=0, atol=1e-14)


@pytest.mark.parametrize("value", [np.nan, -np.nan, np.inf, -np.inf, 3e38, -1.0, 0.0])
def test_largest_bits(value: float) -> None:
    plane = RANDOM.random((7, 11, 13)).astype(np.float32)
    plane[3, 5, 3] = value
    bits = largest_bits_of(plane)
    assert bits == (plane.view(np.uint32) & 0x7FFFFFFF).max()
    assert is_finite(plane) == np.isfinite(value)
    assert (bits >= INFINITY_BITS) == (not np.isfinite(value))
    assert (bits > INFINITY_BITS) == np.isnan(value)


@pytest.mark.parametrize("block", [4, 5, 12])
def test_pair_means(block: int) -> None:
    plane = RANDOM.random((3 * block + 2, 5 * block + 1, 2)).astype(np.float32)
    near, far = block // 4, block - 1 - block // 4
    plane[near, near, 0] = np.inf
    plane[2 * block + far, near, 1] = np.nan
    at = {(y, x): plane[y::block, x::block].astype(float)[:3, :5] for y in (near, far)
          for x in (near, far)}
    pairs = [(at[near, near] + at[far, far]) / 2, (at[near, far] + at[far, near]) / 2]
    np.testing.assert_array_equal(pair_means(plane, block),
                                  np.nan_to_num(np.stack(pairs, axis=2), posinf=0))


def test_light_of_some_rows_and_columns() -> None:
    colour = bad_colours(9, 14)
    colour[0, 5], colour[8, 2] = (1, np.inf, -np.inf), (1, np.nan, 1)
    rows, columns = np.array([[3, 0], [8, 3]]), np.array([13, 2, 5, 5, 0])
    seen = colour[rows.ravel()][:, columns]
    light = light_of(np.where(np.isnan(seen), np.nan, np.clip(seen, 0, 1e30)))
    found = pick_light(colour, rows, columns)
    np.testing.assert_allclose(found, np.nan_to_num(light), rtol=1e-6)


def test_noise_is_taken_from_a_correlation() -> None:
    shown, still = RANDOM.normal(size=(200, 200, 1, 1)), np.zeros((200, 200, 2))
    noisy = [shown + RANDOM.normal(0, 0.8, (200, 200, 2, 1)) for _ in range(2)]
    raw = np.corrcoef(*(halves.mean(axis=2).ravel() for halves in noisy))[0, 1]
    found, _ = relate_cells(*noisy, still, 0.1, 0.5)
    assert raw < 0.8
    assert found == pytest.approx(1, abs=0.02)
    other = np.repeat(RANDOM.normal(size=(200, 200, 1, 1)), 2, axis=2)
    unrelated, _ = relate_cells(noisy[0], other, still, 0.1, 0.5)
    assert unrelated == pytest.approx(0, abs=0.02)
    assert relate_cells(*noisy, still, 2.0, 0.5) == (None, 40000)
    assert relate_cells(*noisy, still, 0.1, 0.9) == (None, 40000)


def test_cells_are_related_to_what_was_at_their_places() -> None:
    before, motion = RANDOM.normal(3, 1, (9, 13, 2, 3)), RANDOM.normal(0, 2, (9, 13, 2))
    before[:, :, 1] += before[:, :, 0]
    now = before + RANDOM.normal(-2, 0.5, before.shape)
    motion[3, 4] = np.nan
    down, across = np.mgrid[:9, :13] + np.moveaxis(motion, 2, 0)[::-1]
    inside = is_inside(motion, across, down)
    assert 0 < inside.sum() < 117
    then = bilinear(before.reshape(9, 13, 6), across[inside], down[inside]).reshape(-1, 2, 3)
    here = now[inside]

    def correlate(one: np.ndarray, other: np.ndarray) -> float:
        """Of all channels together, without the means of each."""
        one, other = (one - one.mean(axis=0)).ravel(), (other - other.mean(axis=0)).ravel()
        return float(one @ other / np.sqrt((one @ one) * (other @ other)))

    reliable = [2 * between / (1 + between)
                for between in (correlate(set_[:, 0], set_[:, 1]) for set_ in (then, here))]
    wanted = correlate(then.mean(axis=1), here.mean(axis=1)) / np.sqrt(np.prod(reliable))
    found, count = relate_cells(before, now, motion, 0.1, 0.1)
    assert found == pytest.approx(wanted, rel=1e-12)
    assert count == inside.sum()


@pytest.mark.parametrize("size", [(1, 1), (7, 9), (40, 62)], ids=str)
def test_positive_cells(size: tuple[int, int]) -> None:
    plane = (RANDOM.random((*size, 1)) * (RANDOM.random((*size, 1)) < 0.05)).astype(np.float32)
    plane[-1, -1] = -1
    cells = np.zeros([-(-side // 4) * 2 for side in size], bool)
    mark_positive(plane, 2, cells)
    for y, x in np.ndindex(cells.shape):
        assert cells[y, x] == (plane[2 * y:2 * y + 2, 2 * x:2 * x + 2] > 0).any()


def test_many_threads_find_what_one_finds() -> None:
    """Work on planes of several MiB is divided among the threads that are lent, and its results are
    the same bits."""
    colour, divided = bad_colours(480, 640), []
    colour[100:140] = 1

    def divide(rows, count, _):
        divided.append(count)
        for i in reversed(range(count)):
            rows(i, i + 1)

    def look():
        detector = CutDetector()
        frames = [Frame({Role.COLOUR: plane}) for plane in (colour, colour[::-1].copy())]
        cuts = [detector(frame) for frame in frames]
        repaired, counts = repair_nonfinite(frames[0], (Role.COLOUR,))
        return cuts, detector.relation, measure(colour), counts, repaired[Role.COLOUR].tobytes()

    wanted = look()
    with lend(divide):
        assert look() == wanted
    assert len(divided) == 4 and min(divided) > 1 and wanted[3]


def test_coverage_noise_is_the_share_of_pixels_unlike_their_neighbours() -> None:
    near, far = np.full((40, 60), 3, np.float32), np.full((40, 60), 1e10, np.float32)
    edge = np.where(np.arange(60) < 30, near, far)
    for surface in (near, far, edge, edge.T, np.full((40, 60), np.nan, np.float32),
                    near + np.arange(60, dtype="f4")):
        assert coverage_noise(surface, 1e9) == 0
    for spot, around in ((near, far), (far, near)):
        spotted = around.copy()
        spotted[5:35:3, 5:55:5] = spot[5:35:3, 5:55:5]  # 50 pixels in 19 rows of 58
        assert coverage_noise(spotted, 1e9) == pytest.approx(50 / (19 * 58))
    white = np.where(np.random.default_rng(1).random((200, 200)) < 0.5, np.float32(3),
                     np.float32(0))
    assert coverage_noise(white, 1e9) == pytest.approx(5 / 16, abs=0.01)


@pytest.mark.parametrize("place", [None, 0, 4095, 4096, 9999])
@pytest.mark.parametrize("value", [1e-45, -1.0, np.nan])
def test_a_plane_is_blank_without_any_number_but_zeros(place, value):
    plane = np.full(10000, -0.0, np.float32)
    if place is not None:
        plane[place] = value
    assert is_blank(plane) == (place is None)


@pytest.mark.parametrize("place", [0, 4095, 4096, 9998, 9999])
def test_planes_are_the_same_with_nan_in_both(place):
    plane = RANDOM.random((100, 100)).astype(np.float32)
    plane[3, ::7] = np.nan
    assert is_same_plane(plane, plane.copy())
    for value in (np.nan, np.inf, 0.5):
        other = plane.copy()
        other.flat[place] = value
        assert not is_same_plane(plane, other) and not is_same_plane(other, plane)


@pytest.mark.parametrize("size", [(1, 1), (7, 9), (40, 61)], ids=str)
def test_bounds_of_cells(size: tuple[int, int]) -> None:
    plane = RANDOM.uniform(-0.2, 1.2, size).astype(np.float32)
    plane.flat[::11] = np.nan
    low, high = bounds_of_cells(plane, 4)
    assert low.shape == high.shape == tuple(-(-side // 4) for side in size)
    for y, x in np.ndindex(low.shape):
        cell = plane[4 * y:4 * y + 4, 4 * x:4 * x + 4]
        known = cell[np.isfinite(cell)]
        assert low[y, x] == known.min(initial=1) and high[y, x] == known.max(initial=0)


@pytest.mark.parametrize("missed", [0, 0.3, 1])
def test_misses_lie_twice_as_far_as_the_farthest_hit(missed):
    depth = RANDOM.normal(3, 4, 200)
    depth[RANDOM.random(200) < missed] = 1e10
    depth[::17] = np.nan
    hit = depth < 1e9
    wanted = np.where(hit, np.maximum(depth, 1e-6), 2 * depth[hit].max(initial=1e-6))
    np.testing.assert_array_equal(depth_doublings(depth, 1e9), np.log2(wanted))


def test_planes_at_any_address_are_taken():
    """What a checkpoint held lies where its bytes lie."""
    plane = np.arange(12.0).reshape(3, 4, 1) + RANDOM.uniform(size=(3, 4, 2))
    held = np.frombuffer(bytearray(plane.nbytes + 1), np.uint8)[1:]
    elsewhere = held.view(np.float64).reshape(plane.shape)
    assert not elsewhere.flags.aligned
    elsewhere[...] = plane
    still = np.zeros((3, 4, 2))
    found, _ = relate_cells(elsewhere, elsewhere, still, 0.1, 0.5)
    assert found is not None
    assert found == relate_cells(plane, plane, still, 0.1, 0.5)[0]
