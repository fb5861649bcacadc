"""Frames that change their size while the output keeps its own."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from postfx.errors import FrameError, GuideError, PassOptionError
from postfx.frame import Frame, Role
from postfx.integrate import jitter_sequence
from postfx.passes import MOST_SIZES
from postfx.passes.denoise import DenoiseUpscale
from postfx.passes.denoise.assembly import FrameNetworks
from postfx.passes.denoise.geometry import Sizes
from postfx.passes.denoise.history import STATE_CHANNELS, Room
from postfx.pipeline import Pipeline
from postfx.runtime import Device
from tests.passes.denoise_frames import PLANES, guided, noisy

COUNT = 12
OUTPUT = 192, 108
SIZES = (96, 54), (80, 45), (64, 36)
PAN = np.array([0.011, 0.004])
"""Parts of the picture's width that it moves by in a frame."""


@pytest.fixture(scope="module")
def device() -> Device:
    return Device("cpu", threads=2)


def albedo_at(x: np.ndarray, y: np.ndarray, number: int) -> np.ndarray:
    """A panned picture of stripes and discs, (..., 3); x and y in parts of its width."""
    x, y = x + number * PAN[0], y + number * PAN[1]
    stripes = 0.5 + 0.5 * np.tanh(8 * np.sin(40 * x + 6 * np.sin(9 * y)))
    discs = np.hypot(np.mod(x, 0.2) - 0.1, np.mod(y, 0.2) - 0.1) < 0.06
    return np.stack([0.1 + 0.7 * stripes, np.where(discs, 0.8, 0.3), 0.2 + 0.3 * stripes * discs],
                    -1)


def light_at(x: np.ndarray, y: np.ndarray, number: int) -> np.ndarray:
    x = x + number * PAN[0]
    return (0.6 + 0.4 * np.sin(7 * x) * np.cos(5 * y))[..., None]


