"""Frames between those of a dissolve, against estimated motion alone and a plain blend.

python -m training.measure.dissolves

Three shots with vectors dissolve into eight others in eight steps. A row says how far frames
between are above the better of both, in dB: on average, at worst, and how many are more than 0.2
and 1 dB below. Ways: by the two frames alone; with those beside them, by the most even way alone;
by all ways as even as they are, as it is; and the same without vectors. Then the dissolves one by
one as it is, the worst first, and the four rows again for dissolves that are drawn by chance: pans,
zooms and turns of other speeds and lights, half of them with a disc, in five to eleven steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from postfx import Between, Frame, Role
from postfx.interpolate import ways
from postfx.interpolate.shares import BY_VECTORS

HEIGHT, WIDTH, STEPS = 96, 160, 8
SEEN_DB = 52
"""Frames that are better than that by either way are left out: nobody sees a difference."""
BEST_ALONE_POWER = 60
"""Power of unevenness by which next to only the best way counts."""
WAYS = ("by two frames", "the most even one alone", "all as even as they are", "without vectors")
AS_IT_IS = 2
"""Which of them is what postfx does."""
Y, X = np.mgrid[:HEIGHT, :WIDTH] + 0.5
Shot = Callable[[float], np.ndarray]


def texture(x: np.ndarray, y: np.ndarray, seed: int) -> np.ndarray:
    """A colourful pattern of waves of 7 to 126 pixels."""
    random, found = np.random.default_rng(seed), np.zeros((*x.shape, 3))
    for _ in range(14):
        k = random.uniform(0.05, 0.9, 2) * random.choice((-1, 1), 2)
        wave = np.sin(x * k[0] + y * k[1] + random.uniform(0, 6.3))
        found += wave[..., None] * random.uniform(-0.5, 0.5, 3)
    return (0.5 + 0.16 * found).clip(0.02, None)


def pan(seed: int, right: float, down: float = 0.0, light: float = 1.0) -> Shot:
    """A wall that moves to the left and up."""
    return lambda time: light * texture(X + right * time, Y + down * time, seed)


def disc_in(place: Callable[[float], tuple[float, float]], wall: Shot, seed: int) -> Shot:
    """A disc that flies in front of a wall."""
    def shown(time: float) -> np.ndarray:
        x, y = (one - centre for one, centre in zip((X, Y), place(time), strict=True))
        return np.where((x**2 + y**2 < 18**2)[..., None], texture(x, y, seed) * (1.2, 0.7, 0.3),
                        wall(time))
    return shown


def flown(time: float) -> tuple[float, float]:
    """Where the disc of the first shot is."""
    return 45 + 7 * time, 40 + 2 * time


def vectors_of_disc(time: float) -> np.ndarray:
    """Motion of that shot to the frame before."""
    x, y = (one - centre for one, centre in zip((X, Y), flown(time), strict=True))
    return np.where((x**2 + y**2 < 18**2)[..., None], (-7.0, -2.0), (3.0, 0.0))


GOING: dict[str, tuple[Shot, Shot]] = {
    "disc": (disc_in(flown, pan(3, 3), 5), vectors_of_disc),
    "still": (pan(3, 0), lambda time: np.zeros((HEIGHT, WIDTH, 2))),
    "fast pan": (pan(3, 11, 2), lambda time: np.full((HEIGHT, WIDTH, 2), (11.0, 2.0))),
}
COMING: dict[str, Shot] = {
    "pan": pan(11, -4, 1), "still": pan(12, 0, light=0.8), "fast pan": pan(13, 9, -3, 1.3),
    "bright pan": pan(14, -2, light=3), "smooth": lambda time: np.repeat(
        0.5 + 0.3 * np.sin((X + 3 * time) / 25)[..., None], 3, axis=2),
    "disc": disc_in(lambda time: (60 - 6 * time, 50 + time), pan(32, -2), 31),
    "fast disc": disc_in(lambda time: (60 + 10 * time, 50 + 4 * time), pan(42, 0), 41),
    "stripes": lambda time: np.repeat(0.5 + 0.4 * np.sin((X - 5 * time) / 2.2)[..., None], 3,
                                      axis=2),
}


DRAWN = 24
"""Dissolves that are drawn by chance."""
DRAWN_SEED = 3
"""Where they begin: none of them decided a constant."""
SPEEDS, LIGHTS, RATES = (0, 1, 2, 3, 5, 8), (0.4, 0.7, 1, 1, 1.5, 3), (-0.03, -0.015, 0.015, 0.03)
"""Pixels a frame, light, and growth or turn a frame of shots that are drawn."""


def draw_shot(random: np.random.Generator) -> tuple[Shot, Shot]:
    """A shot that is drawn by chance, and its motion to the frame before."""
    seed, light = int(random.integers(1000, 1_000_000)), float(random.choice(LIGHTS))
    speed = random.choice(SPEEDS) * np.exp(1j * random.uniform(0, 2 * np.pi))
    growth = random.choice((0, 0, 1, 1j)) * random.choice(RATES)
    middle = complex(WIDTH / 2, HEIGHT / 2)
    place = X + 1j * Y - middle

    def wall(time: float) -> np.ndarray:
        on_wall = place * np.exp(growth * time) + middle + speed * time
        return light * texture(on_wall.real, on_wall.imag, seed)

    def vectors(time: float) -> np.ndarray:
        # the place in the frame before that shows the same of the wall
        before = (place * np.exp(growth * time) + speed) * np.exp(-growth * (time - 1))
        return np.stack([(before - place).real, (before - place).imag], -1)

    if random.random() < 0.5:
        return wall, vectors
    start = complex(random.uniform(30, 130), random.uniform(25, 70))
    step = random.choice((2, 5, 8)) * np.exp(1j * random.uniform(0, 2 * np.pi))

    def at(time: float) -> tuple[float, float]:
        centre = start + step * time
        return centre.real, centre.imag

    def with_disc(time: float) -> np.ndarray:
        x, y = (one - centre for one, centre in zip((X, Y), at(time), strict=True))
        return np.where((x**2 + y**2 < 18**2)[..., None], (-step.real, -step.imag), vectors(time))

    return disc_in(at, wall, seed + 1), with_disc


def psnr(found: np.ndarray, truth: np.ndarray) -> float:
    """PSNR of displayed pictures."""
    one, other = ((light / (1 + light)) ** (1 / 2.2) for light in (np.maximum(found, 0), truth))
    return float(-10 * np.log10(np.mean((one - other) ** 2)))


def gains(going: tuple[Shot, Shot], coming: Shot, steps: int = STEPS) -> list[list[float]]:
    """Gains in dB over the better of a blend and estimated motion: a row for each frame between in
    one dissolve, with a figure for each way."""
    def shown(time: float) -> np.ndarray:
        part = min(max(time / steps, 0.0), 1.0)
        return going[0](time) * (1 - part) + coming(time) * part

    def frame(time: float, with_vectors: bool = True) -> Frame:
        planes = {Role.COLOUR: shown(time).astype(np.float32)}
        if with_vectors:
            planes[Role.MOTION] = going[1](time).astype(np.float32)
        return Frame(planes)

    frames, found = [frame(time) for time in range(-1, steps + 2)], []
    for time in range(steps):
        earlier, before, after, later = frames[time:time + 4]
        wanted, mean = shown(time + 0.5), (before[Role.COLOUR] + after[Role.COLOUR]) / 2
        alone = Between(frame(time, False), frame(time + 1, False))
        alone._shares = BY_VECTORS  # which are estimated
        best = max(psnr(alone.frame(0.5)[Role.COLOUR], wanted), psnr(mean, wanted))
        if best > SEEN_DB:
            continue
        row = [Between(before, after)]
        row += [Between(before, after, later, last=Between(earlier, before)) for _ in range(2)]
        shares = []
        usual = ways.UNEVEN_POWER
        for between, power in zip(row, (usual, BEST_ALONE_POWER, usual), strict=True):
            ways.UNEVEN_POWER = power
            shares.append(psnr(between.frame(0.5)[Role.COLOUR], wanted) - best)
            ways.UNEVEN_POWER = usual
        earlier, before, after, later = (frame(time + k, False) for k in range(-1, 3))
        none = Between(before, after, later, last=Between(earlier, before))
        shares.append(psnr(none.frame(0.5)[Role.COLOUR], wanted) - best)
        found.append(shares)
    return found


def main() -> None:
    """Measure, and print a row for each way, then for each dissolve."""
    found = {f"{name} into {other}": np.array(gains(going, coming))
             for name, going in GOING.items() for other, coming in COMING.items()}
    _print_ways(list(found.values()), "frames between")
    print("dissolve | mean | worst | below -0.2 | below -1")
    as_it_is = {name: rows[:, AS_IT_IS] for name, rows in found.items() if len(rows)}
    for name, gain in sorted(as_it_is.items(), key=lambda one: one[1].min()):
        print(f"{name} | {_row(gain)}")
    random = np.random.default_rng(DRAWN_SEED)
    drawn = [np.array(gains(draw_shot(random), draw_shot(random)[0], int(random.integers(5, 12))))
             for _ in range(DRAWN)]
    _print_ways(drawn, "frames between of dissolves that are drawn")


def _print_ways(found: Sequence[np.ndarray], name: str) -> None:
    """A row for each way, of gains of dissolves."""
    every = np.concatenate([rows for rows in found if len(rows)])
    print(f"{len(every)} {name} | mean | worst | below -0.2 | below -1")
    for way, gain in zip(WAYS, every.T, strict=True):
        print(f"{way} | {_row(gain)}")


def _row(gain: np.ndarray) -> str:
    return (f"{gain.mean():.2f} dB | {gain.min():.2f} dB | {(gain < -0.2).sum()} | "
            f"{(gain < -1).sum()}")


if __name__ == "__main__":
    main()
