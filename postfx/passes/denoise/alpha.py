"""Alpha: a mean of its samples over the frames, which corrects what the picture's filters make of
it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from postfx.frame import FrameSpec, Role
from postfx.kernels.denoise import NEAR_CELL
from postfx.kernels.denoise.alpha import near_cells
from postfx.passes import ResidentFrame
from postfx.passes.denoise.geometry import Size
from postfx.passes.denoise.graph import CORRECTED, GATHERED, kernels_of, run_steps
from postfx.passes.denoise.history import LayerHistory
from postfx.runtime import CommandBuffer, Device, Tensor
from postfx.sampling import three_by_three

FEW_SAMPLES = 4
"""Samples a pixel of files that do not say."""
DRIFT_VARIANCE = 1 / 32
"""Variance, in units of a sample's, that a move adds to a mean of alpha."""
SETTLED = 6
"""As how many samples filtered alpha counts."""
LONGEST_ALPHA_FRAMES = 16
"""Frames over which still alpha is averaged."""
RANDOM = 1 / 48
"""Variance, in units of a sample's, that structure is compared with."""
SHARPER_ALPHA = 0.4
"""How much sharper alpha is made that is twice as large."""
BY_COLOUR = 0.5
"""Share of alpha that comes from colours where it has structure."""
SPECKLED = 0.02
"""Share of the pixels at edges that are alone among others, both covered and not, from which that
is noise."""


class Alpha:
    """Brings filtered alpha nearer to a mean of its samples over the frames, which knows the
    quarters of a pixel where things move by parts of one, and to the colours. Where alpha is 0 or 1
    all around, there is nothing to do.

    Attributes:
        enlarged: where filtered alpha goes.
    """

    def __init__(self, device: Device, spec: FrameSpec, output: Size) -> None:
        self._scale = min(max(output.width / spec.width - 1, 0.0), 1.0)
        new, between = device.heap.tensor, device.heap.transient
        self._rates, self._gain = new("rates of alpha", (4,)), new("gain of alpha", (4,))
        rows, columns = (device.wrap(name, np.arange(size, dtype=np.float32)) for name, size in
                         (("alpha rows", spec.height), ("alpha columns", spec.width)))
        moved = between("motion of alpha", (spec.height, spec.width, 2))
        self._output = between("alpha", (*output, 1))
        self.enlarged = between("enlarged alpha", (*output, 1))
        self._pixels = {"part_rows": rows, "part_columns": columns}
        self._near = new("near alpha", (-(-spec.height // NEAR_CELL), -(-spec.width // NEAR_CELL)))
        self._moved, self._finds_cells = moved, device.gpu is not None
        self._fit = between("alpha by colours", (4, spec.height, spec.width))
        self._words = frozenset({"gpu"} if self._finds_cells else ())
        device.make_ready(*kernels_of(GATHERED, self._words), *kernels_of(CORRECTED))

    def gather(self, commands: CommandBuffer, frame: ResidentFrame, planes: Mapping[str, Tensor],
               history: LayerHistory, keep: bool) -> dict[str, Tensor]:
        """Record the work that adds a frame's own alpha to the mean; returns what filters read of
        it. Jittered alpha does not lie where the pixels do, and counts for nothing but in its own
        frame."""
        samples, jittered = frame.samples or FEW_SAMPLES, frame.jitter != (0.0, 0.0)
        if not self._finds_cells:
            self._near.upload(near_cells(frame.host_planes[Role.ALPHA][..., 0]))
        self._rates.upload([float(keep and not history.resized and not jittered), 1 / samples,
                            DRIFT_VARIANCE, 1 / LONGEST_ALPHA_FRAMES])
        self._gain.upload([0.0 if jittered else 1 / SETTLED, RANDOM / samples,
                           0.0 if jittered else SHARPER_ALPHA * self._scale,
                           0.0 if jittered else BY_COLOUR])
        last, found = (quarters.view(quarters.name,
                                     (2 * quarters.shape[0], 2 * quarters.shape[1], 1))
                                 for quarters in (history.last["samples"], history.next["samples"]))
        self._next = {"next_samples": found, "next_doubt": history.next["doubt"]}
        run_steps(commands, GATHERED, {
            "alpha": frame[Role.ALPHA], "motion": planes[Role.MOTION], "depth": planes[Role.DEPTH],
            "moved": self._moved, "rates": self._rates, "near": self._near, "samples": last,
            "doubt": history.last["doubt"], **self._pixels, **self._next}, self._words)
        return {"next_samples": found, "near": self._near}

    def correct(self, commands: CommandBuffer, picture: Tensor) -> Tensor:
        """Record the work on alpha that was filtered and enlarged, given the picture that the
        filters made; returns alpha."""
        run_steps(commands, CORRECTED, {
            "picture": picture, "enlarged": self.enlarged, "moved": self._moved,
            "near": self._near, "gain": self._gain, "fit": self._fit,
            "corrected": self._output, **self._next})
        return self._output


def has_noisy_alpha(frame: ResidentFrame) -> bool:
    """Whether alpha has noise to filter: values between 0 and 1, or the holes and specks of one
    sample a pixel."""
    alpha = frame.host_planes.get(Role.ALPHA)
    if alpha is None:
        return False
    return bool(((alpha > 0) & (alpha < 1)).any()) or is_speckled(alpha[..., 0] > 0)


def is_speckled(covered: np.ndarray) -> bool:
    """Whether a mask (h, w) has lone pixels of both kinds: wires are lone covered ones, and gaps
    lone empty ones."""
    around = three_by_three(covered.astype(np.float32), 1, np.add)
    edges = np.count_nonzero((around > 0) & (around < 9))
    specks = np.count_nonzero(covered & (around <= 3))
    holes = np.count_nonzero(~covered & (around >= 6))
    return bool(edges > 0 and min(specks, holes) > SPECKLED * edges)
