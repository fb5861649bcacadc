"""What is the hit distance of reflections worth? The ray caster's floor as polished metal, the
camera passing over it.

python samples/reflections.py [--roughness 0.05 0.1 0.2] [--models s,m] [--frames 8] \\
    [--samples 2] [--size 240x136]

Prints PSNR in dB of the floor and of the rest, mean of frames 6 and 8 at twice the size: without
history, with the surfaces' motion, and with the plane `specular_hit_distance`. Takes a minute a
roughness on a CPU.
"""
import argparse
import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from ray_caster import FLOOR, FOV, camera, render, trace

import postfx
from postfx import Role, integrate
from postfx.colour.views import to_codes

METHODS = ("no history", "surface motion", "hit distance")


def floor_mask(number: int, width: int, height: int) -> np.ndarray:
    """(height, width): where a frame shows the floor itself."""
    eye, rays = integrate.view_rays(width, height,
                                    camera(number) @ integrate.perspective(FOV, width, height))
    return trace(np.broadcast_to(eye, rays.shape), rays, number)[1] == FLOOR


def variants(frames: list[postfx.Frame]) -> Iterator[list[postfx.Frame]]:
    """The frames as each of METHODS gets them."""
    bare = [replace(frame, planes={role: plane for role, plane in frame.planes.items()
                                   if role is not Role.SPECULAR_HIT_DISTANCE}) for frame in frames]
    yield [replace(frame, reset=True) for frame in bare]
    yield bare
    yield frames


def psnr(errors: list[np.ndarray]) -> float:
    return -10 * math.log10(float(np.mean([np.square(error).mean() for error in errors])))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--roughness", type=float, nargs="+", default=[0.05, 0.1, 0.2])
    parser.add_argument("--models", default="s,m")
    parser.add_argument("--frames", type=int, default=8)
    parser.add_argument("--judged", type=int, nargs="+", default=[6, 8],
                        help="frames that are compared, from 1")
    parser.add_argument("--samples", type=int, default=2)
    parser.add_argument("--reference-samples", type=int, default=96)
    parser.add_argument("--size", default="240x136")
    arguments = parser.parse_args()
    width, height = map(int, arguments.size.split("x"))
    jitter = integrate.jitter_sequence(integrate.jitter_length(2))
    print(f"| roughness | model | {' | '.join(METHODS)} | the rest of the picture "
          f"|\n|{' --- |' * 6}")
    for roughness in arguments.roughness:
        frames = [render(number, width, height, arguments.samples,
                         jitter[(number - 1) % len(jitter)], floor=roughness)
                  for number in range(1, arguments.frames + 1)]
        stops = integrate.exposure_hint(frames[0][Role.COLOUR])
        factor = 2.0**stops
        references = [render(number, 2 * width, 2 * height, arguments.reference_samples, None,
                             1000 + number, roughness)
                      for number in arguments.judged]
        wanted = {frame.number: to_codes(frame[Role.COLOUR], factor) for frame in references}
        masks = {number: floor_mask(number, 2 * width, 2 * height) for number in arguments.judged}
        for model in arguments.models.split(","):
            floor, rest = [], []
            for some in variants(frames):
                passes = postfx.Pipeline([postfx.DenoiseUpscale(scale=2, model=model)],
                                         exposure=stops, cuts="none")
                made = {frame.number: passes(frame)[Role.COLOUR] for frame in some}
                errors = {number: to_codes(made[number], factor) - wanted[number]
                          for number in arguments.judged}
                floor.append(psnr([errors[number][masks[number]] for number in errors]))
                rest.append(psnr([errors[number][~masks[number]] for number in errors]))
            figures = " | ".join(f"{value:.2f}" for value in floor)
            print(f"| {roughness:g} | {model} | {figures} | {rest[2] - rest[1]:+.2f} |", flush=True)


if __name__ == "__main__":
    main()
