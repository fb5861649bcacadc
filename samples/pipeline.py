"""Denoise, upscale and tone-map in one pipeline, and see what ran and how long it took.

python samples/pipeline.py [OUTPUT_FOLDER]
"""
import sys
from pathlib import Path

import postfx

output = Path(sys.argv[1] if len(sys.argv) > 1 else "out/pipeline")
passes = postfx.Pipeline([postfx.DenoiseUpscale(scale=1.5), postfx.ToneMap()], exposure="auto")
for frame in postfx.read_sequence(Path(__file__).parent / "room" / "noisy.####.exr"):
    postfx.write_frame(output / f"picture.{frame.number:04d}.png", passes(frame))
    print(frame.number, {name: f"{ms:.0f} ms" for name, ms in passes.timings.items()})
print(passes.explain())
