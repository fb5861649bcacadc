"""Frames between frames on a GPU against those on the CPU: kernels run on the host here, and on a
GPU where one is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from postfx import Between, Device, DeviceInterpolator, Interpolator
from postfx.errors import DeviceError, FrameError
from postfx.frame import Frame, Role
from postfx.kernels import Kernel
from postfx.runtime import device as device_module
from postfx.runtime.device import ProviderMemory, cuda_fault
from postfx.runtime.memory import CUDA
from postfx.runtime.session import Placement
from tests.kernels import host_cuda

Scene = Callable[..., Frame]


@pytest.fixture
def emulated(monkeypatch: pytest.MonkeyPatch) -> Device:
    """A device that says that it is a GPU, and runs CUDA kernels on the host."""
    if host_cuda.COMPILER is None:
        pytest.skip("no g++")

    class Away(ProviderMemory):
        def __init__(self, placement: Placement) -> None:
            super().__init__(placement)
            self.place, self.host_visible = (CUDA, 0), True

    placement = Placement("CPUExecutionProvider", "cpu", 0, 1)
    monkeypatch.setattr(device_module, "choose", lambda *rest: (placement, Away(placement)))
    device = Device("auto", threads=1)
    make = device._make_state

    def by_cuda(kernel: Kernel) -> object:
        names = tuple(dict.fromkeys(kernel.reads + kernel.writes))
        return make(replace(kernel, rows=lambda first, last, *arrays: host_cuda.run(
            kernel, dict(zip(names, arrays, strict=True)))))

    monkeypatch.setattr(device, "_make_state", by_cuda)
    return device


def planes_of(frame: Frame) -> dict[Role, np.ndarray]:
    return {role: np.ascontiguousarray(plane) for role, plane in frame.planes.items()}


def turning(size: tuple[int, int], angle: float, number: int) -> Frame:
    """A textured plane that has turned so far about its middle, with a bar in front that stands
    still; noisy, and with motion from a frame earlier by one angle."""
    y, x = np.indices(size, np.float32)
    v, u = y - size[0] / 2, x - size[1] / 2

    def turned(by: float) -> tuple[np.ndarray, np.ndarray]:
        return u * np.cos(by) - v * np.sin(by), u * np.sin(by) + v * np.cos(by)

    (p, q), (back_u, back_v) = turned(-angle * number), turned(-angle)
    bar = np.abs(u - 9 * np.sin(number)) < 5
    waves = [np.sin(0.5 * p + k) * np.cos(0.4 * q - k) for k in range(3)]
    colour = np.exp(np.where(bar[..., None], 2.5, np.stack(waves, -1)))
    colour *= np.random.default_rng(number).uniform(0.9, 1.1, colour.shape)
    motion = np.stack([back_u - u, back_v - v], -1)
    motion[bar] = 9 * (np.sin(number - 1) - np.sin(number)), 0
    depth = np.where(bar, 1, 8 + 0.05 * v)[..., None]
    normal = np.stack([np.sin(0.1 * u), np.cos(0.1 * v), np.where(bar, 0.0, 1.0)], -1)
    planes = {Role.COLOUR: colour, Role.MOTION: motion, Role.DEPTH: depth, Role.NORMAL: normal}
    return Frame({role: plane.astype(np.float32) for role, plane in planes.items()}, number=number,
                 jitter=(0.3 * (number % 2), -0.2))


def assert_alike(found: dict[Role, np.ndarray], wanted: Frame) -> None:
    """But for a few pixels whose choice hangs on a rounding."""
    for role, plane in found.items():
        apart = np.abs(plane - wanted[role]) > 1e-3 * (1e-2 + np.abs(wanted[role]))
        assert apart.mean() < 2e-3, (role, apart.mean())


def follow(device: Device, frames: list[Frame], t: float, previous: float) -> None:
    """Every frame between, on the device and on the CPU; arrays that were pushed change, but for
    normals."""
    stream, wanted = DeviceInterpolator(device), Interpolator(flow=False)
    for number, frame in enumerate(frames):
        planes = {role: plane.copy() for role, plane in planes_of(frame).items()}
        stream.push(planes, jitter=frame.jitter, reset=frame.reset)
        for role in planes.keys() - {Role.NORMAL}:
            planes[role][:] = np.nan
        wanted.push(frame)
        assert stream.ready == (number > 0)
        if number:
            found = {role: tensor.download() for role, tensor in stream.frame(t, previous).items()}
            assert wanted.between is not None and wanted.between.reason is None
            assert_alike(found, wanted.between.frame(t, previous=previous))


@pytest.mark.parametrize("size", [
    (90, 131), pytest.param((64, 65), marks=pytest.mark.soak), (33, 40)])
def test_the_same_frames_as_on_the_cpu(emulated: Device, size: tuple[int, int]) -> None:
    """Of what turns, so that paths bend, behind something that hides it; odd sizes, and pixels as
    cells."""
    follow(emulated, [turning(size, 0.15, number) for number in range(1, 4)], 0.3, -0.2)


def test_a_frame_stays_until_the_second_call_after(emulated: Device, scene: Scene) -> None:
    stream = DeviceInterpolator(emulated)
    for number in range(2):
        stream.push(planes_of(scene(number)))
    first = stream.frame(0.25)[Role.COLOUR]
    held = first.download()
    second = stream.frame(0.75)[Role.COLOUR].download()
    np.testing.assert_array_equal(first.download(), held)
    assert not np.array_equal(second, held)
    assert np.array_equal(stream.frame(0.5)[Role.COLOUR].download(),
                          first.download()), "the place of the first"


def test_what_is_not_finite_is_black_and_harmless(emulated: Device, scene: Scene) -> None:
    frames = [scene(0), scene(1)]
    for frame in frames:
        frame[Role.COLOUR][20:22, 30:33], frame[Role.COLOUR][40, 5] = np.nan, np.inf
        frame[Role.MOTION][50:52, 60:64], frame[Role.MOTION][10, 10] = np.nan, 1e6
        frame[Role.DEPTH][30:32, 70:74] = np.nan
    stream = DeviceInterpolator(emulated)
    for frame in frames:
        stream.push(planes_of(frame))
    found = {role: tensor.download() for role, tensor in stream.frame(0.5).items()}
    assert np.isfinite(found[Role.COLOUR]).all() and np.isfinite(found[Role.MOTION]).all()
    found.pop(Role.DEPTH)
    assert_alike(found, Between(*frames, flow=False).frame(0.5))


def test_a_new_shot_and_a_new_size_begin_again(emulated: Device, scene: Scene) -> None:
    stream, planes = DeviceInterpolator(emulated), planes_of(scene(0))
    for options, ready in (({}, False), ({}, True), ({"reset": True}, False), ({}, True)):
        stream.push(planes, **options)
        assert stream.ready == ready
    stream.push({role: plane[:40] for role, plane in planes.items()})
    assert not stream.ready
    with pytest.raises(FrameError, match="push two frames"):
        stream.frame(0.5)


def test_wrong_use_is_explained(emulated: Device, scene: Scene) -> None:
    with pytest.raises(DeviceError, match="is no GPU with CUDA: on the CPU use Interpolator"):
        DeviceInterpolator(type("Cpu", (), {"memory": type("Memory", (), {"place": (1, 0)})})())  # type: ignore[arg-type]
    stream, planes = DeviceInterpolator(emulated), planes_of(scene(0))
    with pytest.raises(FrameError, match="need depth, too"):
        stream.push({role: plane for role, plane in planes.items() if role != Role.DEPTH})
    stream.push(planes)
    stream.push(planes)
    with pytest.raises(FrameError, match="give 0 < t < 1"):
        stream.frame(1.0)


@pytest.mark.gpu
@pytest.mark.skipif(cuda_fault(0) is not None, reason="needs a GPU")
@pytest.mark.parametrize("size", [(90, 131), (33, 40), (540, 960)])
def test_frames_on_a_gpu_are_those_of_the_cpu(size: tuple[int, int]) -> None:
    follow(Device("cuda"), [turning(size, 0.15, number) for number in range(1, 5)], 0.3, -0.2)
