"""Procedural textures: linear RGB float32 images (S, S, 3) that tile, from a few strokes to fine
print."""

from __future__ import annotations

import colorsys

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from scipy import ndimage, spatial

GLYPHS = "ABCDEFGHKMNRSTWXYZabdefghkmnqrstuwxyz0123456789&%#@*+=<>"


def colour(rng: np.random.Generator) -> np.ndarray:
    """A reflectance: mostly moderate, at times saturated, near black or near white; linear,
    0.01..0.95."""
    kind = rng.random()
    if kind < 0.2:
        return np.full(3, rng.uniform(0.55, 0.92)) * rng.uniform(0.93, 1.0, 3)
    if kind < 0.28:
        return np.full(3, rng.uniform(0.01, 0.05))
    if kind < 0.4:
        return np.full(3, rng.uniform(0.1, 0.5))
    saturation = rng.uniform(0.7, 1.0) if kind > 0.75 else rng.uniform(0.15, 0.6)
    value = rng.uniform(0.3, 0.95)
    return np.clip(np.array(colorsys.hsv_to_rgb(rng.random(), saturation, value)) ** 1.8, 0.01,
                   0.95)


def noise(size: int, cells: int, rng: np.random.Generator, octaves: int = 4) -> np.ndarray:
    """Tiling value noise (size, size), mean about 0.5, `cells` lattice cells in the first
    octave."""
    total, weight = np.zeros((size, size)), 0.0
    for octave in range(octaves):
        n = min(cells * 2**octave, size)
        lattice = rng.random((n, n))
        place = np.arange(size) * (n / size)
        cell = place.astype(int)
        part = place - cell
        rows = lattice[cell] * (1 - part)[:, None] + lattice[(cell + 1) % n] * part[:, None]
        total += (rows[:, cell] * (1 - part) + rows[:, (cell + 1) % n] * part) * 0.55**octave
        weight += 0.55**octave
    return total / weight


def _mix(a: np.ndarray, b: np.ndarray, t: np.ndarray) -> np.ndarray:
    return a + (b - a) * np.clip(t, 0, 1)[..., None]


def _flat(size: int, rng: np.random.Generator) -> np.ndarray:
    return np.tile(colour(rng), (8, 8, 1))


def _cloudy(size: int, rng: np.random.Generator) -> np.ndarray:
    t = noise(size, int(rng.choice([2, 4, 16, 64])), rng)
    return _mix(colour(rng), colour(rng), (t - 0.5) * 3 + 0.5)


