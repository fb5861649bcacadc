"""What it costs and saves to leave alone what has converged, on a frame that was sampled
adaptively.

python samples/converged.py [--size 256x144] [--passes 128] [--model m] [--runs 5] [--one-place]

Renders samples of one frame of samples/ray_caster.py one by one, spread over the pixel, or all at
one place of it, as real-time renderers do: the variance then knows nothing of what lies between
places, such as edges. For each target a pixel stops when the standard error of its mean is at most
so much of it, in steps of 16 samples. The frame, with the variance and number of its samples, is
enlarged to twice its size: denoised everywhere, and with what has converged left alone. Prints
samples a pixel, the share left alone, PSNR in dB there and of the whole (against 64 samples of each
pixel of the output), and milliseconds of the denoiser, medians of runs in turn. pip install
'.[bench]'
"""

import argparse
import statistics
from dataclasses import replace

import numpy as np
from ray_caster import render

import postfx
from postfx import Role, integrate
from postfx.kernels.image import resample
from postfx.masks import Threshold, strength_of_converged
from postfx.tools.bench.metrics import to_codes

TARGETS = (0.1, 0.05, 0.02, 0.01)
STEP, REFERENCE = 16, 64


def adaptive(passes: list[np.ndarray], target: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean, variance of the samples and their number (float32), each pixel having stopped at its
    target."""
    total = squares = np.zeros(passes[0].shape)
    mean, variance, count = total, total, np.zeros((*total.shape[:2], 1))
    for done, colour in enumerate(passes, 1):
        total, squares = total + colour, squares + colour.astype(np.float64)**2
        if done % STEP == 0:
            spread = np.maximum(squares / done - (total / done)**2, 0) * done / (done - 1)
            runs = (count == 0) | (np.sqrt(variance / np.maximum(count, 1)).sum(2, keepdims=True)
                                   > target * mean.sum(2, keepdims=True))
            mean, variance = np.where(runs, total / done, mean), np.where(runs, spread, variance)
            count = np.where(runs, done, count)
    return tuple(plane.astype(np.float32) for plane in (mean, variance, count))


def compare(frames: list[postfx.Frame], model: str,
            runs: int) -> tuple[list[np.ndarray], list[float]]:
    """Colours of frames, each by a chain of its own, and the median time of its denoiser."""
    chains = [postfx.Pipeline([postfx.DenoiseUpscale(scale=2, model=model)]) for _ in frames]
    pictures = [chain(frame)[Role.COLOUR] for chain, frame in zip(chains, frames, strict=True)]
    times: list[list[float]] = [[] for _ in frames]
    for _ in range(runs + 1):
        for chain, frame, some in zip(chains, frames, times, strict=True):
            chain(frame)
            some.append(chain.timings["denoise_upscale"])
    return pictures, [statistics.median(some[1:]) for some in times]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", default="256x144")
    parser.add_argument("--passes", type=int, default=128)
    parser.add_argument("--model", default="m")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--one-place", action="store_true",
                        help="all samples of a pixel at one place")
    arguments = parser.parse_args()
    width, height = map(int, arguments.size.split("x"))
    jitter = (integrate.jitter_sequence(integrate.jitter_length(2))[0] if arguments.one_place
              else None)
    first = render(1, width, height, 1, np.zeros(2) if jitter is None else jitter)
    samples = [render(1, width, height, 1, jitter, seed)[Role.COLOUR].astype(np.float32)
               for seed in range(arguments.passes)]
    reference = render(1, 2 * width, 2 * height, REFERENCE, None)[Role.COLOUR]
    exposure = integrate.exposure_hint(reference)
    print("target  samples  left alone  there: input  denoised  whole: left alone  denoised    ms "
          "left alone  denoised")
    for target in TARGETS:
        mean, variance, count = adaptive(samples, target)
        planes = {**first.planes, Role.COLOUR: mean, Role.SAMPLE_VARIANCE: variance,
                  Role.SAMPLE_COUNT: count}
        strength = strength_of_converged(planes, Threshold(error=target))
        frame = replace(first, planes=planes, exposure=exposure, samples=None)
        masked = replace(frame, planes={**planes, Role.STRENGTH: strength})
        pictures, times = compare([masked, frame], arguments.model, arguments.runs)
        alone = resample(strength, 2 * height, 2 * width, first.jitter)[:, :, 0] == 0
        errors = [(to_codes(picture, 2.0**exposure) - to_codes(reference, 2.0**exposure))**2
                  for picture in pictures]
        scores = [-10 * np.log10(part.mean())
                  for part in (*(error[alone] for error in errors), *errors)]
        print(f"{target:6.2f}  {count.mean():7.1f}  {100 * alone.mean():9.1f} %  "
              f"{scores[0]:12.2f}  {scores[1]:8.2f}  {scores[2]:17.2f}  {scores[3]:8.2f}  "
              f"{times[0]:15.0f}  {times[1]:8.0f}", flush=True)


if __name__ == "__main__":
    main()
