"""Mirrors against reflected rays traced by hand, glass against Snell's law and summed bounces."""


import numpy as np
import pytest

from postfx import Role, integrate
from tests.integrate.pinhole import HEIGHT, WIDTH, Pinhole, hit_plane, hit_sphere, turned

NOW, THEN = (Pinhole(np.array([x, 0.1, -3.0]), turned(yaw, 0.05))
             for x, yaw in ((0.0, 0.1), (0.35, -0.05)))
MIRROR = np.array([0.0, 0, 2.0])
NORMAL = np.array([0.3, 0.1, -1.0]) / np.linalg.norm([0.3, 0.1, -1.0])
CENTRE, CENTRE_BEFORE, RADIUS = np.array([0.7, 0.2, -1.0]), np.array([0.5, 0.3, -1.1]), 0.9


def through_the_mirror(camera: Pinhole, rays: np.ndarray,
                       centre: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points on the mirror, and points on the ball that the reflected rays hit (NaN where they
    miss)."""
    surface = camera.eye + hit_plane(camera.eye, rays, MIRROR, NORMAL)[..., None] * rays
    reflected = rays - 2 * (rays @ NORMAL)[..., None] * NORMAL
    t = hit_sphere(surface, reflected, centre, RADIUS)
    return surface, surface + np.where(np.isfinite(t), t, np.nan)[..., None] * reflected


def clip_of(camera: Pinhole) -> np.ndarray:
    return camera.world_to_camera @ integrate.perspective(camera.fov_x, WIDTH, HEIGHT, forward="+z")


def test_motion_in_a_mirror_leads_to_the_pixel_that_showed_the_same_point_before():
    surface, ball = through_the_mirror(NOW, NOW.rays(), CENTRE)
    seen = np.isfinite(ball).all(-1)
    assert 50 < seen.sum() < seen.size
    before = ball + (CENTRE_BEFORE - CENTRE)
    motion = integrate.motion_from_positions(
        *(integrate.mirrored_positions(points, MIRROR, NORMAL) for points in (ball, before)),
        clip_of(NOW), clip_of(THEN),
    )
    place = np.stack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), -1) + 0.5 + motion
    x, y = (place[..., 0] - WIDTH / 2) / THEN.focal, (HEIGHT / 2 - place[..., 1]) / THEN.focal
    rays = x[..., None] * THEN.axes[0] + y[..., None] * THEN.axes[1] + THEN.axes[2]
    found = through_the_mirror(THEN, rays, CENTRE_BEFORE)[1]
    shown = seen & np.isfinite(found).all(-1)
    assert shown.sum() > 0.7 * seen.sum()
    np.testing.assert_allclose(found[shown], before[shown], atol=1e-6)


def test_virtual_depth_is_the_length_of_the_path():
    surface, ball = through_the_mirror(NOW, NOW.rays(), CENTRE)
    seen = np.isfinite(ball).all(-1)
    virtual = integrate.mirrored_positions(ball, MIRROR, NORMAL)
    path = np.linalg.norm(surface - NOW.eye, axis=-1) + np.linalg.norm(ball - surface, axis=-1)
    depth = path / np.linalg.norm(NOW.rays(), axis=-1)
    np.testing.assert_allclose(integrate.depth_of(virtual, clip_of(NOW))[seen], depth[seen])
    np.testing.assert_allclose(integrate.unfolded_positions(NOW.eye, surface, ball)[seen],
                               virtual[seen])


def test_mirrored_normals_are_those_of_the_mirrored_sphere():
    _, ball = through_the_mirror(NOW, NOW.rays(), CENTRE)
    seen = np.isfinite(ball).all(-1)
    virtual = integrate.mirrored_positions(ball, MIRROR, NORMAL)
    centre = integrate.mirrored_positions(CENTRE, MIRROR, NORMAL)
    found = integrate.mirrored_normals((ball - CENTRE) / RADIUS, NORMAL)
    np.testing.assert_allclose(found[seen], ((virtual - centre) / RADIUS)[seen], atol=1e-12)


@pytest.mark.parametrize("ior", [1.5, 1 / 1.5, 2.4])
def test_fresnel_by_angles(ior):
    angle = np.linspace(0.01, np.pi / 2 - 0.01, 90)
    with np.errstate(invalid="ignore"):
        inner = np.arcsin(np.sin(angle) / ior)
    s = (np.sin(angle - inner) / np.sin(angle + inner)) ** 2
    p = (np.tan(angle - inner) / np.tan(angle + inner)) ** 2
    wanted = np.where(np.isnan(inner), 1, (s + p) / 2)
    np.testing.assert_allclose(integrate.fresnel_dielectric(np.cos(angle), ior), wanted, atol=1e-9)


def test_schlick_is_near_the_exact_reflectance():
    cosine = np.linspace(0, 1, 100)
    exact = integrate.fresnel_dielectric(cosine, 1.5)
    schlick = integrate.fresnel_schlick(0.04, cosine)
    assert np.abs(exact - schlick).max() < 0.05 and abs(exact[-1] - 0.04) < 1e-12


def test_a_pane_sums_its_bounces():
    reflected, transmitted = integrate.glass_weights(np.array([0.3]), pane=True)
    r = integrate.fresnel_dielectric(0.3)
    bounces = r + sum((1 - r) * r ** (2 * k + 1) * (1 - r) for k in range(60))
    np.testing.assert_allclose(reflected, bounces)
    np.testing.assert_allclose(reflected + transmitted, 1)


def test_glass_mixes_albedos_and_takes_the_stronger_surface():
    shape = (1, 2)
    mirror = {Role.DIFFUSE_ALBEDO: np.ones((*shape, 3)), Role.DEPTH: np.full((*shape, 1), 1e10)}
    behind = {Role.DIFFUSE_ALBEDO: np.zeros((*shape, 3)), Role.DEPTH: np.full((*shape, 1), 5.0),
              Role.MOTION: np.zeros((*shape, 2))}
    planes = integrate.blend_surfaces(np.array([[0.25, 0.75]]), mirror, behind)
    assert set(planes) == {Role.DIFFUSE_ALBEDO, Role.DEPTH}
    np.testing.assert_array_equal(planes[Role.DIFFUSE_ALBEDO][0, :, 0], [0.25, 0.75])
    np.testing.assert_array_equal(planes[Role.DEPTH][0, :, 0], [5.0, 1e10])
