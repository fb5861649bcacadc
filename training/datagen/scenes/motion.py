"""Camera paths and object motion: functions of the (fractional) frame number to 4x4 matrices."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from training.datagen.scenes.meshes import rotation, translation

Path = Callable[[float], np.ndarray]


@dataclass(frozen=True)
class Camera:
    """`to_world` maps camera space (x left, y up, z forward) to world space; `fov` is horizontal, in degrees."""

    to_world: np.ndarray
    fov: float

    def project(self, points: np.ndarray, width: int, height: int) -> np.ndarray:
        """World points (N, 3) to pixels (N, 2), x right, y down; points behind the camera give nan."""
        local = (points - self.to_world[:3, 3]) @ self.to_world[:3, :3]
        tangent = np.tan(np.radians(self.fov) / 2)
        depth = np.where(local[:, 2] > 1e-6, local[:, 2], np.nan)
        x = width * (0.5 - local[:, 0] / (2 * tangent * depth))
        y = height * 0.5 - width * local[:, 1] / (2 * tangent * depth)
        return np.stack([x, y], 1)


def look_at(eye: np.ndarray, target: np.ndarray, roll: float = 0.0) -> np.ndarray:
    """Camera-to-world matrix; y is up, `roll` in radians."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    left = np.cross([0.0, 1.0, 0.0], forward)
    left /= np.linalg.norm(left)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([left, np.cross(forward, left), forward], 1)
    matrix[:3, 3] = eye
    return matrix @ rotation(np.array([0.0, 0, 1]), roll)


def target_speed(rng: np.random.Generator) -> float:
    """Image motion to aim for, noisy pixels a frame: log-normal, median 2.5, cut at 20."""
    return float(min(2.5 * np.exp(rng.normal(0, 0.85)), 20.0))


@dataclass(frozen=True)
class CameraPath:
    """A base pose and a kind of move; `amplitude` scales the speed, `seed` fixes the shake."""

    eye: np.ndarray
    target: np.ndarray
    fov: float
    kind: str
    amplitude: float
    direction: np.ndarray
    seed: int

    KINDS = ("pan", "dolly", "orbit", "truck", "shake", "mixed")

    def at(self, frame: float) -> Camera:
        s = self.amplitude * (frame - 3.5)
        eye, target = self.eye, self.target
        forward = target - eye
        distance = np.linalg.norm(forward)
        side = np.cross(forward / distance, [0.0, 1.0, 0.0])
        turn = 0.01 * s * (1 if self.direction[0] > 0 else -1)
        if self.kind == "shake":
            wave = np.random.default_rng([self.seed, int(round(frame * 16)) + 1024]).normal(0, 1, 3)
            target = target + 0.006 * distance * self.amplitude * wave
        if self.kind in ("pan", "mixed"):
            axis = np.array([0.3 * self.direction[1], 1.0, 0.3 * self.direction[2]])
            target = eye + rotation(axis, turn)[:3, :3] @ (target - eye)
        if self.kind == "dolly":
            eye = eye + forward * 0.01 * s
            target = target + forward * 0.01 * s
        if self.kind == "orbit":
            eye = target + rotation(np.array([0.0, 1.0, 0.0]), turn)[:3, :3] @ (eye - target)
        if self.kind in ("truck", "mixed"):
            step = 0.01 * s * distance * (side * self.direction[0] + np.array([0, 0.3, 0]) * self.direction[1])
            eye, target = eye + step, target + step
        return Camera(look_at(eye, target), self.fov)


@dataclass(frozen=True)
class Cut:
    """Two camera paths after one another, the second from frame `frame` on."""

    before: CameraPath
    after: CameraPath
    frame: int

    def at(self, frame: float) -> Camera:
        return (self.after if frame >= self.frame else self.before).at(frame)


def flicker(rng: np.random.Generator) -> Callable[[float], float]:
    """A light's strength over the frames, 0.15 to 1: a slow wave, on and off, or at random like a flame."""
    kind, rate, phase = str(rng.choice(["wave", "switch", "flame"])), rng.uniform(0.2, 1.5), rng.uniform(0, 2 * np.pi)
    low, seed = rng.uniform(0.15, 0.7), int(rng.integers(1 << 30))

    def strength(frame: float) -> float:
        if kind == "flame":
            return low + (1 - low) * np.random.default_rng([seed, int(round(frame * 16)) + 1024]).random()
        wave = np.sin(rate * frame + phase)
        return low + (1 - low) * float(wave > 0 if kind == "switch" else 0.5 + 0.5 * wave)

    return strength


def object_path(
    home: np.ndarray, velocity: np.ndarray, axis: np.ndarray, spin: float, wobble: float = 0.0
) -> Path:
    """An object at `home` (3,), moving by `velocity` a frame, turning by `spin` radians a frame about `axis`."""

    def matrix(frame: float) -> np.ndarray:
        offset = home + velocity * (frame - 3.5) + wobble * np.array([0, np.sin(1.3 * frame), 0])
        return translation(*offset) @ rotation(axis, spin * (frame - 3.5))

    return matrix
