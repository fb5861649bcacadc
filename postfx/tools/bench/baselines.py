"""Open Image Denoise, enlargement and accumulation along the motion: what postfx is compared with.

Open Image Denoise is called through the package pyoidn. Accumulation at output size is a
common addition to a denoiser of single frames: it follows the motion, drops the history where depth
or normal show another surface, and averages up to ten frames.
"""

from __future__ import annotations

import numpy as np

from postfx.compiled.library import Rows
from postfx.errors import BenchError, DeviceError
from postfx.exposure import measure
from postfx.frame import ALBEDOS, Frame, Role
from postfx.kernels import Kernel
from postfx.kernels.image import RESAMPLE, positions
from postfx.oidn import OpenImageDenoise, total_albedo
from postfx.runtime import ArgumentTable, Device
from postfx.tools.bench import require


class Oidn:
    """Denoises frames one by one, with albedo and normal as auxiliary images where there are any.

    Args:
        quality: 'fast', 'balanced' or 'high'.
        device: 'cpu' or 'cuda'.
        threads: CPU threads.
        planes: how it takes albedo and normal, one of `postfx.oidn.WAYS`, or 'none': not at all.

    The albedo is Blender's Denoising Albedo. Without it, it is the sum of diffuse and specular
    albedo, at most 1, which suits OIDN better than diffuse albedo alone.
    Raises BenchError if pyoidn is not installed or OIDN cannot run on the device.
    """

    def __init__(self, quality: str, device: str, threads: int, planes: str = "clean") -> None:
        require("pyoidn", "pyoidn", "runs Open Image Denoise")
        self._alone = planes == "none"
        try:
            self._denoise = OpenImageDenoise(quality, device, threads,
                                             "clean" if self._alone else planes)
        except DeviceError as error:
            raise BenchError(f"{error}: use --device cpu, or leave OIDN out by "
                             "--methods") from error

    @property
    def milliseconds(self) -> float:
        """Total time in the filters, without copies to and from the device."""
        return self._denoise.milliseconds

    def __call__(self, frame: Frame) -> np.ndarray:
        """Denoised colour (h, w, 3) of a frame."""
        result = np.empty_like(frame[Role.COLOUR], np.float32)
        self._denoise(frame[Role.COLOUR], {} if self._alone else _aids(frame), result)
        return result


def _aids(frame: Frame) -> dict[str, np.ndarray]:
    """Albedo and normal by OIDN's names."""
    albedos = [frame[role] for role in ALBEDOS if role in frame]
    if Role.DENOISING_ALBEDO in frame:
        albedos = [frame[Role.DENOISING_ALBEDO]]
    aids = {"albedo": total_albedo(*albedos)} if albedos else {}
    if Role.NORMAL in frame:
        aids["normal"] = frame[Role.NORMAL]
    return aids


class HostKernels:
    """Runs a kernel at once and waits. `milliseconds` sums the time on the device, without copies
    to it and back."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self.milliseconds = 0.0

    def run(self, kernel: Kernel, reads: dict[str, np.ndarray],
            shape: tuple[int, ...]) -> np.ndarray:
        """The one output of a kernel, of `shape`, from its arguments by name."""
        tensors = {name: self.device.wrap(name, array) for name, array in reads.items()}
        output = self.device.heap.tensor(kernel.writes[0], shape)
        table = ArgumentTable(self.device.compute_state(kernel),
                              tensors | {kernel.writes[0]: output})
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

    def enlarge(self, colour: np.ndarray, height: int, width: int,
                jitter: tuple[float, float]) -> np.ndarray:
        """Cubic interpolation of light (h, w, 3), whose samples are `jitter` (x, y) pixels off
        their centres.

        Interpolates log(1 + exposed light), because linear light would spread highlights over their
        neighbours.
        """
        gain = np.float32(2.0 ** (measure(colour) or 0.0))
        exposed = np.log1p(np.maximum(colour, 0) * gain)
        enlarged: np.ndarray = np.expm1(self.resample(exposed, height, width, jitter)) / gain
        return enlarged

    def resample(self, image: np.ndarray, height: int, width: int,
                 jitter: tuple[float, float]) -> np.ndarray:
        """Cubic interpolation of (h, w, C), whose samples are `jitter` (x, y) pixels off their
        centres."""
        h, w = image.shape[:2]
        reads = {"image": image, "rows": positions(h, height, jitter[1]),
                 "columns": positions(w, width, jitter[0])}
        return self.run(RESAMPLE, reads, (height, width, image.shape[2]))


LONGEST_AVERAGE_FRAMES = 10
"""Frames that are averaged, at most, as in postfx/kernels/accumulate.cpp."""
ACCUMULATE_FRAMES = Kernel(
    "accumulate", ("current", "history", "motion", "depth", "normal", "past_depth", "past_normal"),
    ("output",), Rows("accumulate_past"), ("output", 0),
    {"current": ("height", "width", 3), "history": ("height", "width", 4), "motion": ("h", "w", 2),
     "depth": ("h", "w", 1), "normal": ("h", "w", 3), "past_depth": ("h", "w", 1),
     "past_normal": ("h", "w", 3), "output": ("height", "width", 4)},
)


class Accumulator:
    """Averages colours at output size over frames; a frame's depth or normals may be missing."""

    def __init__(self, kernels: HostKernels) -> None:
        self._kernels = kernels
        self.reset()

    def reset(self) -> None:
        """Drop the history."""
        self._history: np.ndarray | None = None
        self._past: dict[str, np.ndarray] = {}

    def __call__(self, current: np.ndarray, frame: Frame) -> np.ndarray:
        """Mean (H, W, 3) of `current` and the earlier frames, which the motion of `frame` aligns
        with it."""
        height, width = current.shape[:2]
        shape = frame[Role.MOTION].shape[:2]
        now = {"depth": _plane(frame, Role.DEPTH, np.ones((*shape, 1), np.float32)),
               "normal": _plane(frame, Role.NORMAL, np.zeros((*shape, 3), np.float32))}
        history, past = self._history, self._past
        if history is None or frame.reset:
            history, past = np.zeros((height, width, 4), np.float32), now
        reads = {"current": current, "history": history, "motion": frame[Role.MOTION], **now,
                 **{f"past_{name}": plane for name, plane in past.items()}}
        self._history = self._kernels.run(ACCUMULATE_FRAMES, reads, (height, width, 4))
        self._past = now
        return np.ascontiguousarray(self._history[..., :3])


def _plane(frame: Frame, role: Role, absent: np.ndarray) -> np.ndarray:
    return frame[role] if role in frame else absent
