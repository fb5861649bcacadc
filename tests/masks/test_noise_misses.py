"""Sky and misses: left alone where they are free of noise, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest

from postfx import sampling
from postfx.frame import DEPTH_MISS, Role
from postfx.masks import misses_of, strength_of_misses
from postfx.masks.noise import misses_in_bands

SIZE = 150, 200
HORIZON = 90
"""First row of the ground."""


def sky(seed: int = 0, ground_noise: float = 0.3) -> dict[Role, np.ndarray]:
    """A sky that shades off smoothly, above noisy ground."""
    random = np.random.default_rng(seed)
    rows, columns = np.mgrid[0:SIZE[0], 0:SIZE[1]] / 100
    light = 2 + np.sin(2 * rows) + 0.5 * np.cos(3 * columns)
    colour = np.stack([0.4 * light, 0.6 * light, light], -1)
    colour[HORIZON:] = 0.5 + ground_noise * random.standard_normal((SIZE[0] - HORIZON, SIZE[1], 3))
    depth, normal = np.full((*SIZE, 1), DEPTH_MISS), np.zeros((*SIZE, 3))
    depth[HORIZON:], normal[HORIZON:] = 5, (0, 1, 0)
    planes = {Role.COLOUR: colour, Role.DEPTH: depth, Role.NORMAL: normal}
    return {role: plane.astype(np.float32) for role, plane in planes.items()}


def noisy_sky(sigma: float) -> dict[Role, np.ndarray]:
    """Light that is scattered in front of the sky: noise relative to it, alike in all channels."""
    planes = sky()
    planes[Role.COLOUR][:HORIZON] *= (1 + sigma * np.random.default_rng(1)
                                      .standard_normal((HORIZON, SIZE[1], 1)))
    return planes


def test_a_clean_sky_is_left_alone_up_to_the_horizon() -> None:
    strength = strength_of_misses(sky())
    assert strength.shape == (*SIZE, 1) and strength.dtype == np.float32
    column = strength[:, 100, 0]
    np.testing.assert_array_equal(column[:HORIZON - 6], 0)
    np.testing.assert_array_equal(column[HORIZON - 2:], 1)
    np.testing.assert_allclose(column[HORIZON - 7:HORIZON - 1], np.linspace(0, 1, 6), atol=1e-6)


@pytest.mark.parametrize("sigma", [0.03, 0.1, 1.0])
def test_fog_in_front_of_the_sky_is_denoised(sigma: float) -> None:
    np.testing.assert_array_equal(strength_of_misses(noisy_sky(sigma)), 1)


def test_noise_that_nobody_sees_is_left_alone() -> None:
    assert (strength_of_misses(noisy_sky(0.001))[:HORIZON - 8] == 0).all()


@pytest.mark.parametrize("spread", [1, 2])
def test_noise_that_a_filter_spread_is_found(spread: int) -> None:
    """Of a renderer that gives each sample to several pixels: weights 1 1, or 1 2 1, both ways."""
    planes, weights = noisy_sky(0.0), np.array([[1, 1], [1, 2, 1]][spread - 1]) / 2**spread
    noise = 0.2 * np.random.default_rng(2).standard_normal((HORIZON, SIZE[1]))
    for axis in (0, 1):
        noise = np.apply_along_axis(np.convolve, axis, noise, weights, mode="same")
    planes[Role.COLOUR][:HORIZON] *= 1 + noise[..., None].astype(np.float32)
    np.testing.assert_array_equal(strength_of_misses(planes), 1)


def test_sparse_spikes_are_denoised_all_over_when_they_are_many_and_around_them_when_few() -> None:
    """Between many spikes light is missing, so a picture without them would be too dark."""
    random = np.random.default_rng(3)
    for share, most, least in ((3e-3, 0.0, 0.0), (2e-4, 0.95, 0.5)):
        planes = sky()
        spikes = random.random((HORIZON, SIZE[1])) < share
        planes[Role.COLOUR][:HORIZON][spikes] *= 5
        strength = strength_of_misses(planes)[:HORIZON, :, 0]
        assert spikes.any() and (strength[spikes] == 1).all()
        assert least <= (strength[:HORIZON - 8] == 0).mean() <= most


def test_what_moved_in_front_of_the_sky_is_denoised_though_depth_says_miss() -> None:
    """Depth of the shutter's opening, colour of all of it: a blurred thing that covers a part of
    some samples."""
    planes, random = sky(), np.random.default_rng(4)
    covered = random.binomial(4, 0.4, (30, 40, 1)) / 4
    part = planes[Role.COLOUR][20:50, 60:100]
    part[:] = part * (1 - covered) + 0.05 * covered
    strength = strength_of_misses(planes)
    assert (strength[20:50, 60:100] == 1).all()
    assert (strength[:60, 130:] == 0).all()


def test_pixels_that_are_not_finite_are_not_left_in() -> None:
    planes = sky()
    planes[Role.COLOUR][30, 50] = np.nan
    planes[Role.COLOUR][60, 150] = np.inf
    strength = strength_of_misses(planes)
    assert strength[30, 50] == strength[60, 150] == 1 and (strength[:20, 100:120] == 0).all()


def test_a_gap_too_small_to_be_measured_is_denoised() -> None:
    planes = sky()
    planes[Role.DEPTH][:, ::9] = 3
    np.testing.assert_array_equal(strength_of_misses(planes), 1)


def test_what_counts_as_a_miss() -> None:
    planes = sky()
    missed = np.arange(SIZE[0])[:, None].repeat(SIZE[1], 1) < HORIZON
    colour, depth, normal = (planes[role] for role in (Role.COLOUR, Role.DEPTH, Role.NORMAL))
    black = np.where(missed[..., None], np.float32(0), np.float32(0.5)).repeat(3, 2)
    averaged = np.where(depth < DEPTH_MISS, depth, np.float32(DEPTH_MISS / 4))
    for found, wanted in (
        ({Role.DEPTH: depth}, missed),
        ({Role.DEPTH: depth, Role.NORMAL: np.ones_like(normal)}, False),
        ({Role.DEPTH: averaged, Role.NORMAL: normal}, False),
        ({Role.DEPTH: depth, Role.DIFFUSE_ALBEDO: np.ones_like(normal)}, missed),
        ({Role.NORMAL: normal, Role.DIFFUSE_ALBEDO: black}, missed),
        ({Role.NORMAL: normal, Role.DIFFUSE_ALBEDO: black,
          Role.SPECULAR_ALBEDO: np.ones_like(black)}, False),
        ({Role.DIFFUSE_ALBEDO: black}, False),
        ({Role.ALPHA: black[..., :1]}, missed),
        ({Role.ALPHA: black[..., :1] + 0.1, Role.DEPTH: depth}, False),
        ({Role.ALPHA: np.ones_like(depth), Role.DEPTH: depth}, missed),
        ({Role.ALPHA: np.ones_like(depth)}, False),
        ({}, False),
    ):
        np.testing.assert_array_equal(misses_of({Role.COLOUR: colour, **found}),
                                      np.broadcast_to(wanted, SIZE))


def test_smoke_with_alpha_and_without_depth_is_denoised() -> None:
    planes = sky()
    planes[Role.ALPHA] = (planes[Role.DEPTH] < DEPTH_MISS).astype(np.float32)
    planes[Role.ALPHA][20:60, 40:90] = 0.3
    strength = strength_of_misses(planes)
    assert (strength[20:60, 40:90] == 1).all() and (strength[:60, 120:] == 0).all()


def test_bands_of_rows_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    planes, calls = noisy_sky(0.008), []
    wanted = strength_of_misses(planes)
    monkeypatch.setattr(sampling, "BAND_ROWS", 16)
    found = list(misses_in_bands(planes, lambda: calls.append(1)))
    np.testing.assert_array_equal(np.concatenate([strength for _, strength, _ in found]), wanted)
    assert [rows.start for rows, _, _ in found] == list(range(0, 150, 16)) and len(calls) == 20
    assert (sum(count for _, _, count in found) == misses_of(planes).sum()
            and 0 < wanted[:60].mean() < 1)


@pytest.mark.parametrize("size", [(1, 1), (3, 40), (5, 5), (40, 2)])
def test_frames_of_any_size(size: tuple[int, int]) -> None:
    planes = {Role.COLOUR: np.ones((*size, 3), np.float32),
              Role.DEPTH: np.full((*size, 1), DEPTH_MISS, np.float32)}
    assert strength_of_misses(planes).shape == (*size, 1)
