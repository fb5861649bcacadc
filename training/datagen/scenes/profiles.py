"""Profiles of mouldings, (K, 2) points of (across, off the surface): skirtings, cornices, frames, panels."""

from __future__ import annotations

import numpy as np

KINDS = ("line", "ovolo", "cove", "ogee", "step", "step")


def _element(kind: str, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Points from `start` (left out) to `end` (kept)."""
    t = np.linspace(0, 1, 7)[1:]
    x, y = {
        "line": (t[-1:], t[-1:]),
        "ovolo": (1 - np.cos(t * np.pi / 2), np.sin(t * np.pi / 2)),
        "cove": (np.sin(t * np.pi / 2), 1 - np.cos(t * np.pi / 2)),
        "ogee": (t, 0.5 - 0.5 * np.cos(np.pi * t)),
        "step": (np.array([0.0, 1.0]), np.array([1.0, 1.0])),
    }[kind]
    return start + np.stack([x, y], 1) * (end - start)


def _run(rng: np.random.Generator, start: np.ndarray, end: np.ndarray, count: int) -> list[np.ndarray]:
    """A stair of `count` elements from `start` to `end`."""
    cuts = np.sort(rng.uniform(0.1, 0.9, (2, count - 1)), 1).T
    stops = [start, *(start + cut * (end - start) for cut in cuts), end]
    return [_element(str(rng.choice(KINDS)), a, b) for a, b in zip(stops[:-1], stops[1:], strict=True)]


def frame(rng: np.random.Generator, width: float, height: float) -> np.ndarray:
    """Both edges on the surface: for architraves, picture frames and panels."""
    low, crest = rng.uniform(0.2, 0.6) * height, np.sort(rng.uniform(0.25, 0.85, 2)) * width
    if rng.random() < 0.2:
        return np.array([[0, 0], [0, height], [width, height], [width, 0]])
    parts = [np.array([[0, 0], [0, low]]), *_run(rng, np.array([0, low]), np.array([crest[0], height]), 2),
             np.array([[crest[1], height]])]
    parts += _run(rng, np.array([crest[1], height]), np.array([width, 0.4 * low]), int(rng.integers(1, 3)))
    return np.concatenate([*parts, np.array([[width, 0.0]])])


def edge(rng: np.random.Generator, width: float, height: float) -> np.ndarray:
    """Thick at the start, thin at the end: skirtings, from the floor at 0 up to `width` on the wall."""
    top = rng.uniform(0.5, 0.85) * width
    if rng.random() < 0.3:
        return np.array([[0, 0], [0, height], [width - 0.3 * height, height], [width, 0.7 * height], [width, 0.0]])
    parts = [np.array([[0, 0], [0, height], [top, height]])]
    parts += _run(rng, np.array([top, height]), np.array([width, 0.2 * height]), int(rng.integers(1, 3)))
    return np.concatenate([*parts, np.array([[width, 0.0]])])


def cornice(rng: np.random.Generator, width: float, height: float) -> np.ndarray:
    """From the wall, `height` below the ceiling, to the ceiling, `width` from the wall."""
    inset = 0.15 * np.array([width, height]) * rng.random()
    start, end = np.array([inset[0], height]), np.array([width, inset[1]])
    parts = [np.array([[0, height], [inset[0], height]]), *_run(rng, start, end, int(rng.integers(1, 5)))]
    return np.concatenate([*parts, np.array([[width, 0.0]])])
