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
    made = {node.get("id"): read_material(node, folder) for node in document.findall("bsdf")}
    objects = [item for node in document.findall("shape[@type='ply']")
               if (item := read_shape(node, folder, made))]
    return objects, [read_camera(node) for node in document.findall("sensor")]


def read_shape(node: ElementTree.Element, folder: Path,
               made: dict[str, bpy.types.Material]) -> bpy.types.Object | None:
    path = folder / node.find("string[@name='filename']").get("value")
    before = set(bpy.data.objects)
    bpy.ops.wm.ply_import(filepath=str(path), forward_axis="Y", up_axis="Z", merge_verts=False)
    item = next((found for found in bpy.data.objects if found not in before), None)
    if item is None:
        return None
    item.matrix_world = Z_UP @ item.matrix_world
    surface = made.get(node.find("ref").get("id"))
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
    kind = inner.get("type")
    made, shader = principled(node.get("id"))
    alpha = inner.find("float[@name='alpha']")
    roughness = (math.sqrt(float(alpha.get("value"))) if alpha is not None
                 else float(kind == "diffuse"))
    shader.inputs["Roughness"].default_value = roughness
    if "dielectric" in kind:
        shader.inputs["Transmission Weight"].default_value = 1.0
        shader.inputs["IOR"].default_value = float(inner.find("float[@name='int_ior']")
                                                   .get("value"))
        shader.inputs["Base Color"].default_value = (1, 1, 1, 1)
    elif "conductor" in kind:
        eta, k = (numbers(inner.find(f"rgb[@name='{name}']")) for name in ("eta", "k"))
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
            picture.image = bpy.data.images.load(str(folder / bitmap.get("value")),
                                                 check_existing=True)
            made.node_tree.links.new(picture.outputs[0], shader.inputs["Base Color"])
    return made


def read_camera(node: ElementTree.Element) -> tuple[np.ndarray, np.ndarray, float]:
    look = node.find("transform/lookat")
    eye, target = (np.array(Z_UP @ Matrix.Translation(numbers(look, name)).to_translation())
                   for name in ("origin", "target"))
    return eye, target, float(node.find("float[@name='fov']").get("value"))


def numbers(node: ElementTree.Element, name: str = "value") -> np.ndarray:
    return np.array([float(x) for x in node.get(name).replace(",", " ").split()])
