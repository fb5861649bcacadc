"""Things that change their shape: functions of vertices and the frame number, and meshes after them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from training.datagen.scenes.meshes import Mesh

Bend = Callable[[np.ndarray, float], np.ndarray]
STEP = 1e-4  # metres, for the slope of a displacement


def bent(mesh: Mesh, bend: Bend, time: float) -> Mesh:
    """The mesh with its vertices displaced; normals follow the inverse transpose of the displacement's slope."""
    v = mesh.vertices
    slope = np.stack([(bend(v + step, time) - bend(v - step, time)) / (2 * STEP) for step in STEP * np.eye(3)], -1)
    columns = [slope[..., k] for k in range(3)]
    cofactors = np.stack([np.cross(columns[1], columns[2]), np.cross(columns[2], columns[0]),
                          np.cross(columns[0], columns[1])], -1)
    normals = np.einsum("nij,nj->ni", cofactors, mesh.normals)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return Mesh(bend(v, time), normals, mesh.uvs, mesh.faces)


def sway(base: np.ndarray, height: float, reach: float, rate: float, rng: np.random.Generator) -> Bend:
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


def ripple(base: np.ndarray, size: float, reach: float, rate: float, rng: np.random.Generator) -> Bend:
    """Waves that run through a thing, as in cloth or water."""
    waves = rng.normal(0, 1, (3, 3))
    waves *= 2 * np.pi * rng.uniform(0.7, 2.0, (3, 1)) / (size * np.linalg.norm(waves, axis=1, keepdims=True))
    sides, phases = rng.normal(0, 1, (3, 3)), rng.uniform(0, 2 * np.pi, 3)
    sides /= np.linalg.norm(sides, axis=1, keepdims=True)

    def move(v: np.ndarray, time: float) -> np.ndarray:
        return v + 0.5 * reach * np.sin((v - base) @ waves.T + rate * time + phases) @ sides

    return move


def twist(base: np.ndarray, height: float, reach: float, rate: float, rng: np.random.Generator) -> Bend:
    """Wringing about the upright axis to and fro, more at the top."""
    phase = rng.uniform(0, 2 * np.pi)

    def move(v: np.ndarray, time: float) -> np.ndarray:
        angle = 3 * reach / height * np.sin(rate * time + phase) * (v[:, 1] - base[1]) / height
        x, z = v[:, 0] - base[0], v[:, 2] - base[2]
        turned = np.stack([x * np.cos(angle) + z * np.sin(angle), v[:, 1] - base[1],
                           z * np.cos(angle) - x * np.sin(angle)], 1)
        return turned + base

    return move


def pulse(base: np.ndarray, height: float, reach: float, rate: float, rng: np.random.Generator) -> Bend:
    """Swelling to the sides while it sinks, like jelly."""
    phase = rng.uniform(0, 2 * np.pi)

    def move(v: np.ndarray, time: float) -> np.ndarray:
        wide = 1 + reach / height * np.sin(rate * time + phase)
        return base + (v - base) * np.array([wide, 1 / wide, wide])

    return move


def hanging(rng: np.random.Generator, top: float, height: float, normal: np.ndarray) -> Bend:
    """Cloth that hangs from `top` and is moved by air along `normal` (3,), more at its foot; waves run through it."""
    reach = float(np.clip(0.03 * np.exp(rng.normal(0, 0.7)), 0.004, 0.12))
    rate, phase, side = rng.uniform(0.15, 0.9), rng.uniform(0, 2 * np.pi), np.cross(normal, [0.0, 1, 0])
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
