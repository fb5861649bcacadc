"""Light of parts below 0, as of lamps that take light away: it is handled as a layer of its own.

Filters, histories and proportions hold no light below 0. So a part that has some becomes two
layers, what it has above 0 and what it has below, and in the end their difference.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from postfx.kernels.denoise.parts import DECODE
from postfx.planes import LARGEST_FLOAT
from postfx.runtime import CommandBuffer, Device, Tensor
from postfx.runtime.states import State

LEAST_BELOW = 3e-3
"""Share of a part's light that must lie below 0: pixel filters leave less, which is cut as in the
picture."""
LEAST_OF_PICTURE = 1e-5
"""Share of the picture's light that must lie below 0: a part without light has rounding alone."""
ROW_STEP = 8
"""One row in so many is looked at for that."""

# What light is multiplied by, before the rest is cut at 0.
ABOVE = 1.0
BELOW = -1.0


def below(name: str) -> str:
    """Name of the layer of what a part has below 0."""
    return f"{name} below 0"


def lies_below(part: np.ndarray, picture: np.ndarray | None) -> bool:
    """Whether a part (h, w, n) has light below 0, and more of it than rounding or a pixel filter
    leaves; `picture`: (h, w, 3), whose part it is, None where that is not known."""
    seen = part[::ROW_STEP]
    seen = seen[np.isfinite(seen)]
    under = np.maximum(-seen, 0).sum(dtype=np.float64)
    if under <= LEAST_BELOW * np.abs(seen).sum(dtype=np.float64):
        return False
    if picture is None:
        return True
    whole = picture[::ROW_STEP]
    return bool(under > LEAST_OF_PICTURE * np.abs(whole[np.isfinite(whole)]).sum(dtype=np.float64))


class SignedLight:
    """Takes light of either sign apart at one size (height, width), and puts it together again at
    another."""

    def __init__(self, device: Device, given: tuple[int, int], output: tuple[int, int]) -> None:
        self._device, self._given, self._output = device, given, output
        self._made: dict[str, Tensor] = {}
        self._add, self._subtract = (device.host_state(name, ("one", "other"), ("output",), work)
                                     for name, work in (("add light", _add),
                                                        ("take off light", _subtract)))

    def split(self, commands: CommandBuffer, name: str, light: Tensor) -> dict[str, Tensor]:
        """Record the work that takes a part (h, w, 3) apart: its two layers by their names, none
        with light below 0."""
        return {layer: self._one_sign(commands, layer, light, sign)
                for layer, sign in ((name, ABOVE), (below(name), BELOW))}

    def lift(self, commands: CommandBuffer, name: str, picture: Tensor,
             under: Iterable[Tensor]) -> Tensor:
        """Record the work that adds what parts have below 0 to a picture, so that it is the sum of
        what they have above; `name` is the sum's."""
        total = picture
        for count, light in enumerate(under, 1):
            total = self._combine(commands, self._add, f"{name}, {count} added", total, light)
        return total

    def join(self, commands: CommandBuffer, name: str, above: Tensor, under: Tensor) -> Tensor:
        """Record the work that makes a part of its two layers."""
        return self._combine(commands, self._subtract, f"{name} of both signs", above, under)

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
