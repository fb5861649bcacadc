"""Materials: a Mitsuba BSDF for the path tracer; F0, albedo factor and roughness for the planes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import mitsuba as mi
import numpy as np

from training.datagen.scenes import textures

# RGB eta and k of measured metals, from the "Material" presets of Mitsuba 3 integrated to linear
# sRGB.
METALS = {
    "gold": ((0.143, 0.375, 1.442), (3.983, 2.386, 1.603)),
    "copper": ((0.200, 0.924, 1.102), (3.912, 2.452, 2.142)),
    "aluminium": ((1.657, 0.880, 0.521), (9.224, 6.270, 4.837)),
    "silver": ((0.155, 0.117, 0.138), (4.822, 3.122, 2.147)),
    "chrome": ((4.370, 2.917, 1.655), (5.206, 4.231, 3.755)),
    "brass": ((0.444, 0.527, 1.094), (3.695, 2.765, 1.829)),
    "iron": ((2.911, 2.950, 2.585), (3.089, 2.932, 2.767)),
}
GLASSES = (1.33, 1.5)  # each index is its own kernel


@dataclass(frozen=True)
class Material:
    """`kind` is diffuse, roughplastic, roughconductor, principled, conductor or dielectric; `alpha`
    the GGX width.

    `albedo` is a linear RGB image (H, W, 3), `eta`/`k` the complex index of a metal, `ior` that of
    a dielectric.
    """

    kind: str
    albedo: np.ndarray = field(default_factory=lambda: np.full((1, 1, 3), 0.5, np.float32))
    alpha: float = 1.0
    eta: tuple[float, float, float] = METALS["chrome"][0]
    k: tuple[float, float, float] = METALS["chrome"][1]
    ior: float = 1.5
    metallic: float = 0.0

    @property
    def roughness(self) -> float:
        """Perceptual roughness, the square root of alpha; 1 for diffuse, 0 for smooth surfaces."""
        if self.kind == "diffuse":
            return 1.0
        return 0.0 if self.kind in ("conductor", "dielectric") else float(np.sqrt(self.alpha))

    @property
    def follow(self) -> float:
        """For primary surface replacement: -1 mirrors, the index of glass, 0 all others."""
        return {"conductor": -1.0, "dielectric": self.ior}.get(self.kind, 0.0)

    def reflectance(self) -> tuple[np.ndarray, float, float]:
        """(constant specular F0 (3,), part of F0 that follows the albedo, factor on the diffuse
        albedo)."""
        if self.kind == "diffuse":
            return np.zeros(3), 0.0, 1.0
        if self.kind in ("conductor", "roughconductor"):
            return fresnel_conductor(np.array(self.eta), np.array(self.k)), 0.0, 0.0
        dielectric = ((self.ior - 1) / (self.ior + 1)) ** 2
        if self.kind == "dielectric":
            return np.full(3, dielectric), 0.0, 0.0
        return np.full(3, dielectric * (1 - self.metallic)), self.metallic, 1.0 - self.metallic

    def bsdf(self) -> dict[str, Any]:
        """The Mitsuba plugin; reflectances are always bitmaps so that scenes share compiled
        kernels."""
        if self.kind == "dielectric":
            return {"type": "dielectric", "int_ior": self.ior}
        if self.kind in ("conductor", "roughconductor"):
            plugin: dict[str, Any] = {"type": self.kind, "eta": _rgb(self.eta), "k": _rgb(self.k)}
            if self.kind == "roughconductor":
                plugin |= {"alpha": self.alpha, "distribution": "ggx"}
            return {"type": "twosided", "bsdf": plugin}
        texture = {"type": "bitmap",
                   "bitmap": mi.Bitmap(np.ascontiguousarray(self.albedo, np.float32)), "raw": True}
        if self.kind == "diffuse":
            plugin = {"type": "diffuse", "reflectance": texture}
        elif self.kind == "roughplastic":
            plugin = {"type": "roughplastic", "diffuse_reflectance": texture, "alpha": self.alpha,
                      "int_ior": self.ior, "distribution": "ggx", "nonlinear": True}
        else:
            plugin = {"type": "principled", "base_color": texture,
                      "roughness": float(np.sqrt(self.alpha)),
                      # 0 would be another kernel
                      "metallic": max(self.metallic, 1e-3), "eta": self.ior}
        return {"type": "twosided", "bsdf": plugin}


def _rgb(value: tuple[float, float, float]) -> dict[str, Any]:
    return {"type": "rgb", "value": list(value)}


def fresnel_conductor(eta: np.ndarray, k: np.ndarray) -> np.ndarray:
    """Reflectance at normal incidence of a metal in air (Born and Wolf, ch. 14)."""
    return ((eta - 1) ** 2 + k**2) / ((eta + 1) ** 2 + k**2)


def palette() -> list[mi.BSDF]:
    """One BSDF of each kind. While they are alive, every scene compiles to the same kernels."""
    kinds = ("diffuse", "roughplastic", "roughconductor", "principled", "conductor")
    materials = [Material(kind, alpha=0.2) for kind in kinds] + [Material("dielectric", ior=ior)
                                                                 for ior in GLASSES]
    return [mi.load_dict(material.bsdf()) for material in materials]


def random_metal(rng: np.random.Generator, smooth: float = 0.15) -> Material:
    eta, k = METALS[str(rng.choice(list(METALS)))]
    if rng.random() < smooth:
        return Material("conductor", eta=eta, k=k)
    return Material("roughconductor", alpha=float(rng.uniform(0.08, 0.6) ** 2 + 0.005), eta=eta,
                    k=k)


def polished_metal(rng: np.random.Generator) -> Material:
    """A shiny metal whose highlights are sharp, seldom a mirror."""
    eta, k = METALS[str(rng.choice(list(METALS)))]
    if rng.random() < 0.2:
        return Material("conductor", eta=eta, k=k)
    return Material("roughconductor", alpha=float(rng.uniform(0.1, 0.3) ** 2), eta=eta, k=k)


def random_material(rng: np.random.Generator, gloss: float = 0.4, metal: float = 0.1,
                    glass: float = 0.0) -> Material:
    """A material for an object; `gloss`, `metal` and `glass` are probabilities, the rest is
    diffuse."""
    pick = rng.random()
    if pick < glass:
        return Material("dielectric", ior=float(rng.choice(GLASSES)))
    if pick < glass + metal:
        return random_metal(rng)
    albedo = textures.texture(rng)
    if pick > glass + metal + gloss:
        return Material("diffuse", albedo)
    alpha = float(rng.uniform(0.15, 0.75) ** 2)
    if rng.random() < 0.5:
        return Material("roughplastic", albedo, alpha, ior=float(rng.uniform(1.35, 1.7)))
    metallic = float(rng.choice([0.0, 0.0, 0.0, 0.5, 1.0]))
    return Material("principled", albedo, alpha, metallic=metallic)
