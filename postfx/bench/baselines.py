"""Open Image Denoise, enlargement and accumulation along the motion: what postfx is compared with.

Open Image Denoise is called through the package pyoidn. Accumulation at output size is a
common addition to a denoiser of single frames: it follows the motion, drops the history where depth or normal show
another surface, and averages up to ten frames.
"""

from __future__ import annotations

import math

import numpy as np

from postfx.bench import require
from postfx.errors import BenchError, DeviceError
from postfx.exposure import measure
from postfx.frame import Frame, Role
from postfx.kernels import Kernel
from postfx.kernels.image import RESAMPLE, positions
from postfx.kernels.numeric import centre, compiled, inline
from postfx.oidn import OpenImageDenoise, total_albedo
from postfx.runtime import ArgumentTable, Device


class Oidn:
    """Denoises frames one by one, with albedo and normal as clean auxiliary images where there are any.

    Args:
        quality: 'fast', 'balanced' or 'high'.
        device: 'cpu' or 'cuda'.
        threads: CPU threads.
        prefilter: whether OIDN denoises albedo and normal first, as its guide advises for noisy ones.

    The albedo is the sum of diffuse and specular albedo, at most 1, which suits OIDN better than diffuse albedo alone.
    Raises BenchError if pyoidn is not installed or OIDN cannot run on the device.
    """

    def __init__(self, quality: str, device: str, threads: int, prefilter: bool = False) -> None:
        require("pyoidn", "pyoidn", "runs Open Image Denoise")
        try:
            self._denoise = OpenImageDenoise(quality, device, threads, prefilter)
        except DeviceError as error:
            raise BenchError(f"{error}: use --device cpu, or leave OIDN out by --methods") from error

    @property
    def milliseconds(self) -> float:
        """Total time in the filters, without copies to and from the device."""
        return self._denoise.milliseconds

    def __call__(self, frame: Frame) -> np.ndarray:
        """Denoised colour (h, w, 3) of a frame."""
        albedos = [frame[role] for role in (Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO) if role in frame]
        aids = {"albedo": total_albedo(*albedos)} if albedos else {}
        if Role.NORMAL in frame:
            aids["normal"] = frame[Role.NORMAL]
        result = np.empty_like(frame[Role.COLOUR], np.float32)
        self._denoise(frame[Role.COLOUR], aids, result)
        return result


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

        Interpolates log(1 + exposed light), because linear light would spread highlights over their neighbours.
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


LONGEST = 10
DEPTH_STEP, FACING = np.float32(0.1), np.float32(0.8)
ONE = np.float32(1)


@inline
def same_surface(
    depth: np.ndarray, normal: np.ndarray, past_depth: np.ndarray, past_normal: np.ndarray,
    y: int, x: int, py: int, px: int,
) -> bool | np.bool_:
    """Whether depth agrees within 10 % and the normals within 37 degrees; pixels without a normal agree."""
    near = abs(past_depth[py, px, 0] - depth[y, x, 0]) < DEPTH_STEP * depth[y, x, 0]
    dot, now, past = np.float32(0), np.float32(0), np.float32(0)
    for c in range(3):
        dot += normal[y, x, c] * past_normal[py, px, c]
        now += normal[y, x, c] * normal[y, x, c]
        past += past_normal[py, px, c] * past_normal[py, px, c]
    return near and (dot > FACING * math.sqrt(now * past) or now + past == np.float32(0))


@compiled
def accumulate_rows(
    y0: int, y1: int, current: np.ndarray, history: np.ndarray, motion: np.ndarray, depth: np.ndarray,
    normal: np.ndarray, past_depth: np.ndarray, past_normal: np.ndarray, output: np.ndarray,
) -> None:
    """output (H, W, 4): colour and the count of frames in it. `history` is the last output; planes are (h, w, C)."""
    height, width = current.shape[:2]
    h, w = motion.shape[:2]
    for y in range(y0, y1):
        row, _ = centre(y, h, height)
        for x in range(width):
            column, _ = centre(x, w, width)
            py = np.float32(y) + motion[row, column, 1] * np.float32(height) / np.float32(h)
            px = np.float32(x) + motion[row, column, 0] * np.float32(width) / np.float32(w)
            half = np.float32(0.5)
            count = ONE
            if -half < py < height - half and -half < px < width - half:
                near_y, near_x = int(math.floor(py + half)), int(math.floor(px + half))
                past_row, _ = centre(near_y, h, height)
                past_column, _ = centre(near_x, w, width)
                if same_surface(depth, normal, past_depth, past_normal, row, column, past_row, past_column):
                    count = min(history[near_y, near_x, 3] + ONE, np.float32(LONGEST))
            output[y, x, 3] = count
            top, left = int(math.floor(py)), int(math.floor(px))
            for c in range(3):
                value = current[y, x, c]
                if count > ONE:
                    up, down = max(top, 0), min(top + 1, height - 1)
                    before, after = max(left, 0), min(left + 1, width - 1)
                    fy, fx = py - np.float32(top), px - np.float32(left)
                    above = history[up, before, c] * (ONE - fx) + history[up, after, c] * fx
                    below = history[down, before, c] * (ONE - fx) + history[down, after, c] * fx
                    past = above * (ONE - fy) + below * fy
                    value = past + (value - past) / count
                output[y, x, c] = value


ACCUMULATE = Kernel(
    "accumulate", ("current", "history", "motion", "depth", "normal", "past_depth", "past_normal"), ("output",),
    accumulate_rows, ("output", 0),
    {"current": ("height", "width", 3), "history": ("height", "width", 4), "motion": ("h", "w", 2),
     "depth": ("h", "w", 1), "normal": ("h", "w", 3), "past_depth": ("h", "w", 1), "past_normal": ("h", "w", 3),
     "output": ("height", "width", 4)},
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
        """Mean (H, W, 3) of `current` and the earlier frames, which the motion of `frame` aligns with it."""
        height, width = current.shape[:2]
        shape = frame[Role.MOTION].shape[:2]
        now = {"depth": _plane(frame, Role.DEPTH, np.ones((*shape, 1), np.float32)),
               "normal": _plane(frame, Role.NORMAL, np.zeros((*shape, 3), np.float32))}
        history, past = self._history, self._past
        if history is None or frame.reset:
            history, past = np.zeros((height, width, 4), np.float32), now
        reads = {"current": current, "history": history, "motion": frame[Role.MOTION], **now,
                 **{f"past_{name}": plane for name, plane in past.items()}}
        self._history, self._past = self._kernels.run(ACCUMULATE, reads, (height, width, 4)), now
        return np.ascontiguousarray(self._history[..., :3])


def _plane(frame: Frame, role: Role, absent: np.ndarray) -> np.ndarray:
    return frame[role] if role in frame else absent
