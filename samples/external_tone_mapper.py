"""A tone mapper outside postfx, measured by checkerboards: right, twice too bright, half as bright,
and drifting.

python samples/external_tone_mapper.py [FOLDER]
"""

import contextlib
import io
import json
import os
import sys
import tempfile
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from postfx.cli.main import main

ROOM = Path(__file__).parent / "room" / "noisy.####.exr"
FRAMES = "1-4"
MISTAKES = {
    "right": lambda number: 0.0,
    "x2": lambda number: 1.0,
    "x0.5": lambda number: -1.0,
    "drifting": lambda number: 0.2 * (number - 1),
}
"""Stops by which the chain exposes more than it is told, by frame number."""


def show(light):
    """A tone curve of one's own, which no part of postfx knows: an S over 14 stops. Exposed light
    to codes 0..1."""
    t = np.clip((np.log2(np.maximum(light, 1e-6) / 0.18) + 8) / 14, 0, 1)
    return 1.1 * t**2 * (3 - 2 * t) / (1 + 0.1 * t)


def grade(source, target, stops=0.0):
    """What another program does: read light and its exposure from the header, expose, tone-map,
    write a PNG."""
    picture = oiio.ImageBuf(str(source))
    exposure = picture.spec().getattribute("postfx:exposureUsedEV")
    codes = show(picture.get_pixels(oiio.FLOAT)[..., :3] * 2.0**(exposure + stops))
    written = oiio.ImageBuf(codes.astype(np.float32))
    target.parent.mkdir(parents=True, exist_ok=True)
    if not written.write(str(target), oiio.UINT8):
        raise SystemExit(written.geterror())


def postfx(*words):
    """Run a command line of postfx; gives what it prints."""
    with contextlib.redirect_stdout(io.StringIO()) as told, contextlib.redirect_stderr(
        io.StringIO()
    ) as errors:
        if main(list(map(str, words))) == 2:
            raise SystemExit(errors.getvalue())
    return told.getvalue()


temporary = tempfile.TemporaryDirectory(prefix="external-tone-mapper-")  # gone at the end
folder = Path(sys.argv[1] if len(sys.argv) > 1 else temporary.name)

# 1. Frames that hold the checkerboard, with the exposure that the tone mapper has to apply in their
#    headers.
os.environ["POSTFX_EXPOSURE_TOOL"] = "1"
postfx("run", ROOM, "-o", folder / "boards/room.####.exr", "--frames", FRAMES, "--overwrite")
del os.environ["POSTFX_EXPOSURE_TOOL"]

# 2. What the tone mapper makes of the chart: its curve.
postfx("exposure", ROOM, "--chart", folder / "chart.exr")
grade(folder / "chart.exr", folder / "chart.png")

# 3. Boards through the chain, without and with a mistake in it, handed back and measured.
print(f"{'chain':<10}{'made':>17}{'measured':>17}  verdict")
for name, stops in MISTAKES.items():
    boards = sorted((folder / "boards").glob("room.*.exr"))
    for board in boards:
        number = int(board.name[5:9])
        grade(board, folder / name / f"room.{number:04d}.png", stops(number))
    report = json.loads(postfx("exposure", ROOM, "--frames", FRAMES, "--reference", "auto",
                               "--json", "--graded",
                               folder / name / "room.####.png", "--response", folder / "chart.png"))
    made = [stops(frame["number"]) for frame in report["frames"]]
    found = [frame["mismatch_ev"] for frame in report["frames"]]
    ranges = "".join(f"{min(stops):>+8.2f} to {max(stops):+.2f}" for stops in (made, found))
    print(f"{name:<10}{ranges}  {report['verdict']}")
    if max(abs(one - other) for one, other in zip(made, found, strict=True)) > 0.05:
        raise SystemExit(f"{name}: not measured within 0.05 EV")
