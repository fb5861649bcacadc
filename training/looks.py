"""Target looks that the tone mapper learns: gain -> local range compression -> a colour pipeline's view.

A look maps exposed scene-linear Rec.709 (>= 0, mid grey 0.18) to sRGB-encoded display colour in [0, 1]:

    out = view(2 ** gain * compress(rgb, sigma, alpha, beta))

The view is any display/view of an OpenColorIO config, or a function. For training it is baked into a cube on log axes,
so that the GPU needs no OpenColorIO; `exact_view` is the pipeline itself, which validation pictures are made with.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F

from training.agx import agx
from training.local_laplacian import compress

CUBE = 65
CUBE_TOE, CUBE_WHITE = 2.0**-10, 2.0**9  # log2(1 + x / toe), x in [0, white], on each axis of the cube
ACES2_CONFIG = "cg-config-v4.0.0_aces-v2.0_ocio-v2.5"


@dataclass(frozen=True)
class Ocio:
    """A display and view of an OpenColorIO config; `config` is a built-in config's name or a file."""

    config: str
    source: str
    display: str
    view: str


@dataclass(frozen=True)
class Look:
    """gain in stops; sigma in stops (what counts as detail); alpha < 1 lifts detail; beta < 1 compresses edges."""

    gain: float
    sigma: float
    alpha: float
    beta: float
    view: Ocio | Callable[[np.ndarray], np.ndarray]


LOOKS: dict[str, Look] = {
    "aces2": Look(
        0.75,
        1.0,
        0.95,
        0.7,
        Ocio(ACES2_CONFIG, "Linear Rec.709 (sRGB)", "sRGB - Display", "ACES 2.0 - SDR 100 nits (Rec.709)"),
    ),
    "agx": Look(0.5, 1.0, 0.95, 0.7, agx),
}


def find_look(name: str) -> Look:
    """A built-in look, or one from a TOML file: gain, sigma, alpha, beta and a table [view] as `Ocio` describes it."""
    if name in LOOKS:
        return LOOKS[name]
    if not name.endswith(".toml"):
        raise SystemExit(f"no look '{name}': there are {', '.join(LOOKS)}, or give a .toml file")
    values = tomllib.loads(Path(name).read_text(encoding="utf-8"))
    try:
        view = Ocio(**values.pop("view"))
        return Look(**values, view=view)
    except (KeyError, TypeError) as error:
        raise SystemExit(
            f"{name}: {error}: give gain, sigma, alpha, beta and [view] config, source, display, view"
        ) from None


@cache
def _ocio_processor(ocio: Ocio) -> object:
    import PyOpenColorIO as OCIO

    registry = OCIO.BuiltinConfigRegistry()
    names = {entry[0] for entry in registry.getBuiltinConfigs()}
    config = (OCIO.Config.CreateFromBuiltinConfig if ocio.config in names else OCIO.Config.CreateFromFile)(ocio.config)
    forward = OCIO.TRANSFORM_DIR_FORWARD
    return config.getProcessor(ocio.source, ocio.display, ocio.view, forward).getDefaultCPUProcessor()


def exact_view(look: Look, rgb: np.ndarray) -> np.ndarray:
    """The view of `look` on (..., 3) float32 scene-linear Rec.709, computed by the pipeline itself; in [0, 1]."""
    if callable(look.view):
        return look.view(rgb)
    out = np.ascontiguousarray(rgb, np.float32).reshape(-1, 1, 3).copy()
    _ocio_processor(look.view).applyRGB(out)
    return out.reshape(rgb.shape).clip(0.0, 1.0)


def bake_cube(look: Look) -> np.ndarray:
    """(65,65,65,3) float32 [blue, green, red, channel] of the view on log axes."""
    axis = np.linspace(0.0, np.log2(1 + CUBE_WHITE / CUBE_TOE), CUBE)
    axis = (CUBE_TOE * (np.exp2(axis) - 1)).astype(np.float32)
    blue, green, red = np.meshgrid(axis, axis, axis, indexing="ij")
    return exact_view(look, np.stack([red, green, blue], -1))


def apply_cube(rgb: torch.Tensor, cube: torch.Tensor) -> torch.Tensor:
    """Trilinear look-up of (N,3,H,W) scene-linear colour in a baked cube; the result is in [0, 1]."""
    scale = 2.0 / float(np.log2(1 + CUBE_WHITE / CUBE_TOE))
    where = torch.log2(1 + rgb.clamp_min(0) / CUBE_TOE) * scale - 1
    where = where.permute(0, 2, 3, 1)[:, None].clamp(-1, 1)
    volume = cube.permute(3, 0, 1, 2)[None].expand(rgb.shape[0], -1, -1, -1, -1)
    return F.grid_sample(volume, where, mode="bilinear", padding_mode="border", align_corners=True)[:, :, 0]


def target(rgb: torch.Tensor, look: Look, cube: torch.Tensor) -> torch.Tensor:
    """The look of exposed scene-linear (N,3,H,W) by the baked cube."""
    return apply_cube(compress(rgb, look.sigma, look.alpha, look.beta) * 2.0**look.gain, cube)


def exact_target(rgb: np.ndarray, look: Look) -> np.ndarray:
    """The look of one exposed scene-linear picture (H,W,3) by the pipeline itself."""
    x = torch.from_numpy(np.ascontiguousarray(rgb, np.float32)).permute(2, 0, 1)[None]
    local = compress(x, look.sigma, look.alpha, look.beta)[0].permute(1, 2, 0).numpy()
    return exact_view(look, local * np.float32(2.0**look.gain)).astype(np.float32)
