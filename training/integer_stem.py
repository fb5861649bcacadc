"""The first convolution of a quantised network: it reads features as 8-bit codes (`postfx.kernels.denoise_store`).

Channels have ranges of their own, so the weights of one output channel differ by much more than 7 bits hold well: only
rounding that makes up for itself (`training.rounding`) leaves as much as float32 does.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import onnx
from onnx import NodeProto, TensorProto, helper

from postfx.passes._denoise_network import CODING, FEATURE_PARTS, STORED, stored_channels
from training.graph_parts import LAST_TO_FIRST, constant, node, value
from training.rounding import Moments

MOST = 255
LIGHT, ALBEDO = (0.0, 5.5), (0.0, 1.25)
SEEN = (*6 * [ALBEDO], *3 * [(-1.0, 1.0)], (0.0, 1.0), (0.0, 1.0))
"""Ranges of both albedos, normal, roughness and depth."""
LIMITS = {
    "features": np.array([*9 * [LIGHT], *SEEN, (-1.0, 1.0), *2 * [(0.0, 1.0)], *2 * [(-0.5, 0.5)], (0.0, 1.25),
                          (0.0, 1.0), *8 * [(-1.0, 1.0)]]),
    "guides": np.array(4 * SEEN)}
"""Least and greatest of each channel that codes tell apart: light of 240 times white, motion of 150 pixels."""


class Coding(NamedTuple):
    """What a channel is multiplied by, and the code of zero; both (C,)."""

    scale: np.ndarray
    zero: np.ndarray

    @classmethod
    def of(cls, name: str) -> Coding:
        """That of some planes, with the channels that fill them up."""
        low, high = LIMITS[name].T
        signed = low < 0
        scale = np.where(signed, (MOST // 2) / high, MOST / high)
        filled = (0, stored_channels(name) - len(low))
        zero = (MOST + 1) // 2 * signed
        return cls(*(np.pad(values, filled).astype(np.float32) for values in (scale, zero)))

    def codes(self, planes: np.ndarray) -> np.ndarray:
        """Codes less that of zero, of planes (1, C, h, w): float32, with the channels that fill them up."""
        scale, zero = (x[:, None, None] for x in self)
        planes = np.pad(planes, ((0, 0), (0, len(self.scale) - planes.shape[1]), (0, 0), (0, 0)))
        return np.clip(np.floor(planes * scale + zero + np.float32(0.5)), 0, MOST) - zero


class Stem:
    """The first convolution of a float network, over all the planes that it reads.

    Attributes:
        names: of the planes, 'features' and 'guides' or the first alone.
        ring: pixels around the picture that it reads.
    """

    def __init__(self, graph: onnx.GraphProto) -> None:
        found = {one.input[0]: one for one in graph.node if one.op_type == "Conv" and one.input[0] in
                 (*FEATURE_PARTS, "guides")}
        weights = {name: value(graph, one.input[1]).astype(np.float32) for name, one in found.items()}
        self._bias = sum(value(graph, one.input[2]).astype(np.float32) for one in found.values() if len(one.input) > 2)
        self.ring = next(list(a.ints) for a in found[next(iter(FEATURE_PARTS))].attribute if a.name == "pads")[0]
        parts = {"features": np.concatenate([weights[part] for part in FEATURE_PARTS], 1)}
        if "guides" in weights:
            parts["guides"] = weights["guides"]
        self.names = tuple(parts)
        self._coding = {name: Coding.of(name) for name in parts}
        self._weights = np.concatenate([self._folded(name, weight) for name, weight in parts.items()], 1)
        self._moments = Moments(self._weights.shape[2], self.ring, stride=2)

    def _folded(self, name: str, weight: np.ndarray) -> np.ndarray:
        """Weights of codes."""
        scale = self._coding[name].scale
        more = len(scale) - weight.shape[1]
        return np.pad(weight, ((0, 0), (0, more), (0, 0), (0, 0))) / np.where(scale, scale, 1)[:, None, None]

    def add(self, reads: Mapping[str, np.ndarray]) -> None:
        """Note what a run of the float network reads."""
        planes = {"features": np.concatenate([reads[part] for part in FEATURE_PARTS], 1), **reads}
        codes = np.concatenate([self._coding[name].codes(planes[name]) for name in self.names], 1)
        self._moments.add(codes)

    def write(self, graph: onnx.GraphProto) -> None:
        """Put it into a quantised graph, in place of the float convolutions and their inputs."""
        target = next(one for one in graph.node if one.op_type == "Relu").input[0]
        behind = [NodeProto.FromString(one.SerializeToString()) for one in graph.node]
        for one in behind:
            one.input[:] = ["stem" if name == target else name for name in one.input]
        made = self._convolution(graph)
        del graph.node[:], graph.input[:]
        graph.node.extend([*made, *behind])
        sides = [f"ringed_{side}" if self.ring else side for side in ("height", "width")]
        for name in self.names:
            count = stored_channels(name)
            constant(graph, f"{CODING}{name}", np.stack(self._coding[name]))
            graph.input.append(helper.make_tensor_value_info(f"{STORED}{name}", TensorProto.UINT8, [1, *sides, count]))
            graph.output.append(helper.make_tensor_value_info(f"{CODING}{name}", TensorProto.FLOAT, [2, count]))

    def _convolution(self, graph: onnx.GraphProto) -> list[NodeProto]:
        """Nodes that give 'stem' of the stored planes; codes of zero are taken off by the bias."""
        factors, steps = self._moments.rounded(self._weights)
        zero = np.concatenate([self._coding[name].zero for name in self.names])
        offset = np.rint(self._bias / steps) - (factors * zero[:, None, None]).sum((1, 2, 3))
        made: list[NodeProto] = []
        stored = [f"{STORED}{name}" for name in self.names]
        last = node(made, "Concat", stored, "stored", axis=3) if len(stored) > 1 else stored[0]
        first = node(made, "Transpose", [last], "stem_codes", perm=LAST_TO_FIRST)
        reads = [node(made, "DequantizeLinear", [first, "stem_one", "stem_zero"], "stem_read")]
        for name, kept in (("weight", factors.astype(np.int8)), ("bias", offset.astype(np.int32))):
            constant(graph, f"stem_{name}", kept)
            constant(graph, f"stem_{name}_zero", np.zeros(len(steps), kept.dtype))
            coded = [f"stem_{name}", "stem_steps", f"stem_{name}_zero"]
            reads.append(node(made, "DequantizeLinear", coded, f"stem_{name}_kept", axis=0))
        constant(graph, "stem_steps", steps)
        constant(graph, "stem_one", np.float32(1))
        constant(graph, "stem_zero", np.uint8(0))
        node(made, "Conv", reads, "stem", strides=[2, 2], pads=[0] * 4, kernel_shape=list(factors.shape[2:]))
        return made
