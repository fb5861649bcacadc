"""A small network inside of a kernel of one's own, between its other instructions.

On the CPU a kernel evaluates `STRIP` points at once, so that products fill vector registers:

    space = mlp_space(network)
    features = mlp_features(space)           # (numbers, STRIP), which the kernel fills
    values = mlp(network, parameters, space)  # (numbers, STRIP)

`network` and `parameters` are bindings: `facts()` and the parameters of a `postfx.neural.Network` without bands. On a
GPU a thread evaluates its point by `mlp<GELU, 14, 64, 64, 3>(parameters.at, features, values)` of `mlp.cuh`, which a
plug-in's source includes by `#include <postfx/mlp.cuh>`.
"""

from __future__ import annotations

import numpy as np

from postfx.kernels.neural import LAYERS, MOST_LAYERS, run_layers, widest
from postfx.kernels.numeric import compiled
from postfx.kernels.vectors import STRIP

__all__ = ["STRIP", "mlp", "mlp_features", "mlp_space"]


@compiled
def mlp_space(network: np.ndarray) -> np.ndarray:
    """Memory for one strip, made once by each call of a kernel's rows."""
    return np.zeros((2, MOST_LAYERS + 1, widest(network) * STRIP), np.float32)


@compiled
def mlp_features(space: np.ndarray) -> np.ndarray:
    """What the first layer reads, (numbers, STRIP); rows beyond the network's inputs do not count."""
    rows: np.ndarray = space[0, 0].reshape((-1, STRIP))
    return rows


@compiled
def mlp(network: np.ndarray, parameters: np.ndarray, space: np.ndarray) -> np.ndarray:
    """What the last layer makes of the features, (numbers, STRIP), until the next call."""
    run_layers(network, parameters, space[0], space[1], 0)
    rows: np.ndarray = space[0, int(network[LAYERS])].reshape((-1, STRIP))
    return rows
