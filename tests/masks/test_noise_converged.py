"""What has converged by its variance or its number of samples: left alone there, and nowhere
else."""

from __future__ import annotations

import numpy as np
import pytest

from postfx import sampling
from postfx.frame import Role
from postfx.masks import (
    StrengthError,
    Threshold,
    parse_leave,
    parse_threshold,
    strength_of_converged,
)
from postfx.masks.noise import converged_in_bands

SIZE = 40, 60
ONE_PERCENT = Threshold(error=0.01)
Planes = dict[Role, np.ndarray]


def rendered(error: float, samples: int = 64, seed: int = 0) -> tuple[Planes, np.ndarray]:
    """Colour whose right half has a relative standard error; and the samples' variance."""
    light = 1 + np.random.default_rng(seed).random((*SIZE, 1))
    colour = (light * (0.4, 0.7, 1.2)).astype(np.float32)
    variance = samples * (error * colour) ** 2
    variance[:, :SIZE[1] // 2] = 0
    return {Role.COLOUR: colour}, variance.astype(np.float32)


def told(role: Role, planes: Planes, variance: np.ndarray, samples: int) -> Planes:
    """The frame with its variance as a renderer may write it."""
    made = {Role.SAMPLE_VARIANCE: variance, Role.VARIANCE_OF_MEAN: variance / samples,
            Role.SECOND_MOMENT: variance * (samples - 1) / samples + planes[Role.COLOUR] ** 2}[role]
    return {**planes, role: made.astype(np.float32)}


def defined(planes: Planes, samples: int, threshold: float) -> np.ndarray:
    """By the definition, of a plane of samples' variance: pixel by pixel, in float64."""
    weights, (height, width) = np.array([0.2126, 0.7152, 0.0722]), SIZE
    power = (np.sqrt(planes[Role.SAMPLE_VARIANCE].astype(np.float64)) @ weights) ** 2 / samples
    light = planes[Role.COLOUR].astype(np.float64) @ weights

    def around(plane: np.ndarray, y: int, x: int) -> np.ndarray:
        return plane[np.ix_(np.arange(y - 2, y + 3).clip(0, height - 1),
                            np.arange(x - 2, x + 3).clip(0, width - 1))]

    def over(plane: np.ndarray, what) -> np.ndarray:
        return np.array([[what(around(plane, y, x)) for x in range(width)] for y in range(height)])

    error = np.sqrt(over(power, np.mean)) / over(light, np.mean)
    return over(over(np.clip(error / threshold - 1, 0, 1), np.max), np.mean)


@pytest.mark.parametrize("error", [0.008, 0.015, 0.05])
def test_strength_is_as_defined(error: float) -> None:
    planes, variance = rendered(error)
    planes = told(Role.SAMPLE_VARIANCE, planes, variance, 64)
    found = strength_of_converged(planes, ONE_PERCENT, 64)[:, :, 0]
    wanted = defined(planes, 64, 0.01)
    # strengths that near to 0 and 1 are 0 and 1
    np.testing.assert_allclose(found, wanted, atol=1.1e-3)
    assert (found[:, :24] == 0).all() and (found[:, 38:].mean() > 0.2) == (error > 0.01)


@pytest.mark.parametrize("role", [Role.VARIANCE_OF_MEAN, Role.SECOND_MOMENT])
def test_planes_of_all_kinds_tell_the_same(role: Role) -> None:
    planes, variance = rendered(0.015)
    wanted = strength_of_converged(told(Role.SAMPLE_VARIANCE, planes, variance, 64), ONE_PERCENT,
                                   64)
    found = strength_of_converged(told(role, planes, variance, 64), ONE_PERCENT, 64)
    np.testing.assert_allclose(found, wanted, atol=2e-3)
    assert 0 < wanted.mean() < 1


def test_the_error_of_a_picture_is_what_it_says() -> None:
    """Samples are drawn: the standard error that they tell is that of the mean, and exposure does
    not count."""
    random = np.random.default_rng(3)
    # mean 1, variance 2: error 8.8 %
    samples = random.gamma(0.5, 2.0, (256, 96, 96, 1)).astype(np.float32)
    mean, variance = samples.mean(0).repeat(3, 2), samples.var(0, ddof=1).repeat(3, 2)
    for scale in (1e-4, 1.0, 1e4):
        planes = {Role.COLOUR: mean * scale, Role.SAMPLE_VARIANCE: variance * scale**2}
        assert (strength_of_converged(planes, Threshold(error=0.13), 256) == 0).all()
        assert (strength_of_converged(planes, Threshold(error=0.06), 256) > 0).all()


def test_numbers_of_samples() -> None:
    planes, _ = rendered(0.0)
    count = np.full((*SIZE, 1), 256, np.float32)
    count[:, 30:] = 100
    found = strength_of_converged({**planes, Role.SAMPLE_COUNT: count},
                                  Threshold(samples=256))[:, :, 0]
    assert (found[:, :26] == 0).all() and found[:, 34:] == pytest.approx(0.6)
    shares = strength_of_converged({**planes, Role.SAMPLE_COUNT: count / 1024},
                                   Threshold(samples=256), 1024)
    np.testing.assert_allclose(shares[:, :, 0], found, atol=1e-6)
    for samples, wanted in ((256, 0), (1024, 0), (64, 1), (16, 1)):
        assert (strength_of_converged(planes, Threshold(samples=256), samples) == wanted).all()


def test_a_plane_of_counts_is_used_for_the_error() -> None:
    planes, variance = rendered(0.015)
    planes[Role.SAMPLE_VARIANCE] = variance
    counted = {**planes, Role.SAMPLE_COUNT: np.full((*SIZE, 1), 640, np.float32)}
    assert (strength_of_converged(counted, ONE_PERCENT, 64) == 0).all()
    assert strength_of_converged(planes, ONE_PERCENT, 64)[:, 40:].min() > 0.3


def test_nothing_is_left_alone_that_is_not_known() -> None:
    planes, variance = rendered(0.0)
    variance[20, 10], planes[Role.COLOUR][5, 50] = np.nan, np.inf
    planes[Role.SAMPLE_VARIANCE] = variance
    found = strength_of_converged(planes, ONE_PERCENT, 64)[:, :, 0]
    assert ((found[18:23, 8:13] == 1).all() and (found[3:8, 48:53] == 1).all()
            and (found[30:] == 0).all())
    assert (strength_of_converged(planes | {Role.SECOND_MOMENT: variance}, ONE_PERCENT,
                                  1)[18:23, 8:13] == 1).all()
    none = {**planes, Role.SAMPLE_COUNT: np.zeros((*SIZE, 1), np.float32)}
    assert (strength_of_converged(none, ONE_PERCENT) == 1).all()


def test_noise_counts_where_filters_made_light_negative() -> None:
    planes, variance = rendered(0.015)
    planes[Role.SAMPLE_VARIANCE] = variance
    found = strength_of_converged({**planes, Role.COLOUR: -planes[Role.COLOUR]}, ONE_PERCENT, 64)
    np.testing.assert_array_equal(found, strength_of_converged(planes, ONE_PERCENT, 64))
    assert found[:, 40:].min() > 0.3


def test_black_without_variance_has_converged() -> None:
    planes = {role: np.zeros((*SIZE, 3), np.float32)
              for role in (Role.COLOUR, Role.VARIANCE_OF_MEAN)}
    assert (strength_of_converged(planes, ONE_PERCENT) == 0).all()


def test_bands_of_rows_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    planes, variance = rendered(0.012)
    planes, calls = told(Role.SAMPLE_VARIANCE, planes, variance, 64), []
    wanted = strength_of_converged(planes, ONE_PERCENT, 64)
    monkeypatch.setattr(sampling, "BAND_ROWS", 16)
    found = list(converged_in_bands(planes, ONE_PERCENT, 64, lambda: calls.append(1)))
    np.testing.assert_array_equal(np.concatenate([strength for _, strength in found]), wanted)
    assert len(found) == len(calls) == 3


def test_entries_are_understood() -> None:
    assert [parse_threshold(entry)
            for entry in parse_leave("converged:0.01,converged:256spp=0.5")] == [
        ONE_PERCENT, Threshold(samples=256)]


@pytest.mark.parametrize("text", ["converged", "converged:", "converged:x", "converged:-1",
                                  "converged:nan", "converged:inf", "converged:0spp",
                                  "converged:2.5spp", "converged:0.01@variance"])
def test_entries_without_a_threshold_are_errors(text: str) -> None:
    with pytest.raises(StrengthError,
                       match="give a relative error, such as converged:0.01, or a number of "
                       "samples"):
        parse_threshold(parse_leave(text)[0])


@pytest.mark.parametrize(("threshold", "roles", "message"), [
    (ONE_PERCENT, (),
     "the error is unknown: render an AOV sample_variance, second_moment, variance_of_mean, or"),
    (ONE_PERCENT, (Role.SAMPLE_VARIANCE,),
     "AOV 'sample_variance' gives the error only with the number of samples"),
    (Threshold(samples=64), (Role.VARIANCE_OF_MEAN,),
     "the number of samples is unknown: render the AOV"),
])
def test_what_is_missing_is_told(threshold: Threshold, roles: tuple[Role, ...],
                                 message: str) -> None:
    with pytest.raises(StrengthError, match=message):
        strength_of_converged({role: np.zeros((8, 8, 3), np.float32)
                               for role in (Role.COLOUR, *roles)}, threshold)
