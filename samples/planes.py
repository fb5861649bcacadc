"""One picture of what a renderer should write: the planes of a frame, and what comes out.

python samples/planes.py [PICTURE.jpg] [PATTERN] [NAME,...]

Each plane is drawn as `postfx inspect --pictures` draws it, with its name in a corner.
"""
import sys
from pathlib import Path

import numpy as np
from pictures import name_corner

import postfx
from postfx.doctor.inspection import picture
from postfx.frame import Role

PLANES = (Role.COLOUR, Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO, Role.NORMAL, Role.DEPTH,
          Role.MOTION, Role.ROUGHNESS)
FRAME, GAP = 6, 4  # late enough to have a history; pixels between the pictures

target = Path(sys.argv[1] if len(sys.argv) > 1 else "out/planes.jpg")
pattern = sys.argv[2] if len(sys.argv) > 2 else Path(__file__).parent / "room" / "noisy.####.exr"
passes = postfx.Pipeline([postfx.DenoiseUpscale(scale=1, model="xl")])
for frame in postfx.read_sequence(pattern, frames=f"1-{FRAME}"):
    clean = passes(frame)
there = [role for role in PLANES if role in frame.planes]
names = sys.argv[3].split(",") if len(sys.argv) > 3 else [role.replace("_", " ") for role in there]
drawn = [picture(frame[role], role) for role in there]
drawn.append(picture(clean[Role.COLOUR], Role.COLOUR))  # at the render's size
drawn = [name_corner(one / np.float32(255), name)
         for one, name in zip(drawn, [*names, "postfx"], strict=True)]
drawn += [np.ones_like(drawn[0])] * (len(drawn) % 2)
apart = [np.pad(one, ((0, GAP), (0, GAP), (0, 0)), constant_values=1) for one in drawn]
rows = [np.concatenate(row, 1) for row in (apart[:len(apart) // 2], apart[len(apart) // 2:])]
sheet = np.concatenate(rows)[:-GAP, :-GAP]
print("wrote", postfx.write_frame(target, postfx.Frame({Role.COLOUR: sheet}, encoding="srgb")))
