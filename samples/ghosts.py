"""Measure the trails that sparks without motion vectors leave, with and without a reactive mask.

python samples/ghosts.py [--models s,m] [-o ghosts.png]

Sparks are put in front of the frames of samples/room, in their colour only. Printed is the mean squared error x1000, in
the display curve, of pixels that are clear of sparks now, but were covered by one in the frame before, or in any frame
before; and the PSNR of whole frames. Without sparks, the same pixels tell what noise of denoising and reference leaves.
The picture shows the last frame, by the last model: without a mask, with one, and the reference.
"""
import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

import postfx
from postfx import Frame, Role

ROOM = Path(__file__).parent / "room"
SIZE, SCALE = (320, 180), 2
COUNT, CLEAR = 40, 4  # sparks, and output pixels around one that are not clear of it


@dataclass(frozen=True)
class Shot:
    """A frame with sparks in its colour, colour without them, their coverage; and at output size what it should be."""

    frame: Frame
    opaque_colour: np.ndarray
    coverage: np.ndarray
    reference: np.ndarray
    covered: np.ndarray

    def given(self, role: Role, plane: np.ndarray) -> Frame:
        return replace(self.frame, planes={**self.frame.planes, role: plane})


WAYS: dict[str, Callable[[Shot], Frame]] = {
    "no sparks": lambda shot: shot.given(Role.COLOUR, shot.opaque_colour),
    "no mask": lambda shot: shot.frame,
    "coverage": lambda shot: shot.given(Role.REACTIVE, shot.coverage),
    "difference": lambda shot: shot.given(Role.OPAQUE_COLOUR, shot.opaque_colour),
}


def sparks(number: int, scale: int, offset: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Premultiplied light and coverage of sparks that fly apart and fall, at pixels' centres plus an offset."""
    random, axes = np.random.default_rng(3), zip(SIZE, offset, strict=True)
    x, y = np.meshgrid(*((np.arange(scale * side) + 0.5 + shift) / scale for side, shift in axes))
    places, angles = random.random((COUNT, 2)) * SIZE, random.uniform(0, 2 * np.pi, COUNT)
    steps = np.stack((np.cos(angles), np.sin(angles)), 1) * random.uniform(2, 7, (COUNT, 1))
    radii, lights = random.uniform(0.8, 2.2, COUNT), np.array([1, 0.55, 0.2]) * random.uniform(2, 8, (COUNT, 1))
    light, coverage = np.zeros((*x.shape, 3)), np.zeros((*x.shape, 1))
    for place, radius, colour in zip(places + number * steps + (0, 0.15 * number**2), radii, lights, strict=True):
        left, top = place % SIZE
        front = np.clip((radius - np.hypot(x - left, y - top)) / (0.35 * radius), 0, 1)[..., None]
        light, coverage = light * (1 - front) + front * colour, coverage * (1 - front) + front
    return light.astype(np.float32), coverage.astype(np.float32)


def shots() -> list[Shot]:
    """Frames of the room with sparks. Those of the reference are means of 3x3 points a pixel."""
    found = []
    for noisy, reference in zip(*(postfx.read_sequence(ROOM / f"{name}.####.exr") for name in ("noisy", "reference")),
                                strict=True):
        light, coverage = sparks(noisy.number, 1, noisy.jitter)
        points = [sparks(noisy.number, SCALE, (x / 3 - 1 / 3, y / 3 - 1 / 3)) for x, y in np.ndindex(3, 3)]
        bright, hidden = (np.mean(values, 0) for values in zip(*points, strict=True))
        frame = replace(noisy, planes={**noisy.planes, Role.COLOUR: noisy[Role.COLOUR] * (1 - coverage) + light})
        wanted = reference[Role.COLOUR] * (1 - hidden) + bright
        found.append(Shot(frame, noisy[Role.COLOUR], coverage, wanted, hidden[..., 0] > 0))
    return found


def seen(colour: np.ndarray, exposure: float) -> np.ndarray:
    """Within [0, 1], as a display shows it."""
    light = np.maximum(colour, 0) * exposure
    return (light / (1 + light)) ** (1 / 2.2)


def clear(covered: np.ndarray) -> np.ndarray:
    """Pixels that are not near a spark."""
    for axis in (0, 1):
        covered = np.logical_or.reduce([np.roll(covered, shift, axis) for shift in range(-CLEAR, CLEAR + 1)])
    return ~covered


def measure(results: list[np.ndarray], sequence: list[Shot]) -> tuple[float, float, float]:
    """Errors x1000 where sparks were one frame before and any number of frames before, and the PSNR in dB."""
    was, errors = np.zeros_like(sequence[0].covered), ([], [], [])
    for before, shot, result in zip(sequence, sequence[1:], results[1:], strict=False):
        error = np.square(seen(result, shot.frame.exposure) - seen(shot.reference, shot.frame.exposure))
        was, now_clear = was | before.covered, clear(shot.covered)
        for kept, pixels in zip(errors, (before.covered & now_clear, was & now_clear, ...), strict=True):
            kept.append(error[pixels].ravel())
    last, ever, all_pixels = (float(np.concatenate(kept).mean()) for kept in errors)
    return 1000 * last, 1000 * ever, -10 * np.log10(all_pixels)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--models", default="s,m")
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    sequence, pictures = shots(), {}
    for model in args.models.split(","):
        for name, frame_of in WAYS.items():
            chain = postfx.Pipeline([postfx.DenoiseUpscale(scale=SCALE, model=model)], exposure="metadata")
            results = [chain(frame_of(shot))[Role.COLOUR] for shot in sequence]
            last, ever, psnr = measure(results, sequence)
            whole = f"  {psnr:5.2f} dB" if name != "no sparks" else ""
            print(f"{model:4} {name:12} {last:6.2f} one frame before  {ever:6.2f} ever before{whole}", flush=True)
            pictures[name] = results[-1]
    if args.output:
        shot = sequence[-1]
        shown = np.concatenate([pictures["no mask"], pictures["difference"], shot.reference], 1)
        pixels = np.ascontiguousarray(255 * seen(shown, shot.frame.exposure) + 0.5, np.uint8)
        oiio.ImageBuf(pixels).write(str(args.output))


if __name__ == "__main__":
    main()