def _speckle(size: int, rng: np.random.Generator) -> np.ndarray:
    t = noise(size, size // int(rng.choice([2, 4, 8])), rng, 1) > rng.uniform(0.55, 0.9)
    return _mix(colour(rng), colour(rng), t.astype(float))


def _checker(size: int, rng: np.random.Generator) -> np.ndarray:
    n = int(rng.choice([2, 4, 8, 16]))
    i = np.arange(size) * n // size
    a, b = colour(rng), colour(rng)
    return _mix(a, b, ((i[:, None] + i[None, :]) % 2).astype(float)) * (0.9 + 0.1 * noise(
        size, 8, rng
    )[..., None])


def _wood(size: int, rng: np.random.Generator) -> np.ndarray:
    tint = np.array(colorsys.hsv_to_rgb(rng.uniform(0.04, 0.1), rng.uniform(0.4, 0.8),
                                        rng.uniform(0.35, 0.9))) ** 2
    planks = int(rng.choice([1, 3, 6, 10]))
    grain = noise(size, 4, rng)
    stretched = ndimage.zoom(noise(size, 64, rng, 3), (1, 1))[:, : max(size // 16, 1)]
    fine = np.repeat(stretched, 16, axis=1)[:size, :size]
    v = np.arange(size)[:, None] / size
    rings = 0.5 + 0.5 * np.sin(2 * np.pi * (v * rng.integers(6, 20) + 2.5 * grain))
    plank = np.floor(v * planks).astype(int)
    tone = rng.uniform(0.6, 1.1, planks)[np.minimum(plank, planks - 1)]
    gap = np.where((v * planks) % 1 < 0.03, 0.25, 1.0) if planks > 1 else 1.0
    return np.clip(tint * ((0.55 + 0.3 * rings + 0.3 * fine) * tone * gap)[..., None], 0.005, 0.9)


def _stripes(size: int, rng: np.random.Generator) -> np.ndarray:
    n, duty = int(rng.choice([4, 8, 20, 40])), rng.uniform(0.3, 0.7)
    band = ((np.arange(size) * n / size) % 1 < duty).astype(float)[:, None] * np.ones((1, size))
    return _mix(colour(rng), colour(rng), band if rng.random() < 0.5 else band.T)


def _tiles(size: int, rng: np.random.Generator) -> np.ndarray:
    n, grout = int(rng.choice([2, 4, 8])), rng.uniform(0.02, 0.08)
    x = np.arange(size) * n / size
    shift = np.where(np.floor(x) % 2 > 0, 0.5, 0.0)[:, None] if rng.random() < 0.4 else 0.0
    u, v = (x[None, :] + shift) % n, x[:, None] + 0 * x[None, :]
    tones = rng.uniform(0.75, 1.0, (n, n))[np.floor(v).astype(int) % n, np.floor(u).astype(int) % n]
    edge = ((u % 1) < grout) | ((v % 1) < grout)
    base = _mix(colour(rng), colour(rng), noise(size, 16, rng) * 0.6) * tones[..., None]
    return np.where(edge[..., None], colour(rng), base)


def _marble(size: int, rng: np.random.Generator) -> np.ndarray:
    u = np.arange(size)[None, :] / size
    veins = np.abs(np.sin(np.pi * (u * rng.integers(1, 4) + 3 * noise(size, 3, rng, 6))))
    return _mix(colour(rng), colour(rng), veins ** rng.uniform(0.15, 0.6))


def _print(size: int, rng: np.random.Generator) -> np.ndarray:
    image = Image.new("L", (size, size), 0)
    draw = ImageDraw.Draw(image)
    point = int(rng.choice([9, 12, 18, 36]))
    font = ImageFont.load_default(point)
    for y in range(2, size, int(point * 1.3)):
        text = "".join(rng.choice(list(GLYPHS + "    "), 2 * size // point))
        draw.text((int(rng.integers(0, 12)), y), text, fill=255, font=font)
    return _mix(colour(rng), colour(rng), np.asarray(image, float) / 255)


def _weave(size: int, rng: np.random.Generator) -> np.ndarray:
    n = int(rng.choice([16, 32, 64]))
    x = np.arange(size) * n / size
    over = (np.floor(x)[:, None] + np.floor(x)[None, :]) % 2
    thread = np.where(over > 0, np.sin(np.pi * (x % 1))[:, None], np.sin(np.pi * (x % 1))[None, :])
    return _mix(colour(rng), colour(rng), over * 0.7) * (0.4 + 0.6 * thread)[..., None]


def _dots(size: int, rng: np.random.Generator) -> np.ndarray:
    n, radius = int(rng.choice([4, 8, 16])), rng.uniform(0.15, 0.45)
    x = (np.arange(size) * n / size) % 1 - 0.5
    return _mix(colour(rng), colour(rng), (np.hypot(x[:, None], x[None, :]) < radius).astype(float))


def _picture(size: int, rng: np.random.Generator) -> np.ndarray:
    image = np.ones((size, size, 3)) * colour(rng)
    y, x = np.mgrid[0:size, 0:size] / size
    for _ in range(int(rng.integers(6, 30))):
        cx, cy, r, angle = *rng.random(2), rng.uniform(0.02, 0.3), rng.uniform(0, 3.2)
        c, s = np.cos(angle), np.sin(angle)
        u, v = (x - cx) * c + (y - cy) * s, (y - cy) * c - (x - cx) * s
        bar = (np.abs(u) < r) & (np.abs(v) < r * rng.uniform(0.05, 1))
        inside = (np.hypot(u, v) < r) if rng.random() < 0.4 else bar
        image[inside] = colour(rng)
    return image


def _carpet(size: int, rng: np.random.Generator) -> np.ndarray:
    """Short fibres: noise of single texels, stretched a little one way, over a faint large
    pattern."""
    fibres = ndimage.uniform_filter1d(rng.random((size, size)), int(rng.choice([2, 4, 8])), axis=0,
                                      mode="wrap")
    fibres = (fibres - fibres.mean()) / (fibres.std() + 1e-6)
    pattern = noise(size, int(rng.choice([2, 8])), rng) > rng.uniform(0.3, 0.7)
    return _mix(colour(rng), colour(rng), 0.8 * pattern) * np.clip(1 + 0.3 * fibres, 0.2,
                                                                   1.8)[..., None]


def _gravel(size: int, rng: np.random.Generator) -> np.ndarray:
    """Pebbles or cracked earth: cells about random points, dark between them."""
    points = rng.random((int(rng.choice([150, 500, 1500])), 2)) * size
    tree = spatial.cKDTree(points, boxsize=size)
    grid = np.stack(list(np.mgrid[0:size, 0:size]), -1).reshape(-1, 2)
    distance, index = tree.query(grid, 2)
    gap = np.clip((distance[:, 1] - distance[:, 0]) / rng.uniform(1.5, 4), 0, 1).reshape(size, size)
    tone = rng.random(len(points))[index[:, 0]].reshape(size, size)
    return _mix(colour(rng), colour(rng), tone) * (0.15 + 0.85 * gap[..., None])


def _plaid(size: int, rng: np.random.Generator) -> np.ndarray:
    """Bands of fine threads crossing, as in cloth."""
    sett = np.repeat(rng.random((32, 1)) > 0.5, size // 32, axis=0)[:size, 0].astype(float)
    thread = (np.add.outer(np.arange(size), np.arange(size)) // 2 % 2).astype(float)
    return _mix(colour(rng), colour(rng), np.where(thread > 0, sett[:, None], sett[None, :]))


def _plan(size: int, rng: np.random.Generator) -> np.ndarray:
    """Fine lines on plain ground: a map, a drawing or squared paper."""
    image = Image.new("L", (size, size), 0)
    draw, thick = ImageDraw.Draw(image), int(rng.integers(1, 3))
    pitch = int(rng.choice([8, 16, 32]))
    if rng.random() < 0.4:
        for at in range(0, size, pitch):
            draw.line([(at, 0), (at, size)], 255, thick)
            draw.line([(0, at), (size, at)], 255, thick)
    for _ in range(int(rng.integers(20, 90))):
        x, y, r = *rng.uniform(0, size, 2), rng.uniform(4, 0.3 * size)
        angle = rng.choice([0, np.pi / 2, rng.uniform(0, np.pi)])
        if rng.random() < 0.3:
            draw.ellipse([x - r / 2, y - r / 2, x + r / 2, y + r / 2], outline=255, width=thick)
        else:
            draw.line([(x, y), (x + r * np.cos(angle), y + r * np.sin(angle))], 255, thick)
    return _mix(colour(rng), colour(rng), np.asarray(image, float) / 255)


KINDS = (_cloudy, _speckle, _checker, _wood, _wood, _stripes, _tiles, _tiles, _marble, _print,
         _weave, _dots, _picture, _carpet, _gravel, _plaid, _plan)


def texture(rng: np.random.Generator, size: int = 256, flat: float = 0.35) -> np.ndarray:
    """A random texture (S, S, 3) float32, linear reflectance 0..0.95; with probability `flat` one
    colour.

    One in six is twice as fine.
    """
    kind = _flat if rng.random() < flat else KINDS[int(rng.integers(len(KINDS)))]
    size = 2 * size if rng.random() < 1 / 6 else size
    return np.clip(kind(size, rng), 0.0, 0.95).astype(np.float32)


def wood(rng: np.random.Generator, size: int = 256) -> np.ndarray:
    return np.clip(_wood(size, rng), 0, 0.95).astype(np.float32)


def picture(rng: np.random.Generator, size: int = 256) -> np.ndarray:
    return np.clip(_picture(size, rng), 0, 0.95).astype(np.float32)


def stone(rng: np.random.Generator, size: int = 256) -> np.ndarray:
    """Floors and worktops: tiles, marble, checks or speckles."""
    kind = (_tiles, _tiles, _marble, _checker, _speckle, _cloudy)[int(rng.integers(6))]
    return np.clip(kind(size, rng), 0, 0.95).astype(np.float32)
