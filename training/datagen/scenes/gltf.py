"""The part of glTF 2.0 that static scenes need: nodes, meshes, base colours and their textures."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from training.datagen.scenes.meshes import Mesh

TYPES = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


def load_gltf(path: Path, plain: dict) -> tuple[list[tuple[Mesh, str, None]], dict[str, dict], list[dict]]:
    """(world mesh, material name, no emission) of each primitive; material facts based on `plain`; no camera."""
    document = json.loads(path.read_text())
    buffers = [(path.parent / b["uri"]).read_bytes() for b in document["buffers"]]
    materials = {f"m{i}": _material(document, m, plain) for i, m in enumerate(document["materials"])}
    shapes = []
    for root in document["scenes"][document.get("scene", 0)]["nodes"]:
        _walk(document, buffers, root, np.eye(4), shapes)
    return shapes, materials, []


def _walk(document: dict, buffers: list[bytes], index: int, parent: np.ndarray, shapes: list) -> None:
    node = document["nodes"][index]
    world = parent @ _matrix(node)
    if "mesh" in node:
        for primitive in document["meshes"][node["mesh"]]["primitives"]:
            mesh = _primitive(document, buffers, primitive).transformed(world)
            shapes.append((mesh, f"m{primitive['material']}", None))
    for child in node.get("children", []):
        _walk(document, buffers, child, world, shapes)


def _primitive(document: dict, buffers: list[bytes], primitive: dict) -> Mesh:
    attributes = {k: _accessor(document, buffers, v) for k, v in primitive["attributes"].items()}
    vertices = attributes["POSITION"].astype(np.float64)
    uvs = attributes.get("TEXCOORD_0", np.zeros((len(vertices), 2))).astype(np.float64)
    faces = _accessor(document, buffers, primitive["indices"]).reshape(-1, 3).astype(np.uint32)
    return Mesh(vertices, attributes["NORMAL"].astype(np.float64), uvs, faces)


def _accessor(document: dict, buffers: list[bytes], index: int) -> np.ndarray:
    accessor = document["accessors"][index]
    view = document["bufferViews"][accessor["bufferView"]]
    dtype, width = np.dtype(TYPES[accessor["componentType"]]), WIDTHS[accessor["type"]]
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    stride = view.get("byteStride", width * dtype.itemsize)
    return np.ndarray((accessor["count"], width), dtype, buffers[view["buffer"]], start, (stride, dtype.itemsize))


def _matrix(node: dict) -> np.ndarray:
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


def _material(document: dict, material: dict, plain: dict) -> dict:
    """Diffuse, or rough plastic below roughness 0.9; a missing metallic factor counts as none (low-poly exports)."""
    surface = material.get("pbrMetallicRoughness", {})
    facts = dict(plain, albedo=list(surface.get("baseColorFactor", (0.8, 0.8, 0.8, 1))[:3]))
    roughness = surface.get("roughnessFactor", 1.0)
    if roughness < 0.9:
        facts |= {"kind": "roughplastic", "alpha": roughness**2}
    if "baseColorTexture" in surface:
        texture = document["textures"][surface["baseColorTexture"]["index"]]
        facts["texture"] = document["images"][texture["source"]]["uri"]
    return facts
