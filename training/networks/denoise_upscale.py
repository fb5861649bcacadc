"""Recurrent denoised upscaler: one step takes a noisy frame and the state, and gives the output and the next state.

A network (``trunk.py``) predicts filters; everything that touches colour is a small fixed operation (``ops.py``):
accumulate demodulated colour over time, filter it in a pyramid of 5x5 kernels from coarse to fine, put the albedo
back, upsample with 3x3 kernels that know where the samples lie, and blend with the reprojected last output.
"""
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from training.networks import ops, phases
from training.networks.reconstruct import reflectance, resolve
from training.networks.trunk import (
    DISTRUST,
    HIDDEN,
    IMPORTANCE,
    KERNEL,
    MEMORY,
    MIX,
    Trunk,
    TrunkConfig,
)

MAX_COUNT = 32.0
MAX_DEPTH = 1e10
MAX_FLOAT = 3e38
ALIGN = 16


@dataclass(frozen=True)
class Guides:
    """Planes at output size (H, W), in the conventions of ``postfx.frame``; all NCHW float32."""

    diffuse_albedo: Tensor
    specular_albedo: Tensor
    normal: Tensor
    roughness: Tensor
    depth: Tensor


@dataclass(frozen=True)
class Inputs:
    """A frame at render size (h, w), in the conventions of ``postfx.frame``; all NCHW float32.

    ``colour`` is already multiplied by the exposure; ``jitter`` is (N, 2); ``gain`` (N, 1, 1, 1) is the exposure over
    that of the frame before, None where it did not change. Planes may hold NaN and infinity.
    """

    colour: Tensor
    diffuse_albedo: Tensor
    specular_albedo: Tensor
    normal: Tensor
    roughness: Tensor
    depth: Tensor
    motion: Tensor
    jitter: Tensor
    gain: Tensor | None = None
    guides: Guides | None = None


@dataclass(frozen=True)
class State:
    """What a frame leaves to the next. ``output`` is log(1 + exposed colour) at output size, the rest render size."""

    output: Tensor
    accumulated: Tensor
    count: Tensor
    hidden: Tensor
    depth: Tensor
    fresh: Tensor

    def drop(self, keep: Tensor) -> "State":
        """Forget the history of the batch entries where ``keep`` (N, 1, 1, 1) is 0."""
        return replace(self, fresh=self.fresh * keep)


@dataclass(frozen=True)
class Reprojected:
    """The state seen from the current frame."""

    motion: Tensor
    output: Tensor
    inside: Tensor
    accumulated: Tensor
    count: Tensor
    hidden: Tensor
    depth_change: Tensor
    valid: Tensor


def empty_state(inputs: Inputs, height: int, width: int) -> State:
    n, _, h, w = inputs.colour.shape
    new = inputs.colour.new_zeros
    return State(new(n, 3, height, width), new(n, 3, h, w), new(n, 1, h, w), new(n, HIDDEN, h, w),
                 new(n, 1, h, w) + 1, new(n, 1, 1, 1))


def reproject(inputs: Inputs, state: State) -> Reprojected:
    """Move the state along the motion; what comes from beyond the border or before a reset is marked invalid."""
    motion = ops.dilate_motion(inputs.motion, inputs.depth)
    return recall(inputs, state, motion, reproject_output(state.output, motion, inputs.gain))


def reproject_output(output: Tensor, motion: Tensor, gain: Tensor | None) -> Tensor:
    """The last output where its pixels are now, rescaled where the exposure changed."""
    moved = ops.warp(output, ops.enlarge_motion(motion, *output.shape[-2:]), "bicubic").clamp(min=0)
    return moved if gain is None else torch.log1p(torch.expm1(moved) * gain)


