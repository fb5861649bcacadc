"""Light paths and first-hit planes of a built scene, through any sub-pixel positions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from training.datagen.scenes.build import FOLLOW, ROW, BuiltScene, Motions, anchors
from training.datagen.scenes.materials import palette
from training.datagen.scenes.motion import Camera

# Paths of light -----------------------------------------------------------------------------------
# Primary surface replacement: through mirrors and glass to the surface seen in them.

FLAT = 1e-3  # a mirror whose normal changes less than this along the texture coordinates is flat


@dataclass
class Image:
    """An affine map of world space, rows (3) and offset: from an object to its image in a flat
    mirror."""

    x: mi.Vector3f
    y: mi.Vector3f
    z: mi.Vector3f
    offset: mi.Vector3f

    def linear(self, v: mi.Vector3f) -> mi.Vector3f:
        return mi.Vector3f(dr.dot(self.x, v), dr.dot(self.y, v), dr.dot(self.z, v))

    def point(self, p: mi.Point3f) -> mi.Vector3f:
        return self.linear(mi.Vector3f(p)) + self.offset

    def mirror(self, p: mi.Point3f, n: mi.Vector3f, mirror: mi.Bool) -> Image:
        """The map after one more mirror, a plane through `p` with unit normal `n`."""
        n = dr.select(mirror, mi.Vector3f(n), 0)
        distance = dr.dot(mi.Vector3f(p), n)
        along = self.linear(n)
        x, y, z = (row - 2 * dr.dot(row, n) * n for row in (self.x, self.y, self.z))
        return Image(x, y, z, self.offset + 2 * distance * along)


@dataclass
class Path:
    """A camera ray after mirrors and glass: the ray to the replaced surface, and how that surface
    appears.

    `tint` is the reflectance so far, `length` the way to the ray's origin, `now` and `before` the
    images in this frame and in the previous one. No affine map describes the image in a bent
    mirror: where `curved` is set, motion comes from `surface`, the previous position of the first
    hit.
    """

    origin: mi.Point3f
    direction: mi.Vector3f
    tint: mi.Color3f
    length: mi.Float
    now: Image
    before: Image
    curved: mi.Bool
    surface: mi.Point3f
    steps: mi.UInt32
    active: mi.Bool


def follow(scene: mi.Scene, ray: mi.RayDifferential3f, properties: mi.Float, motions: Motions,
           steps: int) -> Path:
    """Follow rays through at most `steps` mirrors and faces of glass; 0 leaves them as they are, in
    the same kernel."""
    count = dr.width(ray.d)
    steps_left = dr.full(mi.UInt32, 0, count) + dr.opaque(mi.UInt32, steps)
    start = Path(mi.Point3f(ray.o) + dr.zeros(mi.Point3f, count), mi.Vector3f(ray.d),
                 dr.ones(mi.Color3f, count), dr.zeros(mi.Float, count), _identity(count),
                 _identity(count), dr.full(mi.Bool, False, count),
                 dr.zeros(mi.Point3f, count), steps_left, steps_left > 0)
    return dr.while_loop((start,), lambda path: path.active,
                         lambda path: (_step(scene, path, properties, motions),),
                         labels=("path",))[0]


def _step(scene: mi.Scene, path: Path, properties: mi.Float, motions: Motions) -> Path:
    ray = mi.Ray3f(path.origin, path.direction)
    found = scene.ray_intersect_preliminary(ray, False, path.active)
    si = found.compute_surface_interaction(ray, mi.RayFlags.All | mi.RayFlags.dNSdUV, path.active)
    hit = path.active & si.is_valid()
    row = dr.select(hit, dr.reinterpret_array(mi.UInt32, si.shape), 0)
    kind = dr.gather(mi.Float, properties, row * ROW + FOLLOW, hit)
    f0 = mi.Color3f(*(dr.gather(mi.Float, properties, row * ROW + k, hit) for k in range(3)))
    on = hit & (kind != 0)
    cosine = mi.Frame3f.cos_theta(si.wi)
    reflectance, cosine_t, _, eta_ti = mi.fresnel(cosine, dr.maximum(kind, 1))
    through = on & (kind > 0) & (reflectance < 0.5)
    metal = f0 + (1 - f0) * (1 - dr.abs(cosine)) ** 5
    tint = dr.select(kind < 0, metal, dr.select(through, 1 - reflectance, reflectance))
    local = dr.select(through, mi.refract(si.wi, cosine_t, eta_ti), mi.reflect(si.wi))
    onward = si.spawn_ray(si.to_world(local))
    mirror, normal = on & ~through, si.sh_frame.n
    bent = on & (dr.norm(si.dn_du) + dr.norm(si.dn_dv) > FLAT)
    moved = motions.point(row, found, si.p)
    turned = dr.normalize(motions.vector(row, mi.Vector3f(normal)))
    first = on & (path.length == 0)
    steps = dr.select(on, path.steps - 1, path.steps)
    return Path(
        dr.select(on, onward.o, path.origin), dr.select(on, onward.d, path.direction),
        dr.select(on, path.tint * tint, path.tint), path.length + dr.select(on, si.t, 0),
        path.now.mirror(si.p, normal, mirror), path.before.mirror(moved, turned, mirror),
        path.curved | bent, dr.select(first, moved, path.surface), steps, on & (steps > 0))


def _identity(count: int) -> Image:
    one, zero = dr.ones(mi.Float, count), dr.zeros(mi.Float, count)
    return Image(mi.Vector3f(one, zero, zero), mi.Vector3f(zero, one, zero),
                 mi.Vector3f(zero, zero, one), dr.zeros(mi.Vector3f, count))


# The tracer ---------------------------------------------------------------------------------------

MISS_DEPTH = 1e10


@dataclass(frozen=True)
class Film:
    """Sample positions as fractions of the image, (N,) each: u to the right, v down; and on a lens,
    as two uniform random numbers (None: its centre)."""

    u: mi.Float
    v: mi.Float
    lens: mi.Point2f | None = None

    def first(self, spp: int) -> Film:
        """The first of every `spp` consecutive samples."""
        return Film(_pixels(self.u, spp, False), _pixels(self.v, spp, False))


class Tracer:
    """Holds the integrator and everything that keeps kernels the same between scenes; one a
    process."""

    def __init__(self, depth: int = 6) -> None:
        self._integrator = mi.load_dict({"type": "path", "max_depth": depth})
        self._keep = [*palette(), *anchors()]

    def radiance(self, scene: mi.Scene, camera: Camera, aspect: float, film: Film,
                 seed: int) -> mi.Color3f:
        """Radiance (N samples) of independent light paths; `aspect` is width / height."""
        count = dr.width(film.u)
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(dr.opaque(mi.UInt32, seed & 0xFFFFFFFF), count)
        ray = _rays(camera, aspect, film)
        colour, _, _ = self._integrator.sample(scene, sampler, ray)
        return mi.Color3f(dr.select(dr.isfinite(colour), colour, 0))

    def noisy(self, scene: mi.Scene, camera: Camera, aspect: float, film: Film, spp: int,
              seed: int) -> np.ndarray:
        """Radiance (N, 3) float32: the mean of every `spp` consecutive samples of the film."""
        return _rows(_pixels(self.radiance(scene, camera, aspect, film, seed), spp, True))

    def reference(self, scene: mi.Scene, camera: Camera, size: tuple[int, int], table: np.ndarray,
                  spp: int, seed: int, batch: int = 1 << 25) -> np.ndarray:
        """(H, W, 3) float32 mean of `spp` samples a pixel, spread by the filter's inverse
        distribution `table`."""
        width, height = size
        total, left = np.zeros((height, width, 3), np.float32), spp
        while left:
            now = min(left, max(1, batch // (width * height)))
            film = _spread(width, height, now, table, seed + 7919 * left, bool(camera.aperture))
            colour = self.radiance(scene, camera, width / height, film, seed + 104729 * left)
            sums = [dr.block_sum(channel, now).numpy()
                    for channel in (colour.x, colour.y, colour.z)]
            total += np.stack(sums, -1).reshape(height, width, 3)
            left -= now
        return total / spp

    def planes(self, built: BuiltScene, camera: Camera, previous: Camera, size: tuple[int, int],
               film: Film, spp: int = 1, mean: tuple[str, ...] = (), steps: int = 0,
               positions: str = "") -> dict[str, np.ndarray]:
        """First-hit planes, (N,) or (N, C) float32; motion in pixels of an image of `size`.

        Every `spp` consecutive samples of the film make one of the N rows: the mean in the planes
        named by `mean`, in the others the first. With `steps`, rays go on through at most that many
        mirrors and faces of glass, and the planes show the surface behind them: its albedos times
        the reflectance on the way, its normal as mirrored, the length of the whole way as depth
        along the first ray, the motion of its mirrored image.

        Renderers that write positions average them: with `positions` "all" or "hits", depth and
        motion are those of the mean position of all samples, where misses count as 0, or of those
        that hit.
        """
        width, height = size
        first = _rays(camera, width / height, film)
        path = follow(built.scene, first, built.properties, built.motions, steps)
        ray = mi.RayDifferential3f(path.origin, path.direction)
        found = built.scene.ray_intersect_preliminary(ray, False, True)
        si = found.compute_surface_interaction(ray)
        hit = si.is_valid()
        row = dr.select(hit, dr.reinterpret_array(mi.UInt32, si.shape), 0)
        f0, coloured, diffuse, roughness, emissive = _properties(built.properties, row, hit)
        base = mi.Color3f(si.bsdf().eval_diffuse_reflectance(si, hit))
        normal = dr.select(dr.dot(si.sh_frame.n, ray.d) > 0, -si.sh_frame.n, si.sh_frame.n)
        specular = environment_brdf(f0 + coloured * base, roughness, dr.abs(dr.dot(normal, ray.d)))
        lit = hit & (emissive < 0.5)
        way = first.d * (path.length + dr.select(hit, si.t, 0))
        then = _previous_point(path, first, way, hit, si.p, built.motions.point(row, found, si.p))
        near, place = hit | path.curved, dr.select(hit, mi.Vector3f(first.o) + way, first.d)
        motion_x, motion_y = _motion(previous, (width, height), film, near, then)
        if camera.aperture:  # a blurred point is not where the pinhole in the lens would show it
            here_x, here_y = _motion(camera, (width, height), film, hit, place)
            motion_x, motion_y = motion_x - here_x, motion_y - here_y
        values = {
            "diffuse_albedo": dr.select(lit, path.tint * base * diffuse, 0),
            "specular_albedo": dr.select(lit, path.tint * specular, 0),
            "normal": dr.select(hit, path.now.linear(normal), 0),
            "roughness": dr.select(lit, roughness, 1),
            "depth": dr.select(hit, dr.dot(way, _column(camera.to_world, 2)), MISS_DEPTH),
            "motion": mi.Vector2f(motion_x, motion_y),
        }
        dr.eval(values)
        found = {name: _rows(_pixels(value, spp, name in mean)) for name, value in values.items()}
        if positions:
            places = [_rows(_pixels(dr.select(hit, value, 0), spp, True))
                      for value in (place, then)]
            cover = _rows(_pixels(dr.select(hit, mi.Float(1), mi.Float(0)), spp, True))
            found |= _mean_position(places, cover, (camera, previous), size, positions == "hits")
        return found


def _mean_position(places: list[np.ndarray], cover: np.ndarray, cameras: tuple[Camera, Camera],
                   size: tuple[int, int], hits: bool) -> dict[str, np.ndarray]:
    """Depth (N,) and motion (N, 2) of mean positions (N, 3), now and before, of pixels of which a
    share `cover` hit."""
    share = np.maximum(cover, 1e-6)[:, None] if hits else 1.0
    now, then = (place / share for place in places)
    depth = (now - cameras[0].to_world[:3, 3]) @ cameras[0].to_world[:3, 2]
    motion = cameras[1].project(then, *size) - cameras[0].project(now, *size)
    seen = (cover > 0) & (depth > 1e-4) & np.isfinite(motion).all(1)
    return {"depth": np.where(seen, depth, MISS_DEPTH).astype(np.float32),
            "motion": np.where(seen[:, None], motion, 0).astype(np.float32)}


def environment_brdf(f0: mi.Color3f, roughness: mi.Float, cosine: mi.Float) -> mi.Color3f:
    """Specular reflectance under uniform light (Karis 2014, "Physically based shading on mobile"),
    noise-free."""
    x, y = 1 - roughness, 0.0425 - 0.0275 * roughness
    z, w = 1.04 - 0.572 * roughness, -0.04 + 0.022 * roughness
    a = dr.minimum(x * x, dr.exp2(-9.28 * cosine)) * x + y
    return dr.clip(f0 * (z - 1.04 * a) + (w + 1.04 * a), 0, 1)


def _pixels(value: mi.Float, spp: int, mean: bool) -> mi.Float:
    """One value a pixel from `spp` consecutive samples: their mean or the first."""
    if spp == 1:
        return value
    if mean:
        return dr.block_sum(value, spp) / _opaque(spp)
    kept = dr.arange(mi.UInt32, dr.width(value) // spp) * dr.opaque(mi.UInt32, spp)
    return dr.gather(type(value), value, kept)


def _rows(value: mi.Float) -> np.ndarray:
    array = value.numpy()
    return array if array.ndim == 1 else np.ascontiguousarray(array.T)


def _opaque(value: float) -> mi.Float:
    return dr.opaque(mi.Float, float(value))


def _column(matrix: np.ndarray, column: int) -> mi.Vector3f:
    return mi.Vector3f(*(_opaque(matrix[i, column]) for i in range(3)))


def _rays(camera: Camera, aspect: float, film: Film) -> mi.RayDifferential3f:
    tangent = _opaque(np.tan(np.radians(camera.fov) / 2))
    x = (1 - 2 * film.u) * tangent
    y = (1 - 2 * film.v) * tangent / _opaque(aspect)
    left, up, forward, origin = (_column(camera.to_world, k) for k in range(4))
    direction = left * x + up * y + forward
    if film.lens is not None:
        place = mi.warp.square_to_uniform_disk_concentric(film.lens) * _opaque(camera.aperture)
        shift = left * place.x + up * place.y
        origin, direction = origin + shift, direction * _opaque(camera.focus) - shift
    return mi.RayDifferential3f(mi.Point3f(origin), dr.normalize(direction))


def _spread(width: int, height: int, spp: int, table: np.ndarray, seed: int,
            lens: bool = False) -> Film:
    """`spp` consecutive samples for each pixel, in row order, drawn from the filter's table;
    `lens`: all over it."""
    count = width * height * spp
    index = dr.arange(mi.UInt32, count)
    pixel = index // dr.opaque(mi.UInt32, spp)
    drawn = _uniform(index, seed)
    lookup = mi.Float(table)
    columns, rows = dr.opaque(mi.UInt32, width), dr.opaque(mi.UInt32, height)
    y = pixel // columns
    x = pixel - y * columns
    u = (mi.Float(x) + _offset(lookup, drawn[0])) / mi.Float(columns)
    v = (mi.Float(y) + _offset(lookup, drawn[1])) / mi.Float(rows)
    place = mi.Point2f(*_uniform(index, seed + 15485863)) if lens else None
    dr.eval(u, v, place)
    return Film(u, v, place)


def _uniform(index: mi.UInt32, seed: int) -> list[mi.Float]:
    """Two random numbers in [0, 1) for each index."""
    drawn = mi.sample_tea_32(index, dr.opaque(mi.UInt32, seed & 0xFFFFFFFF), 6)
    return [mi.Float(bits >> 8) * 2.0**-24 for bits in drawn]


def _offset(table: mi.Float, drawn: mi.Float) -> mi.Float:
    position = drawn * (dr.width(table) - 1)
    index = mi.UInt32(position)
    low = dr.gather(mi.Float, table, index)
    return dr.lerp(low, dr.gather(mi.Float, table, index + 1), position - mi.Float(index))


def _properties(table: mi.Float, row: mi.UInt32, active: mi.Bool) -> tuple[Any, ...]:
    value = [dr.gather(mi.Float, table, row * ROW + k, active) for k in range(7)]
    return mi.Color3f(*value[:3]), *value[3:]


def _previous_point(path: Path, first: mi.RayDifferential3f, way: mi.Vector3f, hit: mi.Bool,
                    point: mi.Point3f, moved: mi.Point3f) -> mi.Vector3f:
    """Previous position of whatever a ray shows: a point of world space, or a direction for misses.

    A surface seen in a flat mirror was seen in it before, too, so its previous position is mirrored
    by the mirror's previous position. Glass is taken to shift the objects behind it by as much as
    now. Bent mirrors and glass have their own motion.
    """
    then = path.before.point(moved)
    shift = mi.Vector3f(first.o) + way - path.now.point(point)
    far = path.before.linear(path.direction) + first.d - path.now.linear(path.direction)
    return dr.select(path.curved, mi.Vector3f(path.surface), dr.select(hit, then + shift, far))


def _motion(previous: Camera, size: tuple[int, int], film: Film, near: mi.Bool,
            place: mi.Vector3f) -> tuple[mi.Float, mi.Float]:
    """Previous minus current position in pixels, of points where `near`, else of directions."""
    left, up, forward, origin = (_column(previous.to_world, k) for k in range(4))
    tangent = _opaque(np.tan(np.radians(previous.fov) / 2))
    columns, rows = _opaque(size[0]), _opaque(size[1])
    offset = dr.select(near, place - origin, place)
    depth = dr.dot(offset, forward)
    scale = dr.select(depth > 1e-4, 0.5 * dr.rcp(depth * tangent), 0)
    x = columns * (0.5 - dr.dot(offset, left) * scale) - columns * film.u
    y = rows * 0.5 - columns * dr.dot(offset, up) * scale - rows * film.v
    seen = depth > 1e-4
    return dr.select(seen, x, 0), dr.select(seen, y, 0)
