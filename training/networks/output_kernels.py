"""The upscaler's compute kernels at output size as torch modules, as in ``denoise_kernels.py``."""
import torch
from torch import Tensor, nn

from postfx.kernels.denoise_assemble import HELD, OWN
from training.networks import guide_trust, ops, reconstruct
from training.networks.reconstruct import Reflectance
from training.networks.window import Window, part, shares, to_image, to_picture


class Upsample(nn.Module):
    """radiance (3, th + 2, tw + 2), fine, moved (th, tw, 2), past (th, tw, 4), warped (out_th, out_tw, 3), params,
    window, keep -> output, next_history (out_th, out_tw, 3)."""

    def forward(self, radiance: Tensor, fine: Tensor, moved: Tensor, past: Tensor, warped: Tensor, params: Tensor,
                window: Tensor, keep: Tensor) -> tuple[Tensor, Tensor]:
        return resolve(radiance, fine, moved, past, warped, None, params, Window.of(window), keep)


class UpsampleGuided(nn.Module):
    """The same with radiance (6, th + 2, tw + 2), without and with reflectance, albedos (H, W, 3) by which the first is
    multiplied, and trust (cells, cells, 1) in these."""

    def forward(self, radiance: Tensor, fine: Tensor, moved: Tensor, past: Tensor, warped: Tensor,
                diffuse_albedo: Tensor, specular_albedo: Tensor, trust: Tensor, params: Tensor,
                window: Tensor, keep: Tensor) -> tuple[Tensor, Tensor]:
        frame = Window.of(window)
        at = frame.outputs(warped)
        factor = ops.demodulation(part(diffuse_albedo, *at), part(specular_albedo, *at))
        sizes = [torch.clamp(whole - first, max=size) for whole, first, size in zip(
            (frame.h, frame.w), (frame.top, frame.left), moved.shape[:2], strict=True)]
        trusted = guide_trust.trust_at(to_image(trust), frame.centres(at, moved), *sizes)
        return resolve(radiance, fine, moved, past, warped, Reflectance(factor, trusted), params, frame, keep)


def resolve(radiance: Tensor, fine: Tensor, moved: Tensor, past: Tensor, warped: Tensor,
            guided: Reflectance | None, params: Tensor, frame: Window, keep: Tensor) -> tuple[Tensor, Tensor]:
    h, w = moved.shape[:2]
    here, place = fine[:, :, :h, :w], frame.outputs(warped)
    at = frame.centres(place, moved)
    held = ops.inside(frame.enlarged_motion(moved, at), place, (frame.height, frame.width))
    known = ops.pick((to_image(past)[:, 3:] >= 0).to(moved.dtype), at.rows, at.columns)
    kept = shares(keep, at.rows, at.columns)
    filtered = radiance[None, :, 1:1 + h, 1:1 + w]
    encoded = reconstruct.resolve(filtered, here, params[None, 1:3], to_image(warped), held * known * kept, guided, at)
    return to_picture(torch.expm1(encoded) / params[0]), to_picture(encoded)


class Assemble(nn.Module):
    """tiles (n, th, tw, C), places (n, 10), frame_rows (H,), frame_columns (W,) -> picture (H, W, C)."""

    def forward(self, tiles: Tensor, places: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
        held, own = (self._within(places[:, first:first + 4], rows, columns) for first in (HELD, OWN))
        score = held.to(tiles.dtype) + 2 * own.to(tiles.dtype)
        owner = score.argmax(0)
        y = (rows - places[:, :1]).long().clamp(min=0).clamp(max=tiles.shape[1] - 1)
        x = (columns - places[:, 1:2]).long().clamp(min=0).clamp(max=tiles.shape[2] - 1)
        lines, across = torch.arange(rows.shape[0])[:, None], torch.arange(columns.shape[0])
        found = tiles[owner, y[owner, lines], x[owner, across]]
        return torch.where((score.amax(0) > 0)[..., None], found, torch.zeros_like(found))

    def _within(self, boxes: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
        """Which boxes (n, 4) hold which pixels: (n, H, W)."""
        top, left, bottom, right = boxes[:, :, None].unbind(1)
        return ((rows >= top) & (rows < bottom))[:, :, None] & ((columns >= left) & (columns < right))[:, None]


class Strength(nn.Module):
    """denoised, plain (H, W, 3), strength (H, W, 1), amount (1,) -> output (H, W, 3), exact at both ends."""

    def forward(self, denoised: Tensor, plain: Tensor, strength: Tensor, amount: Tensor) -> Tensor:
        share = ops.sanitise(strength, 0, 1) * ops.sanitise(amount, 0, 1)
        return torch.where(share == 1, denoised, plain + (denoised - plain) * share)


class Resample(nn.Module):
    """image (h, w, C), rows (H,) and columns (W,), positions in the image -> output (H, W, C)."""

    def forward(self, image: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
        return to_picture(ops.resample(to_image(image), rows, columns))
