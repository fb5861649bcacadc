"""Measure the trails that particles without motion vectors leave, with and without a reactive mask.

python samples/ghosts.py [--models s,m,xl] [--smoke] [-o ghosts.png]

Sparks, or puffs of grey smoke, are put in front of the frames of samples/room, in their colour
only. Printed is the mean squared error x1000, in the display curve, of pixels that are clear of
them now, but were covered in the frame before, or in any frame before; and the PSNR of whole
frames. Without particles, the same pixels tell what noise is left by denoising and in the
reference. The picture is the last frame, by the last model: no mask, difference, reference.
"""
import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import OpenImageIO as oiio

import postfx
from postfx import Frame, Role

ROOM = Path(__file__).parent / "room"
SIZE, SCALE = (320, 180), 2
CLEAR = 4  # output pixels around a particle that are not clear of it


class Kind(NamedTuple):
    """How many particles, from what to what their speed and radius (pixels of 320x180), light and
    opacity are drawn."""

    count: int
    speed: tuple[float, float]
    radius: tuple[float, float]
    light: tuple[float, float]
    opacity: tuple[float, float]
    tint: tuple[float, float, float]


SPARKS = Kind(40, (2, 7), (0.8, 2.2), (2, 8), (1, 1), (1, 0.55, 0.2))
SMOKE = Kind(14, (1, 3), (5, 12), (0.02, 0.6), (0.3, 0.8), (1, 1, 1))


@dataclass(frozen=True)
class Shot:
    """A frame with particles in its colour, colour without them, their coverage; at output size
    what it should be."""

    frame: Frame
    opaque_colour: np.ndarray
    coverage: np.ndarray
    reference: np.ndarray
    covered: np.ndarray

    def given(self, role: Role, plane: np.ndarray) -> Frame:
        return replace(self.frame, planes={**self.frame.planes, role: plane})


WAYS: dict[str, Callable[[Shot], Frame]] = {
    "none there": lambda shot: shot.given(Role.COLOUR, shot.opaque_colour),
    "no mask": lambda shot: shot.frame,
    "coverage": lambda shot: shot.given(Role.REACTIVE, shot.coverage),
    "difference": lambda shot: shot.given(Role.OPAQUE_COLOUR, shot.opaque_colour),
}


def particles(kind: Kind, number: int, scale: int,
              offset: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Premultiplied light and coverage of particles that fly apart and fall, at pixels' centres
    plus an offset."""
    random, axes = np.random.default_rng(3), zip(SIZE, offset, strict=True)
    x, y = ((np.arange(scale * side) + 0.5 + shift) / scale for side, shift in axes)
    places, angles = random.random((kind.count, 2)) * SIZE, random.uniform(0, 2 * np.pi, kind.count)
    speeds, radii, lights, opacities = (random.uniform(*span, kind.count) for span in kind[1:5])
    steps = np.stack((np.cos(angles), np.sin(angles)), 1) * speeds[:, None]
    light, coverage = (np.zeros((y.size, x.size, channels)) for channels in (3, 1))
    places = (places + number * steps + (0, 0.15 * number**2)) % SIZE
    for (left, top), radius, bright, opacity in zip(places, radii, lights, opacities, strict=True):
        rows, columns = (slice(*np.searchsorted(axis, (at - radius, at + radius)))
                         for axis, at in ((y, top), (x, left)))
        distance = np.hypot(x[columns] - left, y[rows, None] - top)
        front = opacity * np.clip((radius - distance) / (0.35 * radius), 0, 1)[..., None]
        light[rows,
              columns] = light[rows, columns] * (1 - front) + front * bright * np.array(kind.tint)
        coverage[rows, columns] = coverage[rows, columns] * (1 - front) + front
    return light.astype(np.float32), coverage.astype(np.float32)


def shots(kind: Kind) -> list[Shot]:
    """Frames of the room with particles. Those of the reference are means of 3x3 points a pixel."""
    found = []
    for noisy, reference in zip(*(postfx.read_sequence(ROOM / f"{name}.####.exr")
                                  for name in ("noisy", "reference")),
                                strict=True):
        light, coverage = particles(kind, noisy.number, 1, noisy.jitter)
        points = [particles(kind, noisy.number, SCALE, (x / 3 - 1 / 3, y / 3 - 1 / 3))
                  for x, y in np.ndindex(3, 3)]
        bright, hidden = (np.mean(values, 0) for values in zip(*points, strict=True))
        frame = replace(noisy, planes={**noisy.planes,
                                       Role.COLOUR: noisy[Role.COLOUR] * (1 - coverage) + light})
        wanted = reference[Role.COLOUR] * (1 - hidden) + bright
        found.append(Shot(frame, noisy[Role.COLOUR], coverage, wanted, hidden[..., 0] > 0))
    return found


def seen(colour: np.ndarray, exposure_factor: float) -> np.ndarray:
    """Within [0, 1], as a display shows it."""
    light = np.maximum(colour, 0) * exposure_factor
    return (light / (1 + light)) ** (1 / 2.2)


def clear(covered: np.ndarray) -> np.ndarray:
    """Pixels that are not near a particle."""
    for axis in (0, 1):
        covered = np.logical_or.reduce([np.roll(covered, shift, axis)
                                        for shift in range(-CLEAR, CLEAR + 1)])
    return ~covered


def measure(results: list[np.ndarray], sequence: list[Shot]) -> tuple[float, float, float]:
    """Errors x1000 where particles were one frame before and any number of frames before, and the
    PSNR in dB."""
    was, errors = np.zeros_like(sequence[0].covered), ([], [], [])
    for before, shot, result in zip(sequence, sequence[1:], results[1:], strict=False):
        error = np.square(seen(result, shot.frame.exposure_factor)
                          - seen(shot.reference, shot.frame.exposure_factor))
        was, now_clear = was | before.covered, clear(shot.covered)
        for kept, pixels in zip(errors, (before.covered & now_clear, was & now_clear, ...),
                                strict=True):
            kept.append(error[pixels].ravel())
    last, ever, all_pixels = (float(np.concatenate(kept).mean()) for kept in errors)
    return 1000 * last, 1000 * ever, -10 * np.log10(all_pixels)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--models", default="s,m,xl")
    parser.add_argument("--smoke", action="store_true", help="puffs of smoke instead of sparks")
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    sequence, pictures = shots(SMOKE if args.smoke else SPARKS), {}
    for model in args.models.split(","):
        for name, frame_of in WAYS.items():
            chain = postfx.Pipeline([postfx.DenoiseUpscale(scale=SCALE, model=model)],
                                    exposure="metadata")
            results = [chain(frame_of(shot))[Role.COLOUR] for shot in sequence]
            last, ever, psnr = measure(results, sequence)
            whole = f"  {psnr:5.2f} dB" if name != "none there" else ""
            print(f"{model:4} {name:12} {last:6.2f} one frame before  {ever:6.2f} ever "
                  f"before{whole}", flush=True)
            pictures[name] = results[-1]
    if args.output:
        shot = sequence[-1]
        shown = np.concatenate([pictures["no mask"], pictures["difference"], shot.reference], 1)
        pixels = np.ascontiguousarray(255 * seen(shown, shot.frame.exposure_factor) + 0.5, np.uint8)
        oiio.ImageBuf(pixels).write(str(args.output))


if __name__ == "__main__":
    main()
