"""Tiles of one pixel: masks that leave one, frames whose last tile is one, and pictures made of
them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from postfx.frame import Frame, Role
from postfx.kernels.denoise.output import ASSEMBLE
from postfx.passes.denoise.geometry import SIDE_MULTIPLE
from postfx.runtime import Device
from postfx.tools.bench.baselines import HostKernels
from tests.kernels import host_cuda
from tests.passes.denoise_frames import noisy
from tests.passes.test_denoise_strength_golden import blended64
from tests.stress.bounds import bounds
from tests.stress.scenes import colours, on, portable

SIZE = 10 * SIDE_MULTIPLE + 1, 16 * SIDE_MULTIPLE + 1
"""Of a frame whose last tile is one pixel."""
PIXELS = {"in the middle": (80, 100), "first": (0, 0), "last": (-1, -1), "last of a row": (47, -1)}


def with_strength(frame: Frame, strength: np.ndarray | float) -> Frame:
    plane = np.broadcast_to(np.float32(strength), (*frame[Role.COLOUR].shape[:2], 1))
    return replace(frame, planes={**frame.planes, Role.STRENGTH: plane.copy()})


def shown(colour: np.ndarray) -> np.ndarray:
    return colour / (1 + colour)


@on(cpu=("s.fp32", "s.int8", "m.fp32", "m.int8"), gpu=("s.fp32", "s.fp16", "m.fp32", "m.fp16"))
@pytest.mark.parametrize("place", [
    pytest.param(place, marks=[] if place in ("in the middle", "last") else pytest.mark.soak)
    for place in PIXELS])
def test_a_mask_of_one_pixel(place: str, model: str, device: Device) -> None:
    """It is as in the whole frame."""
    mask = np.zeros((*SIZE, 1))
    mask[PIXELS[place]] = 1
    frame = noisy(1, *SIZE)
    masked = with_strength(frame, mask)
    (whole,), (found,), (plain,) = (colours([one], model, device)
                                    for one in (frame, masked, with_strength(frame, 0)))
    wanted, near = blended64(masked, whole), bounds(device, model).near
    assert np.abs(shown(wanted) - shown(plain)).max() > 10 * near
    error = np.abs(shown(found) - shown(wanted)).max()
    print(f"{device.name} {model}: near {error:.2g}")
    assert error < near


@on(cpu=("s.fp32", "s.int8", "m.fp32", "m.int8"), gpu=("s.fp32", "s.fp16", "m.fp32", "m.fp16"))
def test_rows_below_a_mask(model: str, device: Device) -> None:
    """Those with strength are as in the whole frame, the others as without any."""
    mask = np.arange(SIZE[0])[:, None, None] >= 119
    frame = noisy(1, *SIZE)
    some = (frame, with_strength(frame, mask), with_strength(frame, 0))
    (whole,), (found,), (plain,) = (colours([one], model, device) for one in some)
    wanted, near = blended64(some[1], whole), bounds(device, model).near
    error = np.abs(shown(found) - shown(wanted)).max()
    print(f"{device.name} {model}: near {error:.2g}")
    assert error < near
    np.testing.assert_array_equal(found[:2 * 117], plain[:2 * 117])


@pytest.mark.parametrize("size", [(1, 1), (1, 300), (300, 1), (17, 17)], ids=str)
@pytest.mark.parametrize("strength", [0.0, 0.5, 1.0])
def test_small_frames_with_masks_and_within_a_budget(size: tuple[int, int], strength: float,
                                                     cpu: Device) -> None:
    frames = [with_strength(noisy(number, *size), strength) for number in (1, 2)]
    for frame in frames:
        frame[Role.STRENGTH][0, 0] = 1
    tight = Device("cpu", threads=2, memory="560M")
    for found, wanted in zip(colours(frames, "s.fp32", tight), colours(frames, "s.fp32", cpu),
                             strict=True):
        assert np.isfinite(found).all()
        np.testing.assert_allclose(found, wanted, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("way", ["compiled", "portable", "CUDA"])
def test_a_picture_of_tiles_of_one_pixel(way: str, cpu: Device) -> None:
    height, width = 3, 5
    wanted = np.random.default_rng(1).random((height, width, 4), np.float32)
    boxes = [(y, x, y, x, y + 1, x + 1, y, x, y + 1, x + 1) for y in range(height)
             for x in range(width)]
    inputs = {"tiles": wanted.reshape(-1, 1, 1, 4).copy(), "places": np.float32(boxes),
              "frame_rows": np.arange(height, dtype=np.float32),
              "frame_columns": np.arange(width, dtype=np.float32)}
    found = np.full_like(wanted, np.nan)
    if way == "compiled":
        ASSEMBLE.rows(0, height, *inputs.values(), found)
    elif way == "portable":
        found = HostKernels(portable(cpu)).run(ASSEMBLE, inputs, found.shape)
    elif host_cuda.COMPILER:
        host_cuda.run(ASSEMBLE, inputs | {"picture": found})
    else:
        pytest.skip("no g++")
    np.testing.assert_array_equal(found, wanted)
