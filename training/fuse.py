"""Fused versions of the small operations that a training step spends its time in.

Each is memory-bound when run as it is written: compiled on its own it is one or two GPU kernels forward and as many
backward. The whole step compiled at once would take minutes for every shape.
"""
import torch

from training import losses
from training.networks import denoise_upscale, ops, phases

FUSED = ((ops, ("filter_kernels", "pool", "demodulation", "dilate_motion", "box_mean", "display")),
         (phases, ("upsample",)),
         (denoise_upscale, ("features", "guide_features", "accumulate", "demodulate")),
         (losses, ("frame_loss", "flicker_loss", "explained_by_motion", "even_scale")))


def fuse() -> None:
    """Replace the operations in their modules, for this process."""
    torch._dynamo.config.cache_size_limit = 64
    for module, names in FUSED:
        for name in names:
            setattr(module, name, torch.compile(getattr(module, name), dynamic=False))
