"""A polished floor before a textured wall, and a polished ball, in float64: where reflections were,
by geometry."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from postfx.frame import DEPTH_MISS, Frame, Role
from postfx.integrate import jitter_sequence, perspective, pixel_positions, project, view_rays

FOV = 60.0
WALL = 4.0
"""z of the wall; the floor is at y = 0."""
BALL, RADIUS = np.array([0.3, 0.9, 2.0]), 0.8
TURNS = {"mitsuba": (-1, 1, 1), "opengl": (1, 1, -1), "pbrt": (1, 1, 1)}
"""Signs of the camera's axes: x right, y up, z forward are (1, 1, 1)."""


def camera(number: float, convention: str = "pbrt") -> np.ndarray:
    """World to camera of a frame: it goes to the right and a little upwards, and turns."""
    eye, yaw = np.array([0.06 * number - 0.3, 1.2 + 0.012 * number, -2.0]), 0.009 * number
    forward = np.array([np.sin(yaw) * 0.96, -0.28, np.cos(yaw) * 0.96])
    right = np.cross([0.0, 1.0, 0.0], forward) / np.linalg.norm(np.cross([0.0, 1.0, 0.0], forward))
    axes = np.stack([right, np.cross(forward, right), forward], 1) * TURNS[convention]
    matrix = np.eye(4)
    matrix[:3, :3], matrix[3, :3] = axes, -eye @ axes
    return matrix


def clip(number: float, width: int, height: int) -> np.ndarray:
    return camera(number) @ perspective(FOV, width, height, forward="+z")


@dataclass
class View:
    """What each pixel of a frame shows: (h, w) and (h, w, 3) arrays in the world.

    Attributes:
        shiny: whether the first hit is the floor, or the ball.
        depth, points, normals: of the first hit.
        distance, seen: from there to what is reflected, and where that is on the wall (NaN in matt
            pixels).
    """

    shiny: np.ndarray
    depth: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    distance: np.ndarray
    seen: np.ndarray


def view(clip_matrix: np.ndarray, places: np.ndarray, width: int, height: int,
         ball: bool = False) -> View:
    """What is seen at pixel positions (..., 2)."""
    eye, rays = rays_at(clip_matrix, places, width, height)
    with np.errstate(all="ignore"):
        floor = -eye[1] / rays[..., 1]
    floor = np.where(floor > 0, floor, np.inf)
    wall = (WALL - eye[2]) / rays[..., 2]
    depth = sphere(eye, rays) if ball else np.minimum(floor, wall)
    depth = np.where(np.isfinite(depth), depth, wall) if ball else depth
    shiny = depth < wall
    points = eye + depth[..., None] * rays
    upright = (points - BALL) / RADIUS if ball else np.broadcast_to([0.0, 1.0, 0.0], points.shape)
    normals = np.where(shiny[..., None], upright, [0.0, 0.0, -1.0])
    mirrored = rays - 2 * (rays * normals).sum(-1, keepdims=True) * normals
    with np.errstate(all="ignore"):
        way = (WALL - points[..., 2]) / mirrored[..., 2]
    way = np.where(shiny & (way > 0), way, np.nan)
    distance = way * np.linalg.norm(mirrored, axis=-1)
    return View(shiny, depth, points, normals, distance, points + way[..., None] * mirrored)


def sphere(eye: np.ndarray, rays: np.ndarray) -> np.ndarray:
    a, b = (rays**2).sum(-1), (rays * (eye - BALL)).sum(-1)
    root = b * b - a * (((eye - BALL) ** 2).sum() - RADIUS**2)
    return np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / a, np.inf)


def rays_at(clip_matrix: np.ndarray, places: np.ndarray, width: int,
            height: int) -> tuple[np.ndarray, np.ndarray]:
    """Eye and directions through pixel positions, 1 along the view axis."""
    # through the corners of a picture of one quarter
    eye, corner = view_rays(2, 2, clip_matrix, (-0.5, -0.5))
    across = (corner[0, 1] - corner[0, 0]) * 2 / width
    down = (corner[1, 0] - corner[0, 0]) * 2 / height
    return eye, corner[0, 0] + places[..., :1] * across + places[..., 1:] * down


def texture(points: np.ndarray) -> np.ndarray:
    """Light of the wall (..., 3): stripes and discs."""
    x, y = points[..., 0], points[..., 1]
    stripes = 0.5 + 0.5 * np.tanh(4 * np.sin(9 * x + 2 * np.sin(3 * y)))
    discs = np.hypot(np.mod(x, 0.7) - 0.35, np.mod(y, 0.7) - 0.35) < 0.22
    return np.stack([0.1 + 0.8 * stripes, np.where(discs, 0.9, 0.25), 0.2 + 0.6 * stripes * discs],
                    -1)


def frame(number: int, width: int = 96, height: int = 54, ball: bool = False,
          convention: str = "pbrt",
          noise: float = 0.0, roughness: float = 0.05, pixel_aspect: float = 1.0) -> Frame:
    """A frame with all planes; `noise` is the deviation of its light over its mean."""
    jitter = jitter_sequence(16)[number % 16]
    lens = perspective(FOV, width, height, forward="+z", pixel_aspect=pixel_aspect)
    now, then = (camera(n) @ lens for n in (number, number - 1))
    places = pixel_positions(width, height, jitter)
    found = view(now, places, width, height, ball)
    motion = project(found.points, then, width, height) - places
    shiny, lost = found.shiny[..., None], np.isnan(found.distance)
    light = texture(np.where(lost[..., None], found.points, found.seen)) * np.where(shiny, 0.8, 1.0)
    if noise:
        random = np.random.default_rng([number, width])
        light = light * random.gamma(noise**-2, noise**2, (height, width, 1))
    planes = {
        Role.COLOUR: light, Role.DEPTH: np.minimum(found.depth, DEPTH_MISS), Role.MOTION: motion,
        Role.NORMAL: found.normals, Role.ROUGHNESS: np.where(found.shiny, roughness, 1.0),
        Role.DIFFUSE_ALBEDO: np.where(shiny, 0.0, texture(found.points)),
        Role.SPECULAR_ALBEDO: 0.8 * shiny * np.ones(3),
        Role.SPECULAR_HIT_DISTANCE: np.where(lost, 0, found.distance),
    }
    return Frame(planes, number, tuple(jitter), reset=number == 0, fov_x=FOV,
                 world_to_camera=camera(number, convention))
