"""Looks that the tone mapper learns, as functions of exposed scene-linear Rec.709 with mid grey at
0.18.

    out = view(2 ** gain * local(key(rgb)))

`key` is an automatic exposure that keeps dark scenes dark and bright ones bright, `local` an
operator on local contrast, `view` a colour pipeline; all but the last are optional. A look with
only a view is global: it is a cube, and a network has nothing to learn. With `key` alone there is
one number to learn.
"""

from __future__ import annotations

import json
import math
import os
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from kornia.filters import filter2d_separable

from postfx.colour import ACESCG, REC709, matrix_between
from postfx.colour.displays import DISPLAY_KINDS
from postfx.colour.ocio import DISPLAYS, Transform, file_transform
from postfx.errors import ColourError
from training.tonemap.model import BLACK, CUBE, MID_GREY, default_shaper, lattice, look_up, shape

# Views --------------------------------------------------------------------------------------------
# Colour pipelines that turn exposed scene-linear Rec.709 into sRGB-encoded display colour, through
# OpenColorIO. A view is a display and view of any OpenColorIO config, or a LUT file of any format
# that OpenColorIO reads.

ACES_CONFIG = "cg-config-v4.0.0_aces-v2.0_ocio-v2.5"  # built into OpenColorIO 2.5
ACES_LINEAR = "Linear Rec.709 (sRGB)"
BLENDER_CONFIG = "$BLENDER_OCIO"
SRGB = "srgb"
ONLY_SRGB = ("looks are learnt for sRGB, and 'postfx run --display' shows them on others: give "
             "that for sRGB")
NO_BLENDER = (
    "this look is a view of Blender's OpenColorIO config: set BLENDER_OCIO to "
    "its datafiles/colormanagement/config.ocio (in an installed Blender, or in the wheel that 'pip "
    "download --no-deps bpy' gives)"
)


@dataclass(frozen=True)
class Ocio:
    """A display and view; `config` is a built-in config's name or a file, `source` its name of
    linear Rec.709."""

    config: str
    display: str
    view: str
    source: str = ""
    look: str = ""


@dataclass(frozen=True)
class Lut:
    """A look-up table as `postfx.colour.ocio.file_transform` names it: 'FILE,input=SPACE'."""

    file: str


View = Ocio | Lut
ACES2 = Ocio(ACES_CONFIG, "sRGB - Display", "ACES 2.0 - SDR 100 nits (Rec.709)")
AGX = Ocio(BLENDER_CONFIG, "sRGB", "AgX")
NEUTRAL = Ocio(BLENDER_CONFIG, "sRGB", "Khronos PBR Neutral")


def exact_view(view: View, rgb: np.ndarray) -> np.ndarray:
    """The view of (..., 3) exposed scene-linear Rec.709 by the pipeline itself; float32 in [0,
    1]."""
    if isinstance(view, Lut):
        try:
            return _table(view).apply(rgb @ matrix_between(REC709, ACESCG).T).astype(np.float32)
        except ColourError as error:
            raise SystemExit(str(error)) from None
    out = np.ascontiguousarray(rgb, np.float32).reshape(-1, 1, 3).copy()
    _processor(view).applyRGB(out)
    return out.reshape(rgb.shape).clip(0.0, 1.0)


def bake(view: View, size: int = CUBE) -> np.ndarray:
    """The view at the corners of the tone mapper's cube: (size,size,size,3) float32 that half
    precision holds."""
    return exact_view(view, lattice(size)).astype(np.float16).astype(np.float32)


def _table(view: Lut) -> Transform:
    found = file_transform(view.file)
    if found.display.name != SRGB:
        raise SystemExit(f"{view.file}: is for {found.display.kind.title}: {ONLY_SRGB}")
    return found


@cache
def _processor(view: Ocio) -> Any:
    import PyOpenColorIO as OCIO

    try:
        return _display(OCIO, view).getDefaultCPUProcessor()
    except OCIO.Exception as error:
        raise SystemExit(f"{view.config}: {error}") from None


def _config(ocio: Any, name: str) -> Any:
    """A built-in config by name, or one from a file."""
    if name in {entry[0] for entry in ocio.BuiltinConfigRegistry().getBuiltinConfigs()}:
        return ocio.Config.CreateFromBuiltinConfig(name)
    if name == BLENDER_CONFIG and "BLENDER_OCIO" not in os.environ:
        raise SystemExit(NO_BLENDER)
    try:
        return ocio.Config.CreateFromFile(os.path.expandvars(name))
    except ocio.Exception as error:
        raise SystemExit(f"{name}: {error}") from None


