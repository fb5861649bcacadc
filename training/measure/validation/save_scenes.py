"""Save the validation scenes as .blend files, or render one with Cycles' own adaptive sampling.

    python save_scenes.py save --kinds water,glass --out DIR --size 160x96
    python save_scenes.py adaptive --scene DIR/water.blend --thresholds 0.2,0.05 --out DIR

Runs in Blender's Python. `save` writes DIR/KIND.blend, whole pictures of the frame in the middle of
the shot, for renderers that open a file, such as `postfx loop`. `adaptive` writes
DIR/adaptive.THRESHOLD.exr, with a pass of sample counts. Files that exist are kept.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import bpy

ROOT = Path(__file__).resolve().parents[3]
sys.path[:0] = [str(ROOT), str(ROOT / "hosts/loop")]

import render_blender  # noqa: E402

from training.measure.validation import scenes  # noqa: E402
from training.measure.validation.render_scenes import BOUNCES, pair  # noqa: E402

FRAME = 2
CLAMP = 10.0  # of indirect light, as artists set it
MOST = 1024  # samples a pixel at most under adaptive sampling
FEWEST = 4  # samples a pixel that Cycles takes before it asks whether a pixel has converged


def save(kind: str, path: Path, size: tuple[int, int]) -> None:
    scene = scenes.build(kind)
    scene.cycles.device = "CPU"
    scene.cycles.sample_clamp_indirect = CLAMP
    scene.cycles.max_bounces = max(scene.cycles.max_bounces, BOUNCES)
    scene.render.use_motion_blur = kind in scenes.BLURRED
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.render.resolution_percentage = 100
    scene.frame_set(FRAME)
    path.parent.mkdir(parents=True, exist_ok=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(path))


def render_adaptively(threshold: float, path: Path) -> None:
    """Blender chooses the least number of samples itself, by the threshold."""
    scene = bpy.context.scene
    render_blender.set_up(scene)
    scene.cycles.use_adaptive_sampling = True
    scene.cycles.adaptive_threshold, scene.cycles.adaptive_min_samples = threshold, FEWEST
    job = {"frame": FRAME, "samples": MOST, "seed": 1, "region": None, "output": str(path)}
    render_blender.render(scene, job)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    commands = parser.add_subparsers(dest="command", required=True)
    saving = commands.add_parser("save")
    saving.add_argument("--kinds", default=",".join(scenes.KINDS), help="default: all")
    saving.add_argument("--size", type=pair, default=(160, 96), help="default: 160x96")
    adapting = commands.add_parser("adaptive")
    adapting.add_argument("--scene", type=Path, required=True)
    adapting.add_argument("--thresholds", default="0.4,0.2,0.1,0.05")
    args = parser.parse_args()
    folder = args.out.resolve()
    if args.command == "save":
        for kind in args.kinds.split(","):
            path = folder / f"{kind}.blend"
            if not path.exists():
                save(kind, path, args.size)
        return
    bpy.ops.wm.open_mainfile(filepath=str(args.scene.resolve()))
    for text in args.thresholds.split(","):
        path = folder / f"adaptive.{text}.exr"
        if not path.exists():
            render_adaptively(float(text), path)


if __name__ == "__main__":
    main()
