"""Measure a tone mapper's checkpoint on pictures that it was not trained on, against the colour pipeline itself.

    python -m training.evaluate_tonemap checkpoint.pt --look aces2 -o quality.json [--pictures DIR] A.exr B.hdr ...

Each picture is exposed by the run-time's meter and shrunk to at most --side pixels. Per picture: PSNR, SSIM and FLIP
of the sRGB-encoded result, and mean Delta E ITP (ITU-R BT.2124, display white at 100 cd/m2).
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path

import colour
import flip_evaluator
import numpy as np
import OpenImageIO as oiio
import torch
from skimage.metrics import structural_similarity

from postfx.exposure import measure
from training.looks import exact_target, find_look
from training.make_tonemap_set import read, shrink
from training.networks.hdrnet import HDRNet, default_params

WHITE = 100.0  # cd/m2


def srgb_decode(encoded: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1, [0, 1] to linear [0, 1]."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def delta_e_itp(a: np.ndarray, b: np.ndarray) -> float:
    """Mean Delta E ITP between two sRGB-encoded pictures shown at 100 cd/m2."""
    space = colour.RGB_COLOURSPACES["sRGB"], colour.RGB_COLOURSPACES["ITU-R BT.2020"]
    itp = [colour.RGB_to_ICtCp(colour.RGB_to_RGB(srgb_decode(x.astype(np.float64)), *space) * WHITE) for x in (a, b)]
    return float(colour.difference.delta_E_ITP(*itp).mean())


def compare(out: np.ndarray, wanted: np.ndarray) -> dict[str, float]:
    error = float(np.square(out - wanted).mean())
    return {
        "psnr": round(-10 * math.log10(error + 1e-12), 2),
        "ssim": round(float(structural_similarity(out, wanted, channel_axis=2, data_range=1.0)), 4),
        "flip": round(float(flip_evaluator.evaluate(wanted, out, "LDR")[1]), 4),
        "delta_e_itp": round(delta_e_itp(out, wanted), 2),
    }


def write(path: Path, picture: np.ndarray) -> None:
    oiio.ImageBuf(np.ascontiguousarray(np.round(picture * 255).astype(np.uint8))).write(str(path))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint")
    parser.add_argument("images", nargs="+")
    parser.add_argument("--look", default="aces2", help="built-in look, or a .toml file")
    parser.add_argument("--side", type=int, default=640)
    parser.add_argument("--pictures", type=Path, help="folder for PNGs: result beside target")
    parser.add_argument("-o", "--output", help="JSON file")
    args = parser.parse_args()
    net = HDRNet().eval()
    net.load_state_dict(torch.load(args.checkpoint, map_location="cpu")["weights"])
    look, quality = find_look(args.look), {}
    for path in args.images:
        rgb = shrink(read(path), args.side)
        rgb = rgb * np.float32(2.0 ** (measure(rgb) or 0.0))
        with torch.no_grad():
            out = net.render(torch.from_numpy(rgb).permute(2, 0, 1)[None], default_params())[0].permute(1, 2, 0).numpy()
        wanted = exact_target(rgb, look)
        name = f"{Path(path).parent.name}/{Path(path).stem}"
        quality[name] = compare(out, wanted)
        print(name, quality[name], flush=True)
        if args.pictures:
            args.pictures.mkdir(parents=True, exist_ok=True)
            write(args.pictures / f"{name.replace('/', '_')}.png", np.concatenate([out, wanted], 1))
    if args.output:
        Path(args.output).write_text(json.dumps(quality, indent=2) + "\n")


if __name__ == "__main__":
    main()
