"""Motion: camera and object paths, functions of the (fractional) frame number to 4x4 matrices, and
things that change their shape, functions of vertices and the frame number."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from training.datagen.scenes.meshes import Mesh, rotation, translation

Path = Callable[[float], np.ndarray]


@dataclass(frozen=True)
class Camera:
    """`to_world` maps camera space (x left, y up, z forward) to world space; `fov` is horizontal,
    in degrees. A lens of radius `aperture` is sharp at the depth `focus`."""

    to_world: np.ndarray
    fov: float
    aperture: float = 0.0
    focus: float = 1.0

    def project(self, points: np.ndarray, width: int, height: int) -> np.ndarray:
        """World points (N, 3) to pixels (N, 2), x right, y down; points behind the camera give
        nan."""
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
    """A base pose and a kind of move; `amplitude` scales the speed, `seed` fixes the shake. The
    lens is a Camera's."""

    eye: np.ndarray
    target: np.ndarray
    fov: float
    kind: str
    amplitude: float
    direction: np.ndarray
    seed: int
    aperture: float = 0.0
    focus: float = 1.0

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
            step = 0.01 * s * distance * (side * self.direction[0]
                                          + np.array([0, 0.3, 0]) * self.direction[1])
            eye, target = eye + step, target + step
        return Camera(look_at(eye, target), self.fov, self.aperture, self.focus)


@dataclass(frozen=True)
class Cut:
    """Two camera paths in a row, the second from frame `frame` on."""

    before: CameraPath
    after: CameraPath
    frame: int

    def at(self, frame: float) -> Camera:
        return (self.after if frame >= self.frame else self.before).at(frame)


def flicker(rng: np.random.Generator) -> Callable[[float], float]:
    """A light's strength over the frames, 0.15 to 1: a slow wave, on and off, or at random like a
    flame."""
    kind = str(rng.choice(["wave", "switch", "flame"]))
    rate = rng.uniform(0.2, 1.5)
    phase = rng.uniform(0, 2 * np.pi)
    low, seed = rng.uniform(0.15, 0.7), int(rng.integers(1 << 30))

    def strength(frame: float) -> float:
        if kind == "flame":
            return (low + (1 - low) * np.random.default_rng([seed, int(round(frame * 16)) + 1024])
                    .random())
        wave = np.sin(rate * frame + phase)
        return low + (1 - low) * float(wave > 0 if kind == "switch" else 0.5 + 0.5 * wave)

    return strength


def object_path(home: np.ndarray, velocity: np.ndarray, axis: np.ndarray, spin: float) -> Path:
    """An object at `home` (3,), moving by `velocity` a frame, turning by `spin` radians a frame
    about `axis`."""

    def matrix(frame: float) -> np.ndarray:
        return translation(*(home + velocity * (frame - 3.5))) @ rotation(axis,
                                                                          spin * (frame - 3.5))

    return matrix


# Things that change their shape -------------------------------------------------------------------

Bend = Callable[[np.ndarray, float], np.ndarray]
STEP = 1e-4  # metres, for the slope of a displacement


def bend_mesh(mesh: Mesh, bend: Bend, time: float) -> Mesh:
    """A mesh with its vertices displaced; normals follow the inverse transpose of the
    displacement's slope."""
    v = mesh.vertices
    slope = np.stack([(bend(v + step, time) - bend(v - step, time)) / (2 * STEP)
                      for step in STEP * np.eye(3)], -1)
    columns = [slope[..., k] for k in range(3)]
    cofactors = np.stack([np.cross(columns[1], columns[2]), np.cross(columns[2], columns[0]),
                          np.cross(columns[0], columns[1])], -1)
    normals = np.einsum("nij,nj->ni", cofactors, mesh.normals)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return Mesh(bend(v, time), normals, mesh.uvs, mesh.faces)


