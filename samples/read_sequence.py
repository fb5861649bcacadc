"""Read a sequence of EXR frames and print what is in it.

python samples/read_sequence.py [PATTERN]
"""
import sys
from pathlib import Path

import postfx

pattern = sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parent / "room" / "noisy.####.exr"
for frame in postfx.read_sequence(pattern, frames="1-3",
                                  planes=[postfx.Role.COLOUR, postfx.Role.MOTION]):
    spec, motion = frame.spec, frame[postfx.Role.MOTION]
    print(f"frame {frame.number}: {spec.width}x{spec.height}, {frame.samples} samples a "
          f"pixel, jitter {frame.jitter}, planes {', '.join(spec.roles)}, largest motion "
          f"{abs(motion).max():.1f} pixels")
