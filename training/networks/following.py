"""How the tone mapper follows the light: definitions of the kernels `light`, `follow`, `smooth` and `expose`."""

from __future__ import annotations

import torch

from postfx.kernels.expose import MOST as FARTHEST
from postfx.kernels.follow import JUMP, LAG, MOST, RELEASE
from postfx.kernels.smooth import BROKEN


def light(low: torch.Tensor) -> torch.Tensor:
    """Means (256,3) of the rows of (1,3,256,256)."""
    return low.double().mean(3)[0].T.to(low.dtype)


def follow(light: torch.Tensor, params: torch.Tensor, before: torch.Tensor) -> torch.Tensor:
    """(256,3), (4,) and (1,4) -> (1,4), as `postfx.kernels.follow` says."""
    keep, most, past, scale = params.double().unbind()
    _, made_for, last, share = before.double()[0].unbind()
    now = light.double().mean() / scale
    lag, jump = (made_for - now).abs(), (last - now).abs()
    known = (past > 0) & (lag <= MOST) & (jump <= MOST) & (share.abs() <= 1)
    change = (torch.maximum(lag / LAG, jump / JUMP) - 1).clamp(0, 1)
    share = torch.maximum(torch.maximum(most * change, RELEASE * share), 1 - keep)
    kept, none = 1 - share, torch.zeros_like(now)
    followed = torch.stack([kept, now + kept * (made_for - now), now, share])
    return torch.where(known, followed, torch.stack([none, now, now, none]))[None].to(light.dtype)


def smooth(previous: torch.Tensor, current: torch.Tensor, keep: torch.Tensor) -> torch.Tensor:
    """Exponential smoothing of the grid over time: keep[0,0] of the previous grid, none of it where it is broken."""
    change = previous - current
    return current + keep[0, 0] * torch.where(change.abs() <= float(BROKEN), change, 0)


def expose(previous: torch.Tensor, current: torch.Tensor, keep: torch.Tensor, params: torch.Tensor) -> torch.Tensor:
    """(3,), (1,1), (1,4) and (3,) -> (3,), as `postfx.kernels.expose` says."""
    stops, kept = current.double()[0, 0], keep.double()[0, 0]
    change = torch.log2(previous.double()[0]) - stops
    stops = stops + torch.where((kept > 0) & (change.abs() <= FARTHEST), kept * change, 0)
    exposure, toe, scale = params.unbind()
    return torch.stack([torch.exp2(stops).to(params.dtype), toe / exposure, scale])
