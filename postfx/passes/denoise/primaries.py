"""Wider primaries, for frames whose own do not hold their light: colours go there before all else,
and come back at last; the history goes along."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, MutableMapping, Sequence
from typing import Any

import numpy as np

from postfx.colour import TO_WIDER_PRIMARIES
from postfx.frame import ALBEDOS, Part, Role
from postfx.passes import ResidentFrame
from postfx.passes.denoise.graph import WIDENED, run_steps
from postfx.passes.denoise.history import FILTERED_PICTURE, WHOLE
from postfx.runtime import CommandBuffer, Device, Tensor

COLOURS = (Role.COLOUR, Role.OPAQUE_COLOUR, *ALBEDOS)
"""Light, and what is compared with it or multiplied by it."""

# In a history, light in the first three channels.
LOGARITHMIC_LIGHT = "next_history"
"""By its logarithm, log(1 + light)."""
PLAIN_LIGHT = ("next_state", "history", "last_part")
"""As it is."""


class WiderPrimaries:
    """Colours of a frame in wider primaries, where all light is positive: each noisy pixel's
    negative light would count as 0, and the mean would rise."""

    def __init__(self, device: Device, parts: Sequence[Part]) -> None:
        self._device = device
        self._lights = [part.name for part in parts if part.is_light]
        self._matrices: dict[bool, Tensor] = {}
        self._made: dict[str, Tensor] = {}

    def widen(self, commands: CommandBuffer, frame: ResidentFrame) -> None:
        """Record the conversion of a frame's planes, guides and parts, which are replaced."""
        self._convert_all(commands, "plane", frame.tensors, COLOURS, True)
        self._convert_all(commands, "guide", frame.guides, COLOURS, True)
        self._convert_all(commands, "part", frame.parts, self._lights, True)

    def widen_planes(self, commands: CommandBuffer, kind: str,
                     planes: MutableMapping[Role, Tensor]) -> None:
        """Record the conversion of other planes of a frame, of some kind, which are replaced."""
        self._convert_all(commands, f"{kind} plane", planes, COLOURS, True)

    def widen_light(self, commands: CommandBuffer, name: str, light: Tensor) -> Tensor:
        """Record the conversion of light that is no plane of the frame; returns the result."""
        return self._convert(commands, name, light, True)

    def narrow(self, commands: CommandBuffer, frame: ResidentFrame, colour: Tensor) -> Tensor:
        """Record the conversion back of the frame's parts, which are replaced, and of a colour,
        which is returned."""
        self._convert_all(commands, "part", frame.parts, self._lights, False)
        return self._convert(commands, "picture", colour, False)

    def _convert_all(self, commands: CommandBuffer, kind: str, held: MutableMapping[Any, Tensor],
                     names: Iterable[str], wider: bool) -> None:
        for name in names:
            if name in held and held[name].shape[2] == 3:  # a light of one channel is grey
                held[name] = self._convert(commands, f"{kind} {name}", held[name], wider)

    def _convert(self, commands: CommandBuffer, name: str, colour: Tensor, wider: bool) -> Tensor:
        name = f"{name} in {'wider' if wider else 'its'} primaries"
        if wider not in self._matrices:
            self._matrices[wider] = self._device.heap.tensor("primaries", (9,))
            self._matrices[wider].upload((TO_WIDER_PRIMARIES if wider
                                          else np.linalg.inv(TO_WIDER_PRIMARIES)).ravel())
        if name not in self._made:
            self._made[name] = self._device.heap.transient(name, colour.shape)
        run_steps(commands, WIDENED, {"colour": colour, "matrix": self._matrices[wider],
                                      "output": self._made[name]})
        return self._made[name]


def widen_history(history: Mapping[str, np.ndarray],
                  parts: Sequence[Part]) -> dict[str, np.ndarray]:
    """A history of the pass in wider primaries.

    The last output is exact. What is accumulated was divided by reflectance, and is converted as if
    that were grey.
    """
    lights = {"", WHOLE, FILTERED_PICTURE, *(part.name for part in parts if part.is_light)}
    found = dict(history)
    for key, array in history.items():
        kind, _, name = key.removeprefix("part ").partition(" of ")
        if kind in (LOGARITHMIC_LIGHT, *PLAIN_LIGHT) and name in lights:
            light = np.expm1(array[..., :3]) if kind == LOGARITHMIC_LIGHT else array[..., :3]
            wider = np.maximum(light @ TO_WIDER_PRIMARIES.T.astype(np.float32), 0)
            found[key] = np.concatenate([np.log1p(wider) if kind == LOGARITHMIC_LIGHT else wider,
                                         array[..., 3:]], -1)
    return found
