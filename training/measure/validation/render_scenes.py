"""Render the validation scenes in Cycles, as an artist would set it; runs in Blender's Python.

    python render_scenes.py --kinds water,smoke --out DIR --samples 4,16,64 --reference 1024

For each kind and frame writes DIR/KIND/noisy.SPP.####.exr and DIR/KIND/reference.####.exr, the crop
in the middle of the picture, and DIR/KIND/half.SPP.####.exr: the same crop at half the size, with
the rays of a full size of a quarter of the samples. With --second it also writes
DIR/KIND/second.####.exr, references with other noise: with two, the noise of references leaves the
figures (postfx/bench/metrics.py). With --take, all pictures have other noise than those of another
take. Where motion is blurred, Blender 5 writes no vectors, and so these files have none. Goes on
after a scene that fails; keeps files that exist.
"""

from __future__ import annotations

import argparse
import sys
import time
import traceback
import zlib
from dataclasses import dataclass
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from training.measure.validation import scenes  # noqa: E402

BOUNCES = 8
REFERENCES = ("reference", "second")


@dataclass(frozen=True)
class Shot:
    """One picture of a scene to render."""

    path: Path
    frame: int
    samples: int
    half: bool = False

    def seed(self, take: int) -> int:
        """Another seed for every file and take, the same in every run."""
        words = f"{self.path.parent.name}/{self.path.name}" + f"/{take}" * bool(take)
        return zlib.crc32(words.encode()) & 0x3FFFFFFF


def use_device(scene: bpy.types.Scene, device: str) -> None:
    """Blender resets its preferences with every new scene: call this for each."""
    if device == "CPU":
        scene.cycles.device = "CPU"
        return
    chosen = bpy.context.preferences.addons["cycles"].preferences
    chosen.compute_device_type = device
    chosen.get_devices()
    if not any(each.type == device for each in chosen.devices):
        raise RuntimeError(f"Blender finds no device of type {device}: give --device CPU")
    for each in chosen.devices:
        each.use = each.type == device
    scene.cycles.device = "GPU"


def set_up(scene: bpy.types.Scene, size: tuple[int, int], crop: tuple[int, int]) -> None:
    cycles = scene.cycles
    cycles.use_adaptive_sampling = False
    cycles.use_denoising = False
    cycles.sample_clamp_indirect = 10.0
    cycles.max_bounces = max(cycles.max_bounces, BOUNCES)
    cycles.pixel_filter_type = "BLACKMAN_HARRIS"
    cycles.filter_width = 1.5
    render = scene.render
    render.use_persistent_data = True
    render.use_compositing = False
    render.use_sequencer = False
    render.use_border = True
    render.use_crop_to_border = True
    render.border_min_x, render.border_max_x = (0.5 - 0.5 * crop[0] / size[0],
                                                0.5 + 0.5 * crop[0] / size[0])
    render.border_min_y, render.border_max_y = (0.5 - 0.5 * crop[1] / size[1],
                                                0.5 + 0.5 * crop[1] / size[1])
    render.image_settings.media_type = "MULTI_LAYER_IMAGE"
    render.image_settings.file_format = "OPEN_EXR_MULTILAYER"
    render.image_settings.color_depth = "16"
    render.image_settings.exr_codec = "ZIP"


def choose_passes(layer: bpy.types.ViewLayer, colour_only: bool, vectors: bool) -> None:
    layer.use_pass_z = not colour_only
    layer.use_pass_normal = not colour_only
    layer.use_pass_diffuse_color = not colour_only
    layer.use_pass_glossy_color = not colour_only
    layer.cycles.denoising_store_passes = not colour_only
    layer.use_pass_vector = vectors


def shots(folder: Path, args: argparse.Namespace) -> list[Shot]:
    """The noisy pictures of all frames first: they cost least and tell most."""
    found = []
    for frame in args.frames:
        for samples in args.samples:
            found.append(Shot(folder / f"noisy.{samples}.{frame:04}.exr", frame, samples))
        for samples in args.half:
            found.append(Shot(folder / f"half.{samples}.{frame:04}.exr", frame, samples, True))
    if args.reference:
        for frame in args.frames:
            found.append(Shot(folder / f"reference.{frame:04}.exr", frame, args.reference))
    if args.second:
        for frame in args.frames:
            found.append(Shot(folder / f"second.{frame:04}.exr", frame, args.second))
    return found


def render_shot(scene: bpy.types.Scene, shot: Shot, args: argparse.Namespace,
                blurred: bool) -> None:
    reference = shot.path.name.startswith(REFERENCES)
    scene.render.use_motion_blur = blurred
    choose_passes(scene.view_layers[0], reference, not blurred and not reference)
    scale = 2 if shot.half else 1
    width, height = args.size
    scene.render.resolution_x, scene.render.resolution_y = width // scale, height // scale
    scene.render.resolution_percentage = 100
    scene.cycles.samples, scene.cycles.seed = shot.samples, shot.seed(args.take)
    scene.frame_set(shot.frame)
    part = shot.path.with_name(f"part-{shot.path.name}")
    scene.render.filepath = str(part)
    bpy.ops.render.render(write_still=True)
    part.rename(shot.path)


def render_kind(kind: str, args: argparse.Namespace) -> None:
    folder = args.out / kind
    blurred = kind in scenes.BLURRED
    missing = [shot for shot in shots(folder, args) if not shot.path.exists()]
    if not missing:
        return
    folder.mkdir(parents=True, exist_ok=True)
    scene = scenes.build(kind)
    use_device(scene, args.device)
    set_up(scene, args.size, args.crop)
    for shot in missing:
        start = time.monotonic()
        render_shot(scene, shot, args, blurred)
        print(f"{kind} {shot.path.name} {time.monotonic() - start:.2f} s", flush=True)


def numbers(text: str) -> list[int]:
    return [int(part) for part in text.split(",") if part]


def frame_numbers(text: str) -> list[int]:
    first, _, last = text.partition("-")
    return list(range(int(first), int(last or first) + 1))


def pair(text: str) -> tuple[int, int]:
    width, height = text.split("x")
    return int(width), int(height)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", default=",".join(scenes.KINDS), help="default: all")
    parser.add_argument("--out", type=Path, required=True,
                        help="folder that gets one for each kind")
    parser.add_argument("--samples", type=numbers, default=[4, 16, 64], help="default 4,16,64")
    parser.add_argument("--half", type=numbers, default=[4, 16, 64],
                        help="samples at half the size; default 4,16,64; '' for none")
    parser.add_argument("--reference", type=int, default=1024, help="0: no references")
    parser.add_argument("--second", type=int, default=0,
                        help="samples of further references with other noise; default 0: none")
    parser.add_argument("--take", type=int, default=0,
                        help="a number for other noise in all pictures; default 0")
    parser.add_argument("--frames", type=frame_numbers, default=[1, 2, 3], help="default 1-3")
    parser.add_argument("--size", type=pair, default=(640, 360), help="default 640x360")
    parser.add_argument("--crop", type=pair, default=(320, 180), help="default 320x180")
    parser.add_argument("--device", default="CUDA", help="CUDA (default), OPTIX, HIP, or CPU")
    args = parser.parse_args()
    args.out = args.out.resolve()
    failed = []
    for kind in args.kinds.split(","):
        try:
            render_kind(kind, args)
        except Exception:  # the next scene may well work
            traceback.print_exc()
            failed.append(kind)
    if failed:
        print(f"failed: {', '.join(failed)}", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
