"""Reading planes between their pixels."""

import numpy as np
import pytest

from postfx.sampling import bilinear, is_inside, motion_at

PLANE = np.random.default_rng(7).random((5, 6, 3)).astype(np.float32)


def test_what_is_linear_is_met_everywhere_inside():
    y, x = np.indices((5, 6)).astype(np.float32)
    plane = np.stack([2 * x - 3 * y + 1, x * y], -1)
    at_x, at_y = np.array([0, 0.25, 3.5, 5]), np.array([0, 1.75, 3.999, 4])
    values = bilinear(plane, at_x, at_y)
    np.testing.assert_allclose(values, np.stack([2 * at_x - 3 * at_y + 1, at_x * at_y], -1),
                               rtol=1e-5)


def test_edges_are_repeated_and_known_to_be_outside():
    x, y = np.array([-2, 5.01, 2, 5]), np.array([0, 1, 7, 4])
    expected = PLANE[[0, 1, 4, 4], [0, 5, 2, 5]]
    np.testing.assert_array_equal(bilinear(PLANE, x, y), expected)
    assert is_inside(PLANE, x, y).tolist() == [False, False, False, True]


def test_a_curve_is_applied_before_mixing():
    x, y = np.array([1.5]), np.array([2.0])
    expected = (PLANE[2, 1] ** 2 + PLANE[2, 2] ** 2) / 2
    np.testing.assert_allclose(bilinear(PLANE, x, y, np.square)[0], expected, rtol=1e-6)


@pytest.mark.parametrize("shape", [(1, 1, 2), (1, 4), (4, 1, 2, 2)])
def test_planes_of_a_single_row_or_column(shape):
    plane = np.arange(np.prod(shape), dtype=np.float32).reshape(shape)
    assert bilinear(plane, np.array([0.5]), np.array([0.0])).shape == (1, *shape[2:])


def test_motion_is_that_of_the_nearest_pixel():
    motion = np.random.default_rng(1).random((3, 4, 2)).astype(np.float32)
    assert np.array_equal(motion_at(motion, np.arange(6), np.arange(8), 6, 8),
                          2 * motion.repeat(2, 0).repeat(2, 1))
    assert motion_at(motion, np.arange(0, 5, 2), np.arange(6), 5, 6).shape == (3, 6, 2)
