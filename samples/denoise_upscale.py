"""Denoise a sequence and make it twice as large; the EXR files stay scene-linear.

python samples/denoise_upscale.py [OUTPUT_FOLDER]
"""
import sys
from pathlib import Path

import postfx

output = Path(sys.argv[1] if len(sys.argv) > 1 else "out/denoise_upscale")
# keeps the history: give it the frames in order
denoise = postfx.Pipeline([postfx.DenoiseUpscale(scale=2)])
for frame in postfx.read_sequence(Path(__file__).parent / "room" / "noisy.####.exr"):
    clean = denoise(frame)
    print("wrote", postfx.write_frame(output / f"clean.{frame.number:04d}.exr", clean))
