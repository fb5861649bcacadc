"""Recurrent denoised upscaler: one step takes a noisy frame and the state, and gives the output and the next state.

A network (``trunk.py``) predicts filters; everything that touches colour is a small fixed operation (``ops.py``):
accumulate demodulated colour over time, filter it in a pyramid of 5x5 kernels from coarse to fine, put the albedo
back, upsample with 3x3 kernels that know where the samples lie, and blend with the reprojected last output.
"""
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from training.networks import ops
from training.networks.trunk import HIDDEN, KERNEL, PHASES, Trunk, TrunkConfig

MAX_COUNT = 32.0
ALIGN = 16


@dataclass(frozen=True)
class Inputs:
    """A frame at render size (h, w), in the conventions of ``postfx.frame``; all NCHW float32.

    ``colour`` is already multiplied by the exposure; ``jitter`` is (N, 2).
    """

    colour: Tensor
    diffuse_albedo: Tensor
    specular_albedo: Tensor
    normal: Tensor
    roughness: Tensor
    depth: Tensor
    motion: Tensor
    jitter: Tensor


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
    height, width = state.output.shape[-2:]
    h, w = inputs.colour.shape[-2:]
    motion = ops.dilate_motion(inputs.motion, inputs.depth)
    valid = ops.inside(motion) * state.fresh
    fine_motion = ops.enlarge(motion, height, width) * motion.new_tensor([width / w, height / h])[None, :, None, None]
    output = ops.warp(state.output, fine_motion, "bicubic").clamp(min=0)
    rest = ops.warp(torch.cat((state.accumulated, state.count, state.hidden), 1), motion) * valid
    depth = ops.warp(state.depth, motion, "nearest")
    change = (4 * torch.log(depth.clamp(min=1e-6) / inputs.depth.clamp(min=1e-6))).clamp(-1, 1) * valid
    return Reprojected(motion, output, ops.inside(fine_motion) * state.fresh, rest[:, :3], rest[:, 3:4], rest[:, 4:],
                       change, valid)


def features(inputs: Inputs, past: Reprojected, factor: Tensor) -> Tensor:
    """The trunk's input (N, 35, h, w); ``postfx/kernels`` fills the same channels in the same order."""
    n, _, h, w = inputs.colour.shape
    plane = inputs.colour.new_ones(n, 1, h, w)
    history = torch.expm1(F.adaptive_avg_pool2d(past.output, (h, w))) * past.valid
    scale = ops.depth_scale(inputs.depth)
    return torch.cat((
        ops.log_encode(inputs.colour / factor), ops.log_encode(past.accumulated), ops.log_encode(history / factor),
        inputs.diffuse_albedo.clamp(0, 2), inputs.specular_albedo.clamp(0, 2), inputs.normal.clamp(-1, 1), inputs.roughness.clamp(0, 1),
        scale / (scale + inputs.depth),
        past.depth_change, past.valid, past.count / MAX_COUNT,
        plane * inputs.jitter[:, :, None, None],
        torch.log1p(past.motion.norm(dim=1, keepdim=True)) / 4,
        plane * (w / past.output.shape[-1]), past.hidden), 1)


def accumulate(colour: Tensor, past: Reprojected, distrust: Tensor) -> tuple[Tensor, Tensor]:
    """Running mean of demodulated colour and its effective sample count; ``distrust`` 1 starts anew."""
    count = past.count * past.valid
    share = 1 / (count + 1)
    alpha = share + (1 - share) * distrust
    return torch.lerp(past.accumulated, colour, alpha), (1 / alpha).clamp(max=MAX_COUNT)


def filter_pyramid(colour: Tensor, importance: Tensor, fine: Tensor, levels: tuple[Tensor, ...], height: int,
                   width: int) -> Tensor:
    """Coarse to fine: mix a level's own colour with the coarser result, then smooth both by the level's kernels."""
    valid = [ops.valid_area(colour, height, width)]
    colours, weight = [colour], importance * valid[0]
    for level in levels:
        pooled, weight = ops.pool(colours[-1], weight)
        colours.append(pooled)
        valid.append(F.max_pool2d(valid[-1], 2))
    result = ops.filter_kernels(colours[-1], levels[-1], valid[-1])
    heads = [(fine[:, :KERNEL], fine[:, KERNEL + PHASES + 4:][:, :1]), *((x[:, :KERNEL], x[:, KERNEL:]) for x in levels[:-1])]
    for i in reversed(range(len(heads))):
        kernels, mix = heads[i]
        coarse = F.interpolate(result, scale_factor=2.0, mode="nearest")
        result = ops.filter_kernels(torch.lerp(coarse, colours[i], mix), kernels, valid[i])
    return result


class DenoiseUpscale(nn.Module):
    """One recurrent step. Output size is free: any width and height of 1 to 3 times the render size."""

    def __init__(self, config: TrunkConfig = TrunkConfig()):
        super().__init__()
        self.config = config
        self.trunk = Trunk(config)

    def forward(self, inputs: Inputs, state: State) -> tuple[Tensor, State, Tensor]:
        """Exposed linear output (N, 3, H, W), the next state, and the last output reprojected (log-encoded)."""
        height, width = state.output.shape[-2:]
        h, w = inputs.colour.shape[-2:]
        pad = (0, -w % ALIGN, 0, -h % ALIGN)
        past = reproject(inputs, state)
        factor = ops.demodulation(inputs.diffuse_albedo, inputs.specular_albedo)
        heads = self.trunk(F.pad(features(inputs, past, factor), pad, mode="replicate"))
        fine, *levels = (head.float() for head in heads)
        gates = fine[:, KERNEL + PHASES:, :h, :w]
        colour = (inputs.colour / factor).clamp(0, ops.MAX_COLOUR)
        accumulated, count = accumulate(colour, past, gates[:, 5:6])
        filtered = filter_pyramid(F.pad(accumulated, pad), F.pad(gates[:, 6:7], pad), fine, tuple(levels), h, w)
        weights = fine[:, KERNEL:KERNEL + PHASES, :h, :w].reshape(-1, 9, 4, h, w)
        current = ops.log_encode(ops.upsample(filtered[..., :h, :w] * factor, weights, inputs.jitter, height, width))
        blend = ops.interpolate_phases(gates[:, None, :4], height, width)[:, 0:1]
        output = torch.lerp(past.output, current, 1 - past.inside * (1 - blend))
        hidden = gates[:, 7:]
        one = torch.ones_like(state.fresh)
        return torch.expm1(output), State(output, accumulated, count, hidden, inputs.depth, one), past.output
