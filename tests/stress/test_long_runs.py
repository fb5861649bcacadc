"""Long sequences: the picture does not drift, and its light neither grows nor fades."""

from __future__ import annotations

import numpy as np
import pytest

from postfx.frame import Role
from postfx.runtime import Device
from tests.stress.scenes import pipeline, sliding

DRIFT = 2e-4
"""Part of the scene's mean by which the picture's may differ from what it was when the scene looked the same before."""
BIAS = 2e-3
"""Part of the scene's mean by which the picture's may differ from it."""
NOISY = 0.02
"""Part by which means over 100 noisy frames differ at most; those of the noise itself do by one per cent."""
TREND = 5e-3
"""Part by which a line through them rises or falls over the sequence."""
SETTLED = PERIOD = 48
"""Frames after which a moving scene looks the same again."""


def means(model: str, speed: int, frames: int, device: Device, noise: float = 0.0) -> np.ndarray:
    """Mean of each picture over that of the scene."""
    chain = pipeline(model, device)
    scene = sliding(0, speed)[Role.COLOUR].mean(dtype=np.float64)
    found = (chain(sliding(n, speed, noise))[Role.COLOUR].mean(dtype=np.float64) for n in range(frames))
    return np.fromiter(found, float) / scene


def assert_steady(light: np.ndarray) -> None:
    assert np.abs(light - 1).max() < BIAS
    rounds = light[SETTLED:][: len(light[SETTLED:]) // PERIOD * PERIOD].reshape(-1, PERIOD)
    assert len(rounds) > 2 and np.ptp(rounds, axis=0).max() < DRIFT


@pytest.mark.parametrize("speed", [0, 1], ids=["still", "moving"])
def test_200_frames(speed: int, device: Device) -> None:
    assert_steady(means("s.fp32", speed, 200, device))


@pytest.mark.soak
@pytest.mark.parametrize("model", ["s.fp32", "s.int8"])
@pytest.mark.parametrize("speed", [0, 1], ids=["still", "moving"])
def test_2000_frames(model: str, speed: int, device: Device, request: pytest.FixtureRequest) -> None:
    _only_when_asked_for(request)
    assert_steady(means(model, speed, 2000, device))


@pytest.mark.soak
@pytest.mark.parametrize("speed", [0, 1], ids=["still", "moving"])
def test_2000_noisy_frames(speed: int, device: Device, request: pytest.FixtureRequest) -> None:
    _only_when_asked_for(request)
    hundreds = means("s.fp32", speed, 2000, device, noise=1.0).reshape(20, 100).mean(1)[1:]
    assert np.ptp(hundreds) < NOISY
    assert abs(np.polyfit(np.arange(hundreds.size), hundreds, 1)[0]) * hundreds.size < TREND


def _only_when_asked_for(request: pytest.FixtureRequest) -> None:
    if "soak" not in request.config.option.markexpr:
        pytest.skip("some minutes: give -m soak")
