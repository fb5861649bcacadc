"""Export the denoised upscaler: network and card to models/, its compute kernels to
models/kernels/.

    python -m training.denoise.export checkpoint.pt --tag m [--quality quality.json]
    python -m training.denoise.export checkpoint.pt --tag m.1x
    python -m training.denoise.export
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from torch import nn

from postfx.kernels.denoise import CONTROLS as CONTROL_COUNT
from postfx.kernels.denoise import FINE, GUIDES, HIDDEN, KERNEL, MIRRORED, PHASES
from postfx.kernels.denoise.alpha import CORRECT, FIT, GATHER
from postfx.kernels.denoise.features import FEATURE, GUIDE, MIRROR, TRUST
from postfx.kernels.denoise.history import HISTORY, KEEP, REACTIVE, REFLECTIONS, RESIZE, SPREAD_MASK
from postfx.kernels.denoise.network_io import (
    LEAST_LOG_ERROR,
    MOST_LOG_ERROR,
    OPEN,
    OPEN_ERROR,
    OPEN_FINE,
    OPEN_FINE_PRODUCTS,
    OPEN_PHASED,
    OPEN_PRODUCTS,
    PACK,
    STORE,
    STORE_RINGED,
)
from postfx.kernels.denoise.output import ASSEMBLE, DETAIL, JUDGE, RESTORE, STRENGTH
from postfx.kernels.denoise.parts import (
    ACCUMULATE_PART,
    BALANCE,
    DECODE,
    DECODE_ONE,
    REFLECT,
    UPSAMPLE_LIGHT,
)
from postfx.kernels.denoise.prepare import ACCUMULATE, DILATE, MEANS, SCALE
from postfx.kernels.denoise.pyramid import (
    ENLARGE_ALPHA,
    FILTER,
    LEVEL,
    MIX_LEVELS,
    POOL,
    REMODULATE,
    REMODULATE_BOTH,
)
from postfx.kernels.denoise.upsample import (
    BLEND_PICTURE,
    UPSAMPLE,
    UPSAMPLE_GUIDED,
    UPSAMPLE_UNSCALED,
)
from postfx.kernels.image import ENLARGE_OVERLAY, OVER, OVER_ALPHA, RESAMPLE
from postfx.kernels.partner import ENLARGE_MOTION, MIX_PARTNER
from postfx.passes.denoise.models import GUIDED, UNSCALED, split_ending
from postfx.passes.denoise.network import (
    CONTROLS_NAME,
    ERROR,
    FEATURE_PARTS,
    FINE_HEAD,
    PHASED_FINE,
    PICTURE,
)
from training.denoise.model import (
    LEVELS,
    Trunk,
    TrunkConfig,
    activate_fine,
    filters,
    stem,
)
from training.denoise.picture import PictureConfig, PictureNetwork, layout_from
from training.denoise.residual import (
    STEEPEST,
    ResidualConfig,
    ResidualTrunk,
    normalise,
)
from training.export import (
    export,
    export_kernel,
    parity,
    parser,
    read_quality,
    write_card,
    write_model,
)
from training.kernels import denoise as kernels
from training.kernels import extras, partner, parts

CHECKED = (48, 80)  # size at which the export is compared with torch: not the size that is traced
MIXTURES = "xl"
"""Tag of the network that enlarges mixtures of noisy and denoised frames."""
SUMMARIES = {"": "recurrent denoised upscaler, 1x to 3x",
             UNSCALED: "recurrent denoised upscaler, for 1x",
             GUIDED: "recurrent denoised upscaler, 1x to 3x, guides at output size",
             MIXTURES: "recurrent upscaler, 1x to 3x, of frames that xl.1x has denoised first"}
CONTENT = (f"logits of 5x5 kernel {KERNEL}, 3x3 weights at four phases {PHASES}, history blend and "
           f"sharpening at four phases 4 + 4, mix, distrust, importance, hidden state {HIDDEN}")
MEANING = {
    PHASED_FINE: f"{CONTENT}; of each the four phases of 2x2 pixels",
    FINE_HEAD: f"{CONTENT}, as the kernels read them",
    PICTURE: "log(1 + exposed colour)",
    CONTROLS_NAME: "share of the picture beside the history, distrust of what was accumulated, 1, "
    f"hidden state {HIDDEN}",
    ERROR: "natural logarithm of the expected squared error of each pixel, in sRGB code values of "
    "x / (1 + x)",
    "level": f"5x5 kernel {KERNEL}, mix; level i is height / 2^i by width / 2^i",
    "level4": f"5x5 kernel {KERNEL}",
}
Layout = TrunkConfig | ResidualConfig | PictureConfig
Network = Trunk | ResidualTrunk | PictureNetwork
COUNTS = {PHASED_FINE: 4 * FINE, FINE_HEAD: FINE, PICTURE: 3, CONTROLS_NAME: CONTROL_COUNT,
          ERROR: 1, "level4": KERNEL}
"""Channels of the outputs; other levels have a mix, too."""
ALIKE = "the same at all pixels"
HALO = 80
"""Render pixels around a window of a network of the render size: on four sequences with the network
`l` the result then differs from the whole frame's by at most 3e-5, with 64 pixels by 2e-3
(docs/lab/denoiser.md)."""
FILTERED_HALO = 84
"""Halo where a filter for the albedo runs before: with `xl` it changes results by at most 1.0e-3,
80 pixels by 1.3e-3."""


# Kernel -> its torch definition, and the sizes to trace with: 21x33 pixels of a picture of 25x45,
# padded to 32x48, enlarged to 29x51 of 35x70.
SIZES = {"h": 25, "w": 45, "th": 21, "tw": 33, "hp": 32, "wp": 48, "height": 35, "width": 70,
         "out_th": 29, "out_tw": 51, "padded_h": 23, "padded_w": 35, "half_hp": 16, "half_wp": 24,
         "tiles_high": 2, "tiles_wide": 3,
         "finer_h": 63, "finer_w": 97, "coarse_h": 17, "coarse_w": 25, "heads": FINE,
         "controls": FINE, "channels": 3,
         "tiles": 2, "tile_h": 11, "tile_w": 13, "rows": 17, "columns": 19,
         "keep_h": 15, "keep_w": 27, "parts": 3, "cells_h": 3, "cells_w": 5, "means_h": 6,
         "means_w": 8, "wide": 8,
         "reached_h": 9, "reached_w": 10, "near_h": 4, "near_w": 7, "planes": 9, "motion_h": 35,
         "motion_w": 70, "weight_h": 35, "weight_w": 70, "strength_h": 35, "strength_w": 70}
KERNELS = {
    SCALE: kernels.Scale,
    DILATE: kernels.Dilate,
    HISTORY: kernels.History,
    FEATURE: kernels.Features,
    GUIDE: kernels.GuideFeatures,
    MIRROR: kernels.MirroredFeatures,
    TRUST: kernels.Trust,
    MEANS: kernels.Means,
    ACCUMULATE: kernels.Accumulate,
    RESIZE: kernels.Resize,
    REFLECTIONS: extras.Reflections,
    POOL: kernels.Pool,
    MIX_LEVELS: kernels.Mix,
    FILTER: kernels.Filter,
    REMODULATE: kernels.Remodulate,
    REMODULATE_BOTH: kernels.RemodulateBoth,
    UPSAMPLE: kernels.Upsample,
    UPSAMPLE_GUIDED: kernels.UpsampleGuided,
    UPSAMPLE_UNSCALED: kernels.UpsampleUnscaled,
    BLEND_PICTURE: kernels.BlendPicture,
    REFLECT: parts.Reflect,
    ACCUMULATE_PART: parts.AccumulatePart,
    UPSAMPLE_LIGHT: parts.UpsampleLight,
    BALANCE: parts.Balance,
    GATHER: parts.Gather,
    LEVEL: parts.AlphaLevel,
    ENLARGE_ALPHA: parts.EnlargeAlpha,
    FIT: parts.Fit,
    CORRECT: parts.Correct,
    DECODE: parts.Decode,
    DECODE_ONE: parts.DecodeOne,
    JUDGE: extras.Judge,
    DETAIL: extras.Detail,
    RESTORE: extras.Restore,
    STRENGTH: kernels.Strength,
    REACTIVE: extras.Reactive,
    SPREAD_MASK: extras.Spread,
    KEEP: extras.Keep,
    ASSEMBLE: kernels.Assemble,
    RESAMPLE: kernels.Resample,
    ENLARGE_OVERLAY: extras.Enlarge,
    OVER: extras.Over,
    OVER_ALPHA: extras.OverAlpha,
    MIX_PARTNER: partner.MixPartner,
    ENLARGE_MOTION: partner.EnlargeMotion,
    PACK: kernels.Pack,
    OPEN: kernels.Open,
    OPEN_FINE: kernels.OpenFine,
    OPEN_PHASED: kernels.OpenPhased,
    OPEN_ERROR: kernels.OpenError,
    OPEN_PRODUCTS: kernels.OpenProducts,
    OPEN_FINE_PRODUCTS: kernels.OpenFineProducts,
    STORE: kernels.Store,
    STORE_RINGED: kernels.StoreRinged,
}


def export_kernels(folder: Path) -> None:
    """Write the portable definitions of all kernels."""
    for kernel, definition in KERNELS.items():
        export_kernel(kernel, definition(), SIZES, folder)


def load_trunk(checkpoint: dict[str, Any]) -> Network:
    """The trunk of a checkpoint of train.py: weights rounded to half precision, kept as float32."""
    layout = layout_from(checkpoint["config"])
    kinds = {ResidualConfig: ResidualTrunk, PictureConfig: PictureNetwork}
    trunk = kinds.get(type(layout), Trunk)(layout)
    weights = {key.removeprefix("trunk."): value.half().float()
               for key, value in checkpoint["weights"].items()}
    trunk.load_state_dict(weights)
    return trunk.eval()


def example(trunk: Network, height: int, width: int) -> tuple[torch.Tensor, ...]:
    """Features, and guides or planes where the network reads them, with the ranges of real ones."""
    generator = torch.Generator().manual_seed(0)
    sizes = inputs(trunk.config).values()
    return tuple(torch.rand(1, channels, height, width, generator=generator) * 2 - 0.5
                 for channels in sizes)


def inputs(config: Layout) -> dict[str, int]:
    """Names of the network's inputs and their channels."""
    further = {"guides": GUIDES} if config.guides else {}
    return FEATURE_PARTS | further | ({"mirrored": MIRRORED} if config.mirrored else {})


