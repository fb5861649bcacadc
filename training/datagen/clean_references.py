"""Clean the references of rendered clips, so that few samples are enough for them.

    python -m training.datagen.clean_references RAW CLEAN
    python -m training.datagen.clean_references RAW CLEAN --watch 15 --device cuda
    python -m training.datagen.clean_references RAW CLEAN --keep-noise

A training compares pictures after the display curve, which turns the noise of a reference into a
darker picture: 64 samples a pixel of a night street lose 0.010 in code values, 32 of a room lit
through its door more than 0.03. Open Image Denoise (the package pyoidn) takes that noise away,
with the planes of the reference's first half, each filtered alone first.

A cleaned half is no target for a render with as many samples: the network would learn to be as
blurred as the target. So the other half of the reference leaves the clip. The render from the first
half stays for its planes, which are almost without noise, and is not trained on.

A renderer that fails on the GPU may still save pictures, black or half done. A clip whose renders
have not the light of its reference is left out.

With --keep-noise, references stay as rendered, with both halves, which together tell what their
noise does to a picture (train --noisy-references). Such a training leaves out the render from the
first half, as its target would have one half only.

Clips without halves have references of many samples, and are moved as they are, like clips whose
references are larger than their renders. RAW may still be growing: with --watch the program goes on
for so many minutes. Cleaned clips leave RAW, so a rendering that goes on there makes
them again: give it another --seed.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import time
from pathlib import Path

import numpy as np

from postfx.oidn import OpenImageDenoise
from training.datagen.clip_file import to_half
from training.denoise.clips import grey_factor

BLOCK_PX = 32  # side of the blocks whose light is compared, or the picture's if that is smaller
LEAST_BLOCK_RATIO = 0.25  # of the light of a block to that of the same block
DARK_BLOCK = 0.02  # behind x / (1 + x): darker blocks count as equal
MOST_DIFFERENT_BLOCKS = 0.1  # of a frame
PAUSE = 0.5  # seconds between two looks for new clips
THREADS = 8  # of the CPU

Arrays = dict[str, np.ndarray]


def render_of_half(arrays: Arrays) -> str | None:
    """Name of the render that is half of a clip's reference, as 'v2'; None if there is none of the
    reference's size."""
    named = (name.removesuffix("_half")
             for name in arrays if name.startswith("v") and name.endswith("_half"))
    fitting = (name for name in named if arrays[f"{name}_half"]
               and arrays[f"{name}_colour"].shape == arrays["reference"].shape)
    return next(fitting, None) if "half" in arrays else None


def aids(arrays: Arrays, variant: str, frame: int) -> Arrays:
    """Albedo and normal (h, w, 3) of a frame, as Blender gives them to its denoiser where the clip
    has those."""
    def plane(name: str) -> np.ndarray:
        return arrays[f"{variant}_{name}"][frame].astype(np.float32)

    if f"{variant}_denoising_albedo" in arrays and plane("denoising_albedo").any():
        return {"albedo": plane("denoising_albedo"), "normal": plane("denoising_normal")}
    return {"albedo": np.clip(plane("diffuse_albedo") + plane("specular_albedo"), 0, 1),
            "normal": plane("normal")}


def clean(denoise: OpenImageDenoise, arrays: Arrays, variant: str) -> np.ndarray:
    """The reference (T, h, w, 3) without its noise, by the planes of a render of the clip."""
    result = np.empty(arrays["reference"].shape, np.float32)
    for frame, picture in enumerate(arrays["reference"]):
        denoise(picture.astype(np.float32), aids(arrays, variant, frame), result[frame])
    return result


def is_whole(arrays: Arrays) -> bool:
    """Whether all renders of a clip have the light of its reference, in nearly all blocks of every
    frame. Renders of another size than the reference are not compared."""
    reference = arrays["reference"].astype(np.float32)
    if not reference.reshape(len(reference), -1).max(1).min() > 0:
        return False
    exposure = grey_factor(reference[0].clip(0))
    wanted = block_codes(reference, exposure)
    for name, colour in arrays.items():
        if name.endswith("_colour") and colour.shape == reference.shape:
            found = block_codes(colour.astype(np.float32), exposure)
            less, more = np.minimum(found, wanted), np.maximum(found, wanted)
            differs = (less < LEAST_BLOCK_RATIO * more) & (more > DARK_BLOCK)
            shares = differs.mean((1, 2))
            if not shares.max() <= MOST_DIFFERENT_BLOCKS:
                return False
    return True


def block_codes(light: np.ndarray, exposure: float) -> np.ndarray:
    """The mean light of blocks (T, rows, columns) behind x / (1 + x)."""
    frames, height, width, _ = light.shape
    side = min(BLOCK_PX, height, width)
    rows, columns = height // side, width // side
    cut = light[:, :rows * side, :columns * side].mean(-1)
    exposed = exposure * cut.reshape(frames, rows, side, columns, side).mean((2, 4)).clip(0)
    return exposed / (1 + exposed)


def clean_file(denoise: OpenImageDenoise | None, path: Path, folder: Path) -> bool:
    """Move a clip to a folder, its reference cleaned if it needs that and ``denoise`` is given;
    returns whether it did. A clip that is not whole is deleted."""
    with np.load(path) as file:
        arrays = dict(file)
    if not is_whole(arrays):
        print(f"left out: {path.name}: a render has not the light of its reference", flush=True)
        path.unlink()
        return False
    target, variant = folder / path.name, render_of_half(arrays)
    if variant is None or denoise is None:
        shutil.move(path, target)
        return False
    arrays["reference"] = to_half(clean(denoise, arrays, variant))
    del arrays["half"]
    partial = folder / f".{path.name}.{os.getpid()}.partial.npz"
    np.savez(partial, **arrays)
    partial.replace(target)
    path.unlink()
    return True


def options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("raw", type=Path, help="folder of clip.NNNNN.npz as rendered")
    parser.add_argument("clean", type=Path, help="folder that gets the cleaned clips")
    parser.add_argument("--watch", type=float, default=0.0, metavar="MINUTES",
                        help="wait for new clips so long")
    parser.add_argument("--keep-noise", action="store_true",
                        help="only leave out clips that are not whole, for a training with "
                        "--noisy-references, which learns from both halves as rendered")
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    parser.add_argument("--threads", type=int, default=THREADS,
                        help="of the CPU (default: %(default)s)")
    return parser


def main(argv: list[str] | None = None) -> int:
    args = options().parse_args(argv)
    denoise = (None if args.keep_noise
               else OpenImageDenoise("high", args.device, args.threads))
    args.clean.mkdir(parents=True, exist_ok=True)
    end, moved, cleaned = time.monotonic() + 60 * args.watch, 0, 0
    while True:
        found = sorted(args.raw.glob("clip.*.npz"))
        for path in found:
            cleaned += clean_file(denoise, path, args.clean)
            moved += 1
        if found:
            print(f"{moved} clips, {cleaned} of them cleaned", flush=True)
        if time.monotonic() >= end:
            return 0
        time.sleep(PAUSE)


if __name__ == "__main__":
    sys.exit(main())
