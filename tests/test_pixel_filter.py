"""Pixel filters that spread noise over several pixels: they are found in the noise, undone, and
applied again."""

from __future__ import annotations

import numpy as np
import pytest

from postfx.errors import PassOptionError
from postfx.frame import Role
from postfx.pixel_filter import PixelFilter, find_stddev, parse_stddev
from postfx.runtime import Device
from tests.splatted import splatted

SIZE = 120, 160
FLAT = {Role.DIFFUSE_ALBEDO: np.full((*SIZE, 3), 0.5, np.float32),
        Role.NORMAL: np.tile(np.float32([0, 0, 1]), (*SIZE, 1))}
"""Planes without texture."""


def slope(size: tuple[int, int] = SIZE) -> np.ndarray:
    """Light that rises slowly, of three channels."""
    rows, columns = np.mgrid[:size[0], :size[1]] / size[1]
    return np.stack([0.3 + 0.4 * rows, 0.5 + 0.2 * columns, 0.6 - 0.3 * rows], -1)


def neighbours(noise: np.ndarray) -> float:
    """How alike the noise of pixels beside each other is."""
    noise = noise - noise.mean((0, 1))
    return float((noise[:, 1:] * noise[:, :-1]).mean() / np.square(noise).mean())


@pytest.mark.parametrize("samples", (2, 16))
@pytest.mark.parametrize("stddev", (0.35, 0.42, 0.5, 0.6, 0.7))
def test_the_width_is_found_in_the_noise(stddev: float, samples: int) -> None:
    for seed in (1, 2):
        found = find_stddev(splatted(slope(), stddev, samples, seed), FLAT)
        assert found == pytest.approx(stddev, rel=0.1)


def test_it_is_found_beside_edges_and_fireflies() -> None:
    light = slope()
    light[40:70, 50:100] *= 8
    noisy = splatted(light, 0.5)
    noisy[20:24, 20:24] += 500
    assert find_stddev(noisy) == pytest.approx(0.5, rel=0.1)


@pytest.mark.parametrize("shape", (0.1, 1, 8))
def test_independent_noise_tells_of_no_filter(shape: float) -> None:
    for seed in range(4):
        noise = np.random.default_rng(seed).gamma(shape, 1 / shape, (*SIZE, 3))
        assert find_stddev((slope() * noise).astype(np.float32)) is None


def test_nothing_is_found_where_nothing_can_be() -> None:
    spread = splatted(slope(), 0.5)
    assert find_stddev(spread) is not None
    assert find_stddev(slope().astype(np.float32)) is None
    assert find_stddev(np.zeros((*SIZE, 3), np.float32)) is None
    assert find_stddev(spread[:10, :10]) is None
    assert find_stddev(np.full((*SIZE, 3), np.nan, np.float32)) is None


def test_texture_that_planes_know_is_no_filter() -> None:
    """Soft texture with a little noise of its own looks like spread noise; more noise that is
    spread is still told."""
    texture = splatted(np.full((*SIZE, 3), 0.4), 0.5, samples=1, seed=3)
    planes = {**FLAT, Role.DIFFUSE_ALBEDO: texture}
    noise = np.random.default_rng(1).gamma(400, 1 / 400, (*SIZE, 3))
    assert find_stddev((texture * slope()).astype(np.float32)) is not None
    assert find_stddev((texture * slope() * noise).astype(np.float32), planes) is None
    half = {**planes, Role.DIFFUSE_ALBEDO: texture.copy()}
    half[Role.DIFFUSE_ALBEDO][:, 80:] = 0.5
    light = half[Role.DIFFUSE_ALBEDO] * splatted(slope(), 0.5, samples=4)
    assert find_stddev(light.astype(np.float32), half) == pytest.approx(0.5, rel=0.1)


def test_detail_of_light_on_few_cells_is_no_filter() -> None:
    """As of caustics on a wall: most of what is even has no noise."""
    light = slope()
    light[:36, :80] = splatted(light, 0.5)[:36, :80]
    assert find_stddev(light.astype(np.float32), FLAT) is None


def test_fine_detail_without_noise_is_no_filter() -> None:
    stripes = np.sin(np.arange(SIZE[1]) * 0.9)[None, :, None] * np.ones((*SIZE, 3))
    assert find_stddev((1 + 0.5 * stripes).astype(np.float32)) is None