def outputs(config: Layout) -> tuple[str, ...]:
    """Names of the network's outputs."""
    levels = tuple(f"level{level}" for level in range(1, LEVELS + 1))
    if isinstance(config, PictureConfig):
        return PICTURE, CONTROLS_NAME, ERROR
    if not isinstance(config, ResidualConfig):
        return PHASED_FINE, *levels
    return FINE_HEAD, *levels, *((ERROR,) if config.mirrored else ())


class ExportedTrunk(Trunk):
    """A `Trunk` that reads the features in two parts, and whose fine head ends with the
    convolution: `postfx.kernels.denoise.network_io` does the rest."""

    def __init__(self, trunk: Trunk):
        super().__init__(trunk.config)
        self.load_state_dict(trunk.state_dict())
        shares = self.stem.weight.detach().split(list(FEATURE_PARTS.values()), 1)
        self.stems = nn.ModuleList(stem(self.config, share.shape[1], bias=i == 0)
                                   for i, share in enumerate(shares))
        for part, share in zip(self.stems, shares, strict=True):
            part.weight = nn.Parameter(share.contiguous())
        self.stems[0].bias = self.stem.bias

    # other inputs than the trained network's are what it is for
    def forward(  # type: ignore[override]
        self, first: torch.Tensor, last: torch.Tensor, guides: torch.Tensor | None = None
    ) -> tuple[torch.Tensor, ...]:
        return self.behind(self.stems[0](first) + self.stems[1](last), guides)

    def _fine(self, x: torch.Tensor) -> torch.Tensor:
        return self.fine(x)


