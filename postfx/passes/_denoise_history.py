"""What the denoised upscaler's frames leave to the next."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from postfx.kernels import denoise_layout
from postfx.passes._denoise_window import Sizes
from postfx.runtime import Device, Tensor

NEXT = {"history": "next_history", "state": "next_state", "last_depth": "next_depth", "last_reactive": "next_reactive"}
"""What kernels read of the frame before -> what they write for the next one."""


class History:
    """The last output, what was accumulated, the depth, and the mask of reactive frames, in two sets used in turn."""

    def __init__(self, device: Device, sizes: Sizes, reactive: bool) -> None:
        shapes = {"history": (sizes.height, sizes.width, 3), "last_depth": (sizes.h, sizes.w, 1),
                  "state": (sizes.h, sizes.w, 4 + denoise_layout.HIDDEN)}
        if reactive:
            shapes["last_reactive"] = (sizes.h, sizes.w, 1)
        self._sets = [{name: device.heap.tensor(name, shape) for name, shape in shapes.items()} for _ in range(2)]
        # Before the first frame the history holds nothing, and nothing of it is used: it only has to be defined.
        for tensor in (tensor for one in self._sets for tensor in one.values()):
            tensor.fill(0)

    def turn(self) -> None:
        """Begin a frame: what was written is now the last."""
        self._sets.reverse()

    @property
    def last(self) -> dict[str, Tensor]:
        """What the frame before left, by the kernels' names."""
        return self._sets[0]

    @property
    def next(self) -> dict[str, Tensor]:
        """Where this frame leaves it, by the kernels' names."""
        return {NEXT[name]: tensor for name, tensor in self._sets[1].items()}

    def kept(self) -> dict[str, np.ndarray]:
        """Between two frames: what the last one left, by the kernels' names."""
        return {name: tensor.content() for name, tensor in self.next.items()}

    def recall(self, kept: Mapping[str, np.ndarray]) -> None:
        """Between two frames: take what was `kept` for what the last one left."""
        for name, tensor in self.next.items():
            tensor.upload(kept[name])

    def forget_hidden(self) -> None:
        """Between two frames: forget the hidden state, which another network cannot read; nothing in its place is what
        every network knows from first frames."""
        state = self._sets[1]["state"]
        values = state.download()
        values[..., -denoise_layout.HIDDEN:] = 0
        state.upload(values)
