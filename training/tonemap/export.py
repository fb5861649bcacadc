"""Export the tone mapper: a look's model and card to models/, its compute kernels to
models/kernels/.

    python -m training.tonemap.export runs/local/checkpoint.pt --tag local \\
        [--quality quality.json] [--models DIR]
    python -m training.tonemap.export
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import onnx
import torch

from postfx.kernels.colour import APPLY_CUBE, CONVERT_PRIMARIES, ENCODE_DISPLAY
from postfx.kernels.image import CHECKERBOARD
from postfx.kernels.tonemap import EXPOSE, FOLLOW, LIGHT, SMOOTH_GRID
from training.export import OPSET, export, export_kernel, parity, parser, read_quality, write_card
from training.kernels.tonemap import (
    ApplyCube,
    Checkerboard,
    ConvertPrimaries,
    EncodeDisplay,
    Expose,
    Follow,
    Light,
    Lowres,
    SliceApply,
    Smooth,
)
from training.tonemap.model import (
    CUBE,
    SHAPER,
    SIDE,
    TO_WORKING,
    TOE,
    WHITE,
    Exposure,
    HDRNet,
    default_shaper,
)

IMAGE = {0: torch.export.Dim("height", min=1), 1: torch.export.Dim("width", min=1)}
STEADY = {"keep": 0.6, "follow": 0.6}  # see `postfx.kernels.tonemap`
STEADY_EXPOSURE = {"keep": 0.98, "follow": 0.18}  # of a look that exposes
STOPS = {"stops": {"shape": [1, 1], "meaning": "exposure to add, log2"}}
GRID = {
    "grid": {"shape": [1, 16, 16, 8, 12],
             "meaning": "y, x, guide level, 3x4 affine matrix row-major"},
    "guide": {
        "shape": [112],
        "meaning": "matrix 9, bias 3, shifts 3x16, slopes 3x16, mix 3, mix bias 1",
        "constant": True,
    },
}
IR_VERSION = 10  # the newest that ONNX Runtime 1.20 reads


def export_kernels(folder: Path) -> None:
    torch.manual_seed(0)
    shaper, colour = default_shaper(), torch.rand(48, 64, 3)
    net = HDRNet(torch.rand(CUBE, CUBE, CUBE, 3))
    grid, guide, cube = (x.detach().contiguous() for x in net(torch.rand(1, 3, SIDE, SIDE)))
    reads, free = ["colour", "params", "matrix"], [IMAGE, None, None]
    export(Lowres(), (colour, *shaper), reads, ["lowres"], folder / "lowres.onnx", free)
    size = torch.export.Dim("size", min=2)
    free = [*free, None, None, {0: size, 1: size, 2: size}]
    arguments, names = (colour, *shaper, guide, grid, cube), [*reads, "guide", "grid", "cube"]
    export(SliceApply(), arguments, names, ["output"], folder / "slice_apply.onnx", free)
    export_kernel(LIGHT, Light(), {}, folder)
    export_kernel(FOLLOW, Follow(), {}, folder)
    export_kernel(SMOOTH_GRID, Smooth(), {}, folder)
    export_kernel(EXPOSE, Expose(), {}, folder)
    export_kernel(ENCODE_DISPLAY, EncodeDisplay(), {"height": 9, "width": 16}, folder)
    export_kernel(CONVERT_PRIMARIES, ConvertPrimaries(), {"height": 9, "width": 16}, folder)
    export_kernel(APPLY_CUBE, ApplyCube(), {"height": 9, "width": 16, "size": 5}, folder)
    export_kernel(CHECKERBOARD, Checkerboard(), {"height": 9, "width": 16}, folder)


def network(checkpoint: dict[str, Any]) -> HDRNet | Exposure | None:
    """The network of a checkpoint, None for a global look, which has a cube only."""
    if checkpoint["weights"] is None:
        return None
    net = (Exposure if "dense.0.weight" in checkpoint["weights"] else HDRNet)(checkpoint["cube"])
    net.load_state_dict(checkpoint["weights"])
    return net.eval()


def export_look(checkpoint: dict[str, Any], tag: str, folder: Path,
                quality: dict[str, Any]) -> Path:
    """Write `tonemap.<tag>.onnx` and its card; raises ParityError where it does not compute what
    torch does."""
    path, net = folder / f"tonemap.{tag}.onnx", network(checkpoint)
    if net is None:
        _export_cube(checkpoint["cube"], path)
    else:
        low = torch.rand(1, 3, SIDE, SIDE)
        made = ["stops"] if isinstance(net, Exposure) else ["grid", "guide"]
        export(net, (low,), ["lowres"], [*made, "cube"], path)
        parity(net, path, (low,))
    write_card(path, card(checkpoint, tag, quality))
    return path


def _export_cube(cube: torch.Tensor, path: Path) -> None:
    """A model without inputs, whose output is the cube: kept in half precision, which holds it
    exactly."""
    half = onnx.numpy_helper.from_array(cube.numpy().astype("float16"), "cube_half")
    node = onnx.helper.make_node("Cast", ["cube_half"], ["cube"], to=onnx.TensorProto.FLOAT)
    output = onnx.helper.make_tensor_value_info("cube", onnx.TensorProto.FLOAT, cube.shape)
    graph = onnx.helper.make_graph([node], "look", [], [output], [half])
    model = onnx.helper.make_model(
        graph, opset_imports=[onnx.helper.make_opsetid("", OPSET)], ir_version=IR_VERSION
    )
    onnx.checker.check_model(model)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(model.SerializeToString(deterministic=True))


def card(checkpoint: dict[str, Any], tag: str, quality: dict[str, Any]) -> dict[str, Any]:
    """What the run-time and a reader need to know about the model."""
    size, net = checkpoint["cube"].shape[0], network(checkpoint)
    meaning = "red, green, blue, channel; over shaped colour"
    cube = {"shape": [size, size, size, 3], "meaning": meaning, "constant": True}
    common = {
        "name": f"tonemap.{tag}",
        "pass": "tonemap",
        "tag": tag,
        "shaper": {
            "formula": "clip(log2(1 + exposure * (matrix x) / toe) * scale, 0, 1)",
            "toe": TOE,
            "scale": SHAPER[1],
            "white": WHITE,
            "matrix": TO_WORKING.ravel().tolist(),
            "primaries": "Rec.2020, from Rec.709",
        },
        "output_encoding": "srgb",
        "look": checkpoint["look"],
        "training": {
            "script": "training/tonemap/train.py",
            "runs": checkpoint["history"],
            "pictures": checkpoint["pictures"],
        },
        "quality": {"held_out_psnr": checkpoint["psnr"], "pictures": quality},
    }
    if net is None:
        summary = f"Look {tag}: depends on colour alone, a cube without a network"
        return {**common, "summary": summary, "parameters": 0, "inputs": {},
                "outputs": {"cube": cube}}
    exposes = isinstance(net, Exposure)
    return {
        **common,
        "summary": f"Look {tag}: "
        f"{'a learnt exposure' if exposes else 'HDRNet (Gharbi et al. 2017)'} and a cube",
        "parameters": sum(p.numel() for name, p in net.named_parameters() if name != "cube"),
        **(STEADY_EXPOSURE if checkpoint["look"].get("key") else STEADY),
        "inputs": {"lowres": {"shape": [1, 3, SIDE, SIDE],
                              "meaning": "shaped colour, area average, 0..1"}},
        "outputs": {**(STOPS if exposes else GRID), "cube": cube},
    }


def options() -> argparse.ArgumentParser:
    return parser(__doc__, "local")


def main() -> None:
    args = options().parse_args()
    if not args.network_only:
        export_kernels(args.models / "kernels")
    if args.checkpoint:
        checkpoint = torch.load(args.checkpoint, map_location="cpu", weights_only=True)
        export_look(checkpoint, args.tag, args.models, read_quality(args.quality))


if __name__ == "__main__":
    main()
