"""The compute kernels of light groups, other parts of the picture and alpha as torch modules with
the kernels' own bindings, for export to ONNX. `postfx.kernels.denoise.parts` and
`postfx.kernels.denoise.alpha` explain them.
"""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from postfx.kernels.denoise import (
    BLEND,
    DISTRUST,
    IMPORTANCE,
    KERNEL,
    NEAR_CELL,
    SHARPEN,
)
from postfx.kernels.denoise import alpha as means
from training import ops
from training.denoise.model import MAX_FLOAT
from training.kernels.denoise import Window, part, shares, to_image, to_picture

DARKEST = 1e-30


class Reflect(nn.Module):
    """albedos (h, w, 3), part_rows (th,), part_columns (tw,) -> factor (th, tw, 3)."""

    def forward(self, diffuse_albedo: Tensor, specular_albedo: Tensor, rows: Tensor,
                columns: Tensor) -> Tensor:
        at = rows.long(), columns.long()
        return to_picture(ops.demodulation(part(diffuse_albedo, *at), part(specular_albedo, *at)))


class AccumulatePart(nn.Module):
    """part (h, w, 3), coding (3,), factor (th, tw, 3), past (th, tw, 4), moved, last_part (h, w,
    3), fine, window -> next_part (th, tw, 3), part_level (3, hp, wp)."""

    def forward(self, values: Tensor, coding: Tensor, factor: Tensor, past: Tensor, moved: Tensor,
                last_part: Tensor, fine: Tensor, window: Tensor) -> tuple[Tensor, Tensor]:
        place = Window.of(window)
        (th, tw), at, valid = past.shape[:2], place.positions(past), to_image(place.valid(past))
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
    """radiance (3 n, th + 2, tw + 2), fine, moved (th, tw, 2), past (th, tw, 4), last (n, height,
    width, 3), params, window, keep, out_rows (out_th,), out_columns (out_tw,) -> light (n, out_th,
    out_tw, 3)."""

    def forward(self, radiance: Tensor, fine: Tensor, moved: Tensor, past: Tensor, last: Tensor,
                params: Tensor,
                window: Tensor, keep: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
        frame, place = Window.of(window), (rows.long(), columns.long())
        h, w = moved.shape[:2]
        at = frame.centres(place, moved)
        motion = frame.enlarged_motion(moved, at)
        held = ops.inside(motion, place, (frame.height, frame.width))
        known = ops.pick((to_image(past)[:, 3:] >= 0).to(moved.dtype), at.rows, at.columns)
        weights = fine[:, KERNEL:BLEND, :h, :w].reshape(1, 9, 4, h, w)
        now, _ = ops.upsample_at(radiance[None, :, 1:1 + h, 1:1 + w], weights, params[None, 1:3],
                                 at)
        now = torch.where(now <= MAX_FLOAT, now / params[0], 0)[0].unflatten(0, (-1, 3))
        phases = fine[:, BLEND:SHARPEN, :h, :w].reshape(1, 1, 4, h, w)
        trust = held * known * shares(keep, at.rows,
                                      at.columns) * (1 - ops.interpolate_at(phases, at))
        before = ops.warp(last.permute(0, 3, 1, 2).flatten(0, 1)[None], motion, "bicubic",
                          place).clamp(min=0)
        mixed = now + (before[0].unflatten(0, (-1, 3)) - now) * trust
        return torch.where(mixed <= MAX_FLOAT, mixed.clamp(min=0), now).permute(0, 2, 3, 1)


class Balance(nn.Module):
    """parts (n, H, W, 3), reached (n, h, w), whole and picture (H, W, 3), complete (1,) -> balanced
    (n, H, W, 3)."""

    def forward(self, parts: Tensor, reached: Tensor, whole: Tensor, picture: Tensor,
                complete: Tensor) -> Tensor:
        rows, columns = (torch.arange(out, device=parts.device) * size // out
                         for out, size in zip(parts.shape[1:3], reached.shape[1:], strict=True))
        parts = parts * reached[:, rows][:, :, columns, None]
        total, alone = parts.sum(0), complete > 0
        # equal shares where there is no light
        dark = torch.where(alone, (DARKEST - total).clamp(min=0), 0)
        light = torch.where(alone, total + parts.shape[0] * dark,
                            torch.maximum(total, whole).clamp(min=DARKEST))
        return torch.where(complete < 0, parts, (parts + dark) * (picture / light))


class Gather(nn.Module):
    """alpha (h, w, 1), moved (h, w, 2), samples (2 h, 2 w, 1), doubt (h, w, 1), near (cells,
    cells), rates (4,) -> next_samples (2 h, 2 w, 1), next_doubt (h, w, 1)."""

    def forward(self, values: Tensor, moved: Tensor, samples: Tensor, doubt: Tensor, near: Tensor,
                rates: Tensor) -> tuple[Tensor, Tensor]:
        keep, variance, drift, least = rates.unbind()
        own, motion = ops.sanitise(values[..., 0], 0, 1), to_image(moved)
        held = ((ops.inside(motion)[0, 0] > 0) & (keep > 0)
                & (_nearness(near, *map(torch.arange, doubt.shape[:2])) > 0))
        before = ops.warp(to_image(samples), ops.enlarge_motion(motion, *samples.shape[:2]),
                          "bicubic")[0, 0]
        predicted = (before.unflatten(1, (-1, 2)).unflatten(0, (-1, 2)).permute(1, 3, 0, 2)
                     .flatten(0, 1))
        x, y = ((place[0] + 0.5).floor() for place in ops.positions(motion))
        at = (y.clamp(0, moved.shape[0] - 1).long() * moved.shape[1]
              + x.clamp(0, moved.shape[1] - 1).long())
        known = doubt.flatten()[at] + torch.where(_moves(moved), drift, 0)
        off = torch.where(held, own - predicted.mean(0), 0)
        apart, level = _around(off).mean(-1), _around(own - off / 2).mean(-1).clamp(0, 1)
        chance = level * (1 - level) * (variance + known.clamp(max=1)) / 9
        lost = ~held | (apart.square() > float(means.LIMIT_OFF) * chance + float(means.LEAST_OFF))
        share = torch.maximum(known / (known + variance), least)
        found = torch.where(lost, own, (predicted + off * share).clamp(0, 1)).unflatten(0, (2, 2))
        left = torch.where(lost, variance, torch.minimum((1 - share) * known, variance))
        return found.permute(2, 0, 3, 1).flatten(2, 3).flatten(0, 1)[..., None], left[..., None]


class AlphaLevel(nn.Module):
    """next_samples (2 h, 2 w, 1), part_rows (th,), part_columns (tw,), seen_rows (hp,),
    seen_columns (wp,) -> level (1, hp, wp)."""

    def forward(self, samples: Tensor, rows: Tensor, columns: Tensor, seen_rows: Tensor,
                seen_columns: Tensor) -> Tensor:
        mean = F.avg_pool2d(samples[None, None, ..., 0], 2)
        mean = ops.pick(mean, rows.long(), columns.long())[0]
        beyond = [seen.shape[0] - held.shape[0]
                  for seen, held in ((seen_columns, columns), (seen_rows, rows))]
        return F.pad(mean, (0, beyond[0], 0, beyond[1]))


class EnlargeAlpha(nn.Module):
    """filtered (1, hp, wp), fine, part_rows (th,), part_columns (tw,), params, window, near (cells,
    cells), out_rows (out_th,), out_columns (out_tw,) -> enlarged (out_th, out_tw, 1)."""

    def forward(self, filtered: Tensor, fine: Tensor, part_rows: Tensor, part_columns: Tensor,
                params: Tensor,
                window: Tensor, near: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
        frame, (h, w) = Window.of(window), (part_rows.shape[0], part_columns.shape[0])
        at = frame.centres((rows.long(), columns.long()), fine[0, 0, :h, :w, None])
        weights = fine[:, KERNEL:BLEND, :h, :w].reshape(1, 9, 4, h, w)
        held = filtered[None, :, :h, :w]
        now, _ = ops.upsample_at(held, weights, params[None, 1:3], at)
        own = ops.pick(held, at.rows, at.columns)
        now = torch.where(_nearness(near, at.rows + frame.top, at.columns + frame.left) > 0, now,
                          own)
        return to_picture(ops.sanitise(now, 0, 1))


class Fit(nn.Module):
    """picture (H, W, 3), next_samples (2 h, 2 w, 1), near (cells, cells) -> fit (4, h, w)."""

    def forward(self, picture: Tensor, samples: Tensor, near: Tensor) -> Tensor:
        rows, columns = (_shares_within(one // 2, other) for one, other in
                         zip(samples.shape[:2], picture.shape[:2], strict=True))
        colours = rows @ picture.movedim(2, 0) @ columns.T
        alpha = _around(F.avg_pool2d(samples[None, None, ..., 0], 2)[0, 0])
        colours = torch.stack([_around(colour) for colour in colours.unbind()])
        mean, level = colours.mean(-1), alpha.mean(-1)
        red, green, blue = (colours - mean[..., None]).unbind()
        alpha = alpha - level[..., None]

        def joint(one: Tensor, other: Tensor) -> Tensor:
            return (one * other).mean(-1)

        least = float(means.ALIKE) * colours.square().mean(-1).sum(0) + float(means.DARK)
        first, across, along = joint(red, red) + least, joint(red, green), joint(red, blue)
        second = torch.maximum(joint(green, green) + least - across / first * across, least)
        left = joint(green, blue) - across / first * along
        third = torch.maximum(joint(blue, blue) + least - along / first * along
                              - left / second * left, least)
        by_red = joint(red, alpha)
        by_green = joint(green, alpha) - across / first * by_red
        to_blue = (joint(blue, alpha) - along / first * by_red - left / second * by_green) / third
        to_green = (by_green - left * to_blue) / second
        to_red = by_red / first - across / first * to_green - along / first * to_blue
        found = torch.stack((to_red, to_green, to_blue))
        found = torch.where(found.abs().sum(0) < float(means.LARGE), found, 0)
        found = torch.cat((found, (level - (found * mean).sum(0))[None]))
        return torch.where(_nearness(near, *map(torch.arange, level.shape)) > 0, found, 0)


class Correct(nn.Module):
    """enlarged (H, W, 1), picture (H, W, 3), fit (4, h, w), next_samples (2 h, 2 w, 1), next_doubt
    (h, w, 1), moved (h, w, 2), near (cells, cells), gain (4,) -> corrected (H, W, 1)."""

    def forward(self, filtered: Tensor, picture: Tensor, fit: Tensor, samples: Tensor,
                doubt: Tensor, moved: Tensor, near: Tensor, gain: Tensor) -> Tensor:
        value, size, out = filtered[..., 0], doubt.shape[:2], filtered.shape[:2]
        rows, columns = (_shares_within(one, other) for one, other in zip(size, out, strict=True))
        around = _around(rows @ value @ columns.T)
        mean = around.mean(-1)
        steps = torch.tensor([-1.0, 0.0, 1.0], dtype=mean.dtype)
        across, down = ((around * by).sum(-1) / 6
                        for by in (steps.repeat(3), steps.repeat_interleave(3)))
        sloped = float((1 - means.SLOPED) * means.PLANE) * (across.square() + down.square())
        found = (around.square().mean(-1) - mean.square() - sloped).clamp(min=0)
        structure = found / (found + gain[1] * (mean * (1 - mean)).clamp(min=0)
                             + float(means.FAINTEST))
        weight = structure * gain[0] / (gain[0] + doubt[..., 0] + float(means.FAINTEST))
        lack = F.avg_pool2d(samples[None, None, ..., 0], 2)[0, 0] - around[..., 4]
        upper, lower = (_shares_between(one, other).to(mean.dtype)
                        for one, other in zip(size, out, strict=True))
        high, low = (_shares_between(one, other).to(mean.dtype)
                     for one, other in zip(samples.shape[:2], out, strict=True))
        inside = high.T @ samples[..., 0] @ low - value

        def own(plane: Tensor) -> Tensor:
            return (rows > 0).to(mean.dtype).T @ plane @ (columns > 0).to(mean.dtype)

        moves = own(_moves(moved).to(mean.dtype)) * own(weight) * (inside - own(lack))
        line = torch.tensor([float(means.SIDE), float(means.MIDDLE), float(means.SIDE)],
                            dtype=mean.dtype)
        soft = (_around(value) * torch.outer(line, line).flatten()).sum(-1)
        found = (value + upper.T @ (weight * lack) @ lower + moves
                 + gain[2] * own(structure) * (value - soft))
        found = ops.sanitise(found, 0, 1)
        factors = upper.T @ torch.stack([_around(plane).mean(-1) for plane in fit.unbind()]) @ lower
        by_colour = ops.sanitise((factors[:3] * picture.movedim(2, 0)).sum(0) + factors[3], 0, 1)
        found = found + gain[3] * own(structure) * (by_colour - found)
        held = own(_nearness(near, *map(torch.arange, size)).to(mean.dtype)) > 1.5
        found = torch.where(held, found, own(F.avg_pool2d(samples[None, None, ..., 0], 2)[0, 0]))
        return found[..., None]


def _nearness(near: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
    """Nearness of cells for render pixels (rows, columns)."""
    return part(near[..., None], *((place // NEAR_CELL).clamp(max=size - 1) for place, size in
                                   zip((rows, columns), near.shape, strict=True)))[0, 0]


def _around(plane: Tensor) -> Tensor:
    """3x3 pixels around each of a plane (h, w), edge repeated: (h, w, 9)."""
    return F.pad(plane[None], (1, 1, 1, 1),
                 mode="replicate")[0].unfold(0, 3, 1).unfold(1, 3, 1).flatten(2)


def _moves(moved: Tensor) -> Tensor:
    return (moved.abs() >= float(means.LEAST_MOTION)).any(-1)


def _shares_within(size: Tensor, out: Tensor) -> Tensor:
    """Weights (size, out) of the pixels in each larger pixel, which sum to 1."""
    at = (2 * torch.arange(out) + 1) * size // (2 * out)
    found = (torch.arange(size)[:, None] == at).to(torch.float32)
    return found / found.sum(1, keepdim=True)


def _shares_between(size: Tensor, out: Tensor) -> Tensor:
    """Weights (size, out) by which pixels are interpolated at other ones, edge repeated."""
    at = ((2 * torch.arange(out) + 1) * size / (2 * out) - 0.5).clamp(0, size - 1)
    return (1 - (torch.arange(size)[:, None] - at).abs()).clamp(min=0)


class Decode(nn.Module):
    """filtered (H, W, 3), decoding (5,) -> plane (H, W, 3)."""

    channels = 3

    def forward(self, filtered: Tensor, decoding: Tensor) -> Tensor:
        scale, shift, low, high, kind = decoding.unbind()
        plane = torch.minimum(torch.maximum(filtered[..., :self.channels] * scale + shift, low),
                              high)
        square = (plane * plane).sum(-1, keepdim=True)
        length = torch.where(square > 1e-12, 1 / square.clamp(min=1e-12).sqrt(), 0)
        vectors = torch.where(kind > 0, plane * length, plane)
        covered = filtered[..., 1:2]
        distance = torch.minimum(torch.maximum(covered / filtered[..., :1].clamp(min=DARKEST), low),
                                 high)
        return torch.where(kind < 0, torch.where(covered >= 0.5, distance * scale, shift), vectors)


class DecodeOne(Decode):
    """`Decode` of one channel -> plane (H, W, 1)."""

    channels = 1
