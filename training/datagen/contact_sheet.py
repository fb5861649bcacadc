"""A picture of many clips: noisy | diffuse albedo | specular albedo | normal | motion | reference, one row a clip.

python -m training.datagen.contact_sheet FOLDER OUT.png [--rows 12] [--frame 4] [--skip 0]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from PIL import Image

from training.datagen.clip_file import load_clip


def display(linear: np.ndarray) -> np.ndarray:
    """x/(1+x), then the sRGB curve; 0..1."""
    mapped = np.clip(linear, 0, None) / (1 + np.clip(linear, 0, None))
    return np.where(mapped <= 0.0031308, 12.92 * mapped, 1.055 * mapped ** (1 / 2.4) - 0.055)


def row(clip: dict, frame: int, size: int) -> np.ndarray:
    """One clip's frame, or its last one, as (size, 6 size, 3) uint8."""
    frame = min(frame, len(clip["reference"]) - 1)
    panels = [display(clip["v0_colour"][frame].astype(np.float32))]
    for name in ("diffuse_albedo", "specular_albedo"):
        panels.append(clip[f"v0_{name}"][frame].astype(np.float32) ** (1 / 2.2))
    panels.append(clip["v0_normal"][frame].astype(np.float32) * 0.5 + 0.5)
    motion = clip["v0_motion"][frame] / 20 + 0.5
    panels.append(np.concatenate([motion, np.full_like(motion[..., :1], 0.5)], -1))
    panels.append(display(clip["reference"][frame].astype(np.float32)))
    images = [Image.fromarray((np.clip(p, 0, 1) * 255).astype(np.uint8)).resize((size, size), 0) for p in panels]
    return np.concatenate([np.asarray(i) for i in images], 1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--rows", type=int, default=12)
    parser.add_argument("--frame", type=int, default=4)
    parser.add_argument("--skip", type=int, default=0)
    parser.add_argument("--size", type=int, default=128)
    args = parser.parse_args()
    paths = sorted(args.folder.glob("clip.*.npz"))[args.skip : args.skip + args.rows]
    if not paths:
        parser.error(f"{args.folder} holds no clip.*.npz")
    rows = [row(load_clip(path), args.frame, args.size) for path in paths]
    half = (len(rows) + 1) // 2 if len(rows) > 12 else len(rows)
    rows += [np.zeros_like(rows[0])] * (-len(rows) % half)
    columns = [np.concatenate(rows[k : k + half]) for k in range(0, len(rows), half)]
    Image.fromarray(np.concatenate(columns, 1)).save(args.out)


if __name__ == "__main__":
    main()
