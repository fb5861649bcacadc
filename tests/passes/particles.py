"""Sparks without motion vectors before a wall that pans, noisy as a path tracer's frames, with
exact references."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from postfx.frame import Frame, Role

HEIGHT, WIDTH, SAMPLES, FRAMES = 96, 160, 4, 10
PAN = np.array([1.3, -0.4])  # pixels a frame that the wall moves by
CLEAR = 4  # output pixels around a spark that do not count as left by it


@dataclass(frozen=True)
class Shot:
    """A frame with sparks in its colour only, the same without them, the sparks' coverage, and at
    output size what it should be and where sparks are."""

    frame: Frame
    opaque: Frame
    coverage: np.ndarray
    reference: np.ndarray
    covered: np.ndarray


def shots(seed: int = 1, count: int = 24) -> Iterator[Shot]:
    """Frames of 160x96, exposed as they are, with planes of the wall; references of twice the
    size."""
    random = np.random.default_rng(seed)
    places = random.random((count, 2)) * (WIDTH, HEIGHT)
    angles = random.uniform(0, 2 * np.pi, count)
    steps = np.stack((np.cos(angles), np.sin(angles)), 1) * random.uniform(2, 6, (count, 1))
    radii = random.uniform(0.8, 2, count)
    lights = np.array([1, 0.6, 0.25]) * random.uniform(3, 9, (count, 1))
    for number in range(FRAMES):
        now = np.mod(places + number * steps, (WIDTH, HEIGHT))
        yield _shot(number, list(zip(now, radii, lights, strict=True)), random)


def _shot(number: int, sparks: list[Any], random: np.random.Generator) -> Shot:
    jitter = tuple(random.uniform(-0.5, 0.5, 2))
    albedo, light = _wall(number, *_points(1, *jitter))
    glow, alpha = _sparks(sparks, *_points(1, *jitter))
    noise = random.gamma(SAMPLES, 1 / SAMPLES, light.shape)
    colour = albedo * light * noise
    size = colour.shape[:2]
    constant: dict[Role, Any]
    constant = {Role.DEPTH: [3.0], Role.MOTION: -PAN, Role.NORMAL: [0.0, 0.0, 1.0],
                Role.ROUGHNESS: [0.8], Role.SPECULAR_ALBEDO: [0.0] * 3}
    planes = {role: np.broadcast_to(np.float32(value), (*size, len(value)))
              for role, value in constant.items()}
    planes |= {Role.COLOUR: colour.astype(np.float32),
               Role.DIFFUSE_ALBEDO: albedo.astype(np.float32)}
    opaque = Frame(planes, number=number, jitter=jitter, exposure=0.0, reset=number == 0)
    with_sparks = (colour * (1 - alpha) + glow).astype(np.float32)
    reference, covered = _reference(number, sparks)
    return Shot(replace(opaque, planes={**opaque.planes, Role.COLOUR: with_sparks}), opaque, alpha,
                reference, covered)


def _reference(number: int, sparks: list[Any]) -> tuple[np.ndarray, np.ndarray]:
    """Mean of 3x3 points of each output pixel."""
    total, most = np.zeros(()), np.zeros(())
    for dx, dy in np.ndindex(3, 3):
        at = _points(2, (dx - 1) / 3, (dy - 1) / 3)
        albedo, light = _wall(number, *at)
        glow, alpha = _sparks(sparks, *at)
        total, most = total + (albedo * light * (1 - alpha) + glow) / 9, np.maximum(most, alpha)
    return total.astype(np.float32), most[..., 0] > 0


def _points(scale: int, dx: float, dy: float) -> tuple[np.ndarray, np.ndarray]:
    """Positions x and y of pixels' centres plus an offset, in render pixels."""
    return np.meshgrid((np.arange(scale * WIDTH) + 0.5 + dx) / scale,
                       (np.arange(scale * HEIGHT) + 0.5 + dy) / scale)


def _wall(number: int, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Albedo and light of the wall, (h, w, 3) and (h, w, 1)."""
    u, v = x - PAN[0] * number, y - PAN[1] * number
    waves = np.stack([np.sin(u / a) * np.cos(v / b) for a, b in ((5, 7), (9, 4), (6, 11))], -1)
    return 0.45 + 0.3 * waves, (0.6 + 0.3 * np.sin(u / 31 + v / 23))[..., None]


def _sparks(sparks: list[Any], x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Premultiplied light and coverage of round sparks with soft edges."""
    glow, alpha = np.zeros((*x.shape, 3)), np.zeros((*x.shape, 1))
    for (left, top), radius, light in sparks:
        front = np.clip((radius - np.hypot(x - left, y - top)) / (0.4 * radius), 0, 1)[..., None]
        glow, alpha = glow * (1 - front) + front * light, alpha * (1 - front) + front
    return glow, alpha


def ghost_energy(results: list[np.ndarray], sequence: list[Shot]) -> float:
    """Mean squared error, in the display curve, of pixels that a spark covered in an earlier frame
    and that are clear of sparks now."""
    errors, was = [], np.zeros_like(sequence[0].covered)
    for result, shot in zip(results, sequence, strict=True):
        left = was & ~_around(shot.covered)
        errors.append(np.square(seen(result) - seen(shot.reference))[left].ravel())
        was = was | shot.covered
    return float(np.concatenate(errors).mean())


def _around(mask: np.ndarray) -> np.ndarray:
    for axis in (0, 1):
        mask = np.logical_or.reduce([np.roll(mask, shift, axis)
                                     for shift in range(-CLEAR, CLEAR + 1)])
    return mask


def seen(colour: np.ndarray) -> np.ndarray:
    """Within [0, 1], as a display shows it."""
    return (colour / (1 + colour)) ** (1 / 2.2)
