"""A pinhole camera and two shapes in float64, written out by hand: what the helpers are tested
against."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

WIDTH, HEIGHT = 48, 27


def turned(yaw: float, pitch: float) -> np.ndarray:
    """Camera axes as rows (right, up, forward) in the world."""
    forward = np.array([np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)])
    right = np.cross(np.array([0.0, 1, 0]), forward)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


@dataclass
class Pinhole:
    """Right, up and forward are the camera's x, y and z; row vectors: p_camera = (p - eye) @ axes
    transposed."""

    eye: np.ndarray
    axes: np.ndarray
    fov_x: float = 60.0

    @property
    def focal(self) -> float:
        return WIDTH / 2 / np.tan(np.radians(self.fov_x) / 2)

    @property
    def world_to_camera(self) -> np.ndarray:
        matrix = np.eye(4)
        matrix[:3, :3], matrix[3, :3] = self.axes.T, -self.eye @ self.axes.T
        return matrix

    def rays(self, jitter: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
        """Directions (HEIGHT, WIDTH, 3) of length 1 along the forward axis."""
        rays = np.empty((HEIGHT, WIDTH, 3))
        for row in range(HEIGHT):
            for column in range(WIDTH):
                x = (column + 0.5 + jitter[0] - WIDTH / 2) / self.focal
                y = (HEIGHT / 2 - (row + 0.5 + jitter[1])) / self.focal
                rays[row, column] = x * self.axes[0] + y * self.axes[1] + self.axes[2]
        return rays

    def sees(self, points: np.ndarray) -> np.ndarray:
        """Pixel positions (..., 2) of points."""
        x, y, z = np.moveaxis((points - self.eye) @ self.axes.T, -1, 0)
        return np.stack([WIDTH / 2 + self.focal * x / z, HEIGHT / 2 - self.focal * y / z], -1)


def hit_plane(eye: np.ndarray, rays: np.ndarray, point: np.ndarray,
              normal: np.ndarray) -> np.ndarray:
    """Ray parameter at which a plane is hit; inf where it is not."""
    with np.errstate(divide="ignore"):
        t = ((point - eye) @ normal) / (rays @ normal) if np.ndim(eye) == 1 else (
            ((point - eye) * normal).sum(-1) / (rays * normal).sum(-1))
    return np.where(t > 1e-9, t, np.inf)


def hit_sphere(eye: np.ndarray, rays: np.ndarray, centre: np.ndarray, radius: float) -> np.ndarray:
    """Ray parameter at which a sphere is hit from outside; inf where it is not."""
    a, b = (rays**2).sum(-1), (rays * (eye - centre)).sum(-1)
    c = ((eye - centre) ** 2).sum(-1) - radius**2
    root = b * b - a * c
    t = (-b - np.sqrt(np.maximum(root, 0))) / a
    return np.where((root >= 0) & (t > 1e-9), t, np.inf)
