"""Make the documents' pictures of the default network again, after another one is shipped.

    python -m training.measure.pictures HELMET SHOTS [--images docs/images] [--only NAME,...]

HELMET is what `training/measure/validation/showcase.py` renders. SHOTS holds a folder for each
other scene of the gallery, with noisy.####.exr and reference.####.exr. Prints what each picture
took, and at last the figures of the product shot, which `training.measure.record` keeps for the
gallery. With POSTFX_BPY_PYTHON the panels of Blender are drawn, too. The other pictures do not
change with that network; docs/gallery.md has the commands of all.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
SAMPLES = ROOT / "samples"
SCENES = ("garage", "doorway", "mist", "staircase", "living_room")
"""Scenes of the gallery beside the product shot, named as their folders."""
SIDES = ("noisy", "oidn", "postfx")


def main(argv: list[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("helmet", type=Path)
    parser.add_argument("shots", type=Path)
    parser.add_argument("--images", type=Path, default=ROOT / "docs/images")
    parser.add_argument("--only", type=lambda text: text.split(","),
                        help=f"of helmet, {', '.join(SCENES)}, planes, panels")
    args = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as folder:
        work, said = Path(folder), ""
        for name, words in commands(args.helmet, args.shots, work):
            if args.only and name not in args.only:
                continue
            begin = time.perf_counter()
            printed = run(words)
            said = printed if name == "helmet" else said
            print(f"{name}: {time.perf_counter() - begin:.0f} s", flush=True)
        for path in keep(work, args.images):
            print(f"wrote {path}")
    print(said, end="")


def commands(helmet: Path, shots: Path, work: Path) -> Iterator[tuple[str, list[str]]]:
    """Names and commands, which write below `work` as docs/images is ordered."""
    yield "helmet", ["showcase.py", str(helmet), str(work / "helmet")]
    for scene in SCENES:
        yield scene, ["showcase.py", str(shots / scene), str(work / "scenes"), "--name", scene,
                      "--places", "0,0"]  # within each of them; the gallery shows no crops
    yield "planes", ["planes.py", str(work / "planes.jpg")]
    garage = str(shots / "garage/noisy.####.exr")
    yield "planes", ["planes.py", str(work / "planes_blender.jpg"), garage]
    if "POSTFX_BPY_PYTHON" in os.environ:
        yield "panels", ["blender_panels.py", str(work)]


def run(words: list[str]) -> str:
    """What a sample prints; ends the program where it fails."""
    done = subprocess.run([sys.executable, str(SAMPLES / words[0]), *words[1:]], cwd=ROOT,
                          stdout=subprocess.PIPE, text=True, check=True)
    return done.stdout


def keep(work: Path, images: Path) -> Iterator[Path]:
    """Copy what was made to where documents show it."""
    for name in ("showcase.jpg", "showcase.webp"):
        yield from copy(work / "helmet" / name, images / name)
    for side in SIDES:
        yield from copy(work / f"helmet/showcase_{side}.jpg", images / f"gallery/helmet_{side}.jpg")
        for scene in SCENES:
            yield from copy(work / f"scenes/{scene}_{side}.jpg",
                            images / f"gallery/{scene}_{side}.jpg")
    for made in sorted(work.glob("*.*g")):
        yield from copy(made, images / made.name)


def copy(made: Path, target: Path) -> Iterator[Path]:
    """The target, where something was made for it."""
    if not made.exists():
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(made, target)
    yield target


if __name__ == "__main__":
    main(sys.argv[1:])
