"""Export the tone mapper: network and card to models/, its compute kernels to models/kernels/.

    python -m training.export_tonemap checkpoint.pt --tag aces2 [--look aces2] [--quality quality.json]
    python -m training.export_tonemap
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch

from postfx.kernels.apply_cube import APPLY_CUBE
from postfx.kernels.checkerboard import CHECKERBOARD
from postfx.kernels.encode_display import ENCODE_DISPLAY
from training.export import export, export_kernel, parser, read_quality, write_card
from training.looks import Look, find_look
from training.networks.hdrnet import SHAPER, SIDE, TOE, WHITE, HDRNet, default_params
from training.networks.tonemap_kernels import ApplyCube, Checkerboard, EncodeDisplay, Lowres, SliceApply, Smooth

IMAGE = {0: torch.export.Dim("height", min=1), 1: torch.export.Dim("width", min=1)}


def export_kernels(folder: Path) -> None:
    torch.manual_seed(0)
    colour, params = torch.rand(48, 64, 3), default_params()
    grid, guide = (x.detach().contiguous() for x in HDRNet()(torch.rand(1, 3, SIDE, SIDE)))
    export(Lowres(), (colour, params), ["colour", "params"], ["lowres"], folder / "lowres.onnx", [IMAGE, None])
    reads = ["colour", "params", "guide", "grid"]
    free = [IMAGE, None, None, None]
    export(SliceApply(), (colour, params, guide, grid), reads, ["output"], folder / "slice_apply.onnx", free)
    reads = ["previous", "current", "keep"]
    # Two tensors, not one twice: the exporter would take equal arguments for one and the same.
    export(Smooth(), (grid, grid.clone(), torch.ones(1)), reads, ["result"], folder / "smooth.onnx")
    export_kernel(ENCODE_DISPLAY, EncodeDisplay(), {"height": 9, "width": 16}, folder)
    export_kernel(APPLY_CUBE, ApplyCube(), {"height": 9, "width": 16, "size": 5}, folder)
    export_kernel(CHECKERBOARD, Checkerboard(), {"height": 9, "width": 16}, folder)


def card(checkpoint: dict[str, Any], tag: str, look: Look, quality: dict[str, Any]) -> dict[str, Any]:
    """What the run-time and a reader need to know about the model."""
    return {
        "name": f"tonemap.{tag}",
        "pass": "tonemap",
        "tag": tag,
        "summary": f"HDRNet tone mapper, look {tag}",
        "parameters": sum(p.numel() for p in HDRNet().parameters()),
        "inputs": {"lowres": {"shape": [1, 3, SIDE, SIDE], "meaning": "shaped colour, area average, 0..1"}},
        "outputs": {
            "grid": {"shape": [1, 16, 16, 8, 12], "meaning": "y, x, guide level, 3x4 affine matrix row-major"},
            "guide": {
                "shape": [112],
                "meaning": "matrix 9, bias 3, shifts 3x16, slopes 3x16, mix 3, mix bias 1",
                "constant": True,
            },
        },
        "shaper": {
            "formula": "clip(log2(1 + exposure * x / toe) * scale, 0, 1)",
            "toe": TOE,
            "scale": SHAPER[1],
            "white": WHITE,
        },
        "output_encoding": "srgb",
        "look": describe(look),
        "training": {
            "script": "training/train_tonemap.py",
            "network": "HDRNet (Gharbi et al. 2017)",
            "runs": checkpoint["history"],
            "pictures": checkpoint["pictures"],
        },
        "quality": {"held_out_psnr": checkpoint["psnr"], "pictures": quality},
    }


def describe(look: Look) -> dict[str, Any]:
    view = look.view.__name__ if callable(look.view) else vars(look.view)
    local = {"gain": look.gain, "sigma": look.sigma, "alpha": look.alpha, "beta": look.beta}
    return {"formula": "view(2 ** gain * local_laplacian(rgb))", **local, "view": view}


def main() -> None:
    arguments = parser(__doc__, "aces2")
    arguments.add_argument("--look", help="built-in look or .toml file it was trained on; default: the tag")
    args = arguments.parse_args()
    export_kernels(args.models / "kernels")
    if not args.checkpoint:
        return
    checkpoint = torch.load(args.checkpoint, map_location="cpu", weights_only=True)
    net = HDRNet()
    net.load_state_dict(checkpoint["weights"])
    path = args.models / f"tonemap.{args.tag}.onnx"
    export(net, (torch.rand(1, 3, SIDE, SIDE),), ["lowres"], ["grid", "guide"], path)
    write_card(path, card(checkpoint, args.tag, find_look(args.look or args.tag), read_quality(args.quality)))


if __name__ == "__main__":
    main()
