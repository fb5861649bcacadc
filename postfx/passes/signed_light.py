"""Negative light of parts, as of lamps that take light away.

Filters, histories and proportions work on positive light. So a part with negative light is split
into two layers, its positive light and the size of its negative light, and joined again in the end.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from postfx.kernels.denoise.parts import DECODE
from postfx.planes import LARGEST_FLOAT
from postfx.runtime import CommandBuffer, Device, Tensor
from postfx.runtime.states import State

# Factors of light, before it is cut at 0.
POSITIVE = 1.0
NEGATIVE = -1.0


def negative_layer(name: str) -> str:
    """Name of the layer that holds a part's negative light."""
    return f"{name} below 0"


class SignedLight:
    """Splits parts by the sign of their light, and joins them again.

    Args:
        given: height and width of the parts that are split.
        output: height and width of the layers that are joined.
    """

    def __init__(self, device: Device, given: tuple[int, int], output: tuple[int, int]) -> None:
        self._device, self._given, self._output = device, given, output
        self._made: dict[str, Tensor] = {}
        self._add, self._subtract = (device.host_state(name, ("one", "other"), ("output",), work)
                                     for name, work in (("add light", _add),
                                                        ("take off light", _subtract)))

    def split(self, commands: CommandBuffer, name: str, light: Tensor) -> dict[str, Tensor]:
        """Record the work that splits a part (h, w, 3); returns its two layers by their names."""
        return {layer: self._one_sign(commands, layer, light, sign)
                for layer, sign in ((name, POSITIVE), (negative_layer(name), NEGATIVE))}

    def sum_of_positive(self, commands: CommandBuffer, name: str, picture: Tensor,
                        negatives: Iterable[Tensor]) -> Tensor:
        """Record the work that adds the negative layers of parts to the picture that the parts add
        up to; returns the sum of their positive layers. `name`: of the result."""
        total = picture
        for count, light in enumerate(negatives, 1):
            total = self._combine(commands, self._add, f"{name}, {count} added", total, light)
        return total

    def join(self, commands: CommandBuffer, name: str, positive: Tensor,
             negative: Tensor) -> Tensor:
        """Record the work that joins the two layers of a part; returns the part."""
        return self._combine(commands, self._subtract, f"{name} of both signs", positive, negative)

    def _one_sign(self, commands: CommandBuffer, layer: str, light: Tensor, sign: float) -> Tensor:
        name = f"input of {layer}"
        if name not in self._made:
            self._made[name] = self._device.heap.transient(name, (*self._given, 3))
        commands.run(DECODE, "take apart", filtered=light, decoding=self._cut(sign),
                     plane=self._made[name])
        return self._made[name]

    def _cut(self, sign: float) -> Tensor:
        name = f"cut {sign:g}"
        if name not in self._made:
            self._made[name] = self._device.heap.tensor(name, (5,))
            self._made[name].upload([sign, 0.0, 0.0, LARGEST_FLOAT, 0.0])
        return self._made[name]

    def _combine(self, commands: CommandBuffer, work: State, name: str, one: Tensor,
                 other: Tensor) -> Tensor:
        if name not in self._made:
            self._made[name] = self._device.heap.transient(name, (*self._output, 3))
        commands.run(work, name, one=one, other=other, output=self._made[name])
        return self._made[name]


def _add(one: np.ndarray, other: np.ndarray, output: np.ndarray) -> None:
    np.add(one, other, out=output)


def _subtract(one: np.ndarray, other: np.ndarray, output: np.ndarray) -> None:
    np.subtract(one, other, out=output)
