"""Materials of interiors by the role they play: mostly pale walls and joinery, glossy floors,
cloth, leaves."""

from __future__ import annotations

import colorsys
from collections.abc import Callable

import numpy as np

from training.datagen.scenes import textures
from training.datagen.scenes.build import Description
from training.datagen.scenes.materials import GLASSES, Material, random_metal


def _flat(value: np.ndarray) -> np.ndarray:
    return np.tile(np.clip(np.asarray(value, float), 0.01, 0.93),
                   (1, 1, 1)).astype(np.float32).reshape(1, 1, 3)


def white(rng: np.random.Generator, low: float = 0.6, high: float = 0.9) -> np.ndarray:
    """A white or pale grey, at times slightly warm or cool."""
    return _flat(rng.uniform(low, high) * (1 - rng.uniform(0, 0.12) * rng.random(3)))


Range = tuple[float, float]


def _hsv(rng: np.random.Generator, hue: Range, saturation: Range, value: Range) -> np.ndarray:
    """Linear colour from ranges of hue, saturation and displayed value."""
    return np.array(colorsys.hsv_to_rgb(rng.uniform(*hue) % 1, rng.uniform(*saturation),
                                        rng.uniform(*value))) ** 2.2


def _plastic(rng: np.random.Generator, albedo: np.ndarray, low: float, high: float) -> Material:
    """A glossy surface of a roughness (square root of alpha) in low..high."""
    return Material("roughplastic", albedo, float(rng.uniform(low, high) ** 2))


def _wall(rng: np.random.Generator) -> Material:
    pick = rng.random()
    if pick < 0.65:
        return Material("diffuse", white(rng))
    if pick < 0.87:
        return Material("diffuse", _flat(_hsv(rng, (0, 1), (0.05, 0.5), (0.4, 0.95))))
    return Material("diffuse", textures.texture(rng, flat=0))


def _trim(rng: np.random.Generator) -> Material:
    pick = rng.random()
    albedo = (white(rng, 0.65, 0.9) if pick < 0.75 else _wood(rng) if pick < 0.88
              else _flat(textures.colour(rng)))
    return Material("diffuse", albedo) if rng.random() < 0.4 else _plastic(rng, albedo, 0.2, 0.6)


def _floor(rng: np.random.Generator) -> Material:
    pick = rng.random()
    if pick < 0.6:
        return _plastic(rng, _wood(rng, 512), 0.12, 0.45)
    if pick < 0.72:
        return Material("diffuse", _wood(rng))
    if pick < 0.88:
        return _plastic(rng, textures.stone(rng), 0.1, 0.4)
    return Material("diffuse", textures.texture(rng, flat=0.3))


def _wood(rng: np.random.Generator, size: int = 256) -> np.ndarray:
    return textures.wood(rng, size)


def _fabric(rng: np.random.Generator) -> Material:
    pick = rng.random()
    if pick < 0.4:
        return Material("diffuse", white(rng, 0.4, 0.85))
    if pick < 0.75:
        return Material("diffuse", _flat(_hsv(rng, (0, 1), (0.05, 0.7), (0.2, 0.9))))
    return Material("diffuse", textures.texture(rng, flat=0))


def _bedding(rng: np.random.Generator) -> Material:
    return Material("diffuse", white(rng, 0.6, 0.9)) if rng.random() < 0.75 else _fabric(rng)


def _book(rng: np.random.Generator) -> Material:
    albedo = textures.texture(rng, flat=0.6)
    return Material("diffuse", albedo) if rng.random() < 0.5 else _plastic(rng, albedo, 0.3, 0.6)


def _leaf(rng: np.random.Generator) -> Material:
    """Green leaves, mostly glossy, of one green or of two."""
    hue, depth = (0.2, 0.38), (0.2, 0.65)
    base = _hsv(rng, hue, (0.45, 0.95), depth)
    albedo = _flat(base)
    if rng.random() < 0.4:
        pale = np.clip(base * rng.uniform(1.3, 3.0) + 0.02, 0.01, 0.6)
        blend = np.clip((textures.noise(128, int(rng.choice([4, 16])), rng) - 0.45) * 4, 0,
                        1)[..., None]
        albedo = (base + (pale - base) * blend).astype(np.float32)
    if rng.random() < 0.05:
        albedo = _flat(_hsv(rng, (0.85, 1.1), (0.4, 0.9), depth))
    return Material("diffuse", albedo) if rng.random() < 0.12 else _plastic(rng, albedo, 0.15, 0.55)


