"""Real scenes: converted from Mitsuba XML or glTF into one compact folder each, and drawn from
these folders.

python -m training.datagen.scenes.convert SOURCE_FOLDER OUT_FOLDER

Each sub-folder of SOURCE_FOLDER is one scene.

A folder holds geometry.npz, scene.json and textures. Shapes with the same material become one,
metals keep their index, everything is turned y up; textures shrink to 512.
"""

from __future__ import annotations

import argparse
import json
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from training.datagen import held_back
from training.datagen.scenes import lights
from training.datagen.scenes.build import Description
from training.datagen.scenes.draft import Draft, View, add_moving
from training.datagen.scenes.lights import Environments
from training.datagen.scenes.materials import Material, random_material
from training.datagen.scenes.meshes import Mesh, merge, quad

Facts = dict[str, Any]
"""Facts of a file, or of a thing in it, by their names."""

# glTF ---------------------------------------------------------------------------------------------
# The part of glTF 2.0 that static scenes need: nodes, meshes, base colours and their textures.

TYPES = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32,
         5126: np.float32}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


def load_gltf(path: Path,
              plain: Facts) -> tuple[list[tuple[Mesh, str, None]], dict[str, Facts], list[Facts]]:
    """(world mesh, material name, no emission) of each primitive; material facts based on `plain`;
    no camera."""
    document = json.loads(path.read_text())
    buffers = [(path.parent / b["uri"]).read_bytes() for b in document["buffers"]]
    materials = {f"m{i}": _material(document, m, plain)
                 for i, m in enumerate(document["materials"])}
    shapes: list[Any] = []
    for root in document["scenes"][document.get("scene", 0)]["nodes"]:
        _walk(document, buffers, root, np.eye(4), shapes)
    return shapes, materials, []


def _walk(document: Facts, buffers: list[bytes], index: int, parent: np.ndarray,
          shapes: list[Any]) -> None:
    node = document["nodes"][index]
    world = parent @ _matrix(node)
    if "mesh" in node:
        for primitive in document["meshes"][node["mesh"]]["primitives"]:
            mesh = _primitive(document, buffers, primitive).transform(world)
            shapes.append((mesh, f"m{primitive['material']}", None))
    for child in node.get("children", []):
        _walk(document, buffers, child, world, shapes)


def _primitive(document: Facts, buffers: list[bytes], primitive: Facts) -> Mesh:
    attributes = {k: _accessor(document, buffers, v) for k, v in primitive["attributes"].items()}
    vertices = attributes["POSITION"].astype(np.float64)
    uvs = attributes.get("TEXCOORD_0", np.zeros((len(vertices), 2))).astype(np.float64)
    faces = _accessor(document, buffers, primitive["indices"]).reshape(-1, 3).astype(np.uint32)
    return Mesh(vertices, attributes["NORMAL"].astype(np.float64), uvs, faces)


def _accessor(document: Facts, buffers: list[bytes], index: int) -> np.ndarray:
    accessor = document["accessors"][index]
    view = document["bufferViews"][accessor["bufferView"]]
    dtype, width = np.dtype(TYPES[accessor["componentType"]]), WIDTHS[accessor["type"]]
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    stride = view.get("byteStride", width * dtype.itemsize)
    return np.ndarray((accessor["count"], width), dtype, buffers[view["buffer"]], start,
                      (stride, dtype.itemsize))


def _matrix(node: Facts) -> np.ndarray:
    if "matrix" in node:
        return np.array(node["matrix"]).reshape(4, 4).T
    x, y, z, w = node.get("rotation", (0, 0, 0, 1))
    matrix = np.eye(4)
    matrix[:3, :3] = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]) * np.array(node.get("scale", (1, 1, 1)))
    matrix[:3, 3] = node.get("translation", (0, 0, 0))
    return matrix


def _material(document: Facts, material: Facts, plain: Facts) -> Facts:
    """Diffuse, or rough plastic below roughness 0.9; a missing metallic factor counts as none
    (low-poly exports)."""
    surface = material.get("pbrMetallicRoughness", {})
    facts = dict(plain, albedo=list(surface.get("baseColorFactor", (0.8, 0.8, 0.8, 1))[:3]))
    roughness = surface.get("roughnessFactor", 1.0)
    if roughness < 0.9:
        facts |= {"kind": "roughplastic", "alpha": roughness**2}
    if "baseColorTexture" in surface:
        texture = document["textures"][surface["baseColorTexture"]["index"]]
        facts["texture"] = document["images"][texture["source"]]["uri"]
    return facts


