"""Primary surface replacement: through mirrors and glass to the surface that is seen in them."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from training.scenes.build import FOLLOW, ROW
from training.scenes.moved import Motions

FLAT = 1e-3  # change of the normal along the texture coordinates below which a mirror counts as flat


@dataclass
class Image:
    """An affine map of world space, rows (3) and offset: from where things are to where a flat mirror shows them."""

    x: mi.Vector3f
    y: mi.Vector3f
    z: mi.Vector3f
    offset: mi.Vector3f

    def linear(self, v: mi.Vector3f) -> mi.Vector3f:
        return mi.Vector3f(dr.dot(self.x, v), dr.dot(self.y, v), dr.dot(self.z, v))

    def point(self, p: mi.Point3f) -> mi.Vector3f:
        return self.linear(mi.Vector3f(p)) + self.offset

    def mirrored(self, p: mi.Point3f, n: mi.Vector3f, mirror: mi.Bool) -> Image:
        """After one more mirror, a plane through `p` with unit normal `n`."""
        n = dr.select(mirror, mi.Vector3f(n), 0)
        distance = dr.dot(mi.Vector3f(p), n)
        along = self.linear(n)
        rows = [row - 2 * dr.dot(row, n) * n for row in (self.x, self.y, self.z)]
        return Image(*rows, self.offset + 2 * distance * along)


@dataclass
class Path:
    """What a camera ray has become: the ray to the replaced surface and how that surface is seen.

    `tint` is the reflectance so far, `length` the way to the ray's origin, `now` and `before` the images in this frame
    and in the previous one; `curved` tells of bent mirrors, whose images are not mapped: there `surface`, the previous
    place of the first hit, leads.
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


def follow(scene: mi.Scene, ray: mi.RayDifferential3f, properties: mi.Float, motions: Motions, steps: int) -> Path:
    """Follow rays through at most `steps` mirrors and faces of glass; 0 leaves them as they are, in the same kernel."""
    count = dr.width(ray.d)
    steps_left = dr.full(mi.UInt32, 0, count) + dr.opaque(mi.UInt32, steps)
    start = Path(mi.Point3f(ray.o) + dr.zeros(mi.Point3f, count), mi.Vector3f(ray.d), dr.ones(mi.Color3f, count),
                 dr.zeros(mi.Float, count), _identity(count), _identity(count), dr.full(mi.Bool, False, count),
                 dr.zeros(mi.Point3f, count), steps_left, steps_left > 0)
    return dr.while_loop((start,), lambda path: path.active, lambda path: (_step(scene, path, properties, motions),),
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
    moved, turned = motions.point(row, found, si.p), dr.normalize(motions.vector(row, mi.Vector3f(normal)))
    first = on & (path.length == 0)
    steps = dr.select(on, path.steps - 1, path.steps)
    return Path(
        dr.select(on, onward.o, path.origin), dr.select(on, onward.d, path.direction),
        dr.select(on, path.tint * tint, path.tint), path.length + dr.select(on, si.t, 0),
        path.now.mirrored(si.p, normal, mirror), path.before.mirrored(moved, turned, mirror), path.curved | bent,
        dr.select(first, moved, path.surface), steps, on & (steps > 0))


def _identity(count: int) -> Image:
    one, zero = dr.ones(mi.Float, count), dr.zeros(mi.Float, count)
    return Image(mi.Vector3f(one, zero, zero), mi.Vector3f(zero, one, zero), mi.Vector3f(zero, zero, one),
                 dr.zeros(mi.Vector3f, count))
