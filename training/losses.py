"""What the upscaler is trained to minimise, in the display curve that quality is scored on."""
import torch
import torch.nn.functional as F
from torch import Tensor

from training.networks import ops

COARSE = (4, 8, 16)  # output pixels


def gradient(image: Tensor) -> tuple[Tensor, Tensor]:
    return image[..., :, 1:] - image[..., :, :-1], image[..., 1:, :] - image[..., :-1, :]


def frame_loss(output: Tensor, reference: Tensor) -> Tensor:
    """Absolute, squared (what PSNR counts) and gradient error of two display-encoded pictures, and the absolute error
    of coarser ones: what is left of it there, blotches, is what the eye sees first and what FLIP counts most."""
    error = output - reference
    edges = sum((a - b).abs().mean() for a, b in zip(gradient(output), gradient(reference), strict=True))
    blotches = sum(F.avg_pool2d(error, size).abs().mean() for size in COARSE)
    return error.abs().mean() + 4 * error.square().mean() + 0.5 * edges + blotches


def flicker_loss(output: Tensor, previous: Tensor, reference: Tensor, reference_previous: Tensor,
                 explained: Tensor) -> Tensor:
    """Error of the motion-compensated temporal difference where motion explains the reference's change."""
    change = (output - previous) - (reference - reference_previous)
    return (change.abs() * explained).sum() / (3 * explained.sum() + 1)


def explained_by_motion(reference: Tensor, reference_previous: Tensor) -> Tensor:
    """1 where the reprojected reference stays within 0.1 of the new one, (N, 1, H, W)."""
    return ((reference - reference_previous).abs().amax(1, keepdim=True) < 0.1).to(reference.dtype)


def reproject_reference(reference: Tensor, motion: Tensor) -> Tensor:
    """The previous reference (N, 3, H, W) moved by motion (N, 2, h, w) in render pixels."""
    return ops.warp(reference, ops.enlarge_motion(motion, *reference.shape[-2:]))


def psnr(output: Tensor, reference: Tensor) -> Tensor:
    """Decibels of two display-encoded pictures, a value a batch entry."""
    return -10 * torch.log10((output - reference).square().flatten(1).mean(1) + 1e-12)
