"""Rounding of a convolution's weights to integers, each making up for those before it.

That is Frantar et al., "GPTQ" (2022): what rounding one weight changes in the sums is taken from the weights that are
not yet rounded, by the second moments of what the convolution reads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from onnx import NodeProto

LIMIT = 63
"""Greatest integer: 7 bits, because x86 processors without VNNI add two products in 16 bits and saturate."""
PATCHES = 256
"""Places of a frame whose moments are noted."""
DAMPING = 0.01
"""Part of the mean moment that is added to all, so that what hardly varies is not relied upon."""
SHARES = (1.0, 0.9, 0.8, 0.7, 0.6)
"""Parts of the largest weight that are tried as the largest kept."""


class Rounded(NamedTuple):
    """Weights as integers in the shape of the weights, and what a step of each output channel stands for, float32."""

    factors: np.ndarray
    steps: np.ndarray


class Moments:
    """Mean products of the values that a convolution adds up: over its window and the channels that it reads."""

    def __init__(self, side: int, pad: int, stride: int) -> None:
        self._side, self._pad, self._stride = side, pad, stride
        self._sum, self._random = np.float32(0), np.random.default_rng(0)

    @classmethod
    def of(cls, convolution: NodeProto) -> Moments:
        """For a square one, as far from every border."""
        facts = {fact.name: list(fact.ints) for fact in convolution.attribute}
        return cls(*(facts[name][0] for name in ("kernel_shape", "pads", "strides")))

    def add(self, planes: np.ndarray) -> None:
        """Note some places of what it reads, (1, C, h, w)."""
        padded = np.pad(planes[0], ((0, 0), *2 * [(self._pad, self._pad)]))
        windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * (self._side,), (1, 2))
        windows = windows[:, ::self._stride, ::self._stride]
        rows, columns = (self._random.integers(0, size, PATCHES) for size in windows.shape[1:3])
        some = windows[:, rows, columns].transpose(1, 0, 2, 3).reshape(PATCHES, -1).astype(np.float32)
        self._sum = self._sum + some.T @ some / PATCHES

    def rounded(self, weight: np.ndarray) -> Rounded:
        """The convolution's weights (outputs, C, side, side) in integers."""
        factors, steps = rounded(weight.reshape(len(weight), -1), np.float64(self._sum))
        return Rounded(factors.reshape(weight.shape), steps)


def rounded(weights: np.ndarray, moments: np.ndarray, limit: int = LIMIT) -> Rounded:
    """Integers up to `limit` for weights (outputs, inputs), by least squared error of the sums.

    Args:
        moments: (inputs, inputs), the mean product of inputs.
    """
    count = weights.shape[1]
    damped = moments + (DAMPING * np.trace(moments) / count or 1.0) * np.eye(count)  # 1: inputs that are always zero
    upper = np.linalg.cholesky(np.linalg.inv(damped)).T
    best = np.full(len(weights), np.inf)
    factors, steps = np.zeros(weights.shape), np.ones(len(weights), np.float32)
    for share in SHARES:
        step = np.maximum(np.abs(weights).max(1) * share / limit, 1e-12).astype(np.float32)
        tried = _compensated(weights.astype(np.float64), upper, step, limit)
        apart = tried * step[:, None] - weights
        error = ((apart @ damped) * apart).sum(1)
        better = error < best
        best[better], factors[better], steps[better] = error[better], tried[better], step[better]
    return Rounded(factors, steps)


def _compensated(left: np.ndarray, upper: np.ndarray, step: np.ndarray, limit: int) -> np.ndarray:
    """Rounds one column after the other; what each leaves is taken from those behind it."""
    found = np.empty_like(left)
    for i in range(left.shape[1]):
        found[:, i] = np.clip(np.rint(left[:, i] / step), -limit, limit)
        missing = (left[:, i] - found[:, i] * step) / upper[i, i]
        left[:, i:] -= missing[:, None] * upper[i, i:]
    return found