def _display(ocio: Any, view: Ocio) -> Any:
    shown = next((kind.title for name, kind in DISPLAY_KINDS.items()
                  if view.display in DISPLAYS[name] and name != SRGB), None)
    if shown:
        raise SystemExit(f"{view.display}: is for {shown}: {ONLY_SRGB}")
    config = _config(ocio, view.config)
    source = view.source or _linear_rec709(config)
    pipeline = ocio.LegacyViewingPipeline()
    pipeline.setDisplayViewTransform(ocio.DisplayViewTransform(source, view.display, view.view))
    if view.look:
        pipeline.setLooksOverrideEnabled(True)
        pipeline.setLooksOverride(view.look)
    return pipeline.getProcessor(config)


def _linear_rec709(config: Any) -> str:
    """The config's name of linear Rec.709."""
    for name in (ACES_LINEAR, "lin_rec709", "Linear Rec.709", "Utility - Linear - sRGB",
                 "lin_srgb"):
        if config.getColorSpace(name):
            return name
    raise SystemExit("the config has no linear Rec.709 under a usual name: give its name with "
                     "--source")


# The local operator -------------------------------------------------------------------------------
# A fast local Laplacian filter on log luminance.
#
# Formula: Paris, Hasinoff and Kautz 2011 ("Local Laplacian Filters"), sampled in intensity as in
# Aubry et al. 2014. Edges above `sigma` stops are compressed by `beta`, smaller detail is kept or
# changed by `alpha`; no halos by design.

LUMINANCE = (0.2126, 0.7152, 0.0722)
FLOOR = 2.0**-8  # added to luminance before the logarithm, so that noise in black is not stretched