def recall(inputs: Inputs, state: State, motion: Tensor, output: Tensor, place: ops.Place | None = None) -> Reprojected:
    """The rest of the state moved along the dilated ``motion``, beside the reprojected ``output``; all of the frame, or
    what lies at a ``place`` in it."""
    valid = ops.inside(motion, place, state.depth.shape[-2:]) * state.fresh
    inside = ops.inside(ops.enlarge_motion(motion, *output.shape[-2:])) * state.fresh
    rest = ops.warp(torch.cat((state.accumulated, state.count, state.hidden), 1), motion, place=place)
    accumulated, rest = rest[:, :3] * (valid > 0), rest[:, 3:] * valid  # a mean that counts less is still that mean
    accumulated = accumulated if inputs.gain is None else accumulated * inputs.gain
    depth = ops.warp_nearest(state.depth, motion, place)
    before, now = (ops.sanitise(z, 1e-6, MAX_DEPTH) for z in (depth, inputs.depth))
    change = (4 * torch.log(before / now)).clamp(-1, 1) * valid
    return Reprojected(motion, output, inside, accumulated, rest[:, :1], rest[:, 1:], change, valid)


def demodulate(colour: Tensor, factor: Tensor) -> Tensor:
    """Colour without reflectance, in [0, 1e4]."""
    return (ops.sanitise(colour, 0, MAX_FLOAT) / factor).clamp(max=ops.MAX_COLOUR)


def features(inputs: Inputs, past: Reprojected, factor: Tensor, scale: Tensor) -> Tensor:
    """The trunk's input (N, 35, h, w), with the ``scale`` of depth; ``postfx/kernels`` fills the same channels."""
    h, w = inputs.colour.shape[-2:]
    return features_of(inputs, past, factor, scale, ops.box_mean(past.output, h, w), w / past.output.shape[-1])


def features_of(inputs: Inputs, past: Reprojected, factor: Tensor, scale: Tensor, mean: Tensor,
                shrink: float | Tensor) -> Tensor:
    """The same from the ``mean`` of the last output at each render pixel, and render over output size."""
    plane = torch.ones_like(inputs.depth)
    history = torch.expm1(mean) * past.valid
    return torch.cat((
        torch.log1p(demodulate(inputs.colour, factor)),
        ops.log_encode(past.accumulated * past.valid), ops.log_encode(history / factor),
        ops.sanitise(inputs.diffuse_albedo, 0, 2), ops.sanitise(inputs.specular_albedo, 0, 2),
        ops.sanitise(inputs.normal, -1, 1), ops.sanitise(inputs.roughness, 0, 1),
        scale / (scale + ops.sanitise(inputs.depth, 0, MAX_DEPTH)),
        past.depth_change, past.valid, past.count / MAX_COUNT,
        plane * inputs.jitter[:, :, None, None],
        torch.log1p(past.motion.norm(dim=1, keepdim=True)) / 4,
        plane * shrink, past.hidden), 1)


def guide_features(guides: Guides, h: int, w: int, scale: Tensor) -> Tensor:
    """The guides at the four quarter-pixel corners of each render pixel, nearest sample: (N, 44, h, w)."""
    at = seen_guides(guides, scale)
    rows, columns = phases.corner_index(h, at.shape[-2], at.device), phases.corner_index(w, at.shape[-1], at.device)
    return torch.cat([ops.pick(at, rows[i], columns[j]) for i in range(2) for j in range(2)], 1)


def seen_guides(guides: Guides, scale: Tensor) -> Tensor:
    """What the trunk sees of each pixel of the guides: (N, 11, H, W)."""
    return torch.cat((
        ops.sanitise(guides.diffuse_albedo, 0, 2), ops.sanitise(guides.specular_albedo, 0, 2),
        ops.sanitise(guides.normal, -1, 1), ops.sanitise(guides.roughness, 0, 1),
        scale / (scale + ops.sanitise(guides.depth, 0, MAX_DEPTH))), 1)


def aligned(image: Tensor, multiple: int = ALIGN) -> Tensor:
    """``image`` (N, C, h, w) mirrored at its right and lower edge up to the next multiple."""
    h, w = image.shape[-2:]
    rows, columns = (ops.mirrored(size, size + -size % multiple, image.device) for size in (h, w))
    return ops.pick(image, rows, columns)


def accumulate(colour: Tensor, mean: Tensor, count: Tensor, distrust: Tensor) -> tuple[Tensor, Tensor]:
    """Running ``mean`` of demodulated colour and its effective sample count; ``distrust`` 1 starts anew."""
    share = 1 / (count + 1)
    alpha = share + (1 - share) * distrust
    return torch.lerp(mean, colour, alpha), (1 / alpha).clamp(max=MAX_COUNT)


