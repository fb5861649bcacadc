"""The upscaler's compute kernels as torch modules with the kernels' own bindings, for export to
ONNX.

Pictures are (H, W, C) as in ``postfx.kernels``, pyramid levels (C, H, W); ``params`` is (4,):
exposure, jitter x, jitter y, gain; ``window`` is (8,): the part of the frame to work on; ``keep``
is the share of the history that is used, (th, tw, 1) or (1, 1, 1): see ``postfx.kernels.denoise``.
All sizes come from bindings: one file serves all sizes.
"""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from postfx.kernels.denoise import (
    BORDER_CELLS,
    DISTRUST,
    FINE,
    IMPORTANCE,
    KERNEL,
    MEMORY,
    MIX,
    MOST_STATE,
    PLANE_TRUST,
    TRUST_CELL,
    UNKNOWN,
)
from postfx.kernels.denoise.network_io import LEAST_LOG_ERROR, MOST_LOG_ERROR
from postfx.kernels.denoise.output import HELD, OWN
from training import ops
from training.denoise import model as network
from training.denoise.model import (
    Guides,
    Inputs,
    Reflectance,
    State,
    activate_fine,
    weights_from,
)

# The part of a frame ------------------------------------------------------------------------------
# The part of a frame that the upscaler's kernels work on: see ``postfx.kernels.denoise``.

def to_image(picture: Tensor) -> Tensor:
    """(H, W, C) -> (1, C, H, W)."""
    return picture.permute(2, 0, 1)[None]


def to_picture(image: Tensor) -> Tensor:
    """(1, C, H, W) -> (H, W, C)."""
    return image[0].permute(1, 2, 0)


class Window(NamedTuple):
    """The part of the frame to work on: its first row and column, the frame's size, and both at
    output size."""

    top: Tensor
    left: Tensor
    h: Tensor
    w: Tensor
    out_top: Tensor
    out_left: Tensor
    height: Tensor
    width: Tensor

    @classmethod
    def of(cls, window: Tensor) -> "Window":
        return cls(*window.long().unbind())

    def positions(self, part: Tensor) -> ops.Place:
        """Rows and columns of the frame that a part (h, w, C) holds; its last ones are repeated."""
        rows, columns = list_places(part)
        return (rows + self.top).clamp(max=self.h - 1), (columns + self.left).clamp(max=self.w - 1)

    def valid(self, part: Tensor) -> Tensor:
        """(h, w, 1): 1 where a part (h, w, C) lies in the frame, else 0."""
        rows, columns = list_places(part)
        return ((rows + self.top < self.h)[:, None]
                & (columns + self.left < self.w))[..., None].to(part.dtype)

    def edge(self, part: Tensor) -> Tensor:
        """(h, w, 1): 1 at the edge of a part (h, w, C) beyond which the frame continues, else 0."""
        (rows, columns), (h, w) = list_places(part), part.shape[:2]
        down = ((rows == 0) & (self.top > 0)) | ((rows == h - 1) & (self.top + h < self.h))
        across = ((columns == 0) & (self.left > 0)) | ((columns == w - 1)
                                                       & (self.left + w < self.w))
        return (down[:, None] | across)[..., None].to(part.dtype)

    def outputs(self, part: Tensor) -> ops.Place:
        """Rows and columns of the frame at output size that a part (H, W, C) holds; its last ones
        are repeated."""
        rows, columns = list_places(part)
        return ((rows + self.out_top).clamp(max=self.height - 1),
                (columns + self.out_left).clamp(max=self.width - 1))

    def centres(self, at: ops.Place, moved: Tensor) -> ops.Centres:
        """Positions in a part ``moved`` (h, w, C) of the frame's pixels ``at`` output size."""
        sizes = (self.h, self.height), (self.w, self.width)
        (rows, y), (columns, x) = (ops.nearest_of(index, *size)
                                   for index, size in zip(at, sizes, strict=True))
        return ops.Centres((rows - self.top).clamp(0, moved.shape[0] - 1), y,
                              (columns - self.left).clamp(0, moved.shape[1] - 1), x)

    def enlarged_motion(self, moved: Tensor, at: ops.Centres) -> Tensor:
        """Motion (h, w, 2) of a part at output size (1, 2, H, W), in output pixels."""
        scale = torch.stack((self.width / self.w, self.height / self.h)).to(moved.dtype)
        return ops.pick(to_image(moved * scale), at.rows, at.columns)


    def history_at(self, moved: Tensor, past: Tensor, warped: Tensor,
                   keep: Tensor) -> tuple[ops.Centres, Tensor]:
        """Positions of a part's pixels at output size, and how much of the history each may keep,
        (1, 1, H, W)."""
        place = self.outputs(warped)
        at = self.centres(place, moved)
        held = ops.inside(self.enlarged_motion(moved, at), place, (self.height, self.width))
        known = ops.pick((to_image(past)[:, 3:] >= 0).to(moved.dtype), at.rows, at.columns)
        return at, held * known * shares(keep, at.rows, at.columns)


