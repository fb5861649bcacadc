"""Make the documents' pictures of the default network again, after another one is shipped.

    python -m training.measure.pictures HELMET SHOTS [--only NAME,...]

HELMET is what `training/measure/validation/showcase.py` renders. SHOTS holds a folder for each
other scene of the gallery, with noisy.####.exr and reference.####.exr. Also records the figures of
the product shot, which docs/gallery.md has to repeat, and prints what each picture took. With
POSTFX_BPY_PYTHON the panels of Blender are drawn, too. The other pictures do not change with that
network; docs/gallery.md has the commands of all.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
IMAGES = ROOT / "docs/images"
WORK = Path("out/pictures")
"""Where samples write, below the project's folder."""
SCENES = ("garage", "doorway", "mist", "staircase", "living_room")
"""Scenes of the gallery beside the product shot, named as their folders."""
BLENDER_PASSES = ("Combined", "Diffuse Color", "Glossy Color", "Normal", "Depth", "Vector")
SIDES = ("noisy", "oidn", "postfx")
RECORD = ("-m", "training.measure.record", "showcase", "--note",
          "960x540 by training/measure/validation/showcase.py, 4 samples a pixel", "--", "python")


def main(argv: list[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("helmet")
    parser.add_argument("shots")
    parser.add_argument("--only", type=lambda text: text.split(","),
                        help=f"of helmet, {', '.join(SCENES)}, planes, panels")
    args = parser.parse_args(argv)
    shutil.rmtree(ROOT / WORK, ignore_errors=True)
    (ROOT / WORK).mkdir(parents=True)
    for name, words in commands(args.helmet, args.shots):
        if args.only and name not in args.only:
            continue
        begin = time.perf_counter()
        subprocess.run([sys.executable, *words], cwd=ROOT, stdout=subprocess.DEVNULL, check=True)
        print(f"{name}: {time.perf_counter() - begin:.0f} s", flush=True)
    for made, shown in pictures():
        if (ROOT / WORK / made).exists():
            shutil.copyfile(ROOT / WORK / made, IMAGES / shown)


def commands(helmet: str, shots: str) -> Iterator[tuple[str, list[str]]]:
    """Names and commands of Python."""
    yield "helmet", [*RECORD, "samples/showcase.py", helmet, str(WORK), "--rendered",
                     "as rendered, 4 samples", "--reference", "80 samples"]
    for scene in SCENES:
        yield scene, ["samples/showcase.py", f"{shots}/{scene}", str(WORK), "--name", scene,
                      "--places", "0,0"]  # within each of them; the gallery shows no crops
    yield "planes", ["samples/planes.py", f"{WORK}/planes.jpg"]
    yield "planes", ["samples/planes.py", f"{WORK}/planes_blender.jpg",
                     f"{shots}/garage/noisy.####.exr", ",".join(BLENDER_PASSES)]
    if "POSTFX_BPY_PYTHON" in os.environ:
        yield "panels", ["samples/blender_panels.py", str(WORK)]


def pictures() -> Iterator[tuple[str, str]]:
    """What the commands write, and its name among the documents' pictures."""
    for name in ("showcase.jpg", "showcase.webp", "planes.jpg", "planes_blender.jpg",
                 "blender_panel.png", "blender_passes.png"):
        yield name, name
    for side in SIDES:
        yield f"showcase_{side}.jpg", f"gallery/helmet_{side}.jpg"
        for scene in SCENES:
            yield f"{scene}_{side}.jpg", f"gallery/{scene}_{side}.jpg"


if __name__ == "__main__":
    main(sys.argv[1:])