def sway(base: np.ndarray, height: float, reach: float, rate: float,
         rng: np.random.Generator) -> Bend:
    """Wind in plants that stand at `base`: tops move `reach` metres to and fro, not all in step."""
    heading, phase = rng.normal(0, 1, 3) * [1, 0.1, 1], rng.uniform(0, 2 * np.pi)
    heading /= np.linalg.norm(heading)
    waves = rng.normal(0, 3.0 / height, (2, 3))

    def move(v: np.ndarray, time: float) -> np.ndarray:
        up = np.clip((v[:, 1:2] - base[1]) / height, 0, 1.5) ** 2
        swing = np.sin(rate * time + phase + v @ waves[0])[:, None]
        flutter = np.cos(2.3 * rate * time + 4 * (v @ waves[1]))[:, None]
        return v + reach * up * (swing * heading + 0.3 * flutter * heading[[2, 1, 0]])

    return move


def ripple(base: np.ndarray, size: float, reach: float, rate: float,
           rng: np.random.Generator) -> Bend:
    """Waves that run through a thing, as in cloth or water."""
    waves = rng.normal(0, 1, (3, 3))
    waves *= 2 * np.pi * rng.uniform(0.7, 2.0, (3, 1)) / (size * np.linalg.norm(waves, axis=1,
                                                                                keepdims=True))
    sides, phases = rng.normal(0, 1, (3, 3)), rng.uniform(0, 2 * np.pi, 3)
    sides /= np.linalg.norm(sides, axis=1, keepdims=True)

    def move(v: np.ndarray, time: float) -> np.ndarray:
        return v + 0.5 * reach * np.sin((v - base) @ waves.T + rate * time + phases) @ sides

    return move


def twist(base: np.ndarray, height: float, reach: float, rate: float,
          rng: np.random.Generator) -> Bend:
    """Wringing about the upright axis to and fro, more at the top."""
    phase = rng.uniform(0, 2 * np.pi)

    def move(v: np.ndarray, time: float) -> np.ndarray:
        angle = 3 * reach / height * np.sin(rate * time + phase) * (v[:, 1] - base[1]) / height
        x, z = v[:, 0] - base[0], v[:, 2] - base[2]
        turned = np.stack([x * np.cos(angle) + z * np.sin(angle), v[:, 1] - base[1],
                           z * np.cos(angle) - x * np.sin(angle)], 1)
        return turned + base

    return move


def pulse(base: np.ndarray, height: float, reach: float, rate: float,
          rng: np.random.Generator) -> Bend:
    """Swelling to the sides while it sinks, like jelly."""
    phase = rng.uniform(0, 2 * np.pi)

    def move(v: np.ndarray, time: float) -> np.ndarray:
        wide = 1 + reach / height * np.sin(rate * time + phase)
        return base + (v - base) * np.array([wide, 1 / wide, wide])

    return move


def hanging(rng: np.random.Generator, top: float, height: float, normal: np.ndarray) -> Bend:
    """Cloth hanging from `top` that air moves along `normal` (3,), more at its foot; waves run
    through it."""
    reach = float(np.clip(0.03 * np.exp(rng.normal(0, 0.7)), 0.004, 0.12))
    rate = rng.uniform(0.15, 0.9)
    phase = rng.uniform(0, 2 * np.pi)
    side = np.cross(normal, [0.0, 1, 0])
    along, down = rng.uniform(1.0, 5.0), rng.uniform(0.5, 3.0)

    def move(v: np.ndarray, time: float) -> np.ndarray:
        loose = np.clip((top - v[:, 1:2]) / height, 0, 1) ** 1.5
        wave = np.sin(rate * time + phase + along * (v @ side) + down * v[:, 1])[:, None]
        return v + reach * loose * (wave * normal + 0.3 * wave**2 * side)

    return move


def random_bend(rng: np.random.Generator, base: np.ndarray, height: float, plant: bool) -> Bend:
    """A displacement for a thing of `height` on `base` (3,); plants sway."""
    kind = sway if plant else (sway, ripple, twist, pulse)[int(rng.integers(4))]
    reach = height * float(np.clip(0.06 * np.exp(rng.normal(0, 0.7)), 0.01, 0.2))
    return kind(np.asarray(base, float), height, reach, rng.uniform(0.2, 1.2), rng)
