"""Light: environment maps (measured or made up) and emissive surfaces. Only ratios matter; frames
get a gain later."""

from __future__ import annotations

import colorsys
from pathlib import Path

import mitsuba as mi
import numpy as np

from training.datagen.scenes import meshes
from training.datagen.scenes.build import Description
from training.datagen.scenes.motion import flicker


def tint(rng: np.random.Generator, strong: float = 0.25) -> np.ndarray:
    """A light's colour, largest channel 1: mostly near white, warm or cool, at times saturated."""
    if rng.random() < strong:
        return np.array(colorsys.hsv_to_rgb(rng.random(), rng.uniform(0.4, 0.9), 1.0))
    warm = rng.uniform(-0.35, 0.6)
    return (np.array([1.0, 1 - 0.25 * warm, 1 - 0.6 * warm]) if warm > 0
            else np.array([1 + warm, 1 + 0.5 * warm, 1.0]))


def sky(rng: np.random.Generator, width: int = 256, sunny: bool = False) -> np.ndarray:
    """A made-up sky (width/2, width, 3): gradient, ground, and a soft sun of 4 to 15 degrees.

    With `sunny` the sun is 1.5 to 3 degrees wide and gives one to eight times as much light as the
    sky.
    """
    v, u = np.mgrid[0 : width // 2, 0:width] + 0.5
    theta, phi = np.pi * v / (width // 2), 2 * np.pi * u / width
    up = np.cos(theta)
    zenith, horizon = tint(rng, 0.1) * rng.uniform(0.2, 1), tint(rng, 0.1) * rng.uniform(0.5, 1.5)
    ground = np.array([0.3, 0.27, 0.22]) * rng.uniform(0.1, 1)
    image = horizon + (zenith - horizon) * np.clip(up, 0, 1)[..., None] ** 0.5
    image = np.where(up[..., None] < 0, ground, image)
    elevation, size = rng.uniform(0.1, 1.3), np.radians(rng.uniform(4, 15))
    sun = np.array([np.cos(elevation), np.sin(elevation), 0])
    direction = np.stack([np.sin(theta) * np.cos(phi), up, np.sin(theta) * np.sin(phi)], -1)
    edge = np.clip((direction @ sun - np.cos(size)) / (1 - np.cos(size)), 0, 1)
    strength = rng.choice([0.0, 20.0, 80.0])
    if sunny:
        disc = (direction @ sun
                > np.cos(np.radians(rng.uniform(1.5, 3)) / 2 + np.pi / width)).astype(float)
        area = (disc * np.sin(theta)).sum() / np.sin(theta).sum()
        edge, strength = disc, rng.uniform(1, 8) * image.mean() / max(area, 1e-6)
    return (image + edge[..., None] * tint(rng, 0.1) * strength).astype(np.float32)


class Environments:
    """Measured maps from a folder (*.hdr), read once, or made-up skies where there are none."""

    def __init__(self, folder: Path | None) -> None:
        self._paths = sorted(Path(folder).glob("*.hdr")) if folder else []
        self._images: dict[Path, np.ndarray] = {}

    def draw(self, rng: np.random.Generator, calm: bool = False, sunny: bool = False) -> np.ndarray:
        """Radiance (H, W, 3), mean 1. `calm` cuts small bright suns, for scenes with mirrors or
        glass."""
        if sunny or not self._paths or rng.random() < 0.35:
            image = sky(rng, sunny=sunny)
        else:
            path = self._paths[int(rng.integers(len(self._paths)))]
            if path not in self._images:
                image = np.array(mi.Bitmap(str(path))
                                 .convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32))
                self._images[path] = image
            image = self._images[path]
        image = image / max(image.mean(), 1e-6)
        return np.minimum(image, 12.0 if calm else 20000.0 if sunny else 2000.0).astype(np.float32)


def set_environment(d: Description, rng: np.random.Generator, maps: Environments, calm: bool,
                    gain: float = 1.0, sunny: bool = False) -> None:
    d.environment = maps.draw(rng, calm, sunny)
    d.environment_turn = float(rng.uniform(0, 360))
    d.environment_gain = gain


def _glow(d: Description, rng: np.random.Generator) -> int | None:
    """Let a few lights flicker."""
    if rng.random() > 0.12:
        return None
    d.glows.append(flicker(rng))
    return len(d.glows) - 1


def panel(d: Description, rng: np.random.Generator, centre: np.ndarray, size: float, power: float,
          mover: int | None = None) -> None:
    """A square lamp facing down, `power` shared over its area."""
    w, h = size * rng.uniform(0.3, 1.0, 2)
    x, y, z = centre
    mesh = meshes.quad([x - w / 2, y, z - h / 2], [w, 0, 0], [0, 0, h])
    d.emit(mesh, tint(rng) * power / (w * h), mover, _glow(d, rng))


def bulb(d: Description, rng: np.random.Generator, centre: np.ndarray, radius: float, power: float,
         mover: int | None = None) -> None:
    mesh = meshes.sphere(radius, 16).transform(meshes.translation(*centre))
    d.emit(mesh, tint(rng) * power / (4 * np.pi * radius**2), mover, _glow(d, rng))
