"""Denoise the sample sequence forwards, with a run-up and in both directions: PSNR of every frame,
and a picture of the first.

python samples/both_ways.py [PICTURE.png] [--model m]

The picture: the first frame as it was rendered, denoised forwards, with a run-up and in both
directions, and the reference.
"""
import argparse
from pathlib import Path

import numpy as np

import postfx
from postfx import Frame, Role

ROOM = Path(__file__).parent / "room"
CROP = slice(120, 300), slice(60, 260)  # of the output: boards and a corner with little light


def seen(colour: np.ndarray, exposure_factor: float) -> np.ndarray:
    """Within [0, 1], as a display shows it."""
    light = np.maximum(colour, 0) * exposure_factor
    return (light / (1 + light)) ** (1 / 2.2)


def psnr(colour: np.ndarray, reference: Frame) -> float:
    pictures = (seen(light, reference.exposure_factor)
                for light in (colour, reference[Role.COLOUR]))
    return float(-10 * np.log10(np.square(np.subtract(*pictures)).mean()))


parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
parser.add_argument("picture", nargs="?", type=Path, default=Path("out/both_ways.png"))
parser.add_argument("--model", default="xl")
args = parser.parse_args()

shot = postfx.read_sequence(ROOM / "noisy.####.exr")
references = postfx.read_sequence(ROOM / "reference.####.exr")
later = postfx.Backwards(shot, scale=2, model=args.model)
forwards = postfx.Pipeline([postfx.DenoiseUpscale(scale=2, model=args.model)])
run_up = postfx.Pipeline([postfx.DenoiseUpscale(scale=2, model=args.model)],
                         run_up=postfx.RunUp(shot))
both = postfx.Pipeline([postfx.DenoiseUpscale(scale=2, model=args.model), postfx.BothWays()])
print("frame  forwards  run-up  both ways (PSNR, dB)")
for frame, reference in zip(shot, references, strict=True):
    results = [passed[Role.COLOUR]
               for passed in (forwards(frame), run_up(frame), both(later(frame)))]
    one, two, three = (psnr(result, reference) for result in results)
    print(f"{frame.number:5d}  {one:8.2f}  {two:6.2f}  {three:9.2f}")
    if frame.number == 1:
        columns = [frame[Role.COLOUR].repeat(2, 0).repeat(2, 1), *results, reference[Role.COLOUR]]
        row = np.concatenate([seen(column[CROP], reference.exposure_factor) for column in columns],
                             1)
        sheet = Frame({Role.COLOUR: row.repeat(2, 0).repeat(2, 1).astype(np.float32)},
                      encoding="srgb")
print("wrote", postfx.write_frame(args.picture, sheet))
