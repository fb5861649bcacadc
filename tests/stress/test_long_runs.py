"""Long sequences: the picture does not drift, and its light neither grows nor fades.

Scenes and their noise repeat after a period, so that a frame is held to the one that saw the same
before: what is left is drift alone, without the statistical error of fresh noise. One test has
fresh noise, over hundreds of frames.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from postfx.frame import Frame, Role
from postfx.runtime import Device
from tests.passes.denoise_frames import flat
from tests.stress.bounds import bounds
from tests.stress.scenes import on, pipeline, sliding

PERIOD = 48
"""Frames after which a scene and its noise are the same again. The denoiser settles within two
periods."""
STEADY = 1e-3
"""Part by which the mean over a period changes, and by which it may exceed the scene's."""
BIAS = {0.0: 2e-3, 1.0: 0.06}
"""Noise -> part of the light that may be missing: networks trust bright samples of it less, in a
single frame, too."""
SLIGHT, WINDOW = 0.25, 480
"""Fresh noise and the frames of a mean, whose own statistical error is 0.02 per cent."""
CONSTANT = 3e-6
"""Part by which a picture of one colour differs from that colour."""
SPEEDS = pytest.mark.parametrize("speed", [0, 1], ids=["still", "moving"])
NOISES = pytest.mark.parametrize("noise", BIAS, ids=["clean", "noisy"])


def means(model: str, device: Device, frames: Iterable[Frame]) -> np.ndarray:
    """Mean of each picture."""
    chain = pipeline(model, device)
    return np.fromiter((chain(frame)[Role.COLOUR].mean(dtype=np.float64) for frame in frames),
                       float)


def rounds(model: str, device: Device, speed: int, noise: float, count: int) -> np.ndarray:
    """(count, PERIOD): mean of each picture over that of the noisy frames, of which there are
    PERIOD."""
    frames = [sliding(number, speed, noise) for number in range(PERIOD)]
    light = np.mean([frame[Role.COLOUR].mean(dtype=np.float64) for frame in frames])
    repeated = (replace(frames[number % PERIOD], number=number) for number in range(count * PERIOD))
    return means(model, device, repeated).reshape(count, PERIOD) / light


def assert_steady(model: str, device: Device, speed: int, noise: float, count: int) -> None:
    light = rounds(model, device, speed, noise, count)
    settled = light[2:]
    drift, mean = np.ptp(settled / settled[0], axis=0).max(), settled.mean(1)
    print(f"{device.name} {model}: drift {drift:.2g}, of periods {np.ptp(mean):.2g}, "
          f"light {mean.min():.5f} to {mean.max():.5f}")
    assert drift < bounds(device, model).drift and np.ptp(mean) < STEADY
    assert mean.max() < 1 + STEADY and mean.min() > 1 - BIAS[noise]


@on(cpu=("s.fp32",))
@pytest.mark.parametrize(("speed", "noise"), [
    pytest.param(speed, noise,
                 id=f"{'moving' if speed else 'still'}-{'noisy' if noise else 'clean'}",
                 marks=pytest.mark.soak if speed != noise else [])
    for speed in (0, 1) for noise in BIAS])
def test_192_frames(model: str, speed: int, noise: float, device: Device) -> None:
    assert_steady(model, device, speed, noise, 4)


@pytest.mark.soak
@on(cpu=("s.fp32", "s.int8"))
@SPEEDS
@NOISES
def test_2016_frames(model: str, speed: int, noise: float, device: Device) -> None:
    assert_steady(model, device, speed, noise, 42)


@pytest.mark.soak
@SPEEDS
def test_1968_frames_of_fresh_noise(speed: int, device: Device) -> None:
    """Means over 480 frames, each by the light that came in."""
    frames = [sliding(number, speed, SLIGHT) for number in range(PERIOD + 4 * WINDOW)]
    given = np.array([frame[Role.COLOUR].mean(dtype=np.float64) for frame in frames])
    found, given = (light[PERIOD:].reshape(4, WINDOW).mean(1)
                    for light in (means("s.fp32", device, frames), given))
    print(found / given)
    assert np.ptp(found / given) < STEADY


@on(cpu=("s.fp32", "s.int8"))
@pytest.mark.parametrize("moved", [0.0, 0.37])
def test_one_colour_stays_that_colour(model: str, moved: float, device: Device) -> None:
    """Frame after frame, also where the history is interpolated."""
    chain = pipeline(model, device)
    for number in range(100):
        frame = flat(number, 0.3)
        frame.planes[Role.MOTION][:] = moved
        np.testing.assert_allclose(chain(frame)[Role.COLOUR], 0.3, rtol=CONSTANT)