class ExportedResidual(ResidualTrunk):
    """The same network, except that it reads its inputs in parts."""

    def __init__(self, trunk: ResidualTrunk):
        super().__init__(trunk.config)
        self.load_state_dict(trunk.state_dict())
        shares = self.stem.weight.detach().split(list(inputs(self.config).values()), 1)
        self.stems = nn.ModuleList(nn.Conv2d(share.shape[1], share.shape[0], 3, padding=1,
                                             bias=i == 0)
                                   for i, share in enumerate(shares))
        for part, share in zip(self.stems, shares, strict=True):
            part.weight = nn.Parameter(share.contiguous())
        self.stems[0].bias = self.stem.bias

    def forward(self, first: torch.Tensor, last: torch.Tensor,
                mirrored: torch.Tensor | None = None) -> tuple[torch.Tensor, ...]:
        x = self.stems[0](first) + self.stems[1](last)
        return self.behind(x if mirrored is None else x + self.stems[2](mirrored))

    def level_head(self, head: nn.Conv2d, stream: torch.Tensor) -> torch.Tensor:
        return filters(head(normalise(stream)).clamp(-STEEPEST, STEEPEST))

    def all_heads(self, stream: torch.Tensor,
                  levels: list[torch.Tensor]) -> tuple[torch.Tensor, ...]:
        ends = (() if self.error is None
                else (self.error(stream).clamp(LEAST_LOG_ERROR, MOST_LOG_ERROR),))
        fine = activate_fine(self.fine(stream).clamp(-STEEPEST, STEEPEST))
        return fine, *levels, *ends