def filled(head: Tensor, level: Tensor) -> Tensor:
    """A head with as many rows and columns as its level, or the one that it has."""
    (h, w), (rows, columns) = level.shape[-2:], head.shape[-2:]
    return head if (rows, columns) in ((1, 1), (h, w)) else F.pad(head, (0, w - columns, 0, h - rows))


def filter_pyramid(colour: Tensor, importance: Tensor, fine: Tensor, levels: tuple[Tensor, ...], height: int,
                   width: int) -> Tensor:
    """Coarse to fine: mix a level's own colour with the coarser result, then smooth both by the level's kernels.

    The heads may be smaller than their levels: what they lack lies beyond the picture; one of 1x1 holds for all of it.
    """
    valid = [ops.valid_area(colour, height, width)]
    colours, weight = [colour], importance * valid[0]
    for _ in levels:
        pooled, weight = ops.pool(colours[-1], weight)
        colours.append(pooled)
        valid.append(F.max_pool2d(valid[-1], 2))
    fine, *levels = (filled(head, of) for head, of in zip((fine, *levels), colours, strict=True))
    result = ops.filter_kernels(colours[-1], levels[-1], valid[-1])
    heads = [(fine[:, :KERNEL], fine[:, MIX:MIX + 1]), *((x[:, :KERNEL], x[:, KERNEL:]) for x in levels[:-1])]
    for i in reversed(range(len(heads))):
        kernels, mix = heads[i]
        coarse = F.interpolate(result, scale_factor=2.0, mode="nearest")
        result = ops.filter_kernels(torch.lerp(coarse, colours[i], mix), kernels, valid[i])
    return result


class DenoiseUpscale(nn.Module):
    """One recurrent step. Output size is free: any width and height of 1 to 3 times the render size.

    ``trunk`` is a ready network that gives what ``Trunk`` gives; None makes one of ``config``.
    """

    def __init__(self, config: TrunkConfig | None = None, trunk: nn.Module | None = None):
        super().__init__()
        self.trunk = trunk or Trunk(config)
        self.config = self.trunk.config

    def forward(self, inputs: Inputs, state: State) -> tuple[Tensor, State, Tensor]:
        """Exposed linear output (N, 3, H, W), the next state, and the last output reprojected (log-encoded)."""
        h, w = inputs.colour.shape[-2:]
        align = self.trunk.align
        past = reproject(inputs, state)
        factor = ops.demodulation(inputs.diffuse_albedo, inputs.specular_albedo)
        scale, guides = ops.depth_scale(inputs.depth), inputs.guides
        seen = [features(inputs, past, factor, scale)]
        if self.config.guides:
            seen.append(guide_features(guides, h, w, scale))
        heads = self.trunk(*(aligned(x, align) if h % align or w % align else x for x in seen))
        fine, *levels = (head.float() for head in heads)
        coarsest = 2 ** len(levels)
        pad = (0, -w % coarsest, 0, -h % coarsest)
        here = fine[..., :h, :w]
        noisy, distrust = demodulate(inputs.colour, factor), here[:, DISTRUST:IMPORTANCE]
        accumulated, count = accumulate(noisy, past.accumulated, past.count, distrust)
        importance = F.pad(here[:, IMPORTANCE:MEMORY], pad)
        filtered = filter_pyramid(F.pad(accumulated, pad), importance, fine, tuple(levels), h, w)
        radiance = filtered[..., :h, :w]
        guided = None
        if self.config.guides:
            guided = reflectance(ops.demodulation(guides.diffuse_albedo, guides.specular_albedo), factor)
        shaded = radiance * factor if guided is None else torch.cat((radiance, radiance * factor), 1)
        output = resolve(shaded, here, inputs.jitter, past.output, past.inside, guided)
        state = State(output, accumulated, count, here[:, MEMORY:], inputs.depth, torch.ones_like(state.fresh))
        return torch.expm1(output), state, past.output
