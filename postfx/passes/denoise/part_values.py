"""Values of parts as the filters take them, and back.

The filters work on three channels of positive numbers of about the range of light. A part's kind
(`kinds`) says how its values come there: which span becomes 0 to 1, and what reverses that. Of
distances their reciprocals are filtered, and beside them which pixels have a distance at all.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from postfx.frame import FrameSpec, Part, Role
from postfx.kernels.denoise import MAX_COLOUR
from postfx.passes import ResidentFrame
from postfx.passes.denoise.geometry import Size
from postfx.passes.denoise.graph import DECODED, run_steps
from postfx.passes.denoise.history import ALPHA_LAYER
from postfx.passes.denoise.kinds import KINDS, LIGHT_KIND, Kind
from postfx.planes import LARGEST_FLOAT
from postfx.runtime import CommandBuffer, Device, Tensor

FARTHEST_DISTANCE = 1e9
"""Distances from here on stand for none."""
NO_CHANGE = (1.0, 0.0, -LARGEST_FLOAT, LARGEST_FLOAT, 0.0)
"""A decoding that leaves values as they are."""


class PartValues:
    """Codes the values of layers for the filters, and decodes them, for frames of one spec.

    Args:
        spec: of the frames.
        output: size of what leaves.
        parts: the parts by name, alpha among them.
        negative_layers: names of layers that hold a part's negative light -> the part's name.
    """

    def __init__(self, device: Device, spec: FrameSpec, output: Size, parts: Mapping[str, Part],
                 negative_layers: Mapping[str, str]) -> None:
        self._device, self._output = device, output
        self._render = Size(spec.height, spec.width)
        self._channels = dict(spec.parts)
        self._parts, self._negative_layers = parts, negative_layers
        new = device.heap.tensor
        self._codings = {name: new(f"coding {name}", (3,)) for name in (*parts, *negative_layers)}
        self._decodings = {name: new(f"decoding {name}", (5,))
                           for name, part in parts.items() if not part.is_light}
        self._as_it_is = new("as it is", (5,))
        self._as_it_is.upload([*NO_CHANGE])
        self._copies: dict[str, Tensor] = {}
        self._made: dict[str, Tensor] = {}

    def kind(self, name: str) -> Kind:
        """The kind of a layer; light for one that is no part."""
        name = self._negative_layers.get(name, name)
        return KINDS[self._parts[name].kind] if name in self._parts else LIGHT_KIND

    def is_light(self, name: str) -> bool:
        """Whether a name is of a part that is light."""
        return name in self._parts and self._parts[name].is_light

    def is_decoded(self, name: str) -> bool:
        """Whether filtered values are decoded before anything else is done with them. Distances are
        decoded last, as detail and strength act on their codes."""
        return name in self._decodings and not self.kind(name).are_distances

    def three_channels(self, name: str, frame: ResidentFrame) -> Tensor:
        """A part's values with three channels, as the kernels need them."""
        are_distances = self.kind(name).are_distances
        if self._channels[name] == 3 and not are_distances:
            return frame.parts[name]
        given = frame.host_parts[name]
        if are_distances:
            given, decoding = encode_depth(given)
            self._decodings[name].upload(decoding)
        if name not in self._copies:
            self._copies[name] = self._device.heap.tensor(f"{name}, three times",
                                                          (*self._render, 3))
        self._copies[name].upload(given if given.shape[2] == 3 else np.repeat(given, 3, axis=2))
        return self._copies[name]

    def coding(self, name: str, frame: ResidentFrame, exposure_factor: float) -> Tensor:
        """How a layer's values are coded in a frame, for the kernels: the least value, the scale,
        and the most that is let through. Settles how they are decoded, too."""
        kind = self.kind(name)
        low, high = kind.span or _range_of(frame.host_parts[name])
        scale = 1.0 if (low, high) == (0.0, 1.0) else 1 / max(high - low, 1e-30)
        most = LARGEST_FLOAT if kind.are_distances else MAX_COLOUR / exposure_factor
        self._codings[name].upload([low, scale, most])
        if self.is_decoded(name):
            decoding = [1 / scale, low, *kind.bounds, float(kind.are_vectors)]
            self._decodings[name].upload(decoding)
        return self._codings[name]

    def decode(self, commands: CommandBuffer, name: str, filtered: Tensor) -> Tensor:
        """Record the work that decodes a layer `is_decoded` says it of; returns its values."""
        output = self._picture(f"decoded {name}", 3)
        run_steps(commands, DECODED, {"filtered": filtered, "decoding": self._decodings[name],
                                      "plane": output})
        return output

    def leave(self, commands: CommandBuffer, frame: ResidentFrame, name: str,
              value: Tensor) -> None:
        """Put a layer into the frame, with as many channels as it came with."""
        if name == ALPHA_LAYER:
            frame.set(Role.ALPHA, value)
            return
        channels, are_distances = self._channels[name], self.kind(name).are_distances
        if channels == value.shape[2] and not are_distances:
            frame.parts[name] = value
            return
        output = self._picture(f"output {name}", channels)
        decoding = self._decodings[name] if are_distances else self._as_it_is
        run_steps(commands, DECODED, {"filtered": value, "decoding": decoding, "plane": output},
                  frozenset({"single"} if channels == 1 else ()))
        frame.parts[name] = output

    def _picture(self, name: str, channels: int) -> Tensor:
        """A picture of the output's size that lasts for a frame."""
        if name not in self._made:
            self._made[name] = self._device.heap.transient(name, (*self._output, channels))
        return self._made[name]


def encode_depth(depth: np.ndarray) -> tuple[np.ndarray, list[float]]:
    """A plane of distances (height, width, n), coded for the filters; its first channel counts.

    Returns (height, width, 3): 1 / distance, whether the pixel has a distance (0, 1e9 and NaN are
    none), and the latter again. Then the ``decoding`` that reverses it: sign, the value that stands
    for none, the smallest and largest distance, -1.
    """
    depth = depth[..., 0]
    with np.errstate(invalid="ignore"):
        there = (np.abs(depth) < FARTHEST_DISTANCE) & (depth != 0)
    # some renderers look along the negative axis
    sign = (-1.0 if 2 * (depth[there] < 0).sum() > there.sum() else 1.0)
    there[there] = sign * depth[there] > 0
    distances, none = np.abs(depth[there]), depth[~there]
    near, far = ((float(distances.min()), float(distances.max())) if distances.size
                 else (0.0, LARGEST_FLOAT))
    nothing = float(none[0]) if none.size and not np.isnan(none[0]) else sign * LARGEST_FLOAT
    inverse = np.zeros_like(depth)
    inverse[there] = 1 / distances
    coded = np.stack([inverse, there, there], axis=-1, dtype=np.float32)
    return coded, [sign, nothing, near, far, -1.0]


def _range_of(values: np.ndarray) -> tuple[float, float]:
    """The least and largest finite value."""
    finite = values[np.isfinite(values)]
    return (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