def _down(x: torch.Tensor) -> torch.Tensor:
    """Half size, sampled in line with `_up`: any shift between the two would smear to one side at
    every level."""
    size = [-(-side // 2) for side in x.shape[-2:]]  # kornia's pyrdown rounds odd sizes down
    line = torch.tensor([[1.0, 4.0, 6.0, 4.0, 1.0]], dtype=x.dtype, device=x.device) / 16
    blurred = filter2d_separable(x, line, line, "replicate")
    return F.interpolate(blurred, size=size, mode="bilinear", align_corners=False)


def _up(x: torch.Tensor, size: tuple[int, int]) -> torch.Tensor:
    return F.interpolate(x, size=size, mode="bilinear", align_corners=False)


def _gaussian_pyramid(x: torch.Tensor, levels: int) -> list[torch.Tensor]:
    out = [x]
    for _ in range(levels - 1):
        out.append(_down(out[-1]))
    return out


def _remap(x: torch.Tensor, centre: torch.Tensor, sigma: float, alpha: float,
           beta: float) -> torch.Tensor:
    """Point-wise curve around `centre`: detail (<= sigma) to the power alpha, edges (> sigma)
    scaled by beta."""
    d = x - centre
    a = d.abs()
    detail = sigma * (a / sigma).clamp_min(1e-6) ** alpha
    edge = beta * (a - sigma) + sigma
    return centre + d.sign() * torch.where(a <= sigma, detail, edge)


def local_laplacian(x: torch.Tensor, sigma: float, alpha: float, beta: float,
                    step: float = 1.0) -> torch.Tensor:
    """Filter log2 luminance `x` (N,1,H,W) in stops; the coarsest level is compressed by beta around
    mid grey."""
    levels = max(2, int(min(x.shape[-2:])).bit_length() - 1)
    low, high = float(x.min()), float(x.max())
    count = max(2, int((high - low) / step) + 2)
    centres = torch.linspace(low, high, count, dtype=x.dtype, device=x.device)
    spacing = float(centres[1] - centres[0])
    gauss = _gaussian_pyramid(x, levels)
    centres = centres.view(1, -1, 1, 1)
    remapped = _gaussian_pyramid(_remap(x, centres, sigma, alpha, beta), levels)
    out = []
    for i in range(levels - 1):
        bands = remapped[i] - _up(remapped[i + 1], remapped[i].shape[-2:])
        weights = (1 - (gauss[i] - centres).abs() / spacing).clamp_min(0)
        out.append((bands * weights).sum(1, keepdim=True))
    grey = math.log2(MID_GREY + FLOOR)
    result = grey + beta * (gauss[-1] - grey)
    for i in range(levels - 2, -1, -1):
        result = _up(result, out[i].shape[-2:]) + out[i]
    return result


def compress(rgb: torch.Tensor, sigma: float, alpha: float, beta: float) -> torch.Tensor:
    """Local range compression of exposed scene-linear RGB (N,3,H,W); hue and saturation ratios are
    kept."""
    weights = torch.tensor(LUMINANCE, dtype=rgb.dtype, device=rgb.device).view(1, 3, 1, 1)
    log = torch.log2((rgb * weights).sum(1, keepdim=True).clamp_min(0) + FLOOR)
    return rgb * torch.exp2(local_laplacian(log, sigma, alpha, beta) - log)


# Looks --------------------------------------------------------------------------------------------

ENDS = (0.01, 0.99)  # quantiles that count as a scene's darkest and brightest


@dataclass(frozen=True)
class Local:
    """Local Laplacian: differences below sigma stops are detail; alpha < 1 lifts detail; beta < 1
    compresses edges."""

    sigma: float = 1.0
    alpha: float = 1.0
    beta: float = 1.0


@dataclass(frozen=True)
class Look:
    """gain in stops, before the view."""

    view: View
    gain: float = 0.0
    local: Local | None = None
    key: bool = False

    @property
    def is_global(self) -> bool:
        return self.local is None and not self.key

    @property
    def is_exposure(self) -> bool:
        """Whether the look is one exposure for a picture, then the view."""
        return self.local is None and self.key


LOOKS: dict[str, Look] = {
    "aces2": Look(ACES2),
    "agx": Look(AGX),
    "pbr_neutral": Look(NEUTRAL),
    "local": Look(ACES2, gain=0.75, local=Local(1.0, 0.95, 0.7)),
    "auto": Look(ACES2, gain=0.75, key=True),
}


def find_look(name: str) -> Look:
    """A built-in look, or one from a TOML file: gain, key, tables [local] and [view] with the
    fields of the classes."""
    if name in LOOKS:
        return LOOKS[name]
    if not name.endswith(".toml"):
        raise SystemExit(f"no look '{name}': there are {', '.join(LOOKS)}, or give a .toml file")
    try:
        return look_from(tomllib.loads(Path(name).read_text(encoding="utf-8")))
    except (KeyError, TypeError, OSError, tomllib.TOMLDecodeError) as error:
        raise SystemExit(f"{name}: {error}: give a table [view] with config, display and view, or "
                         "file") from None


def look_from(values: Mapping[str, Any]) -> Look:
    """A look from plain values, as in a TOML file or from `describe`."""
    values = dict(values)
    view, local = dict(values.pop("view")), values.pop("local", None)
    return Look(Lut(**view) if "file" in view else Ocio(**view),
                local=Local(**local) if local else None, **values)


def describe(look: Look) -> dict[str, Any]:
    """Plain values that `look_from` reads."""
    return json.loads(json.dumps(asdict(look)))


def key(rgb: torch.Tensor) -> torch.Tensor:
    """(N,3,H,W) exposed to the scene's own key."""
    return rgb * torch.exp2(key_stops(rgb))[:, None, None, None]


def key_stops(rgb: torch.Tensor) -> torch.Tensor:
    """Stops (N,) that expose (N,3,H,W) to the scene's own key: dark scenes stay dark, bright ones
    bright, within 2 stops of mid grey.

    The geometric mean of the luminance goes to 0.18 * 4 ** ((2 mean - low - high) / (high - low)),
    all in log2; low and high are the 1st and 99th percentile. Formula: Reinhard 2002, "Parameter
    estimation for photographic tone reproduction". The scale of the input does not matter.
    """
    log = log_luminance(rgb).flatten(1)
    low, high = torch.quantile(log[:, :: max(1, log.shape[1] // 2**16)], log.new_tensor(ENDS),
                               dim=1)
    mean = log.mean(1)
    share = (2 * mean - low - high) / (high - low).clamp_min(1.0)
    return 2 * share.clamp(-1, 1) - mean + math.log2(MID_GREY)


def log_luminance(rgb: torch.Tensor) -> torch.Tensor:
    """log2 of the luminance of (N,3,H,W), in stops: (N,H,W)."""
    weights = rgb.new_tensor(LUMINANCE).view(1, 3, 1, 1)
    return torch.log2((rgb * weights).sum(1).clamp_min(0) + BLACK)


def before_view(rgb: torch.Tensor, look: Look) -> torch.Tensor:
    """Scene-linear colour (N,3,H,W) before the view, from exposed scene-linear colour."""
    x = key(rgb) if look.key else rgb
    if look.local:
        x = compress(x, look.local.sigma, look.local.alpha, look.local.beta)
    return x * 2.0**look.gain


def target(rgb: torch.Tensor, look: Look, cube: torch.Tensor) -> torch.Tensor:
    """The look of exposed scene-linear (N,3,H,W) with its view as a cube."""
    return look_up(shape(before_view(rgb, look), *default_shaper(rgb.device)), cube)


def exact_target(rgb: np.ndarray, look: Look) -> np.ndarray:
    """The look of one exposed scene-linear picture (H,W,3) by the pipeline itself."""
    x = torch.from_numpy(np.ascontiguousarray(rgb, np.float32)).permute(2, 0, 1)[None]
    return exact_view(look.view, before_view(x, look)[0].permute(1, 2, 0).numpy())
