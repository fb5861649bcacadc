"""Build a Mitsuba scene with movable objects from a description (meshes, materials, movers,
lights)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from training.datagen.scenes.materials import Material
from training.datagen.scenes.meshes import Mesh, merge
from training.datagen.scenes.motion import bend_mesh

# Motion -------------------------------------------------------------------------------------------
# Leads a surface point back to the previous frame: a matrix for each shape, and a shift for each
# corner that bends.

RIGID = 0xFFFFFFFF


@dataclass(frozen=True)
class Motions:
    """Tables on the device: 3x4 `matrices` by shape id, `starts` of a shape's triangles in
    `corners`, or RIGID.

    `corners` holds, for each triangle of a shape that bends, 3 shifts to be added after the matrix.
    """

    matrices: mi.Float
    starts: mi.UInt32
    corners: mi.Float

    @classmethod
    def of(cls, matrices: np.ndarray, bending: dict[int, np.ndarray]) -> Motions:
        """From matrices (S, 3, 4) and, by shape id, shifts (M, 3, 3) of triangles."""
        starts, total = np.full(len(matrices), RIGID, np.uint32), 0
        for shape_id, shifts in bending.items():
            starts[shape_id] = total
            total += len(shifts)
        corners = np.concatenate([shifts.ravel() for shifts in bending.values()] or [np.zeros(9)])
        flat = matrices.astype(np.float32).ravel()
        return cls(mi.Float(flat), mi.UInt32(starts), mi.Float(corners.astype(np.float32)))

    def vector(self, row: mi.UInt32, v: mi.Vector3f) -> mi.Vector3f:
        columns = [self._column(row, k) for k in range(3)]
        return columns[0] * v.x + columns[1] * v.y + columns[2] * v.z

    def point(self, row: mi.UInt32, hit: mi.PreliminaryIntersection3f,
              point: mi.Point3f) -> mi.Point3f:
        """Previous position of the surface `point`, which a preliminary intersection found on shape
        `row`."""
        start = dr.gather(mi.UInt32, self.starts, row)
        bends = start != RIGID
        triangle = dr.select(bends, start + hit.prim_index, 0)
        b1, b2 = hit.prim_uv.x, hit.prim_uv.y
        shift = sum(weight * mi.Vector3f(*(dr.gather(mi.Float, self.corners,
                                                     triangle * 9 + 3 * corner + i, bends)
                                           for i in range(3)))
                    for corner, weight in enumerate((1 - b1 - b2, b1, b2)))
        moved = self.vector(row, mi.Vector3f(point)) + self._column(row, 3)
        return mi.Point3f(moved + dr.select(bends, shift, 0))

    def _column(self, row: mi.UInt32, column: int) -> mi.Vector3f:
        return mi.Vector3f(*(dr.gather(mi.Float, self.matrices, row * 12 + 4 * i + column)
                             for i in range(3)))


# Scenes -------------------------------------------------------------------------------------------

@dataclass(frozen=True)
class Part:
    """A mesh with a material, or with an emitted radiance (3,).

    `mover`, `glow` and `bend` are indices into the lists of a Description; a part is bent first and
    then moved.
    """

    mesh: Mesh
    material: int
    emission: np.ndarray | None = None
    mover: int | None = None
    glow: int | None = None
    bend: int | None = None


@dataclass
class Description:
    """A scene without its camera. Environment: a (H, W, 3) radiance image or None, turned about y.

    `lens` is the aperture's radius and the depth in focus, as shares of the distance to what is
    looked at.

    Movers are functions of the frame to 4x4 matrices, glows to factors on a radiance, bends of
    vertices (N, 3) and the frame to vertices.
    """

    name: str
    materials: list[Material] = field(default_factory=list)
    parts: list[Part] = field(default_factory=list)
    movers: list[Any] = field(default_factory=list)
    glows: list[Any] = field(default_factory=list)
    bends: list[Any] = field(default_factory=list)
    environment: np.ndarray | None = None
    environment_turn: float = 0.0
    environment_gain: float = 1.0
    lens: tuple[float, float] = (0.0, 1.0)

    def material(self, material: Material) -> int:
        self.materials.append(material)
        return len(self.materials) - 1

    def add(self, mesh: Mesh, material: int, mover: int | None = None,
            bend: int | None = None) -> None:
        self.parts.append(Part(mesh, material, None, mover, bend=bend))

    def emit(self, mesh: Mesh, radiance: np.ndarray, mover: int | None = None,
             glow: int | None = None) -> None:
        self.parts.append(Part(mesh, -1, np.asarray(radiance, float), mover, glow))


@dataclass
class _Shape:
    mesh: mi.Mesh
    source: Mesh
    row: np.ndarray
    first: Part

    @property
    def moves(self) -> bool:
        return self.first.mover is not None or self.first.bend is not None


BLACK = Material("diffuse", np.zeros((1, 1, 3), np.float32))
ROW = 8  # f0.rgb, albedo-coloured part of f0, diffuse factor, roughness, emissive, follow
FOLLOW = 7  # column: -1 mirror, index of refraction of glass, 0 for surfaces that end a camera ray


class BuiltScene:
    """A Mitsuba scene with a table of plane properties and object motions for each of its
    shapes."""

    def __init__(self, description: Description) -> None:
        self.description = description
        bsdfs = [mi.load_dict(m.bsdf()) for m in description.materials]
        black = mi.load_dict(BLACK.bsdf())
        self._shapes = [_shape(i, g, description, bsdfs, black)
                        for i, g in enumerate(_grouped(description.parts))]
        entries: dict[str, Any] = {"type": "scene"}
        entries |= {f"shape{i}": s.mesh for i, s in enumerate(self._shapes)}
        if description.environment is not None:
            entries["environment"] = _environment(description)
        self.scene = mi.load_dict(entries)
        self._params = mi.traverse(self.scene)
        numbers: list[Any] = [dr.reinterpret_array(mi.UInt32, mi.ShapePtr(s.mesh))
                              for s in self._shapes]
        ids = [int(number[0]) for number in numbers]
        self._rows = max(ids) + 1
        properties = np.zeros((self._rows, ROW), np.float32)
        for shape_id, shape in zip(ids, self._shapes, strict=True):
            properties[shape_id] = shape.row
        self._ids = ids
        self.properties = mi.Float(properties.ravel())
        self.motions = self._motions(0.0, 0.0)

    def move(self, time: float, previous: float) -> None:
        """Move objects and set lights for frame `time`; `motions` then leads back to frame
        `previous`."""
        moved = [s for s in self._shapes if s.moves]
        for shape in moved:
            mesh = _posed(shape.source, shape.first, self.description, time)
            key = shape.mesh.id()
            self._params[f"{key}.vertex_positions"] = mi.Float(mesh.vertices.astype(np.float32)
                                                               .ravel())
            self._params[f"{key}.vertex_normals"] = mi.Float(mesh.normals.astype(np.float32)
                                                             .ravel())
        glowing = [(s, s.first.glow) for s in self._shapes if s.first.glow is not None]
        for shape, glow in glowing:
            radiance = shape.first.emission * self.description.glows[glow](time)
            value = mi.Color3f(*(dr.opaque(mi.Float, float(x)) for x in radiance))
            self._params[f"{shape.mesh.id()}.emitter.radiance.value"] = value
        if moved or glowing:
            self._params.update()
        self.motions = self._motions(time, previous)

    def _motions(self, time: float, previous: float) -> Motions:
        """World position now -> world position in the previous frame, for all shapes."""
        matrices, bending = np.tile(np.eye(4)[:3], (self._rows, 1, 1)), {}
        for shape_id, shape in zip(self._ids, self._shapes, strict=True):
            part, d = shape.first, self.description
            if part.mover is not None:
                path = d.movers[part.mover]
                matrices[shape_id] = (path(previous) @ np.linalg.inv(path(time)))[:3]
            if part.bend is not None:
                now, then = (_posed(shape.source, part, d, t).vertices for t in (time, previous))
                rigid = now @ matrices[shape_id, :, :3].T + matrices[shape_id, :, 3]
                bending[shape_id] = (then - rigid)[shape.source.faces]
        return Motions.of(matrices, bending)


def anchors(count: int = 96) -> list[Any]:
    """Objects that keep the instance tables of compiled kernels at one length, so all scenes share
    kernels.

    Dr.Jit writes the highest instance number of each class into the kernel; these hold a high
    number in each.
    """
    bsdfs = [mi.load_dict(Material("diffuse", np.full((1, 1, 3), 0.5, np.float32)).bsdf())
             for _ in range(count)]
    triangle = Mesh(np.eye(3), np.eye(3), np.zeros((3, 2)), np.array([[0, 1, 2]], np.uint32))
    group = [Part(triangle, -1, np.ones(3))]
    shapes = [_shape(i, group, Description("anchor"), [], bsdfs[-1]).mesh for i in range(count)]
    return [bsdfs[-1], shapes[-1]]


def _posed(source: Mesh, part: Part, description: Description, time: float) -> Mesh:
    """A part's mesh in the world at frame `time`."""
    mesh = source if part.bend is None else bend_mesh(source, description.bends[part.bend], time)
    return mesh if part.mover is None else mesh.transform(description.movers[part.mover](time))