class ExportedPicture(PictureNetwork):
    """A `PictureNetwork` that reads the features in parts, and adds up convolutions over several
    tensors instead of joining those.

    ONNX Runtime lays channels out in blocks, and leaves that layout where tensors are joined to an
    odd number of channels.
    """

    def __init__(self, trunk: PictureNetwork):
        super().__init__(trunk.config)
        self.load_state_dict(trunk.state_dict())

    # other inputs than the trained network's are what it is for
    def forward(  # type: ignore[override]
        self, first: torch.Tensor, last: torch.Tensor, mirrored: torch.Tensor
    ) -> tuple[torch.Tensor, ...]:
        return super().forward(torch.cat((first, last), 1), mirrored)[:3]

    @staticmethod
    def convolve(layer: nn.Conv2d, *inputs: torch.Tensor) -> torch.Tensor:
        weights = layer.weight.split([values.shape[1] for values in inputs], 1)
        found = F.conv2d(inputs[0], weights[0], layer.bias, padding=layer.padding)
        for values, some in zip(inputs[1:], weights[1:], strict=True):
            found = found + F.conv2d(values, some, padding=layer.padding)
        return found


def exported(trunk: Network) -> nn.Module:
    """The network as its file holds it."""
    if isinstance(trunk, PictureNetwork):
        return ExportedPicture(trunk)
    return ExportedResidual(trunk) if isinstance(trunk, ResidualTrunk) else ExportedTrunk(trunk)


