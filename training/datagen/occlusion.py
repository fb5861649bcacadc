"""Views of scenes with ray-traced ambient occlusion, to train on and to measure by.

DRJIT_LIBLLVM_PATH=libLLVM.so.19 python -m training.datagen.occlusion SCENES OUT [--views 8]
[--held-out]

SCENES is a folder of converted scenes (`training.datagen.scenes.convert`), or the word `drafts` for
`--drafts` scenes that the factory makes itself (`training.datagen.scenes.procedural`). Each view
becomes a file: normals in camera space (x to the right, y up, z to the camera) and depth along the
camera's axis at pixel centres, and for some radii the share of a cosine-weighted hemisphere in
which nothing is nearer than the radius. `HELD_OUT` names the scenes that are never trained on;
`--held-out` renders those, at the radii `RADII`. Others have radii at random. `--rounds` renders
scenes again, stretched along their axes; `--mixes` puts several scenes on a floor, as large as
things.
"""

from __future__ import annotations

import argparse
import json
import zlib
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from training.datagen.scenes.build import _posed
from training.datagen.scenes.convert import draw_view
from training.datagen.scenes.draft import View
from training.datagen.scenes.lights import Environments
from training.datagen.scenes.meshes import merge
from training.datagen.scenes.procedural import draft
from training.datagen.variant import use_variant

HELD_OUT = ("bathroom", "flight-helmet", "hospital", "kaykit-dungeon", "small-house")
RADII = 0.06, 0.125, 0.25
"""Radii in parts of the median depth."""
LEARNT, LEARNT_RADII = 5, (0.045, 0.33)
"""How many radii a view to learn from has, and the least and largest."""
SMALL = 120_000
"""Triangles of a scene that becomes a thing, at most."""
Part = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Vertices, normals and faces."""
EMPTY = 1e6
"""Depth where there is no surface, in radii or scene units."""
TOGETHER = 16
"""Rays of a pixel that are traced in one go."""
LATTICE = 0.7548776662466927, 0.5698402909980532


class Scene:
    """The triangles of a converted scene, stretched along its axes.

    Attributes:
        facts: of its scene.json, places stretched.
        parts: its meshes, without the ground.
    """

    def __init__(self, folder: Path, stretch: np.ndarray = np.ones(3)) -> None:  # noqa: B008
        facts = json.loads((folder / "scene.json").read_text())
        self.low, self.high = (np.array(facts[key]) * stretch for key in ("low", "high"))
        self.facts = facts | {"low": self.low, "high": self.high,
                              "inner": np.array(facts["inner"]) * stretch,
                              "cameras": [{key: np.array(place) * stretch
                                           for key, place in camera.items()}
                                          for camera in facts["cameras"]]}
        with np.load(folder / "geometry.npz") as file:
            self.parts = [stretched(
                (file[f"v{k}"], file[f"n{k}"].astype(np.float32) / 127, file[f"f{k}"]), stretch
            ) for k in range(len(facts["shapes"]))]
        has_ground = facts["around"] and not facts["indoor"]
        middle, size = (self.low + self.high) / 2, 4 * np.linalg.norm(self.high - self.low)
        ground = ([_ground(np.array([middle[0], self.low[1], middle[2]]), float(size))]
                  if has_ground else [])
        self.scene = load(self.parts + ground)


def stretched(part: Part, by: np.ndarray) -> Part:
    """A mesh whose axes are longer by these factors."""
    vertices, normals, faces = part
    turned = normals / by
    return (vertices * by, turned / np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-9),
            faces)


def _ground(middle: np.ndarray, size: float) -> Part:
    corners = np.array([[-1, 0, -1], [-1, 0, 1], [1, 0, 1], [1, 0, -1]]) * size + middle
    return corners, np.tile([[0.0, 1.0, 0.0]], (4, 1)), np.array([[0, 1, 2], [0, 2, 3]])


def load(parts: Sequence[Part]) -> mi.Scene:
    """Mitsuba's scene of some meshes."""
    return mi.load_dict({"type": "scene",
                         **{f"m{k}": _mesh(f"m{k}", *part) for k, part in enumerate(parts)}})


