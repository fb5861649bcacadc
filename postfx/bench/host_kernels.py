"""Single kernels on host arrays, for the methods that postfx is compared with."""

from __future__ import annotations

import numpy as np

from postfx.exposure import measure
from postfx.kernels.image import RESAMPLE, positions
from postfx.kernels.kernel import Kernel
from postfx.runtime import ArgumentTable, Device


class HostKernels:
    """Runs a kernel at once and waits. `milliseconds` sums the time on the device, without copies to it and back."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self.milliseconds = 0.0

    def run(self, kernel: Kernel, reads: dict[str, np.ndarray], shape: tuple[int, ...]) -> np.ndarray:
        """The one output of a kernel, of `shape`, from its arguments by name."""
        tensors = {name: self.device.wrap(name, array) for name, array in reads.items()}
        output = self.device.heap.tensor(kernel.writes[0], shape)
        table = ArgumentTable(self.device.compute_state(kernel), tensors | {kernel.writes[0]: output})
        commands = self.device.command_buffer(kernel.name)
        try:
            with commands.compute_encoder(kernel.name) as encoder:
                encoder.dispatch(table.state, table)
            commands.commit()
            commands.wait()
            self.milliseconds += sum(elapsed for _, elapsed in commands.timings)
            return output.download()
        finally:
            commands.discard()
            for tensor in (*tensors.values(), output):
                tensor.release()

    def enlarge(self, colour: np.ndarray, height: int, width: int, jitter: tuple[float, float]) -> np.ndarray:
        """Cubic interpolation of light (h, w, 3), whose samples are `jitter` (x, y) pixels off their centres.

        Interpolates log(1 + exposed light): linear light would spread highlights over their neighbours.
        """
        gain = np.float32(2.0 ** (measure(colour) or 0.0))
        exposed = np.log1p(np.maximum(colour, 0) * gain)
        enlarged: np.ndarray = np.expm1(self.resample(exposed, height, width, jitter)) / gain
        return enlarged

    def resample(self, image: np.ndarray, height: int, width: int, jitter: tuple[float, float]) -> np.ndarray:
        """Cubic interpolation of (h, w, C), whose samples are `jitter` (x, y) pixels off their centres."""
        h, w = image.shape[:2]
        reads = {"image": image, "rows": positions(h, height, jitter[1]), "columns": positions(w, width, jitter[0])}
        return self.run(RESAMPLE, reads, (height, width, image.shape[2]))
