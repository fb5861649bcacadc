"""A renderer that keeps to a time for each frame: the size to render at is chosen by the times of
the frames before.

python samples/render_size.py [PICTURE] [--time 400] [--size 640x360] [--frames 40] [--model s]

The ray caster of ray_caster.py renders, and the denoised upscaler brings every frame to the same
size with its history. In the middle third of the frames, a frame is rendered with twice the
samples. Prints each frame's size and time, and draws both. Needs matplotlib.
"""
import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from ray_caster import render

import postfx
from postfx import Role, integrate

parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
parser.add_argument("picture", nargs="?", type=Path,
                    default=Path(tempfile.gettempdir()) / "render_size.png")
parser.add_argument("--time", type=float, default=400, help="milliseconds that a frame may take")
parser.add_argument("--size", default="640x360", help="of the output")
parser.add_argument("--frames", type=int, default=40)
parser.add_argument("--model", default="s")
parser.add_argument("--threads", type=int, default=2)
chosen = parser.parse_args()

size = tuple(map(int, chosen.size.split("x")))
controller = postfx.RenderSize(size, chosen.time)
chain = postfx.Pipeline([postfx.DenoiseUpscale(size=size, model=chosen.model)],
                        postfx.Device("cpu", threads=chosen.threads))
jitter, times, widths = integrate.jitter_sequence(integrate.jitter_length(2)), [], []
for number in range(1, chosen.frames + 1):
    heavy = chosen.frames // 3 < number <= 2 * chosen.frames // 3
    width, height = controller.choose()
    began = time.perf_counter()
    frame = render(number, width, height, 2 if heavy else 1, jitter[(number - 1) % len(jitter)])
    shown = chain(frame)
    times.append(1e3 * (time.perf_counter() - began))
    widths.append(width)
    controller.note_time(times[-1])
    print(f"frame {number:3}  {'heavy' if heavy else 'light'}  {width}x{height}  {times[-1]:6.0f} "
          "ms", flush=True)
    assert shown[Role.COLOUR].shape[:2] == size[::-1]
settled = [taken for number, taken in enumerate(times)
           if number % (chosen.frames // 3 or 1) >= chosen.frames // 6]
print(f"settled frames: median {np.median(settled):.0f} ms of {chosen.time:.0f}")

figure = Figure((8, 4), layout="constrained")
upper, lower = figure.subplots(2, 1, sharex=True)
upper.plot(times)
upper.axhline(chosen.time, color="black", linewidth=0.8)
upper.set_ylabel("ms a frame")
lower.step(range(len(widths)), widths, where="mid")
lower.set_ylabel("render width")
lower.set_xlabel("frame; heavier in the middle third")
figure.savefig(chosen.picture, dpi=80)
print(f"wrote {chosen.picture}")
