"""A small ray caster that writes every plane postfx reads, by the helpers of postfx.integrate.

python samples/ray_caster.py [OUTPUT_FOLDER] [--frames 8] [--samples 2] [--size 240x136] \\
    [--reference FRAMES] [--reference-samples 64]

A textured ball rolls over a chequered floor between a rough copper ball and a flat mirror; the
camera moves. --reference also renders frames such as 8 at twice the size, their samples spread over
the pixel, to measure against.
"""
import argparse
import math
from pathlib import Path

import numpy as np

import postfx
from postfx import Role, integrate

MISS, FLOOR, BALL, COPPER, MIRROR = range(-1, 4)
FOV = 60.0
LIGHT, LIGHT_RADIUS, LIGHT_RADIANCE = np.array([2.0, 4.0, 1.5]), 0.8, 60.0
COPPER_BALL, COPPER_RADIUS, COPPER_ROUGHNESS = np.array([0.9, 0.5, 0.0]), 0.5, 0.35
BALL_RADIUS = 0.45
COPPER_COLOUR = np.array([0.95, 0.64, 0.54])
MIRROR_AT, MIRROR_NORMAL = np.array([0.0, 0.0, -2.0]), np.array([0.0, 0.0, 1.0])


def camera(frame: float) -> np.ndarray:
    """World to camera of a frame, (4, 4), row vectors: the camera looks along its -z, y is up."""
    eye, yaw = np.array([-0.35 + 0.05 * frame, 1.1, 3.0]), math.radians(4 - 0.8 * frame)
    back = np.array([math.sin(yaw) * 0.98, 0.2, math.cos(yaw) * 0.98])
    right = np.cross([0, 1, 0], back) / np.linalg.norm(np.cross([0, 1, 0], back))
    axes = np.stack([right, np.cross(back, right), back], axis=1)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[3, :3] = axes, -eye @ axes
    return matrix


def ball(frame: float) -> np.ndarray:
    """Object to world of the rolling ball, (4, 4), row vectors."""
    way = 0.06 * frame
    turn = -way / BALL_RADIUS
    matrix = np.eye(4)
    matrix[:2, :2] = [[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]]
    matrix[3, :3] = -0.9 + way, BALL_RADIUS, 0.4
    return matrix


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("...i,...i->...", a, b)[..., None]


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.sqrt(dot(vectors, vectors))


def reflected(rays: np.ndarray, normals: np.ndarray) -> np.ndarray:
    return rays - 2 * dot(rays, normals) * normals


def trace(eye: np.ndarray, rays: np.ndarray, frame: float) -> tuple[np.ndarray, np.ndarray]:
    """Distance along each ray (..., 1) and what is hit (...); distance infinite where nothing
    is."""
    with np.errstate(divide="ignore", invalid="ignore"):
        floor, wall = -eye[..., 1:2] / rays[..., 1:2], (MIRROR_AT[2] - eye[..., 2:]) / rays[..., 2:]
        place = eye + wall * rays
    framed = ((np.abs(place[..., :1]) < 1.3) & (place[..., 1:2] > 0.1) & (place[..., 1:2] < 1.5)
              & (rays[..., 2:] < 0))
    hits = [floor, *(sphere(eye, rays, *each) for each in spheres(frame)),
            np.where(framed, wall, np.inf)]
    hits = np.stack([np.where(hit > 1e-4, hit, np.inf) for hit in hits])
    nearest = hits.min(axis=0)
    return nearest, np.where(np.isfinite(nearest), hits.argmin(axis=0), MISS)[..., 0]


def spheres(frame: float) -> list[tuple[np.ndarray, float]]:
    return [(ball(frame)[3, :3], BALL_RADIUS), (COPPER_BALL, COPPER_RADIUS)]


def sphere(eye: np.ndarray, rays: np.ndarray, centre: np.ndarray, radius: float) -> np.ndarray:
    a, b, c = dot(rays, rays), dot(eye - centre, rays), dot(eye - centre, eye - centre) - radius**2
    with np.errstate(invalid="ignore"):
        return np.nan_to_num((-b - np.sqrt(b * b - a * c)) / a, nan=np.inf)