# Conversion ---------------------------------------------------------------------------------------

TEXTURE = 512
# How a scene is looked at: `around` from outside, or from inside; `open` lets an environment in;
# metre in scene units.
HOW = {
    "dining-room": {"around": False, "open": True, "indoor": True, "metre": 1.0},
    "staircase": {"around": False, "open": False, "indoor": True, "metre": 0.6},
    "matpreview": {"around": True, "open": True, "indoor": False, "metre": 1.0},
    "camp": {"around": True, "open": True, "indoor": False, "metre": 0.7},
    "cave": {"around": False, "open": True, "indoor": True, "metre": 0.7},
    "small-city": {"around": True, "open": True, "indoor": False, "metre": 3.0},
}
DEFAULT = {"around": True, "open": True, "indoor": False, "metre": 1.0}
PLAIN = {"kind": "diffuse", "albedo": [0.5] * 3, "texture": None, "alpha": 0.1, "ior": 1.5,
         "eta": [1.0] * 3, "k": [0.0] * 3}


def from_mitsuba(mesh: mi.Mesh) -> Mesh:
    """A loaded mesh; without vertex normals its triangles are split, so that they stay flat."""
    params = mi.traverse(mesh)
    vertices = np.array(params["vertex_positions"], np.float64).reshape(-1, 3)
    faces = np.array(params["faces"], np.uint32).reshape(-1, 3)
    uvs = np.array(params["vertex_texcoords"], np.float64).reshape(-1, 2)
    normals = np.array(params["vertex_normals"], np.float64).reshape(-1, 3)
    if not len(uvs):
        uvs = np.zeros((len(vertices), 2))
    return Mesh(vertices, normals, uvs, faces) if len(normals) else flat(vertices, uvs, faces)


def flat(vertices: np.ndarray, uvs: np.ndarray, faces: np.ndarray) -> Mesh:
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)
    return Mesh(corners.reshape(-1, 3), np.repeat(normals, 3, 0), uvs[faces].reshape(-1, 2),
                np.arange(3 * len(faces), dtype=np.uint32).reshape(-1, 3))


def _numbers(node: ElementTree.Element) -> list[float]:
    """Three numbers; a single one stands for all."""
    found = [float(x) for x in node.get("value", "").replace(",", " ").split()]
    return found * 3 if len(found) == 1 else found


def material_from_xml(node: ElementTree.Element) -> Facts:
    """Facts of a <bsdf>, looking through twosided and bumpmap."""
    while node.get("type") in ("twosided", "bumpmap"):
        inner = node.find("bsdf")
        assert inner is not None, "such a <bsdf> holds another"
        node = inner
    kind = node.get("type", "")
    facts = dict(PLAIN, kind={"plastic": "roughplastic"}.get(kind, kind))
    values = {child.get("name"): child for child in node}
    number = {name: float(c.get("value", "")) for name, c in values.items() if c.tag == "float"}
    facts["alpha"] = number.get("alpha", 0.003 if kind == "plastic" else 0.1)
    facts["ior"] = number.get("intIOR", number.get("int_ior", 1.5))
    for name in ("eta", "k"):
        if name in values:
            facts[name] = _numbers(values[name])
    colour = next((c for n, c in values.items() if n and "eflectance" in n and "pecular" not in n),
                  None)
    if colour is not None and colour.tag == "texture" and colour.get("type") == "bitmap":
        facts["texture"] = next(c.get("value") for c in colour if c.get("name") == "filename")
    elif colour is not None and colour.tag == "rgb":
        facts["albedo"] = _numbers(colour)
    return facts


