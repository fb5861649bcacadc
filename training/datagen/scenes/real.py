"""Real scenes, converted beforehand (`convert.py`) to one folder each: geometry.npz, textures and scene.json."""

from __future__ import annotations

import json
from pathlib import Path

import mitsuba as mi
import numpy as np

from training.datagen.scenes import lights
from training.datagen.scenes.build import Description
from training.datagen.scenes.draft import Draft, View, add_moving
from training.datagen.scenes.lights import Environments
from training.datagen.scenes.materials import Material, random_material
from training.datagen.scenes.meshes import Mesh


def load_image(path: Path) -> np.ndarray:
    """An 8-bit texture as linear RGB (H, W, 3) float32."""
    bitmap = mi.Bitmap(str(path)).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, srgb_gamma=False)
    return np.array(bitmap)


class _Scene:
    """A converted scene, read once."""

    def __init__(self, folder: Path) -> None:
        self.name = folder.name
        self.facts = json.loads((folder / "scene.json").read_text())
        with np.load(folder / "geometry.npz") as file:
            self.meshes = [_unpack(file, i) for i in range(len(self.facts["shapes"]))]
        images = {m["texture"] for m in self.facts["materials"] if m.get("texture")}
        self.images = {name: load_image(folder / name) for name in images}
        self.low, self.high = (np.array(self.facts[key]) for key in ("low", "high"))

    def material(self, facts: dict, rng: np.random.Generator) -> Material:
        if len(self.meshes) > 8 and rng.random() < 0.15 and facts["kind"] != "dielectric":
            return random_material(rng, metal=0.05)
        albedo = self.images[facts["texture"]] if facts.get("texture") else np.array(facts["albedo"], np.float32)
        albedo = albedo if albedo.ndim == 3 else albedo.reshape(1, 1, 3)
        return Material(facts["kind"], albedo, facts["alpha"], tuple(facts["eta"]), tuple(facts["k"]), facts["ior"])


def _unpack(file: np.lib.npyio.NpzFile, index: int) -> Mesh:
    normals = file[f"n{index}"].astype(np.float64) / 127
    return Mesh(file[f"v{index}"].astype(np.float64), normals, file[f"t{index}"].astype(np.float64), file[f"f{index}"])


class RealScenes:
    """The scenes of a folder; empty (false) if no folder is given or it holds none."""

    def __init__(self, folder: Path | None) -> None:
        found = sorted(Path(folder).glob("*/scene.json")) if folder else []
        self._folders = [path.parent for path in found]
        self._loaded: dict[Path, _Scene] = {}

    def __bool__(self) -> bool:
        return bool(self._folders)

    def draft(self, rng: np.random.Generator, maps: Environments) -> Draft:
        folder = self._folders[int(rng.integers(len(self._folders)))]
        if folder not in self._loaded:
            self._loaded[folder] = _Scene(folder)
        scene = self._loaded[folder]
        d = Description(scene.name)
        slots = [d.material(scene.material(facts, rng)) for facts in scene.facts["materials"]]
        for mesh, shape in zip(scene.meshes, scene.facts["shapes"], strict=True):
            if shape["emission"]:
                d.emit(mesh, np.array(shape["emission"]) * lights.tint(rng))
            else:
                d.add(mesh, slots[shape["material"]])
        _light(d, scene, rng, maps)
        extent = scene.facts["metre"]
        for _ in range(int(rng.choice([0, 1, 2], p=[0.5, 0.3, 0.2]))):
            eye, target = _view(scene, rng)
            add_moving(d, rng, eye + rng.uniform(0.4, 1.0) * (target - eye) - [0, 0.3 * extent, 0], extent)
        return Draft(d, lambda r: _view(scene, r), 0.15 * extent)


def _light(d: Description, scene: _Scene, rng: np.random.Generator, maps: Environments) -> None:
    """An environment for open scenes; a lamp or two in closed ones, less often if they have lights."""
    if scene.facts["open"]:
        lights.set_environment(d, rng, maps, False, gain=float(rng.uniform(1, 5)))
    if scene.facts["indoor"] and rng.random() < 0.6:
        metre = scene.facts["metre"]
        eye, target = _view(scene, rng)
        centre = eye + rng.uniform(0.2, 0.8) * (target - eye) + [0, 0.5 * metre, 0]
        lights.panel(d, rng, centre, float(rng.choice([0.3, 1.0])) * metre, rng.uniform(5, 40) * metre**2)


def _view(scene: _Scene, rng: np.random.Generator) -> View:
    """A pose near one of the scene's own cameras, or anywhere in its inner box."""
    cameras = scene.facts["cameras"]
    if cameras and rng.random() < 0.6:
        camera = cameras[int(rng.integers(len(cameras)))]
        eye, target = np.array(camera["eye"]), np.array(camera["target"])
        spread = np.linalg.norm(target - eye)
        return eye + rng.normal(0, 0.12, 3) * spread, target + rng.normal(0, 0.2, 3) * spread
    low, high = (np.array(corner) for corner in scene.facts["inner"])
    target = rng.uniform(low, high)
    if not scene.facts["around"] or rng.random() < 0.3:
        return rng.uniform(low, high), target
    size, angle = np.linalg.norm(scene.high - scene.low), rng.uniform(0, 2 * np.pi)
    reach = size * rng.uniform(0.15, 0.6) * np.array([np.cos(angle), rng.uniform(0.1, 0.7), np.sin(angle)])
    return target + reach, target
