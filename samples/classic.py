"""The classical filter beside the smallest network: error, flicker and time on the room, or on a
sequence of your own.

python samples/classic.py [PICTURE] [--noisy PATTERN --reference PATTERN] \\
    [--models plain classic s] [--threads 1]

PSNR is of colour after x/(1+x) and the sRGB curve: of the first frame, and the mean of the second
half; flicker is the mean absolute error of the difference between two frames, x1000. Time is the
processor's a frame, median of the second half, and its ratio to that of the last model in the same
run. 'plain' only resamples. Needs Pillow.
"""
import argparse
import statistics
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image
from sky import shown

import postfx
from postfx import Role

ROOM = Path(__file__).parent / "room"
parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
parser.add_argument("picture", nargs="?", type=Path,
                    default=Path(tempfile.gettempdir()) / "classic.png")
parser.add_argument("--noisy", default=str(ROOM / "noisy.####.exr"))
parser.add_argument("--reference", default=str(ROOM / "reference.####.exr"))
parser.add_argument("--models", nargs="+", default=["plain", "classic", "s"])
parser.add_argument("--threads", type=int, default=1)
chosen = parser.parse_args()

frames = list(postfx.read_sequence(chosen.noisy))
wanted = [shown(np.maximum(frame[Role.COLOUR], 0))
          for frame in postfx.read_sequence(chosen.reference)]
device = postfx.Device("cpu", threads=chosen.threads)
half = len(frames) // 2
rows = []
pictures = []
for model in chosen.models:
    options = {"strength": 0} if model == "plain" else {"model": model}
    chain = postfx.Pipeline([postfx.DenoiseUpscale(scale=2, **options)], device)
    found = []
    times = []
    for frame in frames:
        began = time.process_time()
        colour = chain(frame)[Role.COLOUR]
        times.append(1e3 * (time.process_time() - began))
        found.append(shown(np.maximum(colour, 0)))
    psnr = [-10 * np.log10(np.mean((one - other) ** 2))
            for one, other in zip(found, wanted, strict=True)]
    flicker = [np.abs((found[k] - found[k - 1]) - (wanted[k] - wanted[k - 1])).mean()
               for k in range(half, len(wanted))]
    rows.append((model, psnr[0], np.mean(psnr[half:]), 1e3 * np.mean(flicker),
                 statistics.median(times[half:])))
    pictures.append(found[-1])
print(f"{'':10} {'first':>7} {'later':>7} {'flicker':>8} {'ms':>7} {'time':>6}")
for name, first, later, flicker, taken in rows:
    print(f"{name:10} {first:7.2f} {later:7.2f} {flicker:8.2f} {taken:7.1f} "
          f"{taken / rows[-1][-1]:6.2f}")
codes = (255 * np.clip(np.concatenate(pictures, axis=1), 0, 1) + 0.5).astype(np.uint8)
Image.fromarray(codes).save(chosen.picture)
print(f"wrote {chosen.picture}")
