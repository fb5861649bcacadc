"""Views of scenes with ray-traced ambient occlusion, to train on and to measure by.

DRJIT_LIBLLVM_PATH=libLLVM.so.19 python -m training.datagen.occlusion SCENES OUT [--views 8] [--held-out]

SCENES is a folder of converted scenes (`training.datagen.scenes.convert`), or the word `drafts` for `--drafts` scenes
that the factory makes itself (`training.datagen.scenes.procedural`). Each view becomes a file: normals in camera
space (x to the right, y up, z to the camera) and depth along the camera's axis at pixel centres, and for three radii
the share of a cosine-weighted hemisphere in which nothing is nearer than the radius. `HELD_OUT` names the scenes that
are never trained on; `--held-out` renders those, with more rays.
"""

from __future__ import annotations

import argparse
import json
import zlib
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

from training.datagen.scenes.build import _posed
from training.datagen.scenes.convert import draw_view
from training.datagen.scenes.draft import View
from training.datagen.scenes.lights import Environments
from training.datagen.scenes.meshes import merge
from training.datagen.scenes.procedural import draft

HELD_OUT = ("bathroom", "flight-helmet", "hospital", "kaykit-dungeon", "small-house")
RADII = 0.06, 0.125, 0.25
"""Of the median depth."""
EMPTY = 1e6
"""Depth where there is no surface, in radii or scene units."""
TOGETHER = 16
"""Rays of a pixel that are traced in one go."""
LATTICE = 0.7548776662466927, 0.5698402909980532


class Scene:
    """The triangles of a converted scene."""

    def __init__(self, folder: Path) -> None:
        self.facts = json.loads((folder / "scene.json").read_text())
        self.low, self.high = (np.array(self.facts[key]) for key in ("low", "high"))
        shapes: dict[str, object] = {}
        with np.load(folder / "geometry.npz") as file:
            for index in range(len(self.facts["shapes"])):
                vertices, normals, faces = (file[f"{letter}{index}"] for letter in "vnf")
                shapes[f"shape{index}"] = _mesh(f"shape{index}", vertices, normals.astype(np.float32) / 127, faces)
        if self.facts["around"] and not self.facts["indoor"]:
            shapes["ground"] = self._ground()
        self.scene = mi.load_dict({"type": "scene", **shapes})

    def _ground(self) -> mi.Mesh:
        middle, size = (self.low + self.high) / 2, 4 * np.linalg.norm(self.high - self.low)
        corners = np.array([[-1, 0, -1], [-1, 0, 1], [1, 0, 1], [1, 0, -1]]) * size
        corners += [middle[0], self.low[1], middle[2]]
        faces = np.array([[0, 1, 2], [0, 2, 3]], np.uint32)
        return _mesh("ground", corners.astype(np.float32), np.tile(np.float32([[0, 1, 0]]), (4, 1)), faces)


def _mesh(name: str, vertices: np.ndarray, normals: np.ndarray, faces: np.ndarray) -> mi.Mesh:
    mesh = mi.Mesh(name, len(vertices), len(faces), has_vertex_normals=True)
    params = mi.traverse(mesh)
    params["vertex_positions"] = vertices.astype(np.float32).ravel()
    params["vertex_normals"] = normals.astype(np.float32).ravel()
    params["faces"] = faces.astype(np.uint32).ravel()
    params.update()
    return mesh


