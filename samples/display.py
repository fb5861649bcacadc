"""Two pictures of docs/howto/display.md: one frame by six looks, and a ramp over eight codes,
rounded and dithered.

python samples/display.py [FOLDER] [--frame FILE.exr]

The looks are, in the first row, `local`, ACES 2 through OpenColorIO and `neutral`; in the second
one `agx`, `reinhard` and light that is only exposed and cut. The ramp's contrast is 25 times what
it is on a screen. Needs Pillow.
"""
import argparse
from pathlib import Path

import numpy as np
from PIL import Image

import postfx
from postfx import Role
from postfx.io.quantisation import Dither, quantise
from postfx.passes.display import make_display_passes

REFERENCE = Path(__file__).parent / "room" / "reference.0004.exr"
LOOKS = ("local", "ocio:", "neutral", "agx", "reinhard", None)

parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
parser.add_argument("folder", nargs="?", type=Path, default=Path("out/display"))
parser.add_argument("--frame", type=Path, default=REFERENCE)
chosen = parser.parse_args()
chosen.folder.mkdir(parents=True, exist_ok=True)

(frame,) = postfx.read_sequence(chosen.frame)
light = postfx.Frame({Role.COLOUR: frame[Role.COLOUR]})
chains = [make_display_passes(True, look, no_tonemap=look is None)[0] for look in LOOKS]
shown = [postfx.Pipeline(passes, exposure="auto")(light)[Role.COLOUR] for passes in chains]
rows = np.concatenate([np.concatenate(shown[at:at + 3], 1) for at in (0, 3)])
views = Image.fromarray(quantise(rows, 8, Dither.NONE)[..., :3])
views.thumbnail((960, 960), Image.Resampling.LANCZOS)
views.save(chosen.folder / "views.jpg", quality=90)

first, codes = 100, 8
ramp = np.broadcast_to(np.linspace(first, first + codes, 900,
                                   dtype=np.float32)[None, :, None] / 255, (110, 900, 1))
bands = [128 + 25 * (quantise(ramp, 8, dither).astype(int) - first - codes // 2)
         for dither in (Dither.NONE, Dither.MOVING)]
white = np.full((6, 900, 1), 255)
picture = np.concatenate([bands[0], white, bands[1]])[..., 0]
Image.fromarray(np.clip(picture, 0, 255).astype(np.uint8)).save(chosen.folder / "dither.png")
print("wrote", chosen.folder / "views.jpg", "and", chosen.folder / "dither.png")
