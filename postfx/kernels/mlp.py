"""A small network inside of a kernel of one's own, between its other instructions.

A kernel in C++ includes `mlp.h`, one for CUDA `<postfx/mlp.cuh>`; both call the same function:

    mlp<GELU, 14, 64, 64, 3>(parameters.at, features, values);

`parameters` is a binding: those of a `postfx.neural.Network` without bands. A vector of points is
evaluated at once, on a GPU a warp's points by its matrix units, or a thread's own where not all of
a warp's threads call, or the network is tiny or wide. Rows that are Python evaluate some points by
the functions here:

    space = mlp_space(network)
    features = mlp_features(space)            # (numbers, points), which the rows fill
    values = mlp(network, parameters, space)  # (outputs, points)

`network` is `facts()` of the network.
"""

from __future__ import annotations

import numpy as np

from postfx.kernels.neural import FORWARD, INPUTS, LAYERS, SIZES

__all__ = ["STRIP", "mlp", "mlp_features", "mlp_space"]

STRIP = 32
"""Points that kernels of networks evaluate at once."""


def mlp_space(network: np.ndarray, points: int = STRIP) -> np.ndarray:
    """Memory for so many points, made once by each call of a kernel's rows."""
    return np.zeros((points, int(network[INPUTS])), np.float32)


def mlp_features(space: np.ndarray) -> np.ndarray:
    """What the first layer reads, float32 (inputs, points)."""
    return space.T


def mlp(network: np.ndarray, parameters: np.ndarray, space: np.ndarray) -> np.ndarray:
    """What the last layer makes of the features, float32 (outputs, points)."""
    values = np.empty((len(space), int(network[SIZES + int(network[LAYERS])])), np.float32)
    FORWARD.rows(0, len(space), network, parameters, space, values)
    return values.T
