"""Motion, positions and depth against a scene of a plane and a sphere that is traced by hand in
float64."""

import math

import numpy as np
import pytest

from postfx import integrate
from tests.integrate.pinhole import HEIGHT, WIDTH, Pinhole, hit_plane, hit_sphere, turned

NOW = Pinhole(np.array([0.3, 1.2, -4.0]), turned(0.15, -0.2))
THEN = Pinhole(np.array([-0.1, 1.0, -4.3]), turned(0.05, -0.1))
JITTER, BEFORE = (0.31, -0.22), (-0.4, 0.17)
CENTRE, RADIUS = np.array([0.4, 0.8, 0.2]), 0.8
FLOOR = np.zeros(3), np.array([0.0, 1, 0])


def clip_of(camera: Pinhole) -> np.ndarray:
    return camera.world_to_camera @ integrate.perspective(camera.fov_x, WIDTH, HEIGHT, forward="+z")


def scene(camera: Pinhole, jitter=(0.0, 0.0)) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Depth (1e10 at misses), whether the sphere was hit, and rays."""
    rays = camera.rays(jitter)
    ball, floor = hit_sphere(camera.eye, rays, CENTRE, RADIUS), hit_plane(camera.eye, rays, *FLOOR)
    depth = np.minimum(ball, floor)
    return np.where(np.isfinite(depth), depth, 1e10), ball < floor, rays


def expected(points: np.ndarray, jitter=JITTER) -> np.ndarray:
    """Motion of points that the pixels show, from where the camera before saw them."""
    x, y = np.arange(WIDTH) + 0.5 + jitter[0], np.arange(HEIGHT) + 0.5 + jitter[1]
    return THEN.sees(points) - np.stack(np.meshgrid(x, y), -1)


def test_motion_of_a_scene_at_rest_with_sky():
    depth, _, rays = scene(NOW, JITTER)
    missed = depth >= 1e10
    assert missed.any() and not missed.all()
    motion = integrate.motion_from_depth(depth, clip_of(NOW), clip_of(THEN), JITTER)
    np.testing.assert_allclose(motion[~missed],
                               expected(NOW.eye + depth[..., None] * rays)[~missed], atol=1e-9)
    rotated_only = THEN.eye + 1e12 * rays
    np.testing.assert_allclose(motion[missed], expected(rotated_only)[missed], atol=1e-6)


def test_positions_and_projection_are_those_of_the_rays():
    depth, _, rays = scene(NOW, JITTER)
    hit = depth < 1e10
    points = integrate.positions_from_depth(depth[..., None], clip_of(NOW), JITTER)
    np.testing.assert_allclose(points[hit], (NOW.eye + depth[..., None] * rays)[hit], atol=1e-9)
    np.testing.assert_allclose(integrate.project(points, clip_of(THEN), WIDTH, HEIGHT)[hit],
                               THEN.sees(points)[hit])
    np.testing.assert_allclose(integrate.depth_of(points, clip_of(NOW))[hit], depth[hit])


def test_what_was_behind_the_camera_leads_out_of_the_picture():
    back = Pinhole(THEN.eye, turned(math.pi, 0.0))
    motion = integrate.motion_from_depth(scene(NOW)[0], clip_of(NOW), clip_of(back))
    column, row = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    assert np.isfinite(motion).all()
    assert ((motion[..., 0] + column >= WIDTH) | (motion[..., 0] + column < 0)
            | (motion[..., 1] + row < 0)).all()


def test_rigid_object_over_a_floor_at_rest():
    depth, ball, rays = scene(NOW, JITTER)
    points = NOW.eye + depth[..., None] * rays
    turn = np.eye(4)
    turn[:3, :3], turn[3, :3] = turned(0.4, 0.3), (0.1, -0.2, 0.05)
    shift = np.eye(4)
    shift[3, :3] = (-0.3, 0.1, 0.2)
    before = integrate.rigid_previous_positions(points, np.where(ball, 7, 0), {7: turn},
                                                {7: turn @ shift})
    moved = np.where(ball[..., None], points + (-0.3, 0.1, 0.2), points)
    np.testing.assert_allclose(before, moved, atol=1e-6 * np.abs(points).max())
    near = depth < 1e10
    motion = integrate.motion_from_positions(points, before, clip_of(NOW), clip_of(THEN))
    np.testing.assert_allclose(motion[near], expected(moved)[near], atol=1e-9)
    with pytest.raises(integrate.IntegrationError,
                       match="object 7 has a transform in one frame only"):
        integrate.rigid_previous_positions(points, ball, {7: turn}, {})


def test_skinned_points_come_from_their_rest_pose():
    rng = np.random.default_rng(3)
    rest, weights = rng.normal(size=(4, 5, 3)), rng.dirichlet([1, 1, 1], (4, 5))
    bones = np.broadcast_to(np.arange(3), (4, 5, 3))
    poses = [np.stack([np.eye(4) for _ in range(3)]) for _ in range(2)]
    for pose in poses:
        for matrix in pose:
            matrix[:3, :3], matrix[3, :3] = turned(*rng.uniform(-0.5, 0.5, 2)), rng.normal(size=3)
    posed = [sum(weights[..., k, None] * (rest @ pose[k, :3, :3] + pose[k, 3, :3])
                 for k in range(3)) for pose in poses]
    weights[0, 0], before = 0, integrate.skinned_previous_positions
    found = before(posed[0], bones, weights, *poses)
    np.testing.assert_allclose(found[1:], posed[1][1:], atol=1e-12)
    np.testing.assert_array_equal(found[0, 0], posed[0][0, 0])


@pytest.mark.parametrize("axes", [("+x", "+y", "-z"), ("-x", "+y", "+z"), ("+x", "+z", "+y")])
def test_cameras_of_any_axes_see_the_same(axes):
    columns = [np.eye(3)["xyz".index(axis[1])] * (-1 if axis[0] == "-" else 1) for axis in axes]
    own = NOW.world_to_camera.copy()
    own[:, :3] = own[:, :3] @ np.array(columns)
    clip = own @ integrate.perspective(NOW.fov_x, WIDTH, HEIGHT, *axes)
    points = np.random.default_rng(1).normal(size=(20, 3))
    np.testing.assert_allclose(integrate.project(points, clip, WIDTH, HEIGHT), NOW.sees(points),
                               atol=1e-9)


def test_a_jittered_matrix_moves_the_sample_to_the_pixel_centre():
    clip = integrate.with_jitter(clip_of(NOW), JITTER, WIDTH, HEIGHT)
    points = NOW.eye + 3 * NOW.rays(JITTER)
    centres = np.stack(np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5), -1)
    np.testing.assert_allclose(integrate.project(points, clip, WIDTH, HEIGHT), centres, atol=1e-9)
    np.testing.assert_allclose(integrate.without_jitter(clip, JITTER, WIDTH, HEIGHT), clip_of(NOW),
                               atol=1e-12)


def test_motion_of_jittered_matrices_is_dejittered():
    depth, _, rays = scene(NOW, JITTER)
    points, hit = NOW.eye + depth[..., None] * rays, depth < 1e10
    with_both = [
        integrate.with_jitter(clip_of(camera), jitter, WIDTH, HEIGHT)
        for camera, jitter in ((NOW, JITTER), (THEN, BEFORE))
    ]
    jittered = integrate.motion_from_positions(points, points, *with_both)
    assert np.abs(jittered - expected(points))[hit].max() > 0.3
    np.testing.assert_allclose(integrate.dejitter_motion(jittered, JITTER, BEFORE)[hit],
                               expected(points)[hit], atol=1e-9)


@pytest.mark.parametrize(
    ("stored", "convention"),
    [
        ((3.0, -1.5), {}),
        ((3.0 / 40, -1.5 / 30), {"unit": "uv"}),
        ((2 * 3.0 / 40, 2 * 1.5 / 30), {"unit": "ndc", "y_up": True}),
        ((-3.0, -1.5), {"y_up": True, "from_previous": True}),
        ((0.5 + 1.5 / 40, 0.5 - 0.75 / 30), {"unit": "uv", "encoded": True}),
    ],
)
def test_every_convention_of_one_motion(stored, convention):
    motion = integrate.motion_in_pixels(np.full((30, 40, 2), stored), **convention)
    np.testing.assert_allclose(motion, np.broadcast_to((3.0, -1.5), (30, 40, 2)))


def test_what_cannot_be_used_is_explained():
    with pytest.raises(integrate.IntegrationError, match="not a perspective matrix"):
        integrate.motion_from_depth(np.ones((4, 4)), np.diag([1.0, 1, 1, 1]), np.eye(4))
    with pytest.raises(integrate.IntegrationError, match="unit 'metres': use pixels, uv, ndc"):
        integrate.motion_in_pixels(np.ones((4, 4, 2)), "metres")
    with pytest.raises(integrate.IntegrationError, match="give one of x, y, z each"):
        integrate.perspective(50, 10, 10, right="+x", up="+x")
    with pytest.raises(integrate.IntegrationError, match=r"shape \(4, 4, 3\)"):
        integrate.positions_from_depth(np.ones((4, 4, 3)), clip_of(NOW))