def load_xml(path: Path) -> tuple[list[tuple[Mesh, str, list[Any] | None]], dict[str, Facts],
                                  list[Facts]]:
    """(mesh, material name, emission) of each shape; facts of each material; the camera."""
    root = ElementTree.parse(path).getroot()
    materials = {name: material_from_xml(node)
                 for node in root.iter("bsdf") if (name := node.get("id"))}
    scene = mi.load_file(str(path))
    shapes = []
    for shape in scene.shapes():
        name = shape.bsdf().id()
        mesh = from_mitsuba(shape) if "faces" in mi.traverse(shape) else _rectangle(shape)
        emission = None
        if shape.is_emitter():
            emission = np.array(mi.traverse(shape.emitter())["radiance.value"]).ravel()[:3].tolist()
        shapes.append((mesh, name if name in materials else next(iter(materials)), emission))
    pose = np.array(mi.traverse(scene.sensors()[0])["to_world"].matrix).reshape(4, 4)
    reach = 0.4 * np.linalg.norm(np.ptp([s[0].vertices.mean(0) for s in shapes], axis=0)) + 1
    return shapes, materials, [{"eye": pose[:3, 3].tolist(),
                                "target": (pose[:3, 3] + reach * pose[:3, 2]).tolist()}]


def _rectangle(shape: mi.Shape) -> Mesh:
    matrix = np.array(mi.traverse(shape)["to_world"].matrix).reshape(4, 4)
    return quad([-1, -1, 0], [2, 0, 0], [0, 2, 0]).transform(matrix)


def write(name: str, loaded: tuple[Any, ...], folder: Path, source: Path) -> None:
    shapes, materials, cameras = loaded
    names = sorted({material for _, material, _ in shapes})
    groups: dict[tuple[Any, ...], list[Mesh]] = {}
    for mesh, material, emission in shapes:
        groups.setdefault((names.index(material), tuple(emission or ())), []).append(mesh)
    folder.mkdir(parents=True, exist_ok=True)
    arrays: dict[str, Any] = {}
    facts = dict(HOW.get(name, DEFAULT), shapes=[], cameras=cameras)
    points = []
    for i, ((material, emission), meshes) in enumerate(groups.items()):
        mesh = merge(meshes)
        textured = materials[names[material]]["texture"]
        arrays |= {f"v{i}": mesh.vertices.astype(np.float32),
                   f"n{i}": np.round(mesh.normals * 127).astype(np.int8),
                   f"t{i}": mesh.uvs.astype(np.float32) if textured
                            else np.zeros((len(mesh.uvs), 2), np.float16),
                   f"f{i}": mesh.faces.astype(np.uint32)}
        facts["shapes"].append({"material": material, "emission": list(emission)})
        points.append(mesh.vertices)
    everything = np.concatenate(points)
    low, high = everything.min(0), everything.max(0)
    facts |= {"low": low.tolist(), "high": high.tolist(),
              "inner": [(low + f * (high - low)).tolist()
                        for f in ([0.2, 0.15, 0.2], [0.8, 0.6, 0.8])]}
    facts["materials"] = [_with_texture(materials[n], source, folder) for n in names]
    np.savez_compressed(folder / "geometry.npz", **arrays)
    (folder / "scene.json").write_text(json.dumps(facts, indent=1))
    print(f"{name}: {sum(len(m.faces) for m, *_ in shapes)} triangles, {len(groups)} shapes",
          file=sys.stderr)


def _with_texture(facts: Facts, source: Path, folder: Path) -> Facts:
    if not facts["texture"]:
        return facts
    from PIL import Image  # which a machine that only renders may lack

    image = Image.open(source / facts["texture"]).convert("RGB")
    image.thumbnail((TEXTURE, TEXTURE), Image.Resampling.LANCZOS)
    name = Path(facts["texture"]).stem + ".jpg"
    image.save(folder / name, quality=88)
    return dict(facts, texture=name)


def y_up(loaded: tuple[Any, ...]) -> tuple[Any, ...]:
    shapes, materials, cameras = loaded
    turn = np.eye(4)[[0, 2, 1, 3]] * np.array([[1], [1], [-1], [1]])
    cameras = [{key: (turn[:3, :3] @ point).tolist() for key, point in camera.items()}
               for camera in cameras]
    return [(m.transform(turn), name, e) for m, name, e in shapes], materials, cameras


# Drawing ------------------------------------------------------------------------------------------

def load_image(path: Path) -> np.ndarray:
    """An 8-bit texture as linear RGB (H, W, 3) float32."""
    bitmap = mi.Bitmap(str(path)).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32,
                                          srgb_gamma=False)
    return np.array(bitmap)


