"""Classical ambient occlusion: what is known of planes and corners, and no light lost at misses."""

from __future__ import annotations

import numpy as np

from postfx.kernels.occlusion import FAR, FIND_LOOKS, FIND_SURFACE, HORIZONS, LOOK, SMOOTH_OCCLUSION

HEIGHT, WIDTH, TANGENT = 60, 80, 0.5


def visible_of(normal: np.ndarray, depth: np.ndarray,
               radius: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Surface, raw and smooth visibility of planes in camera space."""
    camera = np.float32([*np.eye(3).ravel(), radius, TANGENT, TANGENT * HEIGHT / WIDTH])
    surface = np.empty((HEIGHT, WIDTH, 4), np.float32)
    raw, smooth = (np.empty((HEIGHT, WIDTH), np.float32) for _ in range(2))
    FIND_SURFACE.rows(0, HEIGHT, normal.astype(np.float32), depth[..., None].astype(np.float32),
                      camera, surface)
    HORIZONS.rows(0, HEIGHT, surface, camera, np.float32([0.9, 0]), raw)
    SMOOTH_OCCLUSION.rows(0, HEIGHT, surface, raw, smooth)
    return surface, raw, smooth


def slopes() -> tuple[np.ndarray, np.ndarray]:
    x, y = np.meshgrid((np.arange(WIDTH) + 0.5) / WIDTH * 2 - 1,
                       1 - (np.arange(HEIGHT) + 0.5) / HEIGHT * 2)
    return x * TANGENT, y * TANGENT * HEIGHT / WIDTH


def test_a_plane_is_open_however_it_is_turned_and_so_is_nothing() -> None:
    x, y = slopes()
    for plane in ((0, 0, 1), (0.6, 0, 0.8), (0, -0.7, 0.714)):
        normal = np.broadcast_to(np.float32(plane), (HEIGHT, WIDTH, 3)).copy()
        depth = 3 * plane[2] / (plane[2] - plane[0] * x - plane[1] * y)  # n . p = -3 n_z
        normal[:5], depth[:5] = 0, 1e10
        depth[10, 10], normal[11, 11] = np.nan, np.inf
        surface, _, smooth = visible_of(normal, depth, 0.8)
        assert (smooth[surface[..., 3] < FAR].min() > 0.96 and (smooth[:5] == 1).all()
                and smooth[10, 10] == 1)


def test_the_crease_between_two_walls_is_half_as_open_as_a_plane() -> None:
    """A point in the crease of two walls at a right angle sees half of what a plane does; one a
    radius away, all."""
    x, _ = slopes()
    normal = np.stack([np.where(x < 0, 1, -1) / np.sqrt(2), np.zeros_like(x),
                       np.full_like(x, np.sqrt(0.5))], -1)
    depth = 3 / (1 + np.abs(x))  # walls meet at x = 0, 3 away
    _, raw, smooth = visible_of(normal, depth, 0.4)
    across = smooth[10:50].mean(0)
    assert 0.45 < raw[10:50, 39:41].mean() < 0.65
    assert (np.diff(across[40:52]) > -0.02).all() and across[60:75].min() > 0.97


def test_what_the_network_reads_is_bounded() -> None:
    x, _ = slopes()
    normal = np.stack([np.where(x < 0, 1, -1) / np.sqrt(2), np.zeros_like(x),
                       np.full_like(x, np.sqrt(0.5))], -1)
    surface, raw, smooth = visible_of(normal, 3 / (1 + np.abs(x)), 0.4)
    camera = np.float32([*np.eye(3).ravel(), 0.4, TANGENT, TANGENT * HEIGHT / WIDTH])
    points = np.empty((2 * WIDTH, LOOK), np.float32)
    FIND_LOOKS.rows(0, 2 * WIDTH, surface, camera, raw, smooth, np.float32([30]), points)
    assert np.abs(points).max() <= 2 and points[:, :-5:2].max() > 0.5
    np.testing.assert_array_equal(points[:, -1].reshape(2, WIDTH), smooth[30:32])