def places(width: int, height: int, jitter: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    columns, rows = np.arange(width) + 0.5 + jitter[0], np.arange(height) + 0.5 + jitter[1]
    return tuple(np.meshgrid(columns / width, rows / width))


@cache
def panned(number: int, size: tuple[int, int]) -> Frame:
    """A frame of the picture: point samples, as noisy as of two light paths a pixel."""
    jitter = jitter_sequence(16)[number]
    at = places(*size, jitter)
    random, albedo = np.random.default_rng([number, *size]), albedo_at(*at, number)
    planes = {Role.COLOUR: albedo * light_at(*at, number)
                           * random.gamma(2, 0.5, (*albedo.shape[:2], 1)),
              Role.DIFFUSE_ALBEDO: albedo, Role.DEPTH: np.full(albedo.shape[:2], 3.0),
              Role.MOTION: np.broadcast_to(PAN * size[0], (*albedo.shape[:2], 2)),
              Role.NORMAL: np.broadcast_to([0.0, 0.0, 1.0], albedo.shape)}
    return Frame(planes, number, tuple(jitter))


@cache
def truth(number: int) -> np.ndarray:
    """The picture at output size, averaged over its pixels."""
    offsets = (np.mgrid[0:4, 0:4].reshape(2, -1).T + 0.5) / 4 - 0.5
    at = [places(*OUTPUT, offset) for offset in offsets]
    return np.mean([albedo_at(*each, number) * light_at(*each, number) for each in at], 0)


def errors(frames: list[Frame], device: Device, **options) -> list[float]:
    """PSNR of each output, dB."""
    pipeline = Pipeline([DenoiseUpscale(size=OUTPUT, **options)], device, exposure=0.0, cuts="none")
    outputs = [pipeline(frame)[Role.COLOUR] for frame in frames]
    return [-10 * math.log10(np.mean((colour - truth(frame.number)) ** 2))
            for colour, frame in zip(outputs, frames, strict=True)]


@pytest.fixture(scope="module", params=["s", pytest.param("m", marks=pytest.mark.soak)])
def steady(request: pytest.FixtureRequest,
           device: Device) -> tuple[str, dict[tuple[int, int], list[float]]]:
    """A model, and its PSNR of each frame where all have one size."""
    return request.param, {size: errors([panned(number, size) for number in range(COUNT)], device,
                                        model=request.param)
                           for size in SIZES}


@pytest.mark.parametrize("every", [1, 3])
def test_a_change_of_size_costs_next_to_nothing(every: int, steady: tuple, device: Device) -> None:
    """Frames are as good as where all have the size of one of the last three, and much better than
    after cuts."""
    model, alike = steady
    sizes = [SIZES[number // every % len(SIZES)] for number in range(COUNT)]
    frames = [panned(number, size) for number, size in enumerate(sizes)]
    changes = [number for number in range(3, COUNT) if sizes[number] != sizes[number - 1]]
    found = errors(frames, device, model=model)
    cut = errors([replace(frame, reset=frame.number in changes) for frame in frames], device,
                 model=model)
    least = {number: min(alike[size][number] for size in sizes[number - 2:number + 1])
             for number in changes}
    assert all(found[number] > least[number] - 0.5 for number in changes), (found, least)
    assert np.mean([found[number] - cut[number] for number in changes]) > 1.5, (found, cut)


def test_what_a_size_needs_is_made_once_and_the_rest_is_let_go(
        device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    made, original = [], FrameNetworks.__init__

    def noted(self: FrameNetworks, device: Device, sizes: Sizes, *rest, **options) -> None:
        made.append(sizes.render.width)
        original(self, device, sizes, *rest, **options)

    monkeypatch.setattr(FrameNetworks, "__init__", noted)
    upscaler = DenoiseUpscale(size=OUTPUT, model="s")
    pipeline, used = Pipeline([upscaler], device, exposure=0.0), []
    for width in (96, 80, 64, 80, 96, 64, 96) + (92, 88, 84, 76, 72, 68, 96) * 2:
        pipeline(noisy(1, round(width * 9 / 16), width))
        used.append(device.heap.used)
    assert made == [96, 80, 64] + [92, 88, 84, 76, 72, 68, 96] * 2
    assert len(upscaler._sizes) == MOST_SIZES and abs(used[-1] - used[13]) < 0.01 * used[-1]
    (line,) = [line for line in pipeline.savings() if "change" in line.what]
    assert line.what == "preparation at 4 of 20 changes of size in denoise_upscale"


def test_the_history_has_room_for_larger_frames_too(device: Device) -> None:
    """From small to large and back: as much is known of a pixel as before, or more."""
    upscaler = DenoiseUpscale(size=OUTPUT, model="m")
    pipeline, counts = Pipeline([upscaler], device, exposure=0.0, cuts="none"), []
    for number, size in enumerate((SIZES[2], SIZES[2], SIZES[0], SIZES[1], SIZES[0])):
        pipeline(panned(number, size))
        state = upscaler._history.next["next_state"].download()
        assert state.shape[:2] == size[::-1] and np.isfinite(state).all()
        counts.append(np.median(state[..., 3]))
    assert counts[0] == 1 and min(counts[2:]) > 1.2, counts


def test_nothing_of_the_memory_is_taken_for_another_size() -> None:
    room = Room(Device("cpu", threads=1), 12, STATE_CHANNELS)
    wide, high = room.of((2, 6)), room.of((4, 3))
    assert wide["state"].shape == (2, 6, 12) and high["last_depth"].shape == (4, 3, 1)
    assert room.of((2, 6)) is wide


def test_a_reset_at_a_change_of_size_drops_the_history(device: Device) -> None:
    before, after = noisy(1, 54, 96), noisy(2, 45, 80, reset=True)
    pipelines = [Pipeline([DenoiseUpscale(size=OUTPUT)], device, exposure=0.0) for _ in range(2)]
    pipelines[0](before)
    np.testing.assert_array_equal(*(pipeline(after)[Role.COLOUR] for pipeline in pipelines))


def test_with_a_mask_alpha_a_budget_and_guides(device: Device) -> None:
    upscaler = DenoiseUpscale(size=OUTPUT, budget=1000)
    pipeline = Pipeline([upscaler], device, exposure=0.0)
    for number, (width, height) in enumerate(SIZES * 2):
        frame = noisy(number, height, width, (*PLANES, Role.ALPHA))
        frame.planes[Role.STRENGTH] = np.zeros((height, width, 1), np.float32)
        frame.planes[Role.STRENGTH][:, : width // 3] = 1
        result = pipeline(guided(frame, *OUTPUT[::-1]))
        assert (result.spec.width == OUTPUT[0] and np.isfinite(result[Role.COLOUR]).all()
                and Role.ALPHA in result)
    assert upscaler.choice == "m"


def test_without_a_network_only_the_input_is_resampled(device: Device) -> None:
    pipeline = Pipeline([DenoiseUpscale(size=OUTPUT, strength=0)], device, exposure=0.0)
    assert all(pipeline(panned(0, size))[Role.COLOUR].shape[1::-1] == OUTPUT for size in SIZES)


def test_by_portable_kernels(device: Device) -> None:
    portable = Device("cpu", threads=2, compiled_kernels=False)
    frames = [panned(0, SIZES[1]), panned(1, SIZES[0]), panned(2, SIZES[2])]
    results = []
    for place in (device, portable):
        pipeline = Pipeline([DenoiseUpscale(size=OUTPUT, model="s.fp32")], place, exposure=0.0)
        results.append([pipeline(frame)[Role.COLOUR] for frame in frames][-1])
    np.testing.assert_allclose(*results, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("size", [(96, 54), (95, 54), (192, 108), (64, 36), (88, 50), (160, 89)])
def test_sizes_of_about_its_aspect_fit(size: tuple[int, int]) -> None:
    width, height = size
    assert DenoiseUpscale(size=OUTPUT).reflect(noisy(1, height, width).spec).output.width == 192


@pytest.mark.parametrize(("size", "message"), [
    ((96, 60), "shot.exr: 96x60 does not have the proportions of 192x108, overscan included: "
     "give a size like 192x120, or render at 96x54"),
    ((72, 54), "the proportions of"),
    ((48, 27), "48x27 cannot become 192x108: frames are enlarged up to 3 times, and never "
     "reduced: render at 64x36 to 192x108"),
    ((384, 216), "cannot become 192x108"),
])
def test_other_frames_are_errors(size: tuple[int, int], message: str) -> None:
    frame = replace(noisy(1, size[1], size[0]), source="shot.exr")
    with pytest.raises(FrameError, match=message):
        Pipeline([DenoiseUpscale(size=OUTPUT)]).explain(frame.spec)


def test_guides_of_another_size_are_an_error() -> None:
    frame = guided(noisy(1, 54, 96), 54, 96)
    with pytest.raises(GuideError,
                       match="guides are 96x54, the output is 192x108: render them at its size"):
        DenoiseUpscale(size=OUTPUT).reflect(frame.spec)


@pytest.mark.parametrize(("options", "message"), [
    ({"size": (192, 108), "scale": 2}, "has a scale and a size: give one of them"),
    ({"size": (192,)}, "cannot make the size"),
    ({"size": (192, 0)}, "give width and height in pixels"),
    ({"size": (192, 10.5)}, "give width and height in pixels"),
])
def test_options_that_cannot_be(options: dict, message: str) -> None:
    with pytest.raises(PassOptionError, match=message):
        DenoiseUpscale(**options)


def test_frames_that_differ_in_more_than_size_begin_anew(device: Device) -> None:
    upscaler = DenoiseUpscale(size=OUTPUT, model="s")
    pipeline = Pipeline([upscaler], device, exposure=0.0)
    pipeline(panned(0, SIZES[0]))
    fewer = panned(1, SIZES[1])
    del fewer.planes[Role.NORMAL]
    pipeline(fewer)
    assert len(upscaler._sizes) == 1
    assert "stays 192x108 where frames change their size" in str(pipeline.plan)