def mix(scenes: Sequence[Scene], random: np.random.Generator) -> mi.Scene:
    """Two to eight scenes as things on a floor, at most 2 wide, and up to two walls and a ceiling
    around them."""
    parts = [_ground(np.zeros(3), 30.0)]
    for pick in random.integers(len(scenes), size=random.integers(2, 9)):
        scene = scenes[pick]
        span, turn = scene.high - scene.low, random.uniform(0, 2 * np.pi)
        matrix = np.array([[np.cos(turn), 0, -np.sin(turn)], [0, 1, 0],
                           [np.sin(turn), 0, np.cos(turn)]])
        if random.random() < 0.25:  # fallen over
            matrix = matrix @ np.linalg.qr(random.normal(size=(3, 3)))[0]
        size = np.exp(random.uniform(-1.0, 0.7)) / span.max()
        by = np.exp(random.uniform(-0.3, 0.3, 3))
        things = [stretched(((v - scene.low - span * [0.5, 0, 0.5]) * size @ matrix, n @ matrix, f),
                            by)
                  for v, n, f in scene.parts]
        low = min(v[:, 1].min() for v, *_ in things) if random.random() < 0.85 else 0.0
        place = np.array([random.uniform(-1.2, 1.2), -low, random.uniform(-1.2, 1.2)])
        parts += [(v + place, n, f) for v, n, f in things]
    for kind in range(random.choice([0, 1, 2, 3], p=[0.4, 0.2, 0.3, 0.1])):
        far = random.uniform(1.0, 2.0)
        high = random.uniform(1.0, 3.0)
        faces = np.array([[0, 1, 2], [0, 2, 3]])
        corners = np.array([[-4, 0, -far], [4, 0, -far], [4, high, -far], [-4, high, -far]])
        if kind == 1:
            corners = corners[:, ::-1]
        if kind == 2:
            corners = np.array([[-4, high, -4], [4, high, -4], [4, high, 4], [-4, high, 4]])
        facing = np.array([(0, 0, 1), (1, 0, 0), (0, -1, 0)][kind], np.float64)
        parts.append((corners, np.tile(facing, (4, 1)), faces))
    return load(parts)


def view_of_mix(random: np.random.Generator) -> View:
    """A pose around the things of a mix."""
    target, angle = random.uniform((-1, 0, -1), (1, 0.6, 1)), random.uniform(0, 2 * np.pi)
    way = np.array([np.cos(angle), random.uniform(0.05, 0.9), np.sin(angle)])
    return target + random.uniform(0.4, 2.5) * way, target


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


def render(scene: mi.Scene, eye: np.ndarray, target: np.ndarray, tangent: float,
           size: tuple[int, int], rays: int, seed: int, most_open: float = 0.88,
           shares: Sequence[float] | np.ndarray = RADII) -> dict[str, np.ndarray] | None:
    """One view, None if it shows too little; `tangent` is that of half the horizontal field of
    view, `most_open` the mean visibility at the largest radius from which on a view shows too
    little, `shares` the radii over the median depth, the largest last."""
    width, height = size
    axes = camera_axes(eye, target)
    x, y = np.meshgrid((np.arange(width) + 0.5) / width * 2 - 1,
                       1 - (np.arange(height) + 0.5) / height * 2)
    local = np.stack([x * tangent, y * tangent * height / width, -np.ones_like(x)],
                     -1).reshape(-1, 3)
    ways = local @ axes
    lengths = np.linalg.norm(ways, axis=1)
    ray = mi.Ray3f(mi.Point3f(*map(float, eye)),
                   mi.Vector3f((ways / lengths[:, None]).T.astype(np.float32)))
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
    radii = np.array(shares) * median
    if np.mean(_visible(scene, found, face, normal, radii, 32, seed)[-1, hit]) > most_open:
        return None
    open_ = _visible(scene, found, face, normal, radii, rays, seed)
    world = np.array(normal).T
    return {"normal": np.where(hit[:, None], world @ axes.T, 0).reshape(height, width, 3)
                      .astype(np.float16), "depth": depth.reshape(height, width).astype(np.float32),
            "visible": np.where(hit, open_, 1).reshape(len(radii), height, width)
                       .astype(np.float16),
            "radii": radii.astype(np.float32), "tangent": np.float32(tangent)}


