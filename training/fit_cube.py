"""Fit a colour cube to pairs of shaped and wanted colours by least squares.

What no pair speaks of follows its neighbours: second differences of the change from a starting cube are kept small, so
the change goes on evenly where the data ends, and the starting cube's own shape stays.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import cg

SMOOTH, NEAR = 1e-2, 1e-7  # weights of second differences and of the change itself, against 1 for the data of a cell
TOLERANCE, ITERATIONS = 1e-7, 6000  # what has no data comes last: stopping early would leave it at the start


def fit_cube(shaped: np.ndarray, wanted: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Cube (size,size,size,3) float32 in [0, 1], held by half precision.

    shaped: (n, 3) in [0, 1]; wanted: (n, 3) display colour; start: cube that the fit departs from. One linear system a
    channel, solved by conjugate gradients.
    """
    size = start.shape[0]
    matrix = interpolation(shaped, size) * np.sqrt(size**3 / len(shaped))
    missing = wanted * np.sqrt(size**3 / len(shaped)) - matrix @ start.reshape(-1, 3)
    rough = second_differences(size)
    normal = (matrix.T @ matrix + SMOOTH * (rough.T @ rough) + NEAR * sparse.identity(size**3)).tocsr()
    scale = sparse.diags(1.0 / normal.diagonal())
    change = [cg(normal, matrix.T @ missing[:, c], rtol=TOLERANCE, maxiter=ITERATIONS, M=scale)[0] for c in range(3)]
    cube = start + np.stack(change, -1).reshape(start.shape)
    return cube.clip(0.0, 1.0).astype(np.float16).astype(np.float32)


def interpolation(shaped: np.ndarray, size: int) -> sparse.csr_matrix:
    """Sparse (n, size**3) matrix of tetrahedral interpolation, four weights a row; see `postfx.kernels.cube`."""
    at = np.asarray(shaped, np.float64).clip(0.0, 1.0) * (size - 1)
    corner = np.minimum(at.astype(np.int64), size - 2)
    share, steps = at - corner, np.array([size * size, size, 1])
    order = np.argsort(-share, axis=1, kind="stable")
    share = np.take_along_axis(share, order, 1)
    columns = np.cumsum(np.column_stack([corner @ steps, steps[order]]), axis=1)
    weights = np.column_stack([1 - share[:, 0], share[:, 0] - share[:, 1], share[:, 1] - share[:, 2], share[:, 2]])
    rows = np.repeat(np.arange(len(at)), 4)
    return sparse.csr_matrix((weights.ravel(), (rows, columns.ravel())), shape=(len(at), size**3))


def second_differences(size: int) -> sparse.csr_matrix:
    """Second differences of a flat cube along its three axes, stacked."""
    along = sparse.diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(size - 2, size))
    same = sparse.identity(size)
    axes = ((along, same, same), (same, along, same), (same, same, along))
    return sparse.vstack([sparse.kron(sparse.kron(a, b), c) for a, b, c in axes]).tocsr()
