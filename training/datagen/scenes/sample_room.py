"""The room of samples/room: composed by hand, not among the scenes that clips are drawn from."""

from __future__ import annotations

import numpy as np

from training.datagen.scenes import furniture, meshes, textures
from training.datagen.scenes.build import Description
from training.datagen.scenes.lights import sky
from training.datagen.scenes.materials import METALS, Material
from training.datagen.scenes.meshes import rotation, translation
from training.datagen.scenes.motion import Camera, look_at, object_path
from training.datagen.scenes.room import bars, wall

SIZE = (5.2, 2.8, 6.0)


def flat(*rgb: float) -> np.ndarray:
    return np.full((1, 1, 3), rgb, np.float32)


def sample_room() -> Description:
    """A window-lit living room with a lamp and a turning copper wheel."""
    rng = np.random.default_rng(20)
    d = Description("sample-room")
    w, h, depth = SIZE
    floor = d.material(Material("roughplastic", textures.wood(rng, 512), 0.06))
    white = d.material(Material("diffuse", flat(0.75, 0.73, 0.7)))
    blue = d.material(Material("diffuse", flat(0.12, 0.22, 0.3)))
    d.add(meshes.quad([-w / 2, 0, depth / 2], [w, 0, 0], [0, 0, -depth]).scaled_uvs(0.5), floor)
    d.add(meshes.quad([-w / 2, h, -depth / 2], [w, 0, 0], [0, 0, depth]), white)
    corners = np.array([[-w / 2, 0, -depth / 2], [w / 2, 0, -depth / 2], [w / 2, 0, depth / 2], [-w / 2, 0, depth / 2]])
    window = (0.25, 0.75, 0.7, 2.3)
    for side, material in enumerate((blue, white, white, white)):
        low, edge = corners[side], corners[(side + 1) % 4] - corners[side]
        for part in wall(low, edge, h, [window] if side in (1, 3) else []):
            d.add(part, material)
        for bar in bars(low, edge, window, 3) if side in (1, 3) else []:
            d.add(bar, white)
    d.environment, d.environment_turn, d.environment_gain = sky(np.random.default_rng(5)), 200.0, 12.0
    _furnish(d, rng, white, blue)
    return d


def _furnish(d: Description, rng: np.random.Generator, white: int, blue: int) -> None:
    wood = d.material(Material("roughplastic", textures.wood(rng), 0.09))
    red = d.material(Material("roughplastic", flat(0.5, 0.06, 0.04), 0.04))
    weave = d.material(Material("diffuse", textures.texture(np.random.default_rng(11), flat=0)))
    leaf = d.material(Material("diffuse", flat(0.1, 0.28, 0.06)))
    pot = d.material(Material("roughplastic", flat(0.8, 0.8, 0.78), 0.02))
    black = d.material(Material("roughplastic", flat(0.03, 0.03, 0.035), 0.05))
    eta, k = METALS["copper"]
    copper = d.material(Material("roughconductor", alpha=0.06, eta=eta, k=k))
    table = furniture.table(rng)
    top = max(mesh.vertices[:, 1].max() for mesh, _ in table)
    things = [
        (lambda _: table, (0.1, 0, -0.9), 0.0, dict(main=wood, second=black)),
        (furniture.chair, (-0.9, 0, -0.5), 0.9, dict(main=wood, second=black)),
        (furniture.chair, (1.3, 0, -1.3), -2.2, dict(main=red, second=black)),
        (furniture.shelf, (-1.5, 0, -2.75), 0.0, dict(main=white, second=red, third=weave, leaf=blue)),
        (furniture.plant, (1.9, 0, -2.2), 0.3, dict(second=pot, leaf=leaf, third=wood)),
        (furniture.crate, (-2.1, 0, 0.2), 0.2, dict(main=weave)),
        (furniture.stack, (-1.15, 0, 0.35), 0.4, dict(main=wood, second=red, third=weave)),
    ]
    for make, place, turn, slots in things:
        for mesh, slot in make(rng):
            d.add(mesh.transformed(translation(*place) @ rotation(furniture.Y, turn)), slots[slot])
    for mesh, _ in furniture.vase(np.random.default_rng(2)):
        d.add(mesh.transformed(translation(0.35, top, -0.95)), pot)
    lamp = meshes.sphere(0.11, 24).transformed(translation(-0.3, top + 0.12, -1.0))
    d.emit(lamp, np.array([60.0, 44.0, 24.0]))
    d.movers.append(object_path(np.array([0.85, 0.42, 0.2]), np.array([0.012, 0, 0.0]), np.array([0, 0.2, 1.0]), -0.06))
    wheel = furniture.wheel(np.random.default_rng(1))
    hub = 0.5 * max(mesh.vertices[:, 1].max() for mesh, _ in wheel)
    for mesh, slot in wheel:
        d.add(mesh.transformed(translation(0, -hub, 0)), copper if slot == "main" else black, 0)
    for x, seed in ((0.2, 3), (1.1, 8)):
        art = d.material(Material("diffuse", textures.picture(np.random.default_rng(seed))))
        d.add(meshes.box([x - 0.36, 1.2, -3.0], [x + 0.36, 2.0, -2.97]), black)
        canvas = meshes.quad([x - 0.31, 1.25, -2.965], [0.62, 0, 0], [0, 0.7, 0])
        d.add(meshes.Mesh(canvas.vertices, canvas.normals, canvas.uvs / [0.62, 0.7], canvas.faces), art)


def sample_camera(frame: float) -> Camera:
    """A slow truck to the right with a slight turn."""
    eye = np.array([-0.5 + 0.03 * frame, 1.35, 2.75 - 0.01 * frame])
    return Camera(look_at(eye, np.array([0.1 + 0.012 * frame, 0.8, -1.0])), 66.0)