def _grouped(parts: list[Part]) -> list[list[Part]]:
    """Groups of parts that can be one shape: same mover, same material or emission. Few shapes
    trace faster."""
    groups: dict[tuple[Any, ...], list[Part]] = {}
    for part in parts:
        light = None if part.emission is None else tuple(part.emission)
        groups.setdefault((part.mover, part.material, part.glow, part.bend, light), []).append(part)
    return list(groups.values())


def _shape(index: int, group: list[Part], description: Description, bsdfs: list[Any],
           black: mi.BSDF) -> _Shape:
    first, source = group[0], merge([p.mesh for p in group])
    props = mi.Properties()
    props["bsdf"] = black if first.emission is not None else bsdfs[first.material]
    if first.emission is not None:
        props["emitter"] = mi.load_dict({
            "type": "area", "radiance": {"type": "rgb", "value": list(first.emission)}
        })
    mesh = mi.Mesh(f"shape{index}", len(source.vertices), len(source.faces), props, True, True)
    mesh.set_id(f"shape{index}")
    start = _posed(source, first, description, 0.0)
    params = mi.traverse(mesh)
    params["vertex_positions"] = mi.Float(start.vertices.astype(np.float32).ravel())
    params["vertex_normals"] = mi.Float(start.normals.astype(np.float32).ravel())
    params["vertex_texcoords"] = mi.Float(start.uvs.astype(np.float32).ravel())
    params["faces"] = mi.UInt32(start.faces.astype(np.uint32).ravel())
    params.update()
    material = BLACK if first.emission is not None else description.materials[first.material]
    f0, coloured, diffuse = material.reflectance()
    emissive = float(first.emission is not None)
    row = np.array([*f0, coloured, diffuse, material.roughness, emissive, material.follow],
                   np.float32)
    return _Shape(mesh, source, row, first)


def _environment(description: Description) -> dict[str, Any]:
    assert description.environment is not None
    turn = mi.ScalarTransform4f().rotate([0, 1, 0], description.environment_turn)
    bitmap = mi.Bitmap(np.ascontiguousarray(description.environment * description.environment_gain,
                                            np.float32))
    return {"type": "envmap", "bitmap": bitmap, "to_world": turn}
