"""Clean the references of rendered clips, so that few samples are enough for them.

    python -m training.datagen.clean_references RAW CLEAN --network models/denoise_upscale.m.1x.onnx
    python -m training.datagen.clean_references RAW CLEAN --network m.onnx --watch 15 --device cuda:1

A training compares pictures after the display curve, which turns the noise of a reference into a
darker picture: 64 samples a pixel of a night street lose 0.010 in code values, 32 of a room lit
through its door more than 0.03. A network of the project, given the reference as a noisy picture
with the planes of its first half, takes that noise away. Both the reference and its second half are
cleaned, each by itself, so that a render is still compared with samples of which it has none.

Clips without halves have references of many samples, and are moved as they are, like clips whose
references are larger than their renders. RAW may still be growing: with --watch the program goes on
for so many minutes. Cleaned clips leave RAW, so a rendering that goes on there makes
them again: give it another --seed.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from training.datagen.clip_file import to_half
from training.denoise.checkpoint import load_weights, widen
from training.denoise.dataset import Clip, Stack, collate, load, to_batch
from training.denoise.model import DenoiseUpscale, TrunkConfig, empty_state
from training.denoise.picture import PictureDenoiser

PAUSE = 0.5  # seconds between two looks for new clips


def load_network(path: Path, device: torch.device) -> DenoiseUpscale | PictureDenoiser:
    """The network of an exported model in float32, with its card beside it, or of a checkpoint of a picture network."""
    if path.suffix == ".pt":
        found = PictureDenoiser()
        found.load_state_dict(widen(load_weights(path), found.state_dict()))
        return found.to(device).eval()
    config = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))["config"]
    network = DenoiseUpscale(TrunkConfig.from_dict(config))
    network.load_state_dict(load_weights(path, trust=bool(config.get("trust"))))
    return network.to(device).eval()


def is_cleaned(clip: Clip) -> bool:
    """Whether a clip's reference is worth cleaning, and has the size of its renders."""
    return clip.half is not None and any(clip.halved) and clip.reference.shape[-2:] == clip.planes.shape[-2:]


@torch.no_grad()
def clean(network: DenoiseUpscale | PictureDenoiser, clip: Clip, picture: Tensor) -> Tensor:
    """A ``picture`` (T, 3, h, w) of the clip without its noise, by the planes of the first half of the reference."""
    stack = collate([clip], [clip.halved.index(True)])
    batch = to_batch(with_colour(stack, picture))
    state = empty_state(batch.frames[0], *picture.shape[-2:])
    alone = isinstance(network, PictureDenoiser)  # that may begin with weights that know no history
    outputs = []
    for inputs, keep in zip(batch.frames, batch.keep, strict=True):
        step = network.step(inputs, state.drop(keep))
        state = state if alone else step.state
        outputs.append(step.output[0] / clip.exposure)
    return torch.stack(outputs)


def with_colour(stack: Stack, colour: Tensor) -> Stack:
    """The renders of one clip, with another colour (T, 3, h, w)."""
    planes = stack.planes.clone()
    planes[0, :, :3] = colour.float()
    return replace(stack, planes=planes)


def clean_file(network: DenoiseUpscale | PictureDenoiser, path: Path, folder: Path, device: torch.device) -> bool:
    """Move a clip to a folder, its references cleaned if it needs that; returns whether it did."""
    clip = load(path, device, blank_volumes=True)
    target = folder / path.name
    if not is_cleaned(clip):
        shutil.move(path, target)
        return False
    with np.load(path) as file:
        arrays = dict(file)
    for name, picture in (("reference", clip.reference), ("half", clip.half)):
        arrays[name] = to_half(clean(network, clip, picture).movedim(1, -1).cpu().numpy())
    partial = folder / f".{path.name}.{os.getpid()}.partial.npz"
    np.savez(partial, **arrays)
    partial.replace(target)
    path.unlink()
    return True


def options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("raw", type=Path, help="folder of clip.NNNNN.npz as rendered")
    parser.add_argument("clean", type=Path, help="folder that gets the cleaned clips")
    parser.add_argument("--network", type=Path, required=True, help="denoise_upscale.<tag>.onnx in float32, or "
                        "a checkpoint of a picture network (training.denoise.open_weights)")
    parser.add_argument("--watch", type=float, default=0.0, metavar="MINUTES", help="wait for new clips so long")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    return parser


def main(argv: list[str] | None = None) -> int:
    args = options().parse_args(argv)
    device = torch.device(args.device)
    network = load_network(args.network, device)
    args.clean.mkdir(parents=True, exist_ok=True)
    end, moved, cleaned = time.monotonic() + 60 * args.watch, 0, 0
    while True:
        found = sorted(args.raw.glob("clip.*.npz"))
        for path in found:
            cleaned += clean_file(network, path, args.clean, device)
            moved += 1
        if found:
            print(f"{moved} clips, {cleaned} of them cleaned", flush=True)
        if time.monotonic() >= end:
            return 0
        time.sleep(PAUSE)


if __name__ == "__main__":
    sys.exit(main())
