"""Motion turned round: where each pixel goes, from where the next frame's pixels came from. For clips run backwards."""
import torch
from torch import Tensor

from training.networks import ops

OUTSIDE = 1e4  # render pixels: points out of any picture, which counts as no history
CLOSE = 0.03  # neighbours whose depths differ by a smaller share are one surface
ROUNDS = 2  # of filling: holes up to as many pixels from a known motion


def inverse_motion(after: Tensor, depth_after: Tensor, depth: Tensor) -> Tensor:
    """Motion (N, 2, h, w) of a frame to where its pixels are in the next one, in render pixels.

    ``after`` (N, 2, h, w) is the next frame's motion to this one, ``depth_after`` and ``depth`` (N, 1, h, w) are the
    depths of both. What the next frame does not show, because it is hidden there or leaves the picture, points
    ``OUTSIDE``.
    """
    motion = splat(after, depth_after)
    for _ in range(ROUNDS):
        motion = fill(motion, depth)
    return torch.where(motion.isnan(), OUTSIDE, motion)


def splat(after: Tensor, depth_after: Tensor) -> Tensor:
    """Each pixel's motion, turned round, at the pixel nearest to where it came from; the nearest surface wins, and NaN
    stands where nothing came from."""
    n, _, h, w = after.shape
    x, y = (position.round() for position in ops.positions(after))
    lands = (x >= 0) & (x < w) & (y >= 0) & (y < h)
    nowhere = h * w  # one more place, which is cut off
    target = torch.where(lands, y * w + x, nowhere).long().flatten(1)
    depth = depth_after.flatten(1)
    nearest = depth.new_full((n, nowhere + 1), torch.inf).scatter_reduce(1, target, depth, "amin")
    target = torch.where(depth == nearest.gather(1, target), target, nowhere)
    result = after.new_full((n, 2, nowhere + 1), torch.nan)
    result = result.scatter(2, target[:, None].expand(-1, 2, -1), -after.flatten(2))
    return result[..., :nowhere].unflatten(2, (h, w))


def fill(motion: Tensor, depth: Tensor) -> Tensor:
    """``motion`` with holes (NaN) filled by the 3x3 neighbour closest in depth, where one is on the same surface."""
    around = ops.shifted(motion, 3, "replicate")
    apart = (ops.shifted(depth, 3, "replicate") / depth[:, :, None] - 1).abs()
    apart, chosen = torch.where(around[:, :1].isnan(), torch.inf, apart).min(2, keepdim=True)
    found = around.gather(2, chosen.expand(-1, 2, -1, -1, -1))[:, :, 0]
    return torch.where(motion.isnan() & (apart[:, :, 0] < CLOSE), found, motion)
