"""From a description (meshes, materials, movers, lights) to a Mitsuba scene whose objects can be moved."""

from __future__ import annotations

from dataclasses import dataclass, field

import drjit as dr
import mitsuba as mi
import numpy as np

from training.scenes.materials import Material
from training.scenes.meshes import Mesh, merge


@dataclass(frozen=True)
class Part:
    """A mesh with a material, or with an emitted radiance (3,); `mover` and `glow` are indices into a Description's."""

    mesh: Mesh
    material: int
    emission: np.ndarray | None = None
    mover: int | None = None
    glow: int | None = None


@dataclass
class Description:
    """Everything of a scene but the camera. Environment: a (H, W, 3) radiance image or None, turned about y.

    Movers are functions of the frame to 4x4 matrices, glows to factors on a radiance.
    """

    name: str
    materials: list[Material] = field(default_factory=list)
    parts: list[Part] = field(default_factory=list)
    movers: list = field(default_factory=list)
    glows: list = field(default_factory=list)
    environment: np.ndarray | None = None
    environment_turn: float = 0.0
    environment_gain: float = 1.0

    def material(self, material: Material) -> int:
        self.materials.append(material)
        return len(self.materials) - 1

    def add(self, mesh: Mesh, material: int, mover: int | None = None) -> None:
        self.parts.append(Part(mesh, material, None, mover))

    def emit(self, mesh: Mesh, radiance: np.ndarray, mover: int | None = None, glow: int | None = None) -> None:
        self.parts.append(Part(mesh, -1, np.asarray(radiance, float), mover, glow))


@dataclass
class _Shape:
    mesh: mi.Mesh
    source: Mesh
    row: np.ndarray
    first: Part

    @property
    def mover(self) -> int | None:
        return self.first.mover


BLACK = Material("diffuse", np.zeros((1, 1, 3), np.float32))
ROW = 8  # f0.rgb, albedo-coloured part of f0, diffuse factor, roughness, emissive, follow
FOLLOW = 7  # column: -1 mirror, index of refraction of glass, 0 for surfaces that end a camera ray


class BuiltScene:
    """A Mitsuba scene with a table of plane properties and object motions for each of its shapes."""

    def __init__(self, description: Description) -> None:
        self.description = description
        bsdfs = [mi.load_dict(m.bsdf()) for m in description.materials]
        black = mi.load_dict(BLACK.bsdf())
        self._shapes = [_shape(i, g, description, bsdfs, black) for i, g in enumerate(_grouped(description.parts))]
        entries = {"type": "scene"} | {f"shape{i}": s.mesh for i, s in enumerate(self._shapes)}
        if description.environment is not None:
            entries["environment"] = _environment(description)
        self.scene = mi.load_dict(entries)
        self._params = mi.traverse(self.scene)
        ids = [int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(s.mesh))[0]) for s in self._shapes]
        self._rows = max(ids) + 1
        properties = np.zeros((self._rows, ROW), np.float32)
        for shape_id, shape in zip(ids, self._shapes, strict=True):
            properties[shape_id] = shape.row
        self._ids = ids
        self.properties = mi.Float(properties.ravel())
        self.motions = self._motion_table(0.0, 0.0)

    def move(self, time: float, previous: float) -> None:
        """Put every mover where it is at frame `time`, set lights; `motions` then leads back to frame `previous`."""
        moved = [s for s in self._shapes if s.mover is not None]
        for shape in moved:
            mesh = shape.source.transformed(self.description.movers[shape.mover](time))
            key = shape.mesh.id()
            self._params[f"{key}.vertex_positions"] = mi.Float(mesh.vertices.astype(np.float32).ravel())
            self._params[f"{key}.vertex_normals"] = mi.Float(mesh.normals.astype(np.float32).ravel())
        glowing = [s for s in self._shapes if s.first.glow is not None]
        for shape in glowing:
            radiance = shape.first.emission * self.description.glows[shape.first.glow](time)
            value = mi.Color3f(*(dr.opaque(mi.Float, float(x)) for x in radiance))
            self._params[f"{shape.mesh.id()}.emitter.radiance.value"] = value
        if moved or glowing:
            self._params.update()
        self.motions = self._motion_table(time, previous)

    def _motion_table(self, time: float, previous: float) -> mi.Float:
        """3x4 matrices, one for each shape id: world position now -> world position in the previous frame."""
        table = np.tile(np.eye(4)[:3].ravel(), (self._rows, 1))
        for shape_id, shape in zip(self._ids, self._shapes, strict=True):
            if shape.mover is not None:
                path = self.description.movers[shape.mover]
                table[shape_id] = (path(previous) @ np.linalg.inv(path(time)))[:3].ravel()
        return mi.Float(table.astype(np.float32).ravel())


def anchors(count: int = 96) -> list:
    """Objects that keep the instance tables of compiled kernels at one length, so that scenes share kernels.

    Dr.Jit writes the highest instance number of each class into the kernel; these hold a high number in each.
    """
    bsdfs = [mi.load_dict(Material("diffuse", np.full((1, 1, 3), 0.5, np.float32)).bsdf()) for _ in range(count)]
    triangle = Mesh(np.eye(3), np.eye(3), np.zeros((3, 2)), np.array([[0, 1, 2]], np.uint32))
    group = [Part(triangle, -1, np.ones(3))]
    shapes = [_shape(i, group, Description("anchor"), [], bsdfs[-1]).mesh for i in range(count)]
    return [bsdfs[-1], shapes[-1]]


def _grouped(parts: list[Part]) -> list[list[Part]]:
    """Parts that can be one shape: same mover, and same material or same emission. Few shapes trace faster."""
    groups: dict[tuple, list[Part]] = {}
    for part in parts:
        light = None if part.emission is None else tuple(part.emission)
        groups.setdefault((part.mover, part.material, part.glow, light), []).append(part)
    return list(groups.values())


def _shape(index: int, group: list[Part], description: Description, bsdfs: list, black: mi.BSDF) -> _Shape:
    first, source = group[0], merge([p.mesh for p in group])
    props = mi.Properties()
    props["bsdf"] = black if first.emission is not None else bsdfs[first.material]
    if first.emission is not None:
        props["emitter"] = mi.load_dict({"type": "area", "radiance": {"type": "rgb", "value": list(first.emission)}})
    mesh = mi.Mesh(f"shape{index}", len(source.vertices), len(source.faces), props, True, True)
    mesh.set_id(f"shape{index}")
    start = source
    if first.mover is not None:
        start = source.transformed(description.movers[first.mover](0.0))
    params = mi.traverse(mesh)
    params["vertex_positions"] = mi.Float(start.vertices.astype(np.float32).ravel())
    params["vertex_normals"] = mi.Float(start.normals.astype(np.float32).ravel())
    params["vertex_texcoords"] = mi.Float(start.uvs.astype(np.float32).ravel())
    params["faces"] = mi.UInt32(start.faces.astype(np.uint32).ravel())
    params.update()
    material = BLACK if first.emission is not None else description.materials[first.material]
    f0, coloured, diffuse = material.reflectance()
    emissive = float(first.emission is not None)
    row = np.array([*f0, coloured, diffuse, material.roughness, emissive, material.follow], np.float32)
    return _Shape(mesh, source, row, first)


def _environment(description: Description) -> dict:
    turn = mi.ScalarTransform4f().rotate([0, 1, 0], description.environment_turn)
    bitmap = mi.Bitmap(np.ascontiguousarray(description.environment * description.environment_gain, np.float32))
    return {"type": "envmap", "bitmap": bitmap, "to_world": turn}
