"""Sequences of frames that no renderer should write, denoised in both directions."""

from __future__ import annotations

from contextlib import contextmanager

import numpy as np

from postfx.frame import Frame, Role
from postfx.io.read_options import ReadOptions
from postfx.passes.composite import BothWays
from postfx.passes.denoise import DenoiseUpscale
from postfx.pipeline import Pipeline
from postfx.runtime import Device
from postfx.temporal.reverse_order import Backwards
from postfx.tools.bench.stress import BRIGHTEST_OUTPUT, HARD
from tests.passes.denoise_frames import flat, noisy
from tests.stress.scenes import SIZES, on


class Held:
    """Frames in memory, read as those of a `Sequence`."""

    def __init__(self, frames: list[Frame]) -> None:
        self._frames = {frame.number: frame for frame in frames}
        self.numbers = tuple(self._frames)
        self.options = ReadOptions()

    def read(self, number: int, planes=None, guides=None) -> Frame:
        return self._frames[number]

    def reader(self) -> Held:
        return self

    def rewind(self) -> None:
        pass

    def __len__(self) -> int:
        return len(self.numbers)

    def after(self, number: int, count: int) -> list[int]:
        return [other for other in self.numbers if number < other <= number + count]

    def before(self, number: int, count: int) -> list[int]:
        return [number - 1]

    @contextmanager
    def open(self, number: int):
        yield self
        assert number in self._frames

    def spec(self):
        return next(iter(self._frames.values())).spec


def both_ways(
    frames: list[Frame], model: str, device: Device, exposure: str | float = "auto"
) -> list[np.ndarray]:
    """Exposed colours of frames in order."""
    later = Backwards(Held(frames), device, exposure, "none", model=model)
    passes = Pipeline([DenoiseUpscale(model=model), BothWays()], device, exposure, "none")
    return [passes(later(frame))[Role.COLOUR] * np.float32(passes.exposure_factor)
            for frame in frames]


BOTH = on(cpu=("s.fp32",))


@BOTH
def test_light_is_finite_and_in_range(model: str, device: Device) -> None:
    """Also in frames beside hard ones, which have them in their history or ahead; half of the
    inputs."""
    for name, change in list(HARD.items())[::2]:
        hard = [change(noisy(number, 24, 32)) for number in (2, 3)]
        frames = [noisy(1, 24, 32), *hard, noisy(4, 24, 32)]
        frames = [frame for frame in frames if frame.spec == frames[1].spec]
        for frame, colour in zip(frames, both_ways(frames, model, device), strict=True):
            assert np.isfinite(colour).all(), (name, frame.number)
            assert colour.min() >= 0 and colour.max() <= BRIGHTEST_OUTPUT, (name, frame.number)


@BOTH
def test_both_ways_run_at_every_size(model: str, device: Device) -> None:
    for size in SIZES[::2]:
        for colour in both_ways([noisy(number, *size) for number in (1, 2, 3)], model, device):
            assert colour.shape == (*size, 3) and np.isfinite(colour).all(), size


@BOTH
def test_grey_stays_grey_and_as_bright_as_it_is(model: str, device: Device) -> None:
    for colour in both_ways([flat(number, 0.5) for number in range(1, 7)], model, device, 0.0):
        np.testing.assert_allclose(colour, 0.5, rtol=5e-3)


@BOTH
def test_a_bad_pixel_stays_where_it_is(model: str, device: Device) -> None:
    frames = [flat(number, 0.5, 96, 128) for number in range(1, 5)]
    clean = both_ways(frames, model, device, 0.0)
    frames[1].planes[Role.COLOUR][40, 60] = np.nan
    frames[2].planes[Role.MOTION][40, 60] = np.inf
    for before, after in zip(clean, both_ways(frames, model, device, 0.0), strict=True):
        changed = np.abs(after - before).max(-1) > 1e-3
        changed[60:100, 100:140] = False
        assert not changed.any()
