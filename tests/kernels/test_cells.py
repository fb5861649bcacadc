"""Kernels of the coarse grid are what NumPy says."""

from __future__ import annotations

import numpy as np
import pytest

from postfx.kernels.image import box_means, mark_positive, moments

RANDOM = np.random.default_rng(0)


@pytest.mark.parametrize("size", [(1, 1, 1), (3, 40, 2), (45, 80, 6)], ids=str)
@pytest.mark.parametrize("width", [1, 3, 17])
def test_box_means(size: tuple[int, int, int], width: int) -> None:
    planes, found, near = RANDOM.normal(size=size), np.empty(size), width // 2
    padded = np.pad(planes, ((near, near), (near, near), (0, 0)), "edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, (width, width), (0, 1))
    box_means(planes, width, found)
    np.testing.assert_allclose(found, windows.mean((3, 4)), rtol=0, atol=1e-14)


def test_moments() -> None:
    a, b = RANDOM.normal(3, 1, (500, 2, 3)), RANDOM.normal(-2, 2, (500, 2, 3))
    for one, other in ((a[:, 0], b[:, 1]), (a[:, 0, :1], a[:, 0, :1])):
        one_less, other_less = one - one.mean(0), other - other.mean(0)
        wanted = [np.mean(x * y) for x, y in ((one_less, one_less), (other_less, other_less), (one_less, other_less))]
        np.testing.assert_allclose(moments(one, other), wanted, rtol=1e-12)


@pytest.mark.parametrize("size", [(1, 1), (7, 9), (40, 62)], ids=str)
def test_positive_cells(size: tuple[int, int]) -> None:
    plane = (RANDOM.random((*size, 1)) * (RANDOM.random((*size, 1)) < 0.05)).astype(np.float32)
    plane[-1, -1] = -1
    cells = np.zeros([-(-side // 4) * 2 for side in size], bool)
    mark_positive(plane, 2, cells)
    for y, x in np.ndindex(cells.shape):
        assert cells[y, x] == (plane[2 * y:2 * y + 2, 2 * x:2 * x + 2] > 0).any()
