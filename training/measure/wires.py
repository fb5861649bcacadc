"""Frames between those of thin wires, against estimated motion alone and a plain blend.

python -m training.measure.wires

Wires of one or two pixels move in front of a wall that stands still or moves; they are drawn by
chance. Their vectors are right, or (1, 1), zero, those of the wall, of the other sign or of half
the motion. A row says how far frames between are above the better of both, in dB: on average, at
worst, and how many are more than 0.2 and 1 dB below; by two frames alone, and by five. Then both
without the picture of estimated motion where vectors lead a thin thing nowhere right.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from unittest import mock

import numpy as np

from postfx import Between, Frame, Role
from training.measure.dissolves import HEIGHT, WIDTH, X, Y, psnr, texture

DRAWN = 40
"""Wires."""
DRAWN_SEED = 11
"""Where they begin; thresholds were chosen on others."""
SAMPLES = 6
"""Of a pixel's side."""
FINE_Y, FINE_X = (np.mgrid[:HEIGHT * SAMPLES, :WIDTH * SAMPLES] + 0.5) / SAMPLES
WIDTHS = (0.7, 1.0, 1.5, 2.0)
"""Pixels."""
LIGHTS = (0.02, 0.02, 3.0)
SPEEDS, WALL_SPEEDS = (2, 3, 5, 8), (0, 0, 1, 3)
"""Pixels a frame."""
NEAR, FAR = 3.0, 10.0
"""Depth of the wire and of the wall."""
KINDS = ("one", "zero", "wall", "other sign", "half")
"""Of wrong vectors."""
COVERED = 0.3
"""Of a pixel from which planes are the wire's."""
BETWEEN = 2.5
"""Time of the frame that is made, from those at 2 and 3."""
At = Callable[[float, bool], Frame]


def draw_wire(random: np.random.Generator, is_right: bool) -> At:
    """A wire that is drawn by chance: its frame of a time, with vectors or without."""
    angle = random.uniform(0, np.pi)
    width, light = random.choice(WIDTHS), random.choice(LIGHTS)
    speed, wall = (random.choice(speeds) * np.exp(1j * random.uniform(0, 2 * np.pi))
                   for speeds in (SPEEDS, WALL_SPEEDS))
    middle = complex(WIDTH / 2 + random.uniform(-30, 30), HEIGHT / 2 + random.uniform(-20, 20))
    seed, kind = int(random.integers(1000, 100_000)), str(random.choice(KINDS))
    told = {"one": 1 + 1j, "zero": 0j, "wall": -wall, "other sign": speed, "half": -speed / 2}[kind]
    on_wire, on_wall = ((one.real, one.imag) for one in (-speed if is_right else told, -wall))

    def at(time: float, with_vectors: bool) -> Frame:
        place = middle + speed * time
        far = ((FINE_X - place.real) * np.cos(angle) + (FINE_Y - place.imag) * np.sin(angle))
        fine = np.abs(far) < width / 2
        cover = fine.reshape(HEIGHT, SAMPLES, WIDTH, SAMPLES).mean((1, 3))[..., None]
        shown = texture(X - wall.real * time, Y - wall.imag * time, seed)
        planes = {Role.COLOUR: shown * (1 - cover) + light * cover}
        if with_vectors:
            planes[Role.DEPTH] = np.where(cover > COVERED, NEAR, FAR)
            planes[Role.MOTION] = np.where(cover > COVERED, on_wire, on_wall)
        return Frame({role: plane.astype(np.float32) for role, plane in planes.items()},
                     number=int(time))
    return at


def frame_between(at: At, times: Sequence[int], with_vectors: bool) -> np.ndarray:
    """The picture between 2 and 3, by frames of these times."""
    frames, last = [at(time, with_vectors) for time in times], None
    for before, after, later in zip(frames, frames[1:], [*frames[2:], None], strict=False):
        last = Between(before, after, later, last=last)
        if before.number == int(BETWEEN):
            break
    assert last is not None, "there are two frames"
    found: np.ndarray = last.frame(BETWEEN % 1)[Role.COLOUR]
    return found


def gains(at: At) -> list[float]:
    """Of one wire, by two frames alone and by five."""
    wanted = at(BETWEEN, False)[Role.COLOUR]
    mean = (at(2, False)[Role.COLOUR] + at(3, False)[Role.COLOUR]) / 2
    best = max(psnr(frame_between(at, (2, 3), False), wanted), psnr(mean, wanted))
    return [psnr(frame_between(at, times, True), wanted) - best
            for times in ((2, 3), (0, 1, 2, 3, 4))]


def told(name: str, found: Iterable[float]) -> str:
    """A row of the table."""
    found = list(found)
    below = [sum(gain < -least for gain in found) for least in (0.2, 1)]
    return (f"{name} | {np.mean(found):.2f} dB | {min(found):.2f} dB | "
            f"{below[0]} of {len(found)} | {below[1]}")


def main() -> None:
    """Print the table."""
    print("wires | mean | worst | below -0.2 | below -1", flush=True)
    for is_right in (False, True):
        name = f"{'right' if is_right else 'wrong'} vectors"
        random = np.random.default_rng(DRAWN_SEED)
        wires = [draw_wire(random, is_right) for _ in range(DRAWN)]
        both = np.array([gains(at) for at in wires])
        for way, of_way in zip(("two frames", "five frames"), both.T, strict=True):
            print(told(f"{name}, by {way}", of_way), flush=True)
        with mock.patch.object(Between, "_where_flow_is_right", None):
            both = np.array([gains(at) for at in wires])
        print(told(f"{name}, without that picture", both.ravel()), flush=True)


if __name__ == "__main__":
    main()