def export_trunk(trunk: Network, path: Path) -> float:
    """Write the network and compare it with torch; returns the largest relative error. Raises
    ParityError."""
    reads, writes = inputs(trunk.config), outputs(trunk.config)
    names = {name: (1, channels, "height", "width") for name, channels in reads.items()}
    names |= {name: (1, _channels(name), *("??" if has_level(trunk.config, name) else (1, 1)))
              for name in writes}
    module = exported(trunk)
    # traced at one size, in a third of the time: no node holds it, as the comparison shows
    free = None
    if isinstance(trunk, PictureNetwork):  # some of its nodes would
        # torch checks that the sizes of skip connections match, so it must know what the input is a
        # multiple of.
        sides = {2: torch.export.Dim("rows", min=1), 3: torch.export.Dim("columns", min=1)}
        free = [{axis: trunk.align * side for axis, side in sides.items()}] * len(reads)
    model = export(module, example(trunk, 64, 96), list(reads), writes, path, free, names)
    height, width = CHECKED
    error = parity(module, path, example(trunk, height, width), {"height": height, "width": width})
    write_model(model, path)
    return error


def has_level(config: Layout, output: str) -> bool:
    """Whether the network computes an output, which otherwise is the same at all pixels."""
    return (not isinstance(config, TrunkConfig) or output == PHASED_FINE
            or int(output[-1]) <= len(config.widths))


def _channels(name: str) -> int:
    return COUNTS.get(name, KERNEL + 1)


def card(checkpoint: dict[str, Any], tag: str, error: float,
         quality: dict[str, Any]) -> dict[str, Any]:
    """What the run-time and a reader need to know about the model."""
    config = layout_from(checkpoint["config"])
    return {
        "name": f"denoise_upscale.{tag}",
        "pass": "denoise_upscale",
        "tag": tag,
        "summary": SUMMARIES[tag if tag == MIXTURES else split_ending(tag)[1]],
        "parameters": sum(weight.numel() for weight in checkpoint["weights"].values()),
        "inputs": {
            name: {
                "shape": [1, channels, "height", "width"],
                "meaning": "see training/denoise/model.py; height and width multiples of "
                f"{config.align}",
            } for name, channels in inputs(config).items()
        },
        "outputs": {name: _output(config, name) for name in outputs(config)},
        **_manners(config),
        "config": checkpoint["config"],
        "training": {"script": "training/denoise/train.py", **checkpoint["notes"]},
        "parity": {"max_relative_error": float(f"{error:.2g}"),
                   "against": f"torch {torch.__version__}"},
        "quality": quality,
    }


def _manners(config: Layout) -> dict[str, Any]:
    """How a network is run, where not as most are: with the planes of volumes, and with a halo of
    its own."""
    if isinstance(config, TrunkConfig):
        return {}
    halo = FILTERED_HALO if isinstance(config, PictureConfig) and config.filtered else HALO
    return {"blanks_volumes": False, "halo": min(halo, config.sees)}


def _output(config: Layout, name: str) -> dict[str, Any]:
    meaning = MEANING.get(name, MEANING["level"])
    if not has_level(config, name):
        return {"shape": [1, _channels(name), 1, 1], "meaning": f"{meaning}; {ALIKE}",
                "constant": True}
    if name in (FINE_HEAD, PICTURE, CONTROLS_NAME, ERROR):
        return {"shape": [1, _channels(name), "height", "width"], "meaning": meaning}
    level = 1 if name == PHASED_FINE else int(name[-1])
    return {"shape": [1, _channels(name), f"height/{2**level}", f"width/{2**level}"],
            "meaning": meaning}


def main() -> None:
    args = parser(__doc__, "m").parse_args()
    if not args.network_only:
        export_kernels(args.models / "kernels")
    if not args.checkpoint:
        return
    checkpoint = torch.load(args.checkpoint, map_location="cpu", weights_only=True)
    path = args.models / f"denoise_upscale.{args.tag}.onnx"
    error = export_trunk(load_trunk(checkpoint), path)
    write_card(path, card(checkpoint, args.tag, error, read_quality(args.quality)))
    print(f"largest relative error to torch: {error:.2g}")


if __name__ == "__main__":
    main()