def list_places(picture: Tensor) -> ops.Place:
    """Numbers of the rows and columns of a picture (h, w, C)."""
    return tuple(torch.arange(size, device=picture.device) for size in picture.shape[:2])


def part(picture: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
    """Rows and columns of a picture, as (1, C, h, w)."""
    return ops.pick(to_image(picture), rows, columns)


def shares(keep: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
    """Rows and columns of ``keep``, as (1, 1, h, w); (1, 1, 1) holds for all of them."""
    return part(keep, rows.clamp(max=keep.shape[0] - 1), columns.clamp(max=keep.shape[1] - 1))


# Kernels at render size ---------------------------------------------------------------------------

def expose(colour: Tensor, params: Tensor) -> Tensor:
    """Exposed colour (1, 3, h, w) from a file's colour, which is sanitised first: infinity times 0
    is NaN."""
    return ops.sanitise(to_image(colour), 0, network.MAX_FLOAT) * params[0]


class Scale(nn.Module):
    """depth (h, w, 1) -> depth_scale (1,)."""

    def forward(self, depth: Tensor) -> Tensor:
        return ops.depth_scale(to_image(depth)).reshape(1)


class Dilate(nn.Module):
    """motion (h, w, 2), depth (h, w, 1), part_rows (th,), part_columns (tw,) -> moved (th, tw,
    2)."""

    def forward(self, motion: Tensor, depth: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
        moved = ops.dilate_motion(to_image(motion), to_image(depth))
        return to_picture(ops.pick(moved, rows.long(), columns.long()))


class History(nn.Module):
    """history (H, W, 3), moved (th, tw, 2), params, window, out_rows (out_th,), out_columns
    (out_tw,) -> warped (out_th, out_tw, 3)."""

    def forward(self, history: Tensor, moved: Tensor, params: Tensor, window: Tensor, rows: Tensor,
                columns: Tensor) -> Tensor:
        frame, place = Window.of(window), (rows.long(), columns.long())
        motion = frame.enlarged_motion(moved, frame.centres(place, moved))
        warped = ops.warp(to_image(history), motion, "bicubic", place).clamp(min=0)
        return to_picture(torch.log1p(torch.expm1(warped) * params[3]))


class Features(nn.Module):
    """The frame and its history, seen_rows (hp,) and seen_columns (wp,) -> past (th, tw, 4),
    features (1, 35, hp, wp)."""

    def forward(self, colour: Tensor, diffuse_albedo: Tensor, specular_albedo: Tensor,
                normal: Tensor, roughness: Tensor, depth: Tensor, moved: Tensor, state: Tensor,
                last_depth: Tensor, warped: Tensor,
                depth_scale: Tensor, params: Tensor, window: Tensor, keep: Tensor, rows: Tensor,
                columns: Tensor) -> tuple[Tensor, Tensor]:
        frame, here = Window.of(window), (rows.long(), columns.long())
        place = here[0] + frame.top, here[1] + frame.left
        exposed = ops.pick(expose(colour, params), *place)
        inputs = Inputs(
            exposed,
            diffuse_albedo=part(diffuse_albedo, *place),
            specular_albedo=part(specular_albedo, *place),
            normal=part(normal, *place),
            roughness=part(roughness, *place),
            depth=part(depth, *place),
            motion=part(moved, *here),
            jitter=params[None, 1:3],
            gain=params[3],
        )
        old, kept = to_image(state), shares(keep, *here)
        lacking = ops.warp((old[:, 3:4] <= 0).to(old.dtype), inputs.motion, place=place) > UNKNOWN
        unknown = lacking * ops.inside(inputs.motion, place, state.shape[:2]) * (kept > 0)
        before = State(inputs.motion, old[:, :3], old[:, 3:4], old[:, 4:], to_image(last_depth),
                       kept * (1 - unknown))
        past = network.recall(inputs, before, inputs.motion, inputs.motion, place)
        factor = ops.demodulation(inputs.diffuse_albedo, inputs.specular_albedo)
        features = network.features_of(inputs, past, factor, depth_scale.reshape(1, 1, 1, 1),
                                    self._mean(frame, place, warped), frame.w / frame.width)
        count = torch.where(unknown > 0, -torch.ones_like(unknown), past.count)
        known = torch.cat((past.accumulated, count), 1)[:, :, :moved.shape[0], :moved.shape[1]]
        return to_picture(known), features

    def _mean(self, frame: Window, place: ops.Place, warped: Tensor) -> Tensor:
        """Mean of the last output over each render pixel."""
        mean = to_image(warped)
        for axis, at, size, full, first in ((-2, place[0], frame.h, frame.height, frame.out_top),
                                            (-1, place[1], frame.w, frame.width, frame.out_left)):
            start, end = (side - first for side in ops.span(at, size, full))
            mean = ops.spans_mean(mean, start, end, axis)
        return mean


class GuideFeatures(nn.Module):
    """guides (H, W, C), depth_scale, window, seen_rows (hp,), seen_columns (wp,) -> guides (1, 44,
    hp, wp)."""

    def forward(self, diffuse_albedo: Tensor, specular_albedo: Tensor, normal: Tensor,
                roughness: Tensor, guide_depth: Tensor, depth_scale: Tensor, window: Tensor,
                rows: Tensor, columns: Tensor) -> Tensor:
        frame = Window.of(window)
        guides = Guides(*map(to_image,
                             (diffuse_albedo, specular_albedo, normal, roughness, guide_depth)))
        seen = network.seen_guides(guides, depth_scale.reshape(1, 1, 1, 1))
        at = [[(4 * (first + index.long()) + 1 + 2 * side) * full // (4 * size)
               for side in range(2)]
              for first, index, size, full in ((frame.top, rows, frame.h, frame.height),
                                               (frame.left, columns, frame.w, frame.width))]
        return torch.cat([ops.pick(seen, at[0][i], at[1][j]) for i in range(2) for j in range(2)],
                         1)


class MirroredFeatures(nn.Module):
    """denoising_albedo and denoising_normal (h, w, 3), window, seen_rows (hp,), seen_columns (wp,)
    -> mirrored (1, 6, hp, wp)."""

    def forward(self, denoising_albedo: Tensor, denoising_normal: Tensor, window: Tensor,
                rows: Tensor, columns: Tensor) -> Tensor:
        frame = Window.of(window)
        seen = network.mirrored_planes(to_image(denoising_albedo), to_image(denoising_normal))
        return ops.pick(seen, frame.top + rows.long(), frame.left + columns.long())


class Means(nn.Module):
    """albedos (h, w, 3), part_rows (th,), part_columns (tw,) -> means (cells, cells, 3) of the
    frame, beginning one cell before the part; the frame's first and last cells repeat beyond it."""

    def forward(self, diffuse_albedo: Tensor, specular_albedo: Tensor, rows: Tensor,
                columns: Tensor) -> Tensor:
        cells = network.mean_reflectance(ops.demodulation(to_image(diffuse_albedo),
                                                          to_image(specular_albedo)))
        return to_picture(ops.pick(cells, *(self._held(at, count) for at, count in zip(
            (rows, columns), cells.shape[-2:], strict=True))))

    @staticmethod
    def _held(at: Tensor, count: int) -> Tensor:
        needed = (at.shape[0] + TRUST_CELL - 1) // TRUST_CELL + BORDER_CELLS
        return ((torch.arange(needed) + at[0].long() // TRUST_CELL - 1).clamp(min=0)
                .clamp(max=count - 1))


class Accumulate(nn.Module):
    """Frame, means (cells, cells, 3) or (1, 1, 3), past (th, tw, 4), fine -> next_state (th, tw,
    12), next_depth (th, tw, 1), level (4, hp, wp), factor (th, tw, 3).

    A broken value becomes this frame's colour alone, and leaves no history: a state of zeros, as at
    a part's edge inside the frame."""

    def forward(self, colour: Tensor, diffuse_albedo: Tensor, specular_albedo: Tensor,
                means: Tensor, depth: Tensor, past: Tensor, fine: Tensor, params: Tensor,
                window: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        place = Window.of(window)
        (h, w), at, valid = past.shape[:2], place.positions(past), place.valid(past)
        here, old = fine[:, :, :h, :w], to_image(past)
        factor = ops.demodulation(part(diffuse_albedo, *at), part(specular_albedo, *at))
        factor = network.mix_in_mean(factor, self._mean_around(at, means, place),
                                     self._doubt(here, means))
        noisy = network.hold(network.demodulate(ops.pick(expose(colour, params), *at), factor))
        accumulated, count = network.accumulate(noisy, old[:, :3], old[:, 3:].clamp(min=0),
                                                here.narrow(1, DISTRUST, 1))
        importance = here.narrow(1, IMPORTANCE, 1)
        state = torch.cat((accumulated, count, here[:, MEMORY:]), 1)
        whole = torch.cat((state, importance), 1).abs().sum(1, keepdim=True) <= float(MOST_STATE)
        state = to_picture(torch.where(whole, state, 0)) * valid * (1 - place.edge(past))
        level = torch.cat((accumulated, importance), 1)
        level = torch.where(whole, level,
                            torch.cat((noisy, torch.ones_like(importance)), 1)) * to_image(valid)
        level = F.pad(level, (0, fine.shape[3] - w, 0, fine.shape[2] - h))
        now = to_picture(part(depth, *at))
        return (state, torch.where(valid > 0, now, torch.zeros_like(now)), level[0],
                to_picture(factor) * valid)

    @staticmethod
    def _mean_around(at: ops.Place, means: Tensor, place: Window) -> Tensor:
        """Mean reflectance around pixels of the frame; a single cell holds for all of them."""
        cells = to_image(means)
        for axis, index, size, first in ((-1, at[1], place.w, place.left),
                                         (-2, at[0], place.h, place.top)):
            cells = ops.between(cells, index, size, axis, first // TRUST_CELL - 1)
        return cells

    @staticmethod
    def _doubt(here: Tensor, means: Tensor) -> Tensor:
        """Share of the mean in the reflectance: 0 with a single cell."""
        share = 0.5 - 0.5 * here.narrow(1, PLANE_TRUST, 1)
        share = torch.where((share >= 0) & (share <= 1), share, 0)  # a broken answer doubts nothing
        return share * torch.sym_min(means.shape[0] - 1, 1)


class Resize(nn.Module):
    """state (h, w, 12), last_depth (h, w, 1), at_rows (H,), at_columns (W,) -> resized (H, W, 12),
    resized_depth (H, W, 1)."""

    def forward(self, state: Tensor, last_depth: Tensor, rows: Tensor,
                columns: Tensor) -> tuple[Tensor, Tensor]:
        (h, w), top, left = state.shape[:2], rows.floor(), columns.floor()
        shares, weighted = [], []
        for j in range(2):
            for i in range(2):
                value = ops.pick(to_image(state), (top + j).clamp(0, h - 1).long(),
                                 (left + i).clamp(0, w - 1).long())
                share = (1 - j - rows + top).abs()[:, None] * (1 - i - columns + left).abs()
                share = torch.where(value[:, 3:4] > 0, share, torch.zeros_like(share))
                shares.append(share)
                weighted.append(share * value)
        total, weight = sum(weighted[1:], weighted[0]), sum(shares[1:], shares[0])
        mean = total * torch.where(weight > 0.5, 1 / weight.clamp(min=0.5),
                                   torch.zeros_like(weight))
        depth = ops.pick(to_image(last_depth), rows.round().clamp(0, h - 1).long(),
                         columns.round().clamp(0, w - 1).long())
        return to_picture(mean), to_picture(depth)


class Pool(nn.Module):
    """finer (3 n, 2 hp, 2 wp) and finer_importance (1, 2 hp, 2 wp), or a row or column more or
    less; finer_rows (hp,) and finer_columns (wp,), the first ones of cells, -1 for cells that begin
    before them -> level (3 n, hp, wp), importance (1, hp, wp)."""

    def forward(self, finer: Tensor, importance: Tensor, finer_rows: Tensor,
                finer_columns: Tensor) -> tuple[Tensor, Tensor]:
        at, held = zip(*(pairs(first.long(), size)
                         for first, size in zip((finer_rows, finer_columns), finer.shape[1:],
                                                strict=True)), strict=True)
        picked = ops.pick(importance[None], *at)
        # infinity stays, unlike by clamp
        weights = torch.maximum(picked, picked.new_tensor(ops.LEAST_IMPORTANCE))
        weights = weights * (held[0][:, None] & held[1]).to(finer.dtype)
        level, total = ops.pool(ops.pick(finer[None], *at), weights)
        return level[0], total[0]


def pairs(first: Tensor, size: int) -> tuple[Tensor, Tensor]:
    """Each number and the next one, limited to 0 .. ``size``, and whether they were within it."""
    both = (first[:, None] + torch.arange(2, device=first.device)).flatten()
    return both.clamp(0, size - 1), (both >= 0) & (both < size)


class Mix(nn.Module):
    """coarse (3 n, rows, columns), level (3 n, hp, wp), heads (1, 26 or 80, hp, wp), coarse_rows
    (hp,) and coarse_columns (wp,) that hold the pixels -> mixed (3 n, hp, wp)."""

    def forward(self, coarse: Tensor, level: Tensor, heads: Tensor, rows: Tensor,
                columns: Tensor) -> Tensor:
        # The mix is the last of a level's 26 channels, but not of the fine head's: by arithmetic,
        # without a branch.
        at = KERNEL + (MIX - KERNEL) * torch.sym_min(heads.shape[1] - KERNEL - 1, 1)
        share = heads.narrow(1, at, 1)[0]
        return torch.lerp(ops.pick(coarse, rows.long(), columns.long()), level, share)


class Filter(nn.Module):
    """mixed (3 n, hp, wp), heads (1, 25 or more, hp, wp), area (2,) rows and columns -> filtered (3
    n, hp, wp)."""

    def forward(self, mixed: Tensor, heads: Tensor, area: Tensor) -> Tensor:
        valid = ops.valid_area(mixed, area[0], area[1])
        return (ops.filter_kernels(mixed[None], heads[:, :KERNEL], valid) * valid)[0]


class Remodulate(nn.Module):
    """filtered (3, hp, wp), factor (th, tw, 3), part_rows (th,), part_columns (tw,) -> radiance (3,
    th + 2, tw + 2), its edge repeated once around."""

    def forward(self, filtered: Tensor, factor: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
        at = [index.long() - index.long()[:1] for index in (rows, columns)]
        here = ops.pick(filtered[None], *at) * part(factor, *at)
        return F.pad(here, (1, 1, 1, 1), mode="replicate")[0]


class RemodulateBoth(Remodulate):
    """`Remodulate` twice -> radiance (6, th + 2, tw + 2): without the reflectance, and with it."""

    def forward(self, filtered: Tensor, factor: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
        shaded = super().forward(filtered, factor, rows, columns)
        return torch.cat((super().forward(filtered, torch.ones_like(factor), rows, columns),
                          shaded))


class Trust(nn.Module):
    """albedos (h, w, 3), the guides' albedos (H, W, 3), window, part_rows (th,), part_columns
    (tw,) -> trust (cells, cells, 1)."""

    def forward(self, diffuse_albedo: Tensor, specular_albedo: Tensor, guide_diffuse_albedo: Tensor,
                guide_specular_albedo: Tensor, window: Tensor, rows: Tensor,
                columns: Tensor) -> Tensor:
        frame, at = Window.of(window), (rows.long(), columns.long())
        own = ops.demodulation(part(diffuse_albedo, *at), part(specular_albedo, *at))
        guides = ops.demodulation(to_image(guide_diffuse_albedo), to_image(guide_specular_albedo))
        valid = to_image(frame.valid(own[0, 0, :, :, None]))
        return to_picture(ops.trust(own, guides, at, frame.h, frame.w, valid))


class Pack(nn.Module):
    """planes (1, C, hp, wp) -> packed (1, hp, wp, C and zeros up to a multiple of 8), half
    precision."""

    def forward(self, planes: Tensor) -> Tensor:
        return F.pad(planes, (0, 0, 0, 0, 0, -planes.shape[1] % 8)).permute(0, 2, 3, 1).half()


class Open(nn.Module):
    """raw (1, hp, wp, 32), half precision -> heads (1, 26, hp, wp), activated."""

    def forward(self, raw: Tensor) -> Tensor:
        heads = raw.float().permute(0, 3, 1, 2)
        return torch.cat((weights_from(heads[:, :KERNEL]),
                          torch.sigmoid(heads[:, KERNEL:KERNEL + 1])), 1)


class OpenFine(nn.Module):
    """raw_fine (1, hp/2, wp/2, 4 * 80), half precision -> fine (1, 80, hp, wp), activated."""

    def forward(self, raw_fine: Tensor) -> Tensor:
        _, rows, columns, _ = raw_fine.shape
        phases = raw_fine.float().reshape(1, rows, columns, 2, 2, FINE)
        return activate_fine(phases.permute(0, 5, 1, 3, 2, 4)
                             .reshape(1, FINE, 2 * rows, 2 * columns))


class OpenPhased(nn.Module):
    """phased_fine (1, 80 * 4, hp/2, wp/2) -> fine (1, 80, hp, wp), activated."""

    def forward(self, phased_fine: Tensor) -> Tensor:
        return activate_fine(F.pixel_shuffle(phased_fine, 2))


class OpenError(nn.Module):
    """log_error (1, 1, hp, wp), part_rows (th,), part_columns (tw,) -> error (th, tw, 1)."""

    def forward(self, log_error: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
        held = log_error[..., : rows.shape[0], : columns.shape[0]]
        return to_picture(torch.exp(ops.sanitise(held, LEAST_LOG_ERROR, MOST_LOG_ERROR)))


class OpenProducts(nn.Module):
    """products (1, C, hp, wp) of int32, scaling (2, C) -> heads (1, C, hp, wp), activated."""

    def forward(self, products: Tensor, scaling: Tensor) -> Tensor:
        heads = logits(products, scaling)
        return torch.cat((weights_from(heads[:, :KERNEL]), torch.sigmoid(heads[:, KERNEL:])), 1)


class OpenFineProducts(nn.Module):
    """products (1, 80 * 4, hp/2, wp/2) of int32, scaling (2, 80 * 4) -> fine (1, 80, hp, wp),
    activated."""

    def forward(self, products: Tensor, scaling: Tensor) -> Tensor:
        return activate_fine(F.pixel_shuffle(logits(products, scaling), 2))


def logits(products: Tensor, scaling: Tensor) -> Tensor:
    """Logits from sums of 8-bit products."""
    scale, bias = scaling[:, :, None, None]
    return products.float() * scale + bias


class Store(nn.Module):
    """planes (1, C, hp, wp), coding (2, wide) -> stored (1, hp, wp, wide) of uint8."""

    ring = 0

    def forward(self, planes: Tensor, coding: Tensor) -> Tensor:
        ringed = F.pad(planes, 4 * [self.ring]).permute(0, 2, 3, 1)
        held = F.pad(ringed, (0, coding.shape[1] - planes.shape[1]))
        scaled = torch.where(held == held, held * coding[0], 0)
        return (scaled + coding[1] + 0.5).clamp(0, 255).floor().to(torch.uint8)


class StoreRinged(Store):
    """`Store` with an edge of one pixel around -> stored (1, hp + 2, wp + 2, wide)."""

    ring = 1


# Kernels at output size ---------------------------------------------------------------------------

class Upsample(nn.Module):
    """radiance (3, th + 2, tw + 2), fine, moved (th, tw, 2), past (th, tw, 4), warped (out_th,
    out_tw, 3), params, window, keep -> output, next_history (out_th, out_tw, 3)."""

    def forward(self, radiance: Tensor, fine: Tensor, moved: Tensor, past: Tensor, warped: Tensor,
                params: Tensor, window: Tensor, keep: Tensor) -> tuple[Tensor, Tensor]:
        return resolve(radiance, fine, moved, past, warped, None, params, Window.of(window), keep)


class UpsampleGuided(nn.Module):
    """`Upsample` by guides: radiance (6, th + 2, tw + 2), without and with reflectance, the guides'
    albedos (H, W, 3), by which the first is multiplied, and the trust in them (cells, cells, 1)."""

    def forward(self, radiance: Tensor, fine: Tensor, moved: Tensor, past: Tensor, warped: Tensor,
                diffuse_albedo: Tensor, specular_albedo: Tensor, trust: Tensor, params: Tensor,
                window: Tensor, keep: Tensor) -> tuple[Tensor, Tensor]:
        frame = Window.of(window)
        at = frame.outputs(warped)
        factor = ops.demodulation(part(diffuse_albedo, *at), part(specular_albedo, *at))
        sizes = [torch.clamp(whole - first, max=size) for whole, first, size in zip(
            (frame.h, frame.w), (frame.top, frame.left), moved.shape[:2], strict=True)]
        trusted = ops.trust_at(to_image(trust), frame.centres(at, moved), *sizes)
        return resolve(radiance, fine, moved, past, warped, Reflectance(factor, trusted), params,
                       frame, keep)


class UpsampleUnscaled(nn.Module):
    """`Upsample` at the render size: radiance (6, th + 2, tw + 2) and the render pixels' factor
    (th, tw, 3), which is multiplied after weighting the samples if these are not jittered."""

    def forward(self, radiance: Tensor, fine: Tensor, moved: Tensor, past: Tensor, warped: Tensor,
                factor: Tensor,
                params: Tensor, window: Tensor, keep: Tensor) -> tuple[Tensor, Tensor]:
        frame = Window.of(window)
        at = frame.centres(frame.outputs(warped), moved)
        centred = (params[1:3] == 0).all().to(factor.dtype)
        own = Reflectance(part(factor, at.rows, at.columns), centred)
        return resolve(radiance, fine, moved, past, warped, own, params, frame, keep)


class BlendPicture(nn.Module):
    """Picture (1, 3, hp, wp), log-encoded, controls (1, 11, hp, wp), moved (th, tw, 2), past (th,
    tw, 4), warped (out_th, out_tw, 3), params, window, keep -> output, next_history (out_th,
    out_tw, 3), at the render size."""

    def forward(self, picture: Tensor, controls: Tensor, moved: Tensor, past: Tensor,
                warped: Tensor, params: Tensor,
                window: Tensor, keep: Tensor) -> tuple[Tensor, Tensor]:
        frame = Window.of(window)
        at, held = frame.history_at(moved, past, warped, keep)
        current = ops.pick(picture, at.rows, at.columns).clamp(min=0)
        share = held * (1 - ops.pick(controls[:, :1], at.rows, at.columns))
        encoded = network.blend_with_history(current, to_image(warped), share)
        return to_picture(torch.expm1(encoded) / params[0]), to_picture(encoded)


def resolve(radiance: Tensor, fine: Tensor, moved: Tensor, past: Tensor, warped: Tensor,
            guided: Reflectance | None, params: Tensor, frame: Window,
            keep: Tensor) -> tuple[Tensor, Tensor]:
    h, w = moved.shape[:2]
    here = fine[:, :, :h, :w]
    at, held = frame.history_at(moved, past, warped, keep)
    filtered = radiance[None, :, 1:1 + h, 1:1 + w]
    encoded = network.resolve(filtered, here, params[None, 1:3], to_image(warped), held, guided, at)
    return to_picture(torch.expm1(encoded) / params[0]), to_picture(encoded)


class Assemble(nn.Module):
    """tiles (n, th, tw, C), places (n, 10), frame_rows (H,), frame_columns (W,) -> picture (H, W,
    C)."""

    def forward(self, tiles: Tensor, places: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
        held, own = (self._within(places[:, first:first + 4], rows, columns)
                     for first in (HELD, OWN))
        score = held.to(tiles.dtype) + 2 * own.to(tiles.dtype)
        owner = score.argmax(0)
        y = (rows - places[:, :1]).long().clamp(min=0).clamp(max=tiles.shape[1] - 1)
        x = (columns - places[:, 1:2]).long().clamp(min=0).clamp(max=tiles.shape[2] - 1)
        lines, across = torch.arange(rows.shape[0])[:, None], torch.arange(columns.shape[0])
        found = tiles[owner, y[owner, lines], x[owner, across]]
        return torch.where((score.amax(0) > 0)[..., None], found, torch.zeros_like(found))

    def _within(self, boxes: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
        """Whether boxes (n, 4) hold pixels: (n, H, W)."""
        top, left, bottom, right = boxes[:, :, None].unbind(1)
        return ((rows >= top)
                & (rows < bottom))[:, :, None] & ((columns >= left) & (columns < right))[:, None]


class Strength(nn.Module):
    """denoised, plain (H, W, C), strength (H, W, 1), amount (1,) -> output (H, W, C), exact at both
    ends."""

    def forward(self, denoised: Tensor, plain: Tensor, strength: Tensor, amount: Tensor) -> Tensor:
        share = ops.sanitise(strength, 0, 1) * ops.sanitise(amount, 0, 1)
        return torch.where(share == 1, denoised, plain + (denoised - plain) * share)


class Resample(nn.Module):
    """image (h, w, C), rows (H,) and columns (W,), positions in the image -> output (H, W, C)."""

    def forward(self, image: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
        return to_picture(ops.resample(to_image(image), rows, columns))
