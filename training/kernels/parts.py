"""The compute kernels of the picture's parts as torch modules with the kernels' own bindings, for export to ONNX.

``postfx.kernels.denoise.parts`` explains them.
"""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from training import ops
from training.denoise import model as network
from training.denoise.model import DISTRUST, IMPORTANCE, KERNEL, MAX_FLOAT
from training.kernels.denoise import Window, part, shares, to_image, to_picture

DARKEST = 1e-30


class Reflect(nn.Module):
    """albedos (h, w, 3), part_rows (th,), part_columns (tw,) -> factor (th, tw, 3)."""

    def forward(self, diffuse_albedo: Tensor, specular_albedo: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
        at = rows.long(), columns.long()
        return to_picture(ops.demodulation(part(diffuse_albedo, *at), part(specular_albedo, *at)))


class AccumulatePart(nn.Module):
    """part (h, w, 3), coding (3,), factor (th, tw, 3), past (th, tw, 4), moved, last_part (h, w, 3), fine, window
    -> next_part (th, tw, 3), part_level (3, hp, wp)."""

    def forward(self, values: Tensor, coding: Tensor, factor: Tensor, past: Tensor,
                moved: Tensor, last_part: Tensor, fine: Tensor, window: Tensor) -> tuple[Tensor, Tensor]:
        place = Window.of(window)
        (th, tw), at, valid = past.shape[:2], place.held(past), to_image(place.valid(past))
        known = ops.sanitise(ops.pick(to_image(values), *at), -MAX_FLOAT, MAX_FLOAT)
        coded = (known - coding[0]).clamp(min=0) * coding[1]
        now = torch.minimum(coded / to_image(factor), coding[2])
        count = to_image(past)[:, 3:]
        share = 1 / (count.clamp(min=0) + 1)
        alpha = share + (1 - share) * fine[:, DISTRUST:IMPORTANCE, :th, :tw]
        before = ops.warp(to_image(last_part), to_image(moved), place=at)
        mean = torch.where(count > 0, before + (now - before) * alpha, now)
        mean = torch.where(mean <= MAX_FLOAT, mean, now) * valid
        padded = F.pad(mean, (0, fine.shape[3] - tw, 0, fine.shape[2] - th))[0]
        return to_picture(mean), padded


class UpsampleLight(nn.Module):
    """radiance (3 n, th + 2, tw + 2), fine, moved (th, tw, 2), past (th, tw, 4), last (n, height, width, 3), params,
    window, keep, out_rows (out_th,), out_columns (out_tw,) -> light (n, out_th, out_tw, 3)."""

    def forward(self, radiance: Tensor, fine: Tensor, moved: Tensor, past: Tensor, last: Tensor, params: Tensor,
                window: Tensor, keep: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
        frame, place = Window.of(window), (rows.long(), columns.long())
        h, w = moved.shape[:2]
        at = frame.centres(place, moved)
        motion = frame.enlarged_motion(moved, at)
        held = ops.inside(motion, place, (frame.height, frame.width))
        known = ops.pick((to_image(past)[:, 3:] >= 0).to(moved.dtype), at.rows, at.columns)
        weights = fine[:, KERNEL:network.BLEND, :h, :w].reshape(1, 9, 4, h, w)
        now, _ = ops.upsample_at(radiance[None, :, 1:1 + h, 1:1 + w], weights, params[None, 1:3], at)
        now = torch.where(now <= MAX_FLOAT, now / params[0], 0)[0].unflatten(0, (-1, 3))
        phases = fine[:, network.BLEND:network.SHARPEN, :h, :w].reshape(1, 1, 4, h, w)
        trust = held * known * shares(keep, at.rows, at.columns) * (1 - ops.interpolate_at(phases, at))
        before = ops.warp(last.permute(0, 3, 1, 2).flatten(0, 1)[None], motion, "bicubic", place).clamp(min=0)
        mixed = now + (before[0].unflatten(0, (-1, 3)) - now) * trust
        return torch.where(mixed <= MAX_FLOAT, mixed.clamp(min=0), now).permute(0, 2, 3, 1)


class Balance(nn.Module):
    """parts (n, H, W, 3), reached (n, h, w), whole and picture (H, W, 3), complete (1,) -> balanced (n, H, W, 3)."""

    def forward(self, parts: Tensor, reached: Tensor, whole: Tensor, picture: Tensor, complete: Tensor) -> Tensor:
        rows, columns = (torch.arange(out, device=parts.device) * size // out
                         for out, size in zip(parts.shape[1:3], reached.shape[1:], strict=True))
        parts = parts * reached[:, rows][:, :, columns, None]
        total, alone = parts.sum(0), complete > 0
        dark = torch.where(alone, (DARKEST - total).clamp(min=0), 0)  # equal shares where there is no light
        light = torch.where(alone, total + parts.shape[0] * dark, torch.maximum(total, whole).clamp(min=DARKEST))
        return (parts + dark) * (picture / light)


class Correct(nn.Module):
    """filtered (H, W, 3), part (h, w, 3), motion (h, w, 2), gain (3,) -> corrected (H, W, 3)."""

    def forward(self, filtered: Tensor, values: Tensor, motion: Tensor, gain: Tensor) -> Tensor:
        rows, columns = (_shares_within(size, out) for size, out in
                         zip(values.shape[:2], filtered.shape[:2], strict=True))
        mean = rows @ filtered[..., 0] @ columns.T
        around = F.pad(mean[None], (1, 1, 1, 1), mode="replicate")[0].unfold(0, 3, 1).unfold(1, 3, 1).flatten(2)
        middle = around.mean(-1)
        structure = (around.square().mean(-1) - middle.square()).clamp(min=0)
        noise = gain[2] * (middle * (1 - middle)).clamp(min=0)
        still = (motion.abs() < 1 / 64).all(-1)
        share = torch.where(still, gain[1], gain[0]) * structure / (structure + noise + 1e-6)
        lack = share * (ops.sanitise(values[..., 0], 0, 1) - mean)
        found = filtered[..., 0] + (rows > 0).to(lack.dtype).T @ lack @ (columns > 0).to(lack.dtype)
        return ops.sanitise(found, 0, 1)[..., None].expand(-1, -1, 3)


def _shares_within(size: Tensor, out: Tensor) -> Tensor:
    """Weights (size, out) of the pixels in each larger pixel, which sum to 1."""
    at = (2 * torch.arange(out) + 1) * size // (2 * out)
    found = (torch.arange(size)[:, None] == at).to(torch.float32)
    return found / found.sum(1, keepdim=True)


class Decode(nn.Module):
    """filtered (H, W, 3), decoding (5,) -> plane (H, W, 3)."""

    channels = 3

    def forward(self, filtered: Tensor, decoding: Tensor) -> Tensor:
        scale, shift, low, high, kind = decoding.unbind()
        plane = torch.minimum(torch.maximum(filtered[..., :self.channels] * scale + shift, low), high)
        square = (plane * plane).sum(-1, keepdim=True)
        length = torch.where(square > 1e-12, 1 / square.clamp(min=1e-12).sqrt(), 0)
        vectors = torch.where(kind > 0, plane * length, plane)
        covered = filtered[..., 1:2]
        distance = torch.minimum(torch.maximum(covered / filtered[..., :1].clamp(min=DARKEST), low), high)
        return torch.where(kind < 0, torch.where(covered >= 0.5, distance * scale, shift), vectors)


class DecodeOne(Decode):
    """The same -> plane (H, W, 1)."""

    channels = 1
