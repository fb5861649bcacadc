"""Motion of a background that files leave out, against a camera that turns and moves over a traced
scene."""

from __future__ import annotations

import numpy as np
import pytest

from postfx import integrate
from postfx.io.convert import fill_background_motion
from tests.integrate.pinhole import Pinhole, hit_plane, hit_sphere, turned

HEIGHT, WIDTH = 72, 128
NOW = Pinhole(np.array([0.3, 1.2, -4.0]), turned(0.15, 0.05))


def clip_of(camera: Pinhole) -> np.ndarray:
    return camera.world_to_camera @ integrate.perspective(camera.fov_x, WIDTH, HEIGHT, forward="+z")


def scene(floor: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Depth (height, width, 1) of balls over a floor, or of balls alone, under a sky, and which one
    was hit."""
    eye, rays = integrate.view_rays(WIDTH, HEIGHT, clip_of(NOW))
    shapes = [hit_sphere(eye, rays, np.array(centre), 0.6)
              for centre in ((-0.5, 0.8, 0.2), (1.5, 1.0, 2.0))]
    if floor:
        shapes.append(hit_plane(eye, rays, np.zeros(3), np.array([0.0, 1, 0])))
    depth = np.min(shapes, axis=0)
    return np.where(np.isfinite(depth), depth, 1e10)[..., None], np.argmin(shapes, axis=0)


def motions(before: Pinhole,
            floor: bool = True) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """True motion, the same with zeros at misses, depth, and which shape was hit."""
    depth, shape = scene(floor)
    truth = integrate.motion_from_depth(depth, clip_of(NOW), clip_of(before)).astype(np.float32)
    return truth, np.where(depth < 1e10, truth, 0).astype(np.float32), depth, shape


@pytest.mark.parametrize(("eye", "yaw", "pitch"), [
    ((0.3, 1.2, -4.0), 0.12, 0.04), ((0.1, 1.1, -4.3), 0.15, 0.05), ((0.1, 1.3, -4.2), 0.17, 0.06)],
    ids=["turns", "moves", "turns and moves"])
def test_misses_move_with_the_camera(eye: tuple[float, float, float], yaw: float,
                                     pitch: float) -> None:
    truth, stored, depth, shape = motions(Pinhole(np.array(eye), turned(yaw, pitch)))
    stored[(shape == 1) & (depth[..., 0] < 1e10)] += 5  # a ball that moves by itself
    surfaces = stored[depth[..., 0] < 1e10]
    assert fill_background_motion(stored, depth)
    missed = depth[..., 0] >= 1e10
    assert missed.mean() > 0.2
    np.testing.assert_allclose(stored[missed], truth[missed], atol=0.1)
    np.testing.assert_array_equal(stored[~missed], surfaces)


def test_nothing_is_filled_where_all_is_there_still_or_unknown() -> None:
    turns = Pinhole(NOW.eye, turned(0.12, 0.04))
    truth, stored, depth, _ = motions(turns)
    for motion, why in ((truth, "the sky has motion"), (np.zeros_like(stored), "nothing moves")):
        before = motion.copy()
        assert not fill_background_motion(motion, depth), why
        np.testing.assert_array_equal(motion, before)
    fog = np.where(np.random.default_rng(2).random(depth.shape) < 0.5, truth, stored)
    assert not fill_background_motion(fog, depth), "half of the misses have motion"
    assert not fill_background_motion(stored, np.full_like(depth, 1e10)), "no surface"
    random = np.random.default_rng(1).normal(0, 3, stored.shape).astype(np.float32)
    random[depth[..., 0] >= 1e10] = 0
    assert not fill_background_motion(random, depth), "surfaces that move anyhow"
