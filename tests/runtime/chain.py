"""Two chains of commands through transient tensors, for the tests of the arena."""

from __future__ import annotations

from typing import Any

import numpy as np

from postfx.runtime import (
    ArgumentTable,
    CommandBuffer,
    Device,
    Library,
    MachineLearningEncoder,
    Tensor,
)


class Chain:
    """Twice 4 x: by two networks with the transient tensor `first` between them, then by two with
    `second`."""

    def __init__(self, device: Device, library: Library, rows: int = 4) -> None:
        self.device = device
        self.state = device.pipeline_state(library, "double", {"height": rows, "width": 500})
        self.shape = (1, rows, 500)
        self.x = device.wrap("x", np.ones(self.shape, np.float32))
        self.first, self.second = (device.heap.transient(name, self.shape)
                                   for name in ("first", "second"))
        self.totals = [device.heap.tensor(f"total {i}", self.shape) for i in range(2)]

    def record(self, barrier: bool = True, label: str = "frame 1") -> CommandBuffer:
        """Commands of two encoders; without a barrier they are in no certain order."""
        commands = self.device.command_buffer(label)
        for name, between, total in (("one", self.first, self.totals[0]),
                                     ("two", self.second, self.totals[1])):
            with commands.machine_learning_encoder(name) as encoder:
                if barrier:
                    encoder.barrier(after="machine-learning", before="machine-learning")
                self.double(encoder, self.x, between)
                encoder.barrier()
                self.double(encoder, between, total)
        return commands

    def double(self, encoder: MachineLearningEncoder, x: Tensor, y: Tensor) -> None:
        """Record y = 2 x."""
        encoder.dispatch_network(self.state, ArgumentTable(self.state, {"x": x, "y": y}))

    def run(self, **options: Any) -> CommandBuffer:
        """Record, commit and wait."""
        commands = self.record(**options)
        commands.commit()
        commands.wait(10)
        return commands

    def right(self) -> bool:
        """Whether both results are what they should be."""
        return all(np.all(total.download() == 4.0) for total in self.totals)


def spans(*tensors: Tensor) -> list[tuple[int, int]]:
    """Addresses of tensors, where the last commit placed them."""
    return [(tensor.resident().start, tensor.resident().end) for tensor in tensors]


def shared(one: Tensor, other: Tensor) -> bool:
    """Whether two tensors were placed on the same bytes."""
    return one.resident().overlaps(other.resident())
