"""One picture: a noisy frame of the sample sequence beside what postfx makes of it, with the same exposure and look.

python samples/before_after.py [PICTURE.png]
"""
import sys
from pathlib import Path

import numpy as np

import postfx
from postfx.frame import Role

FRAME = 6  # late enough to have a history

picture = Path(sys.argv[1] if len(sys.argv) > 1 else "out/before_after.png")
before = postfx.Pipeline([postfx.ToneMap()], exposure="metadata")
after = postfx.Pipeline([postfx.DenoiseUpscale(scale=2), postfx.ToneMap()], exposure="metadata")
for frame in postfx.read_sequence(Path(__file__).parent / "room" / "noisy.####.exr", frames=f"1-{FRAME}"):
    clean = after(frame)
noisy = before(frame)[Role.COLOUR].repeat(2, 0).repeat(2, 1)
both = np.concatenate([noisy, clean[Role.COLOUR]], 1)
print("wrote", postfx.write_frame(picture, postfx.Frame({Role.COLOUR: both}, encoding=clean.encoding)))
