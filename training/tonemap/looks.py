"""Looks that the tone mapper learns, as functions of exposed scene-linear Rec.709 with mid grey at 0.18.

    out = view(2 ** gain * local(key(rgb)))

`key` is an automatic exposure that keeps dark scenes dark and bright ones bright, `local` an operator on local
contrast, `view` a colour pipeline; each may be absent but the last. A look with neither is global: its cube is the
whole of it, and there is nothing for the network to do. With `key` alone there is one number to be learnt.
"""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from training.tonemap.local_laplacian import LUMINANCE, MID_GREY, compress
from training.tonemap.model import default_shaper, look_up, shape
from training.tonemap.views import ACES2, AGX, NEUTRAL, Lut, Ocio, View, exact_view

BLACK = 2.0**-16  # added to luminance before its logarithm
ENDS = (0.01, 0.99)  # quantiles that count as a scene's darkest and brightest


@dataclass(frozen=True)
class Local:
    """Local Laplacian: sigma in stops (what counts as detail); alpha < 1 lifts detail; beta < 1 compresses edges."""

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
        """Whether one exposure for a picture is all that there is before the view."""
        return self.local is None and self.key


LOOKS: dict[str, Look] = {
    "aces2": Look(ACES2),
    "agx": Look(AGX),
    "pbr_neutral": Look(NEUTRAL),
    "local": Look(ACES2, gain=0.75, local=Local(1.0, 0.95, 0.7)),
    "auto": Look(ACES2, gain=0.75, key=True),
}


def find_look(name: str) -> Look:
    """A built-in look, or one from a TOML file: gain, key, tables [local] and [view] with the fields of the classes."""
    if name in LOOKS:
        return LOOKS[name]
    if not name.endswith(".toml"):
        raise SystemExit(f"no look '{name}': there are {', '.join(LOOKS)}, or give a .toml file")
    try:
        return look_from(tomllib.loads(Path(name).read_text(encoding="utf-8")))
    except (KeyError, TypeError, OSError, tomllib.TOMLDecodeError) as error:
        raise SystemExit(f"{name}: {error}: give a table [view] with config, display and view, or file") from None


def look_from(values: Mapping[str, Any]) -> Look:
    """A look from plain values, as in a TOML file or from `describe`."""
    values = dict(values)
    view, local = dict(values.pop("view")), values.pop("local", None)
    return Look(Lut(**view) if "file" in view else Ocio(**view), local=Local(**local) if local else None, **values)


def describe(look: Look) -> dict[str, Any]:
    """Plain values that `look_from` reads."""
    return json.loads(json.dumps(asdict(look)))


def key(rgb: torch.Tensor) -> torch.Tensor:
    """(N,3,H,W) exposed to the scene's own key."""
    return rgb * torch.exp2(key_stops(rgb))[:, None, None, None]


def key_stops(rgb: torch.Tensor) -> torch.Tensor:
    """Stops (N,) that expose (N,3,H,W) to the scene's own key: dark scenes stay dark, bright ones bright, within 2
    stops of mid grey.

    The geometric mean of the luminance goes to 0.18 * 4 ** ((2 mean - low - high) / (high - low)), all in log2; low and
    high are the 1st and 99th percentile. Formula: Reinhard 2002, "Parameter estimation for photographic tone
    reproduction". The scale of the input does not matter.
    """
    log = log_luminance(rgb).flatten(1)
    low, high = torch.quantile(log[:, :: max(1, log.shape[1] // 2**16)], log.new_tensor(ENDS), dim=1)
    mean = log.mean(1)
    share = (2 * mean - low - high) / (high - low).clamp_min(1.0)
    return 2 * share.clamp(-1, 1) - mean + math.log2(MID_GREY)


def log_luminance(rgb: torch.Tensor) -> torch.Tensor:
    """log2 of the luminance of (N,3,H,W), in stops: (N,H,W)."""
    weights = rgb.new_tensor(LUMINANCE).view(1, 3, 1, 1)
    return torch.log2((rgb * weights).sum(1).clamp_min(0) + BLACK)


def before_view(rgb: torch.Tensor, look: Look) -> torch.Tensor:
    """Exposed scene-linear (N,3,H,W) as it meets the view."""
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
