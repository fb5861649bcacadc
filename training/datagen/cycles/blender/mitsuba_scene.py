"""Scenes in Mitsuba's XML, read into Blender: PLY meshes, their materials and lights, and the
cameras.

Only what the library's scenes use is read: shapes of type `ply` in the world's place, `diffuse`,
`plastic`, `conductor` and `dielectric` surfaces with a colour or a bitmap, and `area` emitters.
Mitsuba's y is up, Blender's is z.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from .scene import principled

Z_UP = Matrix.Rotation(math.pi / 2, 4, "X")


def load(folder: Path) -> tuple[list[bpy.types.Object], list[tuple[np.ndarray, np.ndarray, float]]]:
    """The objects of `scene.xml`, and of each camera its place, a point in front of it and its
    field of view in degrees."""
    document = ElementTree.parse(folder / "scene.xml").getroot()
    made = {read(node, "id"): read_material(node, folder) for node in document.findall("bsdf")}
    objects = [item for node in document.findall("shape[@type='ply']")
               if (item := read_shape(node, folder, made))]
    return objects, [read_camera(node) for node in document.findall("sensor")]


def read_shape(node: ElementTree.Element, folder: Path,
               made: dict[str, bpy.types.Material]) -> bpy.types.Object | None:
    path = folder / read(require(node, "string[@name='filename']"))
    before = set(bpy.data.objects)
    bpy.ops.wm.ply_import(filepath=str(path), forward_axis="Y", up_axis="Z", merge_verts=False)
    item = next((found for found in bpy.data.objects if found not in before), None)
    if item is None:
        return None
    item.matrix_world = Z_UP @ item.matrix_world
    surface = made.get(read(require(node, "ref"), "id"))
    radiance = node.find("emitter[@type='area']/rgb")
    if radiance is not None:
        surface, shader = principled("lamp")
        light = numbers(radiance)
        shader.inputs["Base Color"].default_value = (0, 0, 0, 1)
        shader.inputs["Emission Color"].default_value = (*light / light.max(), 1)
        shader.inputs["Emission Strength"].default_value = float(light.max())
    if surface:
        item.data.materials.clear()
        item.data.materials.append(surface)
    return item


def read_material(node: ElementTree.Element, folder: Path) -> bpy.types.Material:
    """A Principled material like Mitsuba's."""
    inner = node.find("bsdf") if node.get("type") in ("twosided", "bumpmap", "mask") else node
    inner = node if inner is None else inner
    kind = read(inner, "type")
    made, shader = principled(read(node, "id"))
    alpha = inner.find("float[@name='alpha']")
    roughness = (math.sqrt(float(read(alpha))) if alpha is not None
                 else float(kind == "diffuse"))
    shader.inputs["Roughness"].default_value = roughness
    if "dielectric" in kind:
        shader.inputs["Transmission Weight"].default_value = 1.0
        refraction = require(inner, "float[@name='int_ior']")
        shader.inputs["IOR"].default_value = float(read(refraction))
        shader.inputs["Base Color"].default_value = (1, 1, 1, 1)
    elif "conductor" in kind:
        eta, k = (numbers(require(inner, f"rgb[@name='{name}']")) for name in ("eta", "k"))
        shader.inputs["Metallic"].default_value = 1.0
        reflected = ((eta - 1) ** 2 + k**2) / ((eta + 1) ** 2 + k**2)
        shader.inputs["Base Color"].default_value = (*reflected, 1)
    else:
        colour = inner.find("rgb")
        if colour is not None:
            shader.inputs["Base Color"].default_value = (*numbers(colour), 1)
        bitmap = inner.find("texture[@type='bitmap']/string[@name='filename']")
        if bitmap is not None:
            picture = made.node_tree.nodes.new("ShaderNodeTexImage")
            picture.image = bpy.data.images.load(str(folder / read(bitmap)),
                                                 check_existing=True)
            made.node_tree.links.new(picture.outputs[0], shader.inputs["Base Color"])
    return made


def read_camera(node: ElementTree.Element) -> tuple[np.ndarray, np.ndarray, float]:
    look = require(node, "transform/lookat")
    eye, target = (np.array(Z_UP @ Matrix.Translation(numbers(look, name)).to_translation())
                   for name in ("origin", "target"))
    return eye, target, float(read(require(node, "float[@name='fov']")))


def numbers(node: ElementTree.Element, name: str = "value") -> np.ndarray:
    return np.array([float(x) for x in read(node, name).replace(",", " ").split()])


def require(node: ElementTree.Element, path: str) -> ElementTree.Element:
    """What lies at a path below a node; ValueError where there is nothing."""
    found = node.find(path)
    if found is None:
        raise ValueError(f"a {node.tag} of the scene has no {path}")
    return found


def read(node: ElementTree.Element, name: str = "value") -> str:
    """An attribute of a node; ValueError where it has none of that name."""
    found = node.get(name)
    if found is None:
        raise ValueError(f"a {node.tag} of the scene has no {name}")
    return found
