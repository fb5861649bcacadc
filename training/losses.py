"""What the upscaler is trained to minimise, in the display curve that quality is scored on."""
import torch
import torch.nn.functional as F
from torch import Tensor

from training import perception
from training.networks import ops

COARSE = (4, 8, 16)  # output pixels
KNEE, COARSE_KNEE = 0.02, 0.005  # code values
SEEN = 0.5  # weight of how different pictures look
NOISY, MOST_SCALE = 0.2, 8.0  # the display-encoded error of an input whose frames count once, and how much they may


def gradient(image: Tensor) -> tuple[Tensor, Tensor]:
    return image[..., :, 1:] - image[..., :, :-1], image[..., 1:, :] - image[..., :-1, :]


def huber(error: Tensor, knee: float) -> Tensor:
    """Mean of an error that is squared below ``knee`` and absolute above (pseudo-Huber). References keep some noise,
    which is skewed: small errors squared find its mean, where absolute ones would find its median, which is darker."""
    return ((error.square() + knee**2).sqrt() - knee).mean()


def frame_loss(output: Tensor, reference: Tensor, scale: Tensor) -> Tensor:
    """Error of two display-encoded pictures, times ``scale`` (N, 1, 1, 1): by value, squared (what PSNR counts), of
    gradients, of coarser pictures, where blotches are what is left of it, and, not scaled, as the eye sees it (what
    FLIP counts)."""
    error = (output - reference) * scale
    edges = sum(change.abs().mean() for change in gradient(error))
    blotches = sum(huber(F.avg_pool2d(error, size), COARSE_KNEE) for size in COARSE)
    seen = perception.difference(output, reference)
    return huber(error, KNEE) + 4 * error.square().mean() + 0.5 * edges + blotches + SEEN * seen


def flicker_loss(output: Tensor, previous: Tensor, reference: Tensor, reference_previous: Tensor,
                 explained: Tensor, scale: Tensor) -> Tensor:
    """Error of the motion-compensated temporal difference, times ``scale`` (N, 1, 1, 1), where motion explains the
    reference's change."""
    change = ((output - previous) - (reference - reference_previous)) * scale
    return (change.abs() * explained).sum() / (3 * explained.sum() + 1)


def explained_by_motion(reference: Tensor, reference_previous: Tensor) -> Tensor:
    """1 where the reprojected reference stays within 0.1 of the new one, (N, 1, H, W)."""
    return ((reference - reference_previous).abs().amax(1, keepdim=True) < 0.1).to(reference.dtype)


def reproject_reference(reference: Tensor, motion: Tensor) -> Tensor:
    """The previous reference (N, 3, H, W) moved by motion (N, 2, h, w) in render pixels."""
    return ops.warp(reference, ops.enlarge_motion(motion, *reference.shape[-2:]))


def even_scale(colour: Tensor, reference: Tensor) -> Tensor:
    """(N, 1, 1, 1): what errors of display-encoded pictures are multiplied by, so that frames of many samples count as
    those of few: ``NOISY`` by the error of the input ``colour`` (N, 3, h, w), 1 to ``MOST_SCALE``."""
    error = colour - F.adaptive_avg_pool2d(reference, colour.shape[-2:])
    return (NOISY / error.square().mean((1, 2, 3), keepdim=True).sqrt().clamp(min=1e-6)).clamp(1, MOST_SCALE)


def psnr(output: Tensor, reference: Tensor) -> Tensor:
    """Decibels of two display-encoded pictures, a value a batch entry."""
    return -10 * torch.log10((output - reference).square().flatten(1).mean(1) + 1e-12)
