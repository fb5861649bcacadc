"""Pack HDR pictures and a baked look into one .npz that `train_tonemap.py` reads; needs OpenImageIO and opencolorio.

    python -m training.make_tonemap_set -o tonemap_set.npz --look aces2 --photos 'hdr/*.exr' --panoramas 'env/*.hdr'

Pictures named by --hold-out are never trained on: they become validation pairs, whose targets are made by the colour
pipeline itself and not by its baked cube. --clips takes a folder of .npz files with a `reference` (T,H,W,3).
"""

from __future__ import annotations

import argparse
import glob
from dataclasses import asdict
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import torch
import torch.nn.functional as F

from training.looks import Look, bake_cube, exact_target, find_look
from training.panorama import perspective

LARGEST = 2.0**14  # after exposure; the shaper ends at 2**8, so nothing visible is lost
VALIDATION_VIEWS = ((0.0, 0.0), (120.0, 10.0), (240.0, -15.0))  # yaw, pitch in degrees


def read(path: str) -> np.ndarray:
    """First three channels of an HDR picture, float32, non-finite and negative values set to 0."""
    pixels = oiio.ImageBuf(path).get_pixels("float")
    if pixels is None or pixels.ndim != 3 or pixels.shape[2] < 3:
        raise SystemExit(f"{path}: not a readable RGB picture")
    return np.maximum(np.nan_to_num(pixels[..., :3], nan=0.0, posinf=LARGEST, neginf=0.0), 0.0)


def expose(rgb: np.ndarray) -> np.ndarray:
    """Scale so that the geometric mean of the luminance between the 2nd and 98th percentile is mid grey, 0.18."""
    log = np.log2(np.maximum(rgb @ np.float32([0.2126, 0.7152, 0.0722]), 2.0**-30))
    log = log[log > -30]
    low, high = np.percentile(log, [2, 98])
    mean = log[(log >= low) & (log <= high)].mean()
    return (rgb * np.float32(0.18 / 2.0**mean)).clip(0.0, LARGEST)


def shrink(rgb: np.ndarray, side: int) -> np.ndarray:
    """Area average to at most `side` pixels on the longer side."""
    h, w = rgb.shape[:2]
    if max(h, w) <= side:
        return rgb
    size = (round(h * side / max(h, w)), round(w * side / max(h, w)))
    x = torch.from_numpy(np.ascontiguousarray(rgb)).permute(2, 0, 1)[None]
    return F.interpolate(x, size=size, mode="area")[0].permute(1, 2, 0).numpy()


def validation_views(path: str, panorama: bool) -> list[np.ndarray]:
    if not panorama:
        return [expose(shrink(read(path), 640))]
    sphere = torch.from_numpy(read(path)).permute(2, 0, 1)
    views = [perspective(sphere, yaw, pitch, 85.0, (288, 512)) for yaw, pitch in VALIDATION_VIEWS]
    return [expose(view.permute(1, 2, 0).numpy()) for view in views]


def clip_frames(folder: str, limit: int) -> list[np.ndarray]:
    """Up to `limit` rendered references, the first frame of evenly spread clips."""
    paths = sorted(glob.glob(f"{folder}/*.npz"))
    paths = paths[:: max(1, len(paths) // limit)][:limit] if limit else []
    return [np.load(path)["reference"][0].astype(np.float32) for path in paths]


def pack(args: argparse.Namespace, look: Look) -> dict[str, np.ndarray]:
    arrays: dict[str, np.ndarray] = {}
    names, kinds, held = [], [], []
    sources = [(p, False) for g in args.photos for p in sorted(glob.glob(g))]
    sources += [(p, True) for g in args.panoramas for p in sorted(glob.glob(g))]
    for path, panorama in sources:
        if Path(path).stem in args.hold_out:
            for i, view in enumerate(validation_views(path, panorama)):
                view = view.astype(np.float16)
                arrays[f"validation_input_{len(held)}"] = view
                exact = exact_target(view.astype(np.float32), look)
                arrays[f"validation_target_{len(held)}"] = np.round(exact * 65535).astype(np.uint16)
                held.append(f"{Path(path).stem}.{i}" if panorama else Path(path).stem)
            continue
        arrays[f"image_{len(names)}"] = expose(shrink(read(path), 1024 if panorama else args.side)).astype(np.float16)
        names.append(Path(path).stem)
        kinds.append(panorama)
    for i, frame in enumerate(clip_frames(args.clips, args.clip_limit) if args.clips else []):
        arrays[f"image_{len(names)}"] = expose(frame).astype(np.float16)
        names.append(f"clip_{i}")
        kinds.append(False)
    arrays["cube"] = np.round(bake_cube(look) * 65535).astype(np.uint16)
    return arrays | {
        "names": np.array(names),
        "panorama": np.array(kinds),
        "validation_names": np.array(held),
        "look": np.array(repr(asdict(look) if not callable(look.view) else look)),
        "local": np.array([look.gain, look.sigma, look.alpha, look.beta]),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", required=True)
    parser.add_argument("--look", default="aces2", help="built-in look, or a .toml file")
    parser.add_argument("--photos", nargs="*", default=[], help="HDR photographs (patterns)")
    parser.add_argument("--panoramas", nargs="*", default=[], help="equirectangular HDR environments (patterns)")
    parser.add_argument("--clips", help="folder of rendered clips (.npz with `reference`)")
    parser.add_argument("--clip-limit", type=int, default=12)
    parser.add_argument("--hold-out", nargs="*", default=[], help="file stems kept for validation")
    parser.add_argument("--side", type=int, default=768, help="longest side of a photograph")
    args = parser.parse_args()
    arrays = pack(args, find_look(args.look))
    np.savez_compressed(args.output, **arrays)
    size = Path(args.output).stat().st_size / 2**20
    print(f"{args.output}: {len(arrays['names'])} pictures, {len(arrays['validation_names'])} held out, {size:.1f} MiB")


if __name__ == "__main__":
    main()