def _visible(scene: mi.Scene, found: mi.SurfaceInteraction3f, face: mi.Normal3f,
             normal: mi.Normal3f, radii: np.ndarray, rays: int, seed: int) -> np.ndarray:
    """Shares (radii, pixels) of cosine-weighted rays that are longer than each radius; rays below
    the face of the triangle do not count."""
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
    # a lattice (R2, Roberts 2018), shifted from pixel to pixel
    for first in range(0, rays, TOGETHER):
        u, v = (value + (dr.opaque(mi.Float, first * share % 1) + within * share)
                for value, share in zip(
                    (dr.gather(mi.Float, turns[0], index), dr.gather(mi.Float, turns[1], index)),
                    LATTICE, strict=True))
        local = mi.warp.square_to_cosine_hemisphere(mi.Point2f(u - dr.floor(u), v - dr.floor(v)))
        way = mi.Frame3f(along).to_world(local)
        above = hit & (dr.dot(way, side) > 1e-4)
        hits = scene.ray_intersect_preliminary(mi.Ray3f(origin, way, longest, 0.0, []),
                                               active=above)
        distance = dr.select(hits.is_valid(), hits.t, dr.inf)
        longer = [above & (distance > dr.opaque(mi.Float, float(radius))) for radius in radii]
        sums = [dr.block_sum(dr.select(counted, 1.0, 0.0), TOGETHER)
                for counted in (above, *longer)]
        dr.eval(sums)
        known += np.array(sums[0])
        clear += np.stack([np.array(one) for one in sums[1:]])
    return clear / np.maximum(known, 1)


def draw_shares(random: np.random.Generator) -> np.ndarray:
    """Radii over the median depth to learn from, one in each of as many equal ratios."""
    low, high = LEARNT_RADII
    return low * (high / low) ** ((np.arange(LEARNT) + random.random(LEARNT)) / LEARNT)


def scenes_of(args: argparse.Namespace) -> Iterator[tuple[str, mi.Scene,
                                                          Callable[[np.random.Generator], View]]]:
    """Name, triangles, and how to draw a view, of every scene that is asked for."""
    if args.scenes.name == "drafts":
        for seed in range(args.first, args.first + args.drafts):
            made = draft(np.random.default_rng((7, seed)), Environments(None))
            whole = merge([_posed(part.mesh, part, made.description, 0.0)
                           for part in made.description.parts])
            yield f"draft-{seed}", load([(whole.vertices, whole.normals, whole.faces)]), made.view
        return
    folders = [path.parent for path in sorted(args.scenes.glob("*/scene.json"))]
    folders = [folder for folder in folders if (folder.name in HELD_OUT) == args.held_out]
    things = [scene for scene in map(Scene, folders if args.mixes else []) if scene.facts["around"]
              and sum(len(faces) for *_, faces in scene.parts) < SMALL]
    for seed in range(args.first, args.first + args.mixes):
        yield f"mix-{seed}", mix(things, np.random.default_rng((8, seed))), view_of_mix
    for turn in range(args.rounds if not args.mixes else 0):
        for folder in folders:
            random = np.random.default_rng((9, turn, zlib.crc32(folder.name.encode())))
            scene = Scene(folder, np.exp(random.uniform(-0.3, 0.3, 3)) if turn else np.ones(3))
            yield (f"{folder.name}.{turn}" if turn else folder.name, scene.scene,
                   partial(draw_view, scene.facts, own=0.5, shift=0.1, inside=0.1))


def options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--views", type=int, default=8, help="of each scene")
    parser.add_argument("--size", type=int, nargs=2, default=(192, 128))
    parser.add_argument("--rays", type=int, default=256)
    parser.add_argument("--held-out", action="store_true")
    parser.add_argument("--rounds", type=int, default=1,
                        help="over the scenes, stretched from the second on")
    parser.add_argument("--mixes", type=int, default=0, help="of scenes, instead of them")
    parser.add_argument("--drafts", type=int, default=400, help="scenes that are made")
    parser.add_argument("--first", type=int, default=0,
                        help="number of the first mix or made scene")
    parser.add_argument("--variant", default="llvm_ad_rgb", help="of Mitsuba: cuda_ad_rgb on a GPU")
    parser.add_argument("--threads", type=int, default=1)
    return parser


def main() -> None:
    args = options().parse_args()
    use_variant(args.variant)
    dr.set_thread_count(args.threads)
    args.out.mkdir(parents=True, exist_ok=True)
    for name, scene, draw in scenes_of(args):
        random, made = np.random.default_rng(zlib.crc32(name.encode())), 0
        for attempt in range(12 * args.views):
            path = args.out / f"{name}.{made}.npz"
            eye, target = draw(random)
            tangent = np.tan(np.radians(random.uniform(35, 80)) / 2)
            view = render(scene, eye, target, tangent, args.size, args.rays, attempt,
                          shares=RADII if args.held_out else draw_shares(random))
            if view is not None:
                arrays: dict[str, Any] = view
                np.savez_compressed(path, **arrays)
                made += 1
            if made == args.views:
                break
        print(f"{name}: {made} views", flush=True)


if __name__ == "__main__":
    main()