@pytest.mark.parametrize("stddev", (0.35, 0.5, 0.6))
def test_undone_noise_is_independent_and_keeps_its_light(stddev: float) -> None:
    light = splatted(slope(), stddev)
    undone, between = np.empty_like(light), np.empty_like(light)
    PixelFilter(stddev).undo_light(light, undone, between)
    assert neighbours(light - slope()) > 0.1
    assert abs(neighbours(undone - slope())) < 0.04
    assert undone.min() >= 0 and undone.mean() == pytest.approx(light.mean(), rel=5e-3)


def test_spreading_is_what_undoing_undoes() -> None:
    plane = np.random.default_rng(2).normal(size=(*SIZE, 2)).astype(np.float32)
    pixel_filter = PixelFilter(0.5)
    spread, found = np.empty_like(plane), np.empty_like(plane)
    pixel_filter.spread(plane, spread)
    pixel_filter.undo(spread, found)
    assert neighbours(plane) < 0.03 < neighbours(spread)
    np.testing.assert_allclose(found[8:-8, 8:-8], plane[8:-8, 8:-8], atol=0.05)
    assert spread.mean() == pytest.approx(plane.mean(), abs=1e-3)


def finished(light: np.ndarray, denoised: np.ndarray | None = None) -> np.ndarray:
    """What leaves where the undone light, or another picture, is what was made of it."""
    pixel_filter = PixelFilter(0.5)
    undone, between, output = (np.empty_like(light) for _ in range(3))
    pixel_filter.undo_light(light, undone, between)
    pixel_filter.finish(light, undone, undone if denoised is None else denoised, output)
    return output


def test_a_picture_that_nothing_was_done_to_comes_back() -> None:
    """Also beside a lamp, whose light cannot all be undone."""
    light = splatted(slope(), 0.5)
    light[40:60, 40:60] += 30
    np.testing.assert_allclose(finished(light), light, rtol=1e-4, atol=1e-4)


def test_a_firefly_leaves_no_ring_where_it_was_taken_away() -> None:
    light = np.full((*SIZE, 3), 0.5, np.float32)
    light[50, 60] = 100
    found = finished(light, np.full_like(light, 0.5))
    np.testing.assert_allclose(found, 0.5, atol=0.12)


def test_light_below_0_comes_no_farther_below() -> None:
    light = np.full((*SIZE, 3), 0.5, np.float32)
    light[:, 80:, 1] = -0.2
    undone, between = np.empty_like(light), np.empty_like(light)
    PixelFilter(0.5).undo_light(light, undone, between)
    np.testing.assert_allclose(undone[:, 90:], light[:, 90:], atol=1e-5)
    assert undone[..., 0].min() > 0.49 and undone[..., 1].min() >= -0.2001


@pytest.mark.parametrize("channels", (1, 2, 3, 4))
@pytest.mark.parametrize("size", ((1, 1), (3, 50), (50, 3)))
def test_planes_of_any_shape_keep_one_value(size: tuple[int, int], channels: int) -> None:
    plane = np.full((*size, channels), 0.25, np.float32)
    pixel_filter, output = PixelFilter(0.7), np.empty_like(plane)
    for work in (pixel_filter.spread, pixel_filter.undo):
        work(plane, output)
        np.testing.assert_allclose(output, 0.25, rtol=1e-5)


def test_threads_change_no_bit() -> None:
    light = splatted(slope(), 0.5)
    planes = {Role.COLOUR: light, Role.NORMAL: light - 0.5}
    alone = PixelFilter(0.5).without(planes)
    together = PixelFilter(0.5, Device("cpu", threads=3).divide_planes).without(planes)
    assert set(alone) == set(planes)
    for role in planes:
        np.testing.assert_array_equal(alone[role], together[role])


def test_the_option_s_words() -> None:
    assert [parse_stddev(given) for given in ("auto", "none", 0.5, "0.45")] == [None, 0, 0.5, 0.45]
    for wrong in ("wide", 0.1, 3, float("nan"), None):
        with pytest.raises(PassOptionError, match="give auto, none, or the standard deviation"):
            parse_stddev(wrong)
