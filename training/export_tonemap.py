"""Export the tone mapper: network and card to models/, its compute kernels to models/kernels/.

    python -m training.export_tonemap checkpoint.pt --tag aces2 [--look aces2] [--quality quality.json]
    python -m training.export_tonemap --kernels-only
"""

from __future__ import annotations

import argparse
import hashlib
import json
from pathlib import Path
from typing import Any

import onnx
import torch
from torch import nn

from training.looks import Look, find_look
from training.networks.hdrnet import SHAPER, SIDE, TOE, WHITE, HDRNet, default_params
from training.networks.tonemap_kernels import EncodeSrgb, Lowres, SliceApply, Smooth

OPSET = 20  # the first with 5-D GridSample
MODELS = Path(__file__).resolve().parent.parent / "models"


def export(
    module: nn.Module,
    examples: tuple[torch.Tensor, ...],
    reads: list[str],
    writes: list[str],
    path: Path,
    image: bool = False,
) -> None:
    """One ONNX file without traces of the machine it was made on; `image`: height and width of the first input free."""
    free = {0: torch.export.Dim("height", min=1), 1: torch.export.Dim("width", min=1)}
    shapes = (free, *[None] * (len(examples) - 1)) if image else None
    program = torch.onnx.export(
        module.eval(),
        examples,
        input_names=reads,
        output_names=writes,
        opset_version=OPSET,
        dynamo=True,
        dynamic_shapes=shapes,
        verbose=False,
    )
    model = program.model_proto
    strip(model)
    onnx.checker.check_model(model)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(model.SerializeToString(deterministic=True))
    print(f"{path}: {len(model.graph.node)} nodes, {path.stat().st_size} bytes")


def strip(model: onnx.ModelProto) -> None:
    """Remove stack traces and other notes that the exporter leaves."""
    del model.metadata_props[:]
    del model.graph.metadata_props[:]
    del model.graph.value_info[:]
    for item in [*model.graph.node, *model.graph.input, *model.graph.output, *model.graph.initializer]:
        del item.metadata_props[:]
        item.doc_string = ""


def export_kernels(folder: Path) -> None:
    torch.manual_seed(0)
    colour, params = torch.rand(48, 64, 3), default_params()
    grid, guide = (x.detach().contiguous() for x in HDRNet()(torch.rand(1, 3, SIDE, SIDE)))
    export(Lowres(), (colour, params), ["colour", "params"], ["lowres"], folder / "lowres.onnx", image=True)
    reads = ["colour", "params", "guide", "grid"]
    export(SliceApply(), (colour, params, guide, grid), reads, ["output"], folder / "slice_apply.onnx", image=True)
    reads = ["previous", "current", "keep"]
    # Two tensors, not one twice: the exporter would take equal arguments for one and the same.
    export(Smooth(), (grid, grid.clone(), torch.ones(1)), reads, ["result"], folder / "smooth.onnx")
    export(EncodeSrgb(), (colour, torch.ones(1)), ["colour", "exposure"], ["output"], folder / "encode_srgb.onnx", True)


def card(
    checkpoint: dict[str, Any], tag: str, look: Look, path: Path, quality: dict[str, Any]
) -> dict[str, Any]:
    """What the run-time and a reader need to know about the model."""
    args, log = checkpoint["args"], checkpoint["log"]
    return {
        "name": f"tonemap.{tag}",
        "pass": "tonemap",
        "tag": tag,
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "opset": OPSET,
        "parameters": sum(p.numel() for p in HDRNet().parameters()),
        "inputs": {"lowres": {"shape": [1, 3, SIDE, SIDE], "meaning": "shaped colour, area average, 0..1"}},
        "outputs": {
            "grid": {"shape": [1, 16, 16, 8, 12], "meaning": "y, x, guide level, 3x4 affine matrix row-major"},
            "guide": {"shape": [112], "meaning": "matrix 9, bias 3, shifts 3x16, slopes 3x16, mix 3, mix bias 1"},
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
            "steps": log["step"],
            "seconds": log["seconds"],
            "batch": args["batch"],
            "rate": args["rate"],
            "scale": args["scale"],
            "seed": args["seed"],
            "torch": checkpoint.get("torch"),
            "device": checkpoint.get("device"),
            "data": checkpoint.get("data"),
        },
        "quality": {"held_out_psnr": log["psnr"], "pictures": quality},
    }


def describe(look: Look) -> dict[str, Any]:
    view = look.view.__name__ if callable(look.view) else vars(look.view)
    local = {"gain": look.gain, "sigma": look.sigma, "alpha": look.alpha, "beta": look.beta}
    return {"formula": "view(2 ** gain * local_laplacian(rgb))", **local, "view": view}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint", nargs="?")
    parser.add_argument("--tag", default="aces2", help="the model becomes tonemap.TAG")
    parser.add_argument("--look", help="built-in look or .toml file it was trained on; default: the tag")
    parser.add_argument("--quality", help="JSON of evaluate_tonemap.py, kept in the card")
    parser.add_argument("--models", type=Path, default=MODELS)
    parser.add_argument("--kernels-only", action="store_true")
    args = parser.parse_args()
    export_kernels(args.models / "kernels")
    if args.kernels_only:
        return
    if not args.checkpoint:
        parser.error("name a checkpoint, or give --kernels-only")
    checkpoint = torch.load(args.checkpoint, map_location="cpu")
    net = HDRNet()
    net.load_state_dict(checkpoint["weights"])
    path = args.models / f"tonemap.{args.tag}.onnx"
    export(net, (torch.rand(1, 3, SIDE, SIDE),), ["lowres"], ["grid", "guide"], path)
    quality = json.loads(Path(args.quality).read_text()) if args.quality else {}
    text = json.dumps(card(checkpoint, args.tag, find_look(args.look or args.tag), path, quality), indent=2)
    path.with_suffix(".json").write_text(text + "\n")


if __name__ == "__main__":
    main()