def _tile(rng: np.random.Generator) -> Material:
    albedo = white(rng, 0.6, 0.9) if rng.random() < 0.6 else _flat(textures.colour(rng))
    return _plastic(rng, albedo, 0.08, 0.35)


def _counter(rng: np.random.Generator) -> Material:
    pick = rng.random()
    albedo = white(rng) if pick < 0.35 else textures.stone(rng) if pick < 0.75 else _wood(rng)
    return _plastic(rng, albedo, 0.1, 0.5)


def _colour_gloss(rng: np.random.Generator) -> Material:
    return _plastic(rng, _flat(textures.colour(rng)), 0.08, 0.4)


def _glass(rng: np.random.Generator) -> Material:
    if rng.random() < 0.3:
        return Material("dielectric", ior=float(rng.choice(GLASSES)))
    return _plastic(rng, _flat(_hsv(rng, (0, 1), (0.1, 0.9), (0.05, 0.5))), 0.08, 0.2)


ROLES: dict[str, Callable[[np.random.Generator], Material]] = {
    "wall": _wall, "trim": _trim, "floor": _floor, "bedding": _bedding, "leaf": _leaf,
    "tile": _tile, "glass": _glass,
    "counter": _counter, "gloss": _colour_gloss, "fabric": _fabric, "fabric2": _fabric,
    "leaf2": lambda rng: _plastic(rng, _flat(_hsv(rng, (0.18, 0.35), (0.3, 0.8), (0.3, 0.7))), 0.3,
                                  0.6),
    "ceiling": lambda rng: Material("diffuse", white(rng, 0.7, 0.92)),
    "wood": lambda rng: _plastic(rng, _wood(rng), 0.2, 0.6),
    "lacquer": lambda rng: _plastic(rng, _flat(textures.colour(rng)), 0.15, 0.5),
    "curtain": _bedding, "cloth": lambda rng: Material("diffuse", white(rng, 0.5, 0.9)),
    "accent": lambda rng: Material("diffuse", _flat(_hsv(rng, (0, 1), (0.5, 1), (0.3, 0.95)))),
    "pattern": lambda rng: Material("diffuse", textures.texture(rng, flat=0)),
    "paper": lambda rng: Material("diffuse", white(rng, 0.65, 0.9)),
    "ceramic": lambda rng: _plastic(rng, white(rng, 0.5, 0.9), 0.1, 0.35),
    "porcelain": lambda rng: _plastic(rng, white(rng, 0.75, 0.9), 0.08, 0.25),
    "metal": lambda rng: random_metal(rng, 0.08),
    "shade": lambda rng: Material("diffuse", white(rng, 0.5, 0.85)),
    "blind": lambda rng: Material("diffuse", white(rng)) if rng.random() < 0.7
                         else _plastic(rng, _wood(rng), 0.3, 0.6),
    "pot": lambda rng: Material("diffuse", _flat(_hsv(rng, (0.02, 0.07), (0.4, 0.7), (0.5, 0.8)))),
    "ground": lambda rng: Material("diffuse", _flat(_hsv(rng, (0.05, 0.4), (0, 0.4), (0.3, 0.7)))),
    "soil": lambda rng: Material("diffuse", _flat(np.array([0.05, 0.035, 0.025]))),
    "soot": lambda rng: Material("diffuse", _flat(rng.uniform(0.015, 0.08, 1) * np.ones(3))),
    "dark": lambda rng: _plastic(rng, _flat(np.full(3, rng.uniform(0.015, 0.06))), 0.3, 0.6),
    "gloss_dark": lambda rng: _plastic(rng, _flat(np.full(3, 0.012)), 0.08, 0.2),
    "card": lambda rng: Material("diffuse",
                                 _flat(_hsv(rng, (0.06, 0.09), (0.3, 0.5), (0.55, 0.75)))),
    "grout": lambda rng: Material("diffuse", _flat(rng.uniform(0.2, 0.8, 1) * np.ones(3))),
}


class Roles:
    """A scene's material for each role, made on first use."""

    def __init__(self, d: Description, rng: np.random.Generator) -> None:
        self._d, self._rng = d, rng
        self._known: dict[str, int] = {}
        self._panel = "trim" if rng.random() < 0.55 else "wall"

    def __getitem__(self, role: str) -> int:
        if role not in self._known:
            self._known[role] = self[self._panel] if role == "panel" else self._made(role)
        return self._known[role]

    def add(self, role: str, material: Material) -> None:
        self._known[role] = self._d.material(material)

    def _made(self, role: str) -> int:
        if role.startswith("book"):
            return self._d.material(_book(self._rng))
        return self._d.material(ROLES[role](self._rng))