class _Scene:
    """A converted scene, read once."""

    def __init__(self, folder: Path) -> None:
        held_back.refuse(folder.name)
        self.name = folder.name
        self.facts = json.loads((folder / "scene.json").read_text())
        with np.load(folder / "geometry.npz") as file:
            self.meshes = [_unpack(file, i) for i in range(len(self.facts["shapes"]))]
        images = {m["texture"] for m in self.facts["materials"] if m.get("texture")}
        self.images = {name: load_image(folder / name) for name in images}

    def material(self, facts: Facts, rng: np.random.Generator) -> Material:
        if len(self.meshes) > 8 and rng.random() < 0.15 and facts["kind"] != "dielectric":
            return random_material(rng, metal=0.05)
        albedo = (self.images[facts["texture"]] if facts.get("texture")
                  else np.array(facts["albedo"], np.float32))
        albedo = albedo if albedo.ndim == 3 else albedo.reshape(1, 1, 3)
        return Material(facts["kind"], albedo, facts["alpha"], tuple(facts["eta"]),
                        tuple(facts["k"]), facts["ior"])


def _unpack(file: np.lib.npyio.NpzFile, index: int) -> Mesh:
    normals = file[f"n{index}"].astype(np.float64) / 127
    return Mesh(file[f"v{index}"].astype(np.float64), normals, file[f"t{index}"].astype(np.float64),
                file[f"f{index}"])


class RealScenes:
    """The scenes of a folder that training may show; empty (false) if no folder is given or it
    holds none."""

    def __init__(self, folder: Path | None) -> None:
        found = sorted(Path(folder).glob("*/scene.json")) if folder else []
        self._folders = held_back.for_training(path.parent for path in found)
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
            eye, target = draw_view(scene.facts, rng)
            add_moving(d, rng, eye + rng.uniform(0.4, 1.0) * (target - eye) - [0, 0.3 * extent, 0],
                       extent)
        return Draft(d, lambda r: draw_view(scene.facts, r), 0.15 * extent)


def _light(d: Description, scene: _Scene, rng: np.random.Generator, maps: Environments) -> None:
    """An environment for open scenes; a lamp or two in closed ones, less often if they have
    lights."""
    if scene.facts["open"]:
        lights.set_environment(d, rng, maps, False, gain=float(rng.uniform(1, 5)))
    if scene.facts["indoor"] and rng.random() < 0.6:
        metre = scene.facts["metre"]
        eye, target = draw_view(scene.facts, rng)
        centre = eye + rng.uniform(0.2, 0.8) * (target - eye) + [0, 0.5 * metre, 0]
        lights.panel(d, rng, centre, float(rng.choice([0.3, 1.0])) * metre,
                     rng.uniform(5, 40) * metre**2)


def draw_view(facts: Facts, rng: np.random.Generator, own: float = 0.6, shift: float = 0.12,
              inside: float = 0.3) -> View:
    """A pose near one of a scene's own cameras, or anywhere in its inner box.

    own: chance of the scene's cameras. shift: of the eye from them, over how far they look. inside:
    chance of an eye within the inner box of a scene that is looked at from around it; others always
    have it there.
    """
    cameras = facts["cameras"]
    if cameras and rng.random() < own:
        camera = cameras[int(rng.integers(len(cameras)))]
        eye, target = np.array(camera["eye"]), np.array(camera["target"])
        spread = np.linalg.norm(target - eye)
        return eye + rng.normal(0, shift, 3) * spread, target + rng.normal(0, 0.2, 3) * spread
    low, high = (np.array(corner) for corner in facts["inner"])
    target = rng.uniform(low, high)
    if not facts["around"] or rng.random() < inside:
        return rng.uniform(low, high), target
    size = np.linalg.norm(np.subtract(facts["high"], facts["low"]))
    angle = rng.uniform(0, 2 * np.pi)
    reach = size * rng.uniform(0.15, 0.6) * np.array([np.cos(angle), rng.uniform(0.1, 0.7),
                                                      np.sin(angle)])
    return target + reach, target


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", type=Path)
    parser.add_argument("out", type=Path)
    args = parser.parse_args()
    mi.set_variant("scalar_rgb")
    for source in sorted(p for p in args.source.iterdir() if p.is_dir()):
        xml, gltf = source / "scene.xml", next(source.glob("*.gltf"), None)
        loaded: tuple[Any, ...]
        if xml.exists():
            loaded = load_xml(xml)
        elif gltf is not None:
            loaded = load_gltf(gltf, PLAIN)
        else:
            continue
        write(source.name, y_up(loaded) if source.name == "matpreview" else loaded,
              args.out / source.name, source)


if __name__ == "__main__":
    main()
