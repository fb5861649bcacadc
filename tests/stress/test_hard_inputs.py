"""Every pass on frames that no renderer should write: what comes out is finite and in range."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from postfx.frame import Frame, Role
from postfx.io.sequence import read_sequence
from postfx.passes import Pass
from postfx.passes.composite import Overlay
from postfx.passes.display import Display, View
from postfx.passes.tonemap import ToneMap
from postfx.pipeline import Pipeline
from postfx.runtime import Device, Library
from postfx.tools.bench.stress import (
    BRIGHTEST_OUTPUT,
    HARD,
    LIGHT_CHANGES,
    Outcome,
    as_dict,
    as_text,
    stress,
    tags,
)
from tests.passes.denoise_frames import noisy
from tests.stress.scenes import ROOM, SIZES, held, on, pipeline

NAMES = Library().names()
DISPLAYS = {
    "tonemap": lambda: ToneMap(), "tonemap, a network": lambda: ToneMap(look="local"),
    "tonemap, a network that exposes": lambda: ToneMap(look="auto"), "view": lambda: View(),
    "view for HDR": lambda: View(view="reinhard", display="pq"), "display": lambda: Display(),
    "display for HDR": lambda: Display(display="hlg"),
}


@pytest.fixture(scope="module", params=DISPLAYS)
def shown(request: pytest.FixtureRequest, device: Device) -> Pipeline:
    return Pipeline([DISPLAYS[request.param]()], device, cuts="none")


def assert_light(colour: np.ndarray, exposure: float, name: str = "") -> None:
    assert np.isfinite(colour).all(), name
    assert colour.min() >= 0 and colour.max() * exposure <= BRIGHTEST_OUTPUT, name


@on()
def test_denoised_light_is_finite_and_in_range(model: str, device: Device) -> None:
    """Also the frame after, which has such a history."""
    for name, change in HARD.items():
        denoiser = held(model, device)
        for frame in [change(noisy(number, 24, 32)) for number in (1, 2)] + [noisy(3, 24, 32)]:
            assert_light(denoiser(frame)[Role.COLOUR], denoiser.exposure_factor, name)


def test_shown_light_is_within_the_display(shown: Pipeline) -> None:
    for name, change in LIGHT_CHANGES.items():
        shown.reset()
        colour = shown(Frame({Role.COLOUR: change(noisy(1, 24, 32))[Role.COLOUR]}))[Role.COLOUR]
        assert np.isfinite(colour).all() and colour.min() >= 0 and colour.max() <= 1, name


@pytest.mark.parametrize(("scale", "sizes"),
                         [(1, SIZES[3:5]), (1.5, SIZES[5:7]), (2, SIZES), (3, SIZES[::3])])
def test_all_passes_run_at_every_size(scale: float, sizes: tuple[tuple[int, int], ...],
                                      device: Device) -> None:
    chain = Pipeline([*pipeline("s.fp32", device, scale=scale).passes, ToneMap(),
                      Display(display="p3")], device)
    for size in sizes:
        for number in (1, 2):
            colour = chain(noisy(number, *size))[Role.COLOUR]
            assert colour.shape == (round(size[0] * scale), round(size[1] * scale), 3)
            assert np.isfinite(colour).all() and colour.min() >= 0 and colour.max() <= 1, size


def test_overlays_and_alpha(device: Device) -> None:
    """Resampled to the output's size and composited, broken overlays cover nothing that is
    finite."""
    passes: list[Pass] = [*pipeline("s.fp32", device).passes, Overlay()]
    chains = Pipeline(passes, device), Pipeline([Overlay()], device)
    for bad in (np.nan, np.inf, -np.inf, -1.0, 1e-42, 65504.0, 1e10):
        frame = noisy(1, 24, 32, (Role.COLOUR, Role.ALPHA))
        overlay = np.random.default_rng(1).random((24, 32, 4), np.float32)
        overlay[::3, ::2] = bad
        overlay[1::3, ::2, 3] = bad
        frame = replace(frame, planes={**frame.planes, Role.OVERLAY: overlay})
        for chain in chains:
            chain.reset()
            result = chain(frame)
            assert np.isfinite(result[Role.COLOUR]).all(), bad
            assert result[Role.ALPHA].min() >= 0 and result[Role.ALPHA].max() <= 1, bad


@on()
def test_resets_in_turn(model: str, device: Device) -> None:
    """A frame that begins a shot is the same whatever came before it."""
    frames = [replace(noisy(number % 3, 24, 32), number=number, reset=number % 2 == 0)
              for number in range(8)]
    chain = pipeline(model, device)
    fresh = [chain(frame)[Role.COLOUR] for frame in frames[4:6]]
    found = [chain(frame)[Role.COLOUR] for frame in frames]
    np.testing.assert_array_equal(found[0], found[6])
    np.testing.assert_array_equal(found[4:6], fresh)
    assert all(np.isfinite(colour).all() for colour in found)


def test_strength_0_keeps_hard_light(device: Device) -> None:
    """Only resampled: exactly the light that came in, up to the largest float, where it is the same
    all over."""
    chain = pipeline("s.fp32", device, strength=0.0)
    for value in (0.0, 1e-42, 65504.0, 1e10, 1e37):
        frame = Frame({Role.COLOUR: np.full((5, 7, 3), value, np.float32)})
        np.testing.assert_allclose(chain(frame)[Role.COLOUR], np.float32(value), rtol=1e-6)


@on()
def test_a_plane_of_strength_1_changes_no_bit(model: str, device: Device) -> None:
    """Nothing is blended then; where one pixel of it is less, the rest of the frame is as it
    was."""
    frames = [noisy(number, 24, 32) for number in range(4)]
    strength = [np.ones((24, 32, 1), np.float32) for _ in frames]
    strength[2][0, 0] = 0.5
    masked = [replace(frame, planes={**frame.planes, Role.STRENGTH: plane})
              for frame, plane in zip(frames, strength, strict=True)]
    chain = pipeline(model, device)
    wanted = [chain(frame)[Role.COLOUR] for frame in frames]
    chain.reset()
    found = [chain(frame)[Role.COLOUR] for frame in masked]
    assert [np.array_equal(*pair) for pair in zip(found, wanted, strict=True)] == [True, True,
                                                                                   False, True]
    np.testing.assert_array_equal(found[2][8:, 8:], wanted[2][8:, 8:])


def test_dim_light_after_bright_light_is_not_negative(device: Device) -> None:
    """Differences of logarithms of light 16 stops apart are rounded."""
    first, second, last = list(read_sequence(ROOM / "noisy.####.exr", "1-3"))
    chain = pipeline("s.fp32", device, "auto")
    for frame in (LIGHT_CHANGES["largest half"](first), LIGHT_CHANGES["largest half"](second),
                  last):
        assert_light(chain(frame)[Role.COLOUR], chain.exposure_factor)


@on(cpu=("s.int8", "s.int8.1x"), gpu=("s.fp16", "s.fp16.1x"))
def test_report_of_all_hard_inputs(model: str, device: Device) -> None:
    found = list(stress([noisy(1, 12, 16), noisy(2, 12, 16)], device, [model]))
    assert [one.case for one in found] == list(HARD) and all(one.well for one in found)
    assert as_text(found) == f"{model}: {len(HARD)} of {len(HARD)} hard inputs give light in range"
    worse = [*found[:-1], Outcome(model, "everything NaN", float("nan"), False)]
    assert as_text(worse).endswith("\n  everything NaN: not in range, largest exposed light nan")
    assert as_dict(found)["well"] and not as_dict(worse)["well"]
    assert as_dict(worse)["outcomes"][-1]["highest"] is None


@pytest.mark.parametrize(("device", "fast"),
                         [("cpu", "int8"), pytest.param("gpu", "fp16", marks=pytest.mark.gpu)],
                         indirect=["device"])
def test_networks_of_the_report_are_those_of_the_device(fast: str, device: Device) -> None:
    every = [f"{size}.{precision}{ending}" for size in ("s", "m", "l", "xl")
             for precision in ("fp32", fast) for ending in ("", ".1x")]
    wanted = [tag for tag in every
              if f"denoise_upscale.{tag.replace('.fp32', '')}" in NAMES]
    assert sorted(tags(device)) == sorted(wanted)
