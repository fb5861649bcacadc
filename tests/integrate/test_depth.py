"""Depth conventions against projection matrices written out, and normals against rotated ones."""

import math

import numpy as np
import pytest

from postfx import integrate
from postfx.errors import DepthError
from tests.integrate.pinhole import Pinhole, turned

NEAR, FAR = 0.1, 250.0
DEPTH = np.array([[0.1, 0.5, 3.0], [40.0, 200.0, 249.0]])


def device(depth: np.ndarray, a: float, b: float) -> np.ndarray:
    """z / w of a projection whose third row gives a * depth + b."""
    return (a * depth + b) / depth


@pytest.mark.parametrize(
    ("a", "b", "planes"),
    [
        (FAR / (FAR - NEAR), -FAR * NEAR / (FAR - NEAR), {"far": FAR}),  # Direct3D, Vulkan, Metal
        (NEAR / (NEAR - FAR), FAR * NEAR / (FAR - NEAR), {"far": FAR, "reversed_z": True}),
        # OpenGL
        ((FAR + NEAR) / (FAR - NEAR), -2 * FAR * NEAR / (FAR - NEAR), {"far": FAR, "signed": True}),
        (0.0, NEAR, {"reversed_z": True}),  # infinite far plane
        (1.0, -NEAR, {}),
    ],
)
def test_depth_buffers_of_projections(a, b, planes):
    buffer = device(DEPTH, a, b)
    np.testing.assert_allclose(integrate.depth_from_device(buffer, NEAR, **planes), DEPTH,
                               rtol=1e-9)
    np.testing.assert_allclose(integrate.depth_to_device(DEPTH, NEAR, **planes), buffer, atol=1e-12)
    empty = 0.0 if planes.get("reversed_z") else 1.0
    assert integrate.depth_from_device(np.full((1, 1), empty), NEAR, **planes) == 1e10
    assert integrate.depth_to_device(np.full((1, 1), 1e10), NEAR, **planes) == empty


def test_normalised_depth():
    stored = (DEPTH - NEAR) / (FAR - NEAR)
    np.testing.assert_allclose(integrate.depth_from_normalised(stored, NEAR, FAR), DEPTH)
    np.testing.assert_allclose(integrate.depth_from_normalised(1 - stored, NEAR, FAR,
                                                               reversed_z=True), DEPTH)
    assert integrate.depth_from_normalised(np.ones((1, 1)), 0, FAR) == 1e10


def test_ray_distance_is_the_length_of_the_ray():
    camera, jitter = Pinhole(np.zeros(3), np.eye(3)), (0.2, -0.3)
    rays = camera.rays(jitter)
    depth = np.random.default_rng(2).uniform(1, 9, rays.shape[:2])
    distance = np.linalg.norm(depth[..., None] * rays, axis=-1)
    np.testing.assert_allclose(integrate.depth_from_ray(distance, camera.fov_x, jitter), depth)
    np.testing.assert_allclose(integrate.ray_from_depth(depth[..., None], camera.fov_x,
                                                        jitter)[..., 0], distance)
    rows = integrate.depth_from_ray(distance[5:9], camera.fov_x, jitter, first=5,
                                    height=len(distance))
    np.testing.assert_allclose(rows, depth[5:9])
    distance[0, 0], distance[0, 1] = np.inf, 1e10
    assert (integrate.depth_from_ray(distance, camera.fov_x)[0, :2] == 1e10).all()


def test_misses_become_1e10():
    found = integrate.depth_with_misses(np.array([[0.0, 2.0], [np.nan, 1e30]]), miss=0)
    np.testing.assert_array_equal(found, [[1e10, 2.0], [1e10, 1e10]])


@pytest.mark.parametrize("planes", [(0.0, 5.0), (2.0, 1.0), (-1.0, math.inf)])
def test_planes_that_no_camera_has(planes):
    with pytest.raises(DepthError, match="near .* and far"):
        integrate.depth_from_device(DEPTH, *planes)


def test_normals_turn_with_the_camera():
    axes = turned(0.7, 0.2)
    camera = Pinhole(np.array([1.0, 2, 3]), axes)
    normals = np.random.default_rng(4).normal(size=(5, 6, 3))
    by_axis = np.stack([(normals * axis).sum(-1) for axis in axes], -1)
    np.testing.assert_allclose(integrate.normals_to_camera(normals, camera.world_to_camera),
                               by_axis)
    np.testing.assert_allclose(integrate.normals_to_world(by_axis, 3 * camera.world_to_camera),
                               normals, atol=1e-12)
    away = integrate.facing_normals(normals, camera.rays()[:5, :6])
    assert (((away * camera.rays()[:5, :6]).sum(-1) <= 0).all()
            and np.allclose(abs(away), abs(normals)))
    encoded = np.array([[[0.5, 1.0, 0.5], [0, 0, 0]]])
    np.testing.assert_array_equal(integrate.normals_from_encoded(encoded), [[[0, 1, 0], [0, 0, 0]]])