def surface(points: np.ndarray, ids: np.ndarray,
            frame: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normals (..., 3), base colour (..., 3) and metallic (..., 1)."""
    normals = np.where(ids[..., None] == MIRROR, MIRROR_NORMAL, [0.0, 1.0, 0.0])
    for identity, (centre, radius) in zip((BALL, COPPER), spheres(frame), strict=True):
        normals = np.where(ids[..., None] == identity, (points - centre) / radius, normals)
    own = (points - ball(frame)[3, :3]) @ np.linalg.inv(ball(frame)[:3, :3])
    stripes = np.sign(np.sin(14 * own[..., :1]) * np.sin(14 * own[..., 1:2]))
    tiles = np.sign(np.sin(6 * points[..., :1]) * np.sin(6 * points[..., 2:]))
    colour = np.where(ids[..., None] == BALL, 0.5 + stripes * [0.35, 0.2, -0.1],
                      0.45 + tiles * [0.3, 0.28, 0.25])
    metallic = (ids == COPPER)[..., None].astype(float)
    return normals, np.where(metallic > 0, COPPER_COLOUR, colour), metallic


def sky(rays: np.ndarray) -> np.ndarray:
    up = np.clip(unit(rays)[..., 1:2], 0, 1)
    return 0.8 * (1 - up) + up * np.array([0.25, 0.45, 1.0])


def on_sphere(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    return unit(rng.normal(size=(*shape, 3)))


def light_at(points: np.ndarray, normals: np.ndarray, frame: float,
             rng: np.random.Generator) -> np.ndarray:
    """Irradiance over pi (..., 3), by one ray to the lamp and one to the surroundings: this is the
    noise."""
    start = points + 1e-3 * normals
    to_lamp = LIGHT + LIGHT_RADIUS * on_sphere(rng, points.shape[:-1]) - start
    clear = trace(start, to_lamp, frame)[0] > 1
    lamp = clear * np.maximum(dot(unit(to_lamp), normals),
                              0) * LIGHT_RADIANCE / dot(to_lamp, to_lamp) / math.pi
    around = unit(normals + on_sphere(rng, points.shape[:-1]) * 0.999)
    return lamp + np.where(np.isinf(trace(start, around, frame)[0]), sky(around), 0.12)


def shaded(eye: np.ndarray, rays: np.ndarray, frame: float, rng: np.random.Generator) -> np.ndarray:
    """Radiance (..., 3) that comes along rays, mirrors and glossy surfaces once."""
    distance, ids = trace(eye, rays, frame)
    points = eye + np.where(np.isfinite(distance), distance, 0) * rays
    normals, colour, metallic = surface(points, ids, frame)
    diffuse = integrate.diffuse_albedo(colour, metallic) * light_at(points, normals, frame, rng)
    return np.where(np.isinf(distance), sky(rays), diffuse)


def seen(eye: np.ndarray, rays: np.ndarray, frame: float) -> tuple[np.ndarray, ...]:
    """What each view ray shows, through the mirror where it hits that: eye, rays, distance, ids,
    whether mirrored."""
    eye = np.broadcast_to(eye, rays.shape)
    distance, ids = trace(eye, rays, frame)
    mirrored = (ids == MIRROR)[..., None]
    eye = np.where(mirrored, eye + np.where(mirrored, distance, 0) * rays, eye)
    rays = np.where(mirrored, reflected(rays, MIRROR_NORMAL), rays)
    return eye, rays, *trace(eye, rays, frame), mirrored


def render(
    number: int, width: int, height: int, samples: int, jitter: np.ndarray | None,
    seed: int | None = None, floor: float | None = None,
) -> postfx.Frame:
    """One frame with all planes. Without jitter the samples are spread over the pixel, and the
    planes of the last stay.

    Frame 1 is the first of the shot, so it is marked as a cut. Without a seed the number is the
    seed of the noise. `floor` makes the floor a metal of this roughness, and adds the plane of hit
    distances.
    """
    rng, colour, nearness = np.random.default_rng(number if seed is None else seed), 0, 0
    projection = integrate.perspective(FOV, width, height)
    clip, clip_before = camera(number) @ projection, camera(number - 1) @ projection
    for _ in range(samples):
        place = rng.random(2) - 0.5 if jitter is None else jitter
        eye, rays = integrate.view_rays(width, height, clip, place)
        start, ways, distance, ids, mirrored = seen(eye, rays, number)
        hit = np.isfinite(distance)
        points = start + np.where(hit, distance, 0) * ways
        normals, base, metallic = surface(points, ids, number)
        cosine = dot(unit(-ways), normals)
        polished = (ids == FLOOR)[..., None] & (floor is not None)
        metallic = np.where(polished, 1.0, metallic)
        gloss = np.where(polished, floor or 0.0, COPPER_ROUGHNESS)
        rough = np.where(metallic > 0, gloss, 1.0)
        f0 = np.where(metallic > 0, integrate.f0_of(base, metallic), 0.0)
        specular = integrate.specular_albedo(f0, rough, cosine)
        diffuse = integrate.diffuse_albedo(base, metallic)
        facet = unit(normals + gloss**2 * on_sphere(rng, rays.shape[:-1]))
        glossy = shaded(points + 1e-3 * normals, reflected(ways, facet), number, rng)
        # the mirror's planes show what it reflects, so it has no hit distance
        if floor is not None:
            away = trace(points + 1e-3 * normals, unit(reflected(ways, facet)), number)[0]
            nearness = nearness + np.where(hit & (metallic > 0) & ~mirrored, 1 / away, 0) / samples
        lit = diffuse * light_at(points, normals, number, rng) + specular * glossy
        colour = colour + np.where(hit, lit, sky(ways)) / samples
    before = integrate.rigid_previous_positions(points, ids, {BALL: ball(number)},
                                                {BALL: ball(number - 1)})
    virtual, virtual_before = (
        np.where(mirrored, integrate.mirrored_positions(each, MIRROR_AT, MIRROR_NORMAL), each)
        for each in (points, before)
    )
    homogeneous = [np.concatenate([np.where(hit, each, rays), hit], axis=-1)
                   for each in (virtual, virtual_before)]
    turned = np.where(mirrored, integrate.mirrored_normals(normals, MIRROR_NORMAL), normals)
    planes = {
        Role.COLOUR: colour,
        Role.DIFFUSE_ALBEDO: np.where(hit, diffuse, 0),
        Role.SPECULAR_ALBEDO: np.where(hit, specular, 0),
        Role.NORMAL: np.where(hit, turned, 0),
        Role.ROUGHNESS: np.where(hit, rough, 0),
        Role.DEPTH: np.where(hit[..., 0], integrate.depth_of(virtual, clip), 1e10)[..., None],
        Role.MOTION: integrate.motion_from_positions(*homogeneous, clip, clip_before),
    }
    if floor is not None:
        planes[Role.SPECULAR_HIT_DISTANCE] = np.where(nearness > 0, 1 / np.maximum(nearness, 1e-10),
                                                      0)
    return postfx.Frame(
        planes, number, (0.0, 0.0) if jitter is None else tuple(jitter), reset=number == 1,
        samples=samples, world_to_camera=camera(number), fov_x=FOV,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("output", nargs="?", type=Path, default=Path("out/ray_caster"))
    parser.add_argument("--frames", type=int, default=8)
    parser.add_argument("--samples", type=int, default=2)
    parser.add_argument("--size", default="240x136")
    parser.add_argument("--reference", type=int, nargs="*", default=[], metavar="FRAME")
    parser.add_argument("--reference-samples", type=int, default=64)
    arguments = parser.parse_args()
    width, height = map(int, arguments.size.split("x"))
    jitter, exposure = integrate.jitter_sequence(integrate.jitter_length(2)), None
    for number in range(1, arguments.frames + 1):
        frame = render(number, width, height, arguments.samples, jitter[(number - 1) % len(jitter)])
        if exposure is None:
            exposure = integrate.exposure_hint(frame[Role.COLOUR])
        frame.exposure = exposure
        print("wrote", integrate.write_planes(arguments.output / f"noisy.{number:04d}.exr", frame))
    for number in arguments.reference:
        frame = render(number, 2 * width, 2 * height, arguments.reference_samples, None)
        colour = postfx.Frame({Role.COLOUR: frame[Role.COLOUR]}, number, exposure=exposure,
                              samples=frame.samples)
        print("wrote",
              integrate.write_planes(arguments.output / f"reference.{number:04d}.exr", colour))


if __name__ == "__main__":
    main()
