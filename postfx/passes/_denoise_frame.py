"""How the denoised upscaler goes over a frame, and what it keeps from frame to frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from postfx.kernels import denoise_prepare
from postfx.passes._denoise_graph import Graph
from postfx.passes._denoise_history import History
from postfx.passes._denoise_window import Sizes, Window
from postfx.runtime import ArgumentTable, CommandBuffer, Device, Tensor


class Frames:
    """The networks and the history of frames of one size.

    Of several models the first is in use until `use` takes another. Guided models read guides.
    """

    def __init__(self, device: Device, sizes: Sizes, models: Sequence[str], guided: bool = False) -> None:
        self._window = Window.whole(sizes)
        self._graph = Graph(device, self._window, models, guided)
        self._history = History(device, sizes)
        new, between = device.heap.tensor, device.heap.transient
        self._common = {"params": new("params", (5,)), "depth_scale": between("depth scale", (1,)),
                        "output": between("output", (sizes.height, sizes.width, 3))}
        if guided:
            black = new("no reflectance", (sizes.h, sizes.w, 3))  # makes a factor of one
            black.fill(0)
            self._common["no_reflectance"] = black
        self._scale = ArgumentTable(device.compute_state(denoise_prepare.SCALE),
                                    {"depth_scale": self._common["depth_scale"]})
        self.model = models[0]

    def use(self, model: str) -> None:
        """Take another model from the next frame on. The history goes on, but for the hidden state."""
        if model != self.model:
            self.model = model
            self._history.forget_hidden()

    def encode(self, commands: CommandBuffer, planes: Mapping[str, Tensor], params: np.ndarray, keep: bool) -> Tensor:
        """Record one frame; returns the output colour tensor."""
        self._history.turn()
        self._common["params"].upload(params)
        self._scale["depth"] = planes["depth"]
        with commands.compute_encoder("scale") as encoder:
            encoder.barrier(after=("compute", "machine-learning"), before="compute")
            encoder.dispatch(self._scale.state, self._scale)
        tensors = {**planes, **self._common, **self._history.last, **self._history.next}
        self._graph.encode(commands, self._window, self.model, tensors, keep)
        return self._common["output"]
