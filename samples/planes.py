"""One picture of what a renderer should write: the planes of a frame of the sample sequence, and what comes out.

python samples/planes.py [PICTURE.jpg]

Each plane is drawn as `postfx inspect --pictures` draws it.
"""
import sys
from pathlib import Path

import numpy as np

import postfx
from postfx.doctor.pictures import picture
from postfx.frame import Role

ROWS = ((Role.COLOUR, Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO, Role.NORMAL),
        (Role.DEPTH, Role.MOTION, Role.ROUGHNESS, None))  # None: the result, at the render's size
FRAME, GAP = 6, 4  # late enough to have a history; pixels between the pictures

target = Path(sys.argv[1] if len(sys.argv) > 1 else "out/planes.jpg")
passes = postfx.Pipeline([postfx.DenoiseUpscale(scale=1)])
for frame in postfx.read_sequence(Path(__file__).parent / "room" / "noisy.####.exr", frames=f"1-{FRAME}"):
    clean = passes(frame)
drawn = [[picture(frame[role] if role else clean[Role.COLOUR], role or Role.COLOUR) for role in row] for row in ROWS]
apart = [[np.pad(one, ((0, GAP), (0, GAP), (0, 0)), constant_values=255) for one in row] for row in drawn]
sheet = np.concatenate([np.concatenate(row, 1) for row in apart])[:-GAP, :-GAP].astype(np.float32) / 255
print("wrote", postfx.write_frame(target, postfx.Frame({Role.COLOUR: sheet}, encoding="srgb")))
