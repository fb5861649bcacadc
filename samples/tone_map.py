"""Tone-map scene-linear frames to pictures, exposed half a stop up.

python samples/tone_map.py [OUTPUT_FOLDER]
"""
import sys
from pathlib import Path

import postfx

output = Path(sys.argv[1] if len(sys.argv) > 1 else "out/tone_map")
# in stops; "auto" meters every frame instead
look = postfx.Pipeline([postfx.ToneMap(look="aces2")], exposure=0.5)
for frame in postfx.read_sequence(Path(__file__).parent / "room" / "noisy.####.exr", frames="1-2"):
    print("wrote", postfx.write_frame(output / f"picture.{frame.number:04d}.png", look(frame)))
