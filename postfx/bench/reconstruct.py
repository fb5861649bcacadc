"""From a method to something that turns frames into pictures of the output's size."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from postfx.bench.accumulate import Accumulator
from postfx.bench.host_kernels import HostKernels
from postfx.bench.methods import Method
from postfx.bench.oidn import Oidn
from postfx.frame import Frame, Role
from postfx.io.sequence import Sequence
from postfx.passes.both_ways import BothWays
from postfx.passes.denoise import DenoiseUpscale
from postfx.passes.denoise.models import exact
from postfx.pipeline import Pipeline
from postfx.runtime import Device
from postfx.temporal import Backwards, RunUp


class Network:
    """The project's denoised upscaler."""

    def __init__(self, method: Method, device: Device, scale: float, sequence: Sequence | None) -> None:
        self._method = method
        self._lost = frozenset(map(Role, method.without))
        model = exact(method.model)
        run_up, self._backwards = None, None
        if method.run_up or method.both:
            assert sequence is not None, "frames are run ahead"
            run_up = RunUp(sequence, prepare=self._given) if method.run_up else None
            if method.both:
                self._backwards = Backwards(sequence, device, prepare=self._given, model=model, scale=scale)
        self._pipeline = Pipeline([DenoiseUpscale(model=model, scale=scale), BothWays()], device, run_up=run_up)
        self.device_ms = 0.0

    def reset(self) -> None:
        """Drop the history."""
        self._pipeline.reset()
        if self._backwards:
            self._backwards.reset()

    def __call__(self, frame: Frame) -> np.ndarray:
        """Colour (H, W, 3) of a frame."""
        frame = self._given(frame)
        frame = self._backwards(frame) if self._backwards else frame
        result = self._pipeline(replace(frame, reset=frame.reset or self._method.alone))
        self.device_ms += sum(self._pipeline.timings.values()) + sum(self._pipeline.ahead)
        self.device_ms += (self._backwards.milliseconds or 0.0) if self._backwards else 0.0
        return result[Role.COLOUR]

    def _given(self, frame: Frame) -> Frame:
        """The frame with what the method is given of it."""
        planes = {role: plane for role, plane in frame.planes.items() if role not in self._lost}
        return replace(frame, guides=frame.guides if self._method.guides else {}, planes=planes)


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


def make(method: Method, device: Device, scale: float, size: tuple[int, int],
         sequence: Sequence | None = None) -> Network | Chain:
    """What carries out a method, for outputs of `size` (height, width). The `sequence` is needed where frames are
    run ahead: for a run-up and for both ways."""
    return Network(method, device, scale, sequence) if method.model else Chain(method, device, size)
