"""The denoiser's steps for a GPU, with CUDA kernels that run on the host, against the CPU's."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from postfx.frame import Frame, Role
from postfx.kernels import Kernel
from postfx.passes.denoise import DenoiseUpscale
from postfx.pipeline import Pipeline
from postfx.runtime import Device
from tests.kernels import host_cuda
from tests.passes.denoise_frames import noisy

SIZE = 40, 56


@pytest.fixture
def emulated(monkeypatch: pytest.MonkeyPatch) -> Iterator[Device]:
    """A device of the CPU that takes the steps of a GPU, and runs CUDA kernels on the host."""
    if host_cuda.COMPILER is None:
        pytest.skip("no g++")
    device, gpu = Device("cpu", threads=1), SimpleNamespace(convolves=False)
    make = device._make_state

    def by_cuda(kernel: Kernel) -> object:
        names = tuple(dict.fromkeys(kernel.reads + kernel.writes))
        own = replace(kernel, rows=lambda first, last, *arrays: host_cuda.run(
            kernel, dict(zip(names, arrays, strict=True))))
        with monkeypatch.context() as as_cpu:
            as_cpu.setattr(Device, "gpu", None)
            return make(own)

    monkeypatch.setattr(device, "_make_state", by_cuda)
    monkeypatch.setattr(Device, "gpu", property(lambda one: gpu if one is device else None))
    yield device


def frames(kind: str) -> list[Frame]:
    y, x = np.indices(SIZE, np.float32)
    found = []
    kept = {"jitter": (0.0, 0.0)} if kind == "centred" else {}
    for frame in (noisy(number, *SIZE, **kept) for number in (1, 2, 3)):
        planes = dict(frame.planes)
        if kind == "strength":
            planes[Role.STRENGTH] = (x > 14)[..., None].astype(np.float32)
        if kind == "alpha":
            planes[Role.ALPHA] = np.clip(x / 20, 0, 1)[..., None].astype(np.float32)
        found.append(replace(frame, planes=planes))
    return found


def run(device: Device, model: str, scale: float, given: list[Frame]) -> list[np.ndarray]:
    chain = Pipeline([DenoiseUpscale(model=model, scale=scale)], device, exposure=0.0, cuts="none")
    return [chain(frame)[Role.COLOUR].copy() for frame in given]


@pytest.mark.parametrize(("model", "scale", "kind"), [
    ("xl", 1, ""), ("xl", 1, "strength"), ("xl.fp32", 2, "centred"), ("s.fp32", 1, ""),
    ("s.fp32", 2, "alpha"), ("classic", 1, "alpha"), ("classic", 1.5, "")])
def test_a_gpus_steps_make_the_pictures_of_the_cpu(emulated: Device, model: str, scale: float,
                                                   kind: str) -> None:
    """With a history, in which what a network keeps comes back."""
    given = frames(kind)
    wanted = run(Device("cpu", threads=1), model, scale, given)
    for found, right in zip(run(emulated, model, scale, given), wanted, strict=True):
        np.testing.assert_allclose(found / (1 + found), right / (1 + right), atol=1e-5)
