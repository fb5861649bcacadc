"""The compute kernels of overlays, reactive masks, reflections and restored detail as torch modules
with the kernels' own bindings, for export to ONNX. Overlays are premultiplied RGBA, (h, w, 4).
"""

import math

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from postfx.kernels.denoise import FARTHEST, MAX_COLOUR, MOST_MOTION, NEAREST
from postfx.kernels.denoise import history as layout
from postfx.kernels.denoise.history import SPREAD
from postfx.kernels.denoise.output import (
    CLEAN,
    COUNT,
    DARK,
    FILTERED,
    FIRST,
    HELD_POWER,
    INVISIBLE,
    LAGS,
    LIMIT,
    LOUD,
    NEAR,
    POWER,
    SPREAD_NOISE,
    STRUCTURE,
    TILE,
)
from training import ops
from training.denoise.model import MAX_FLOAT
from training.kernels.denoise import part, to_image, to_picture

# Overlays -----------------------------------------------------------------------------------------

def make_finite(values: Tensor) -> Tensor:
    """The values with 0 in place of those that are not finite."""
    return torch.where(values.abs() < torch.inf, values, torch.zeros_like(values))


class Enlarge(nn.Module):
    """image (h, w, 4), rows (H,) and columns (W,), positions in the image -> output (H, W, 4)."""

    def forward(self, image: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
        cubic = to_picture(ops.resample(to_image(image), rows, columns))
        alpha, colour = cubic[..., 3:].clamp(0, 1), cubic[..., :3]
        low, high = straight(make_finite(image))
        for axis, positions in ((0, rows), (1, columns)):
            near = [(positions.floor() + k).clamp(0, image.shape[axis] - 1).long()
                    for k in range(2)]
            low = torch.minimum(*(low.index_select(axis, index) for index in near))
            high = torch.maximum(*(high.index_select(axis, index) for index in near))
        colour = torch.where(high.abs() < torch.inf, torch.minimum(colour, high * alpha), colour)
        colour = torch.where(low.abs() < torch.inf, torch.maximum(colour, low * alpha), colour)
        return torch.cat((colour, alpha), -1)


def straight(image: Tensor) -> tuple[Tensor, Tensor]:
    """Straight colour of a pixel, as least and as largest value: infinite for light without
    coverage, an empty range for a pixel without light and coverage."""
    light, alpha = image[..., :3], image[..., 3:]
    infinite = torch.full_like(light, torch.inf)
    own = torch.where(light > 0, infinite, -infinite)
    own = torch.where(alpha > 0, light / alpha, own)
    nothing = (alpha <= 0) & (light == 0)
    return torch.where(nothing, infinite, own), torch.where(nothing, -infinite, own)


class Over(nn.Module):
    """overlay (H, W, 4), colour (H, W, 3) -> output (H, W, 3)."""

    def forward(self, overlay: Tensor, colour: Tensor) -> Tensor:
        return over(make_finite(overlay[..., :3]), ops.sanitise(overlay[..., 3:], 0, 1),
                    make_finite(colour))


class OverAlpha(nn.Module):
    """overlay (H, W, 4), alpha (H, W, 1) -> output (H, W, 1)."""

    def forward(self, overlay: Tensor, alpha: Tensor) -> Tensor:
        covered = ops.sanitise(overlay[..., 3:], 0, 1)
        return over(covered, covered, make_finite(alpha))


def over(front: Tensor, alpha: Tensor, behind: Tensor) -> Tensor:
    """Porter and Duff 1984, premultiplied."""
    return front + (1 - alpha) * behind


# Reactive mask ------------------------------------------------------------------------------------
# The kernels of the reactive mask as torch modules: see ``postfx.kernels.denoise.history``.

def compress(colour: Tensor, exposure: Tensor) -> Tensor:
    """Exposed light as a display shows it, 0 to 1."""
    light = (ops.sanitise(colour, 0, MAX_FLOAT) * exposure).clamp(max=MAX_COLOUR)
    return torch.sqrt(light / (1 + light))


class Reactive(nn.Module):
    """colour, opaque_colour (h, w, 3), difference (3,): exposure, scale, threshold -> reactive (h,
    w, 1)."""

    def forward(self, colour: Tensor, opaque_colour: Tensor, difference: Tensor) -> Tensor:
        exposure, scale, threshold = difference.unbind()
        most = ((compress(colour, exposure) - compress(opaque_colour, exposure)).abs()
                .amax(-1, keepdim=True))
        return torch.where(most >= threshold, (most * scale).clamp(max=1), torch.zeros_like(most))


class Spread(nn.Module):
    """reactive (h, w, 1) -> next_reactive (h, w, 1)."""

    def forward(self, reactive: Tensor) -> Tensor:
        return to_picture(F.max_pool2d(to_image(ops.sanitise(reactive, 0, 1)), 2 * SPREAD + 1, 1,
                                       SPREAD))


class Keep(nn.Module):
    """reactive, last_reactive (h, w, 1), moved (th, tw, 2), part_rows (th,), part_columns (tw,) ->
    keep (th, tw, 1)."""

    def forward(self, reactive: Tensor, last_reactive: Tensor, moved: Tensor, rows: Tensor,
                columns: Tensor) -> Tensor:
        place = rows.long(), columns.long()
        before = ops.warp_nearest(to_image(last_reactive), to_image(moved), place)
        return to_picture(1 - torch.maximum(ops.sanitise(part(reactive, *place), 0, 1), before))


# Reflections --------------------------------------------------------------------------------------
# The kernel of reflections' motion as a torch module, see ``postfx.kernels.denoise.history``.

Pair = tuple[Tensor, Tensor]


def around(plane: Tensor) -> Tensor:
    """(H, W, C) -> (H, W, C, 9): the 3x3 neighbours of every pixel, edge repeated, rows first."""
    padded = F.pad(plane.permute(2, 0, 1)[None], (1, 1, 1, 1), mode="replicate")[0].permute(1, 2, 0)
    h, w = plane.shape[:2]
    return torch.stack([padded[y:y + h, x:x + w] for y in range(3) for x in range(3)], -1)


def unit(normal: Tensor) -> Tensor:
    length = normal.square().sum(-1, keepdim=True).sqrt()
    return normal * torch.where(length > 0.1, 1 / length.clamp(min=0.1), torch.zeros_like(length))


class Reflections(nn.Module):
    """motion (h, w, 2), depth, normal, roughness, both albedos, hit_distance (h, w, 1), camera
    (27,) -> reflected (h, w, 2)."""

    def forward(self, motion: Tensor, depth: Tensor, normal: Tensor, roughness: Tensor,
                diffuse_albedo: Tensor,
                specular_albedo: Tensor, hit_distance: Tensor, camera: Tensor) -> Tensor:
        own = torch.where(motion.abs() < float(MOST_MOTION), motion, torch.zeros_like(motion))
        share = (ops.sanitise(specular_albedo, 0, 1)
                 - ops.sanitise(diffuse_albedo, 0, 1)).sum(-1, keepdim=True)
        chosen = (share > 0) & (roughness <= layout.ROUGHEST) & (hit_distance > 0)
        chosen = chosen & (depth > 0) & (depth < FARTHEST)
        rays = self._rays(depth, camera)
        still, _ = self._motion(camera, rays, 1 / depth)
        most = layout.STILL + layout.PART * own.abs().amax(-1, keepdim=True)
        chosen &= ((still - own).abs() <= most).all(-1, keepdim=True)
        bend, inside = self._curvature(normal, depth, rays, camera)
        inverse, found = self._inverse_distance(hit_distance, depth)
        smooth = 1 - ops.sanitise(roughness, 0, 1)
        inverse = inverse / (smooth * (smooth.sqrt() + 1 - smooth)) + 2 * bend
        stretched = inverse * (rays.square().sum(-1, keepdim=True) + 1).sqrt()
        moved, ahead = self._motion(camera, rays, stretched / (1 + stretched * depth))
        return torch.where(chosen & inside & found & (ahead > 1e-3), moved, own)

    def _rays(self, depth: Tensor, camera: Tensor) -> Tensor:
        h, w = depth.shape[:2]
        x = torch.arange(w) + 0.5 + camera[layout.JITTER] - 0.5 * w
        y = torch.arange(h) + 0.5 + camera[layout.JITTER + 1] - 0.5 * h
        x, y = x / camera[layout.FOCAL], y / camera[layout.FOCAL + 1]
        return torch.stack((x[None].expand(h, w), y[:, None].expand(h, w)), -1)

    def _motion(self, camera: Tensor, rays: Tensor, nearness: Tensor) -> Pair:
        turn = camera[layout.TURN:layout.SHIFT].reshape(3, 3)
        then = rays[..., :1] * turn[0] + rays[..., 1:] * turn[1] + turn[2]
        then = then + camera[layout.SHIFT:layout.WORLD] * nearness
        ahead = then[..., 2:]
        at = then[..., :2] / ahead.clamp(min=float(NEAREST))
        return (at * camera[layout.FOCAL_THEN:layout.JITTER]
                - rays * camera[layout.FOCAL:layout.FOCAL_THEN], ahead)

    def _inverse_distance(self, hit_distance: Tensor, depth: Tensor) -> Pair:
        """Mean of one over the hit distance, and whether there is any. Repeated edges do not
        count."""
        distance, z = around(hit_distance), around(depth)
        counts = (distance > 0) & ((z - depth[..., None]).abs() <= layout.STEP * depth[..., None])
        counts &= self._in_picture(depth) > 0
        each = torch.where(counts, 1 / distance.clamp(min=float(NEAREST)),
                           torch.zeros_like(distance))
        count = counts.to(depth.dtype).sum(-1)
        return each.sum(-1) / count.clamp(min=1), count > 0

    def _in_picture(self, depth: Tensor) -> Tensor:
        """(h, w, 1, 9): 1 for neighbours in the picture."""
        padded = F.pad(torch.ones_like(depth).permute(2, 0, 1), (1, 1, 1, 1)).permute(1, 2, 0)
        h, w = depth.shape[:2]
        return torch.stack([padded[y:y + h, x:x + w] for y in range(3) for x in range(3)], -1)

    def _curvature(self, normal: Tensor, depth: Tensor, rays: Tensor, camera: Tensor) -> Pair:
        """How much a surface bends outwards, and whether a pixel is inside one."""
        directions = unit(normal)
        places = torch.cat((rays, torch.ones_like(depth)), -1) * depth
        facing = directions @ camera[layout.WORLD:].reshape(3, 3)
        near, turned, z = around(directions), around(facing), around(depth)
        place, total, inside = around(places), torch.zeros_like(depth), torch.ones_like(depth) > 0
        for low, high in ((1, 7), (3, 5)):
            for side in (low, high):
                cosine = (near[..., side] * directions).sum(-1, keepdim=True)
                inside = (inside & ((z[..., side] - depth).abs() <= layout.STEP * depth)
                          & (cosine >= layout.BEND))
            along = place[..., high] - place[..., low]
            change = ((turned[..., high] - turned[..., low]) * along).sum(-1, keepdim=True)
            total = total + change / along.square().sum(-1, keepdim=True).clamp(min=1e-20)
        return (0.5 * total).clamp(min=0), inside


# Restored detail ----------------------------------------------------------------------------------
# The kernels of ``postfx.kernels.denoise.output`` as torch modules. Pictures (H, W, C).

TINY = 1e-12


class Judge(nn.Module):
    """colour, denoised (h, w, 3), params, judged (tiles_high, tiles_wide, 1) -> sums (tiles_high,
    tiles_wide, 11): pixels, power, held power, products; 0 where a tile is not judged."""

    def forward(self, colour: Tensor, denoised: Tensor, params: Tensor, judged: Tensor) -> Tensor:
        clean = light(denoised, params)
        seen = clean.clamp(min=DARK)
        slope = 0.5 / (torch.sqrt(seen * (1 + seen)) * (1 + seen))
        removed = ((light(colour, params) - clean) * slope).clamp(-1, 1)
        tile, count = tiles(removed), tiles(torch.ones_like(removed)).sum((1, 3))
        power = tile.square().sum((1, 3))
        limit = (LIMIT * torch.sqrt(power / count))[:, None, :, None]
        held = torch.minimum(torch.maximum(tile, -limit), limit)
        products = []
        for dy, dx in LAGS:
            here = held[:, :TILE - dy, :, max(0, -dx):TILE - max(0, dx)]
            there = held[:, dy:, :, max(0, dx):TILE + min(0, dx)]
            products.append((here * there)
                            .sum((1, 3)) * (TILE**2 / ((TILE - dy) * (TILE - abs(dx)))))
        sums = torch.stack((count, power, held.square().sum((1, 3)), *products), -1)
        return torch.where(judged > 0, sums, torch.zeros_like(sums))


class Detail(nn.Module):
    """sums (tiles_high, tiles_wide, 11), evidence (1,), known (tiles_high, tiles_wide, 1) -> detail
    (tiles_high, tiles_wide, 1), the share to restore."""

    def forward(self, sums: Tensor, evidence: Tensor, known: Tensor) -> Tensor:
        spread = binomial(binomial(sums, 0), 1)
        count = spread[..., COUNT].clamp(min=1)  # 0 if nothing around is judged
        power = spread[..., POWER] / count
        weight = torch.sqrt(power) * sums[..., COUNT]
        total = weight.sum().clamp(min=TINY)
        found = spread[..., FIRST:] / (spread[..., HELD_POWER:FIRST] + TINY)
        common = F.pad((found * weight[..., None]).sum((0, 1))[:NEAR].clamp(min=0) / total,
                       (0, len(LAGS) - NEAR))
        mean = sums[..., POWER].sum() / sums[..., COUNT].sum().clamp(min=1)
        filtered = ramp(torch.log(mean + TINY), math.log(FILTERED[0]), math.log(FILTERED[1]))
        structure = (found - filtered * common).square().sum(-1) - SPREAD_NOISE * len(LAGS) / count
        faint = ramp(-torch.log(power + TINY), -math.log(INVISIBLE[1]), -math.log(INVISIBLE[0]))
        quiet = ramp(-torch.log(mean + TINY), -math.log(LOUD[1]),
                     -math.log(LOUD[0])) * evidence.clamp(max=1)
        own = torch.maximum(ramp(torch.sqrt(structure.clamp(min=0)), *STRUCTURE), faint) * quiet
        clean = ramp((own * weight).sum() / total * evidence, *CLEAN)
        return torch.maximum((own + (1 - own) * clean)[..., None], known)


class Restore(nn.Module):
    """colour, denoised (h, w, C), detail (tiles_high, tiles_wide, 1) -> output (h, w, C)."""

    def forward(self, colour: Tensor, denoised: Tensor, detail: Tensor) -> Tensor:
        share = between(between(detail, colour.shape[0], 0), colour.shape[1], 1)
        noisy = ops.sanitise(colour, 0, MAX_FLOAT)
        return torch.where(share == 1, noisy, denoised + (noisy - denoised) * share)


def light(colour: Tensor, params: Tensor) -> Tensor:
    """Exposed luminance (h, w), within the network's range."""
    exposed = (ops.sanitise(colour, 0, MAX_FLOAT) * params[0]).clamp(max=MAX_COLOUR)
    return 0.2126 * exposed[..., 0] + 0.7152 * exposed[..., 1] + 0.0722 * exposed[..., 2]


def tiles(image: Tensor) -> Tensor:
    """(h, w) -> (tiles_high, TILE, tiles_wide, TILE), zero beyond the picture."""
    h, w = image.shape
    padded = F.pad(image[None], (0, -w % TILE, 0, -h % TILE))[0]
    return padded.unflatten(0, (-1, TILE)).unflatten(2, (-1, TILE))


def binomial(sums: Tensor, axis: int) -> Tensor:
    """Sums weighted by 1 2 1 along an axis; 0 beyond the border."""
    nothing = torch.zeros_like(sums.narrow(axis, 0, 1))
    size = sums.shape[axis]
    padded = torch.cat((nothing, sums, nothing), axis)
    return padded.narrow(axis, 0, size) + 2 * sums + padded.narrow(axis, 2, size)


def ramp(value: Tensor, low: float, high: float) -> Tensor:
    return ((value - low) / (high - low)).clamp(0, 1)


def between(values: Tensor, size: int, axis: int) -> Tensor:
    """Values of tiles at the pixels of an axis, linear between the tiles' centres."""
    last = values.shape[axis] - 1
    at = ((torch.arange(size) + 0.5) / TILE - 0.5).clamp(0, last)
    first = at.floor().long()
    part = (at - first).unflatten(0, (-1, *[1] * (values.ndim - 1 - axis)))
    one = values.index_select(axis, first)
    other = values.index_select(axis, (first + 1).clamp(max=last))
    return one + (other - one) * part
