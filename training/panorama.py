"""Perspective views of equirectangular environment maps."""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F


def perspective(sphere: torch.Tensor, yaw: float, pitch: float, fov: float, size: tuple[int, int]) -> torch.Tensor:
    """View (3,H,W) of an environment (3,h,w); angles in degrees, `fov` along the longer side, bilinear."""
    h, w = size
    device = sphere.device
    focal = max(h, w) / (2 * math.tan(math.radians(fov) / 2))
    x = (torch.arange(w, device=device) + 0.5 - w / 2) / focal
    y = (torch.arange(h, device=device) + 0.5 - h / 2) / focal
    y, x = torch.meshgrid(y, x, indexing="ij")
    c, s = math.cos(math.radians(pitch)), math.sin(math.radians(pitch))
    up, forward = y * c - s, y * s + c
    longitude = torch.atan2(x, forward) / math.pi + yaw / 180
    longitude = torch.remainder(longitude + 1, 2) - 1
    latitude = torch.atan2(up, torch.hypot(x, forward)) / (math.pi / 2)
    where = torch.stack([longitude, latitude], -1)[None]
    return F.grid_sample(sphere[None], where, mode="bilinear", padding_mode="border", align_corners=False)[0]
