"""Kernels around a network that sees each pixel of one scene alone: rows and CUDA, against what
they stand for."""

from __future__ import annotations

import numpy as np
import pytest

from postfx.kernels import Kernel
from postfx.kernels.scene import (
    CAMERA_PLACE,
    FARTHEST_PLACE,
    FIND_POINTS,
    LAMP_REFLECTANCE,
    LIGHT_OF_POINTS,
    POINT,
)
from postfx.passes.scene_points import places_of, reflectance_of
from postfx.runtime import ArgumentTable, Device
from postfx.runtime.device import cuda_fault
from tests.kernels import host_cuda

SIZES = ((1, 1), (7, 5), (6, 53), (20, 64))
BOX = np.float32([0.3, -0.2, 1.1, 2.5])


def arguments(kernel: Kernel, height: int, width: int) -> dict[str, np.ndarray]:
    """What a kernel reads of a picture with lamps, with places far out, and with numbers that a
    network must not give."""
    random = np.random.default_rng(height * width)
    if kernel is FIND_POINTS:
        axes = np.linalg.qr(random.normal(0, 1, (3, 3)))[0]
        camera = np.float32([*axes.ravel(), 0.5, 1.2, -2.0, 0.6, 0.35, 0.25, -0.375])
        depth = random.uniform(0.5, 4, (height, width, 1)).astype(np.float32)
        depth[::3, ::4] = 1e10
        normal = random.normal(0, 1, (height, width, 3)).astype(np.float32)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        normal[1::5] = 0
        return {"camera": camera, "box": BOX, "depth": depth, "normal": normal}
    values = random.normal(1, 2, (height * width, 3)).astype(np.float32)
    values[::7] = 1e6
    planes = {name: random.random((height, width, 3), np.float32)
              for name in ("diffuse", "specular", "colour")}
    planes["diffuse"][::2, ::3] = planes["specular"][::2, ::3] = 0.002
    return {"values": values, **planes}


def wanted_points(camera: np.ndarray, box: np.ndarray, depth: np.ndarray,
                  normal: np.ndarray) -> np.ndarray:
    """By places in the world, (height * width, 9)."""
    place = np.clip((places_of(camera, depth) - box[:3]) / box[3], -FARTHEST_PLACE, FARTHEST_PLACE)
    ray = places_of(camera, np.ones_like(depth)) - camera[CAMERA_PLACE]
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    mirrored = ray - 2 * (ray * normal).sum(-1, keepdims=True) * normal
    return np.concatenate([place, normal, mirrored], -1).reshape(-1, POINT)


def wanted_light(values: np.ndarray, diffuse: np.ndarray, specular: np.ndarray,
                 colour: np.ndarray) -> np.ndarray:
    """By NumPy, (height, width, 3)."""
    light = np.expm1(np.clip(values, 0, 20).reshape(colour.shape))
    is_lamp = (diffuse + specular).max(-1, keepdims=True) < LAMP_REFLECTANCE
    return np.where(is_lamp, colour, light * reflectance_of(diffuse, specular))


def by_device(device: Device, kernel: Kernel, inputs: dict[str, np.ndarray],
              shape: tuple[int, ...]) -> np.ndarray:
    """What a device makes of arguments."""
    (written,) = kernel.writes
    state = device.compute_state(kernel)
    tensors = {name: device.wrap(name, array) for name, array in inputs.items()}
    tensors[written] = device.wrap(written, np.full(shape, np.nan, np.float32))
    commands = device.command_buffer("scene")
    with commands.compute_encoder("scene") as encoder:
        encoder.dispatch(state, ArgumentTable(state, tensors))
    commands.commit()
    commands.wait(timeout=60)
    return tensors[written].download()


WANTED = {FIND_POINTS: wanted_points, LIGHT_OF_POINTS: wanted_light}
BOTH = pytest.mark.parametrize("kernel", WANTED, ids=lambda kernel: kernel.name)


@BOTH
@pytest.mark.parametrize("size", SIZES, ids=str)
def test_rows_make_points_and_their_light(kernel: Kernel, size: tuple[int, int]) -> None:
    """In bands, too, whose borders are anywhere."""
    inputs = arguments(kernel, *size)
    wanted = WANTED[kernel](**inputs)
    found = np.full(wanted.shape, np.nan, np.float32)
    count = len(wanted)
    for first, last in ((0, count // 3), (count // 3, count // 3 + 1), (count // 3 + 1, count)):
        kernel.rows(first, last, *inputs.values(), found)
    np.testing.assert_allclose(found, wanted, rtol=2e-5, atol=2e-5)


@pytest.mark.skipif(host_cuda.COMPILER is None, reason="no g++")
@BOTH
@pytest.mark.parametrize("size", SIZES, ids=str)
def test_cuda_makes_the_same(kernel: Kernel, size: tuple[int, int]) -> None:
    inputs = arguments(kernel, *size)
    wanted = WANTED[kernel](**inputs)
    found = np.full(wanted.shape, np.nan, np.float32)
    host_cuda.run(kernel, {**inputs, kernel.writes[0]: found})
    np.testing.assert_allclose(found, wanted, rtol=2e-5, atol=2e-5)


@BOTH
def test_light_and_points_without_numbers_stay_bounded(kernel: Kernel) -> None:
    """A network reads finite places, and gives no light where it gave no number."""
    inputs = arguments(kernel, 7, 53)
    (inputs["depth"] if kernel is FIND_POINTS else inputs["values"])[2] = np.nan
    found = np.full(WANTED[kernel](**inputs).shape, np.nan, np.float32)
    kernel.rows(0, len(found), *inputs.values(), found)
    assert np.isfinite(found).all()


@pytest.mark.parametrize("name", [
    "cpu", pytest.param("cuda", marks=[pytest.mark.gpu, pytest.mark.skipif(
        cuda_fault(0) is not None, reason="needs a GPU")])])
@BOTH
@pytest.mark.parametrize("size", SIZES, ids=str)
def test_devices_make_the_same(kernel: Kernel, size: tuple[int, int], name: str) -> None:
    inputs = arguments(kernel, *size)
    wanted = WANTED[kernel](**inputs)
    found = by_device(Device(name), kernel, inputs, wanted.shape)
    np.testing.assert_allclose(found, wanted, rtol=2e-5, atol=2e-5)
