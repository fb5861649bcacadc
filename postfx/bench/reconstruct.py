"""From a method to something that turns frames into pictures of the output's size."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from postfx.bench.accumulate import Accumulator
from postfx.bench.host_kernels import HostKernels
from postfx.bench.methods import Method
from postfx.bench.oidn import Oidn
from postfx.frame import Frame, Role
from postfx.passes._denoise_models import exact
from postfx.passes.denoise_upscale import DenoiseUpscale
from postfx.pipeline import Pipeline
from postfx.runtime import Device


class Network:
    """The project's denoised upscaler."""

    def __init__(self, method: Method, device: Device, scale: float) -> None:
        self._method = method
        self._lost = frozenset(map(Role, method.without))
        self._pipeline = Pipeline([DenoiseUpscale(model=exact(method.model), scale=scale)], device)
        self.device_ms = 0.0

    def reset(self) -> None:
        """Drop the history."""
        self._pipeline.reset()

    def __call__(self, frame: Frame) -> np.ndarray:
        """Colour (H, W, 3) of a frame."""
        guides = frame.guides if self._method.guides else {}
        planes = {role: plane for role, plane in frame.planes.items() if role not in self._lost}
        result = self._pipeline(replace(frame, reset=frame.reset or self._method.alone, guides=guides, planes=planes))
        self.device_ms += sum(self._pipeline.timings.values())
        return result[Role.COLOUR]


class Chain:
    """A denoiser of single frames or none, cubic enlargement, then accumulation or none.

    Accumulation runs on the CPU and is not part of `device_ms`.
    """

    def __init__(self, method: Method, device: Device, size: tuple[int, int]) -> None:
        self._height, self._width = size
        self._kernels = HostKernels(device)
        self._oidn = Oidn(method.quality, device.name.split(":")[0], device.threads) if method.quality else None
        host = HostKernels(device if device.name == "cpu" else Device("cpu", device.threads))
        self._accumulator = Accumulator(host) if method.accumulated else None

    @property
    def device_ms(self) -> float:
        """Milliseconds in OIDN's filter and in the enlargement so far, without copies."""
        return self._kernels.milliseconds + (self._oidn.milliseconds if self._oidn else 0.0)

    def reset(self) -> None:
        """Drop the history."""
        if self._accumulator:
            self._accumulator.reset()

    def __call__(self, frame: Frame) -> np.ndarray:
        """Colour (H, W, 3) of a frame."""
        colour = self._oidn(frame) if self._oidn else frame[Role.COLOUR]
        large = self._kernels.enlarge(colour, self._height, self._width, frame.jitter)
        return self._accumulator(large, frame) if self._accumulator else large


def make(method: Method, device: Device, scale: float, size: tuple[int, int]) -> Network | Chain:
    """What carries out a method, for outputs of `size` (height, width)."""
    return Network(method, device, scale) if method.model else Chain(method, device, size)