def camera_axes(eye: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Rows to the right, up and backwards of a camera that looks at a target."""
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross([0.0, 1.0, 0.0], back)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(back, right), back])


def render(scene: mi.Scene, eye: np.ndarray, target: np.ndarray, tangent: float, size: tuple[int, int], rays: int,
           seed: int, most_open: float = 0.88) -> dict[str, np.ndarray] | None:
    """One view, None if it shows too little; `tangent` is that of half the horizontal field of view, `most_open` the
    mean visibility at the largest radius from which on a view shows too little."""
    width, height = size
    axes = camera_axes(eye, target)
    x, y = np.meshgrid((np.arange(width) + 0.5) / width * 2 - 1, 1 - (np.arange(height) + 0.5) / height * 2)
    local = np.stack([x * tangent, y * tangent * height / width, -np.ones_like(x)], -1).reshape(-1, 3)
    ways = local @ axes
    lengths = np.linalg.norm(ways, axis=1)
    ray = mi.Ray3f(mi.Point3f(*map(float, eye)), mi.Vector3f((ways / lengths[:, None]).T.astype(np.float32)))
    found = scene.ray_intersect(ray)
    hit = np.array(found.is_valid())
    depth = np.where(hit, np.array(found.t) / lengths, EMPTY)
    if hit.mean() < 0.6:
        return None
    median = np.median(depth[hit])
    if np.percentile(depth[hit], 4) < 0.08 * median:
        return None
    face = dr.select(dr.dot(found.n, ray.d) > 0, -found.n, found.n)
    normal = dr.select(dr.dot(found.sh_frame.n, face) > 0, found.sh_frame.n, -found.sh_frame.n)
    radii = np.array(RADII) * median
    if np.mean(_visible(scene, found, face, normal, radii, 32, seed)[-1, hit]) > most_open:
        return None
    open_ = _visible(scene, found, face, normal, radii, rays, seed)
    world = np.array(normal).T
    return {"normal": np.where(hit[:, None], world @ axes.T, 0).reshape(height, width, 3).astype(np.float16),
            "depth": depth.reshape(height, width).astype(np.float32),
            "visible": np.where(hit, open_, 1).reshape(3, height, width).astype(np.float16),
            "radii": radii.astype(np.float32), "tangent": np.float32(tangent)}


def _visible(scene: mi.Scene, found: mi.SurfaceInteraction3f, face: mi.Normal3f, normal: mi.Normal3f,
             radii: np.ndarray, rays: int, seed: int) -> np.ndarray:
    """Shares (radii, pixels) of cosine-weighted rays that are longer than each radius; rays below the face of the
    triangle do not count."""
    count, random = dr.width(found.t), np.random.default_rng(seed)
    index = dr.repeat(dr.arange(mi.UInt32, count), TOGETHER)
    turns = [mi.Float(random.random(count).astype(np.float32)) for _ in range(2)]
    longest = dr.opaque(mi.Float, float(radii[-1]))
    start = mi.Point3f(found.p + face * (1e-4 * longest))
    dr.eval(start, face, normal)
    origin, side, along = (dr.gather(kind, value, index) for kind, value in
                           ((mi.Point3f, start), (mi.Normal3f, face), (mi.Normal3f, normal)))
    hit = dr.gather(mi.Bool, found.is_valid(), index)
    clear, known = np.zeros((len(radii), count)), np.zeros(count)
    within = mi.Float(dr.tile(dr.arange(mi.UInt32, TOGETHER), count))
    for first in range(0, rays, TOGETHER):  # a lattice (R2, Roberts 2018), shifted from pixel to pixel
        u, v = (value + (dr.opaque(mi.Float, first * share % 1) + within * share) for value, share in zip(
            (dr.gather(mi.Float, turns[0], index), dr.gather(mi.Float, turns[1], index)), LATTICE, strict=True))
        local = mi.warp.square_to_cosine_hemisphere(mi.Point2f(u - dr.floor(u), v - dr.floor(v)))
        way = mi.Frame3f(along).to_world(local)
        above = hit & (dr.dot(way, side) > 1e-4)
        hits = scene.ray_intersect_preliminary(mi.Ray3f(origin, way, longest, 0.0, []), active=above)
        distance = dr.select(hits.is_valid(), hits.t, dr.inf)
        longer = [above & (distance > dr.opaque(mi.Float, float(radius))) for radius in radii]
        sums = [dr.block_sum(dr.select(counted, 1.0, 0.0), TOGETHER) for counted in (above, *longer)]
        dr.eval(sums)
        known += np.array(sums[0])
        clear += np.stack([np.array(one) for one in sums[1:]])
    return clear / np.maximum(known, 1)


def scenes_of(args: argparse.Namespace) -> Iterator[tuple[str, mi.Scene, Callable[[np.random.Generator], View]]]:
    """Name, triangles, and how to draw a view, of every scene that is asked for."""
    if args.scenes.name == "drafts":
        for seed in range(args.first, args.first + args.drafts):
            made = draft(np.random.default_rng((7, seed)), Environments(None))
            whole = merge([_posed(part.mesh, part, made.description, 0.0) for part in made.description.parts])
            mesh = _mesh("draft", whole.vertices, whole.normals, whole.faces)
            yield f"draft-{seed}", mi.load_dict({"type": "scene", "draft": mesh}), made.view
        return
    for folder in sorted(path.parent for path in args.scenes.glob("*/scene.json")):
        if (folder.name in HELD_OUT) == args.held_out:
            scene = Scene(folder)
            yield folder.name, scene.scene, partial(draw_view, scene.facts, own=0.5, shift=0.1, inside=0.1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--views", type=int, default=8, help="of each scene")
    parser.add_argument("--size", type=int, nargs=2, default=(192, 128))
    parser.add_argument("--rays", type=int, default=256)
    parser.add_argument("--held-out", action="store_true")
    parser.add_argument("--drafts", type=int, default=400, help="scenes that are made")
    parser.add_argument("--first", type=int, default=0, help="number of the first of these")
    parser.add_argument("--variant", default="llvm_ad_rgb", help="of Mitsuba: cuda_ad_rgb on a GPU")
    parser.add_argument("--threads", type=int, default=1)
    args = parser.parse_args()
    mi.set_variant(args.variant)
    dr.set_thread_count(args.threads)
    args.out.mkdir(parents=True, exist_ok=True)
    for name, scene, draw in scenes_of(args):
        random, made = np.random.default_rng(zlib.crc32(name.encode())), 0
        for attempt in range(12 * args.views):
            path = args.out / f"{name}.{made}.npz"
            eye, target = draw(random)
            view = render(scene, eye, target, np.tan(np.radians(random.uniform(35, 80)) / 2), args.size, args.rays,
                          attempt)
            if view is not None:
                np.savez_compressed(path, **view)
                made += 1
            if made == args.views:
                break
        print(f"{name}: {made} views", flush=True)


if __name__ == "__main__":
    main()
