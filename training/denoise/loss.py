"""The loss of the upscaler, in the display curve in which quality is scored."""

import math
from dataclasses import replace

import numpy as np
import torch
import torch.nn.functional as F
from kornia.color import linear_rgb_to_rgb, rgb_to_linear_rgb
from torch import Tensor, nn

from training import ops
from training.denoise.dataset import Batch
from training.denoise.model import (
    DenoiseUpscale,
    Inputs,
    State,
    Step,
    empty_state,
    trust_reflectance,
)
from training.denoise.picture import guide_codes

# Perceived difference -----------------------------------------------------------------------------
# Differentiable perceived difference: the colour part of FLIP (Andersson et al. 2020).
#
# Both pictures are filtered like the eye does at a distance, converted to Lab with less chroma in
# the dark (Hunt), and compared by HyAB; an exponent of 0.7 gives weight to small differences.

DENSITY = 67.0
"""Pixels for each degree of the field of view."""
BANDS = (0.0047, 0.0053, (34.1 * 0.04 + 13.5 * 0.025) / (34.1 + 13.5))
"""Widths of the contrast sensitivity to lightness, red-green and blue-yellow, in degrees^2. FLIP
describes blue-yellow by two Gaussians; this is the mean of their widths, weighted by their areas.
"""
TO_XYZ = ((0.4123908, 0.3575843, 0.1804808), (0.2126390, 0.7151687, 0.0721923),
          (0.0193308, 0.1191948, 0.9505322))
"""Linear sRGB to XYZ."""
EXPONENT = 0.7
"""Of the distance of two colours."""
SCALE = 0.95 / (0.4 * 41.2760)
"""Of the distance to the power of `EXPONENT`. 41.276 is the distance of green and blue, the two
colours that are farthest apart, to that power."""
SOFT = 1.0
"""Lab units, below which the distance is smooth: a kink at 0 would draw the result to the median of
a noisy reference."""
LAB_KNEE = 6 / 29
"""Cube root of the value below which Lab is linear."""
_MATRIX = np.array(TO_XYZ) / np.sum(TO_XYZ, 1, keepdims=True)
TO_WHITE_XYZ = _MATRIX.tolist()
"""Linear sRGB to XYZ as a share of white."""
FROM_WHITE_XYZ = np.linalg.inv(_MATRIX).tolist()
"""The inverse of `TO_WHITE_XYZ`."""


def apply_matrix(matrix: list[list[float]], image: Tensor) -> Tensor:
    """``matrix`` (3, 3) times each pixel of (N, 3, H, W)."""
    x, y, z = image.unbind(1)
    return torch.stack([row[0] * x + row[1] * y + row[2] * z for row in matrix], 1)


def filters(size: int, device: torch.device) -> Tensor:
    """(3, size, size): matrices that filter a line of pixels by the Gaussian of each band of the
    contrast sensitivity; edge pixels repeat."""
    lines = []
    for band in BANDS:
        sigma = math.sqrt(band / 2) / math.pi * DENSITY
        radius = math.ceil(3 * sigma)
        step = torch.arange(-radius, radius + 1, device=device)
        weights = torch.exp(-step.square() / (2 * sigma**2))
        reached = (torch.arange(size, device=device)[:, None] + step).clamp(0, size - 1)
        line = torch.zeros(size, size, device=device)
        lines.append(line.scatter_add(1, reached, (weights / weights.sum()).expand(size, -1)))
    return torch.stack(lines)


def perceive(display: Tensor) -> Tensor:
    """sRGB code values (N, 3, H, W) in [0, 1] to filtered Lab, whose chroma is multiplied by the
    lightness over 100 (Hunt)."""
    x, y, z = apply_matrix(TO_WHITE_XYZ, rgb_to_linear_rgb(display)).unbind(1)
    opponent, (height, width) = torch.stack((y, x - y, y - z), 1), display.shape[-2:]
    with torch.autocast(display.device.type, enabled=False):  # eight bits are too few
        passed = filters(height, display.device) @ opponent @ filters(width, display.device).mT
    y, red, blue = passed.unbind(1)
    linear = apply_matrix(FROM_WHITE_XYZ, torch.stack((red + y, y, y - blue), 1)).clamp(0, 1)
    value = apply_matrix(TO_WHITE_XYZ, linear)
    root = torch.where(value > LAB_KNEE**3, value.clamp(min=LAB_KNEE**3) ** (1 / 3),
                       value / (3 * LAB_KNEE**2) + 4 / 29)
    x, y, z = root.unbind(1)
    lightness = 116 * y - 16
    share = lightness / 100
    return torch.stack((lightness, 500 * share * (x - y), 200 * share * (y - z)), 1)


def difference(output: Tensor, reference: Tensor) -> Tensor:
    """Mean FLIP of two pictures of sRGB code values (N, 3, H, W), without its attention to
    edges."""
    change = perceive(output) - perceive(reference)
    chroma = (change[:, 1:].square().sum(1) + 1e-6).sqrt()
    distance = change[:, 0].abs() + chroma
    return SCALE * (distance.square() + SOFT**2).pow(EXPONENT / 2).mean()


# Losses of a frame --------------------------------------------------------------------------------

COARSE = (4, 8, 16)
"""Sides of the cells of the coarser pictures, in output pixels."""
KNEE = 0.02
"""Error below which values count squared, in display code values (1 is white)."""
COARSE_KNEE = 0.005
"""The same for coarser pictures."""
LIGHT_CELL = 16
"""Side of the cells in which light is compared, in output pixels."""
LIGHT_MOST = 1000.0
"""Exposed light above which a pixel counts no more."""
LIGHT_FLOOR = 0.05
"""Exposed light added to the reference that an error is relative to."""
LIGHT = 0.5, 0.05
"""Weight and knee of the relative error of light."""
DARK_REFLECTANCE = 0.05
"""Added to a reflectance before its logarithm."""
REFLECTANCE_KNEE = 0.1
"""Of the difference of two logarithms of reflectance."""
SEEN = 0.5
"""Weight of the perceived difference."""
ERROR = 0.1
"""Weight of the loss of the predicted error."""
GUIDES_KNEE = 0.02
"""Of the codes of albedo and normal."""
ERROR_FLOOR = 0.03
"""Expected error in code values; pixels below it have almost the same weight."""
NOISY = 0.2
"""Error of the input, in code values, of a frame whose weight `even_scale` leaves at 1."""
DARKEST = 1e-3
"""Exposed light; where there is less, the display curve has the slope that it has here."""
SQUARED = 40.0
"""Weight of squared errors against noisy references."""
USUAL_SQUARED_ERROR = 2e-3
"""Of a denoised frame of few samples, in code values: frames whose reference has as much noise
count half."""


def display(exposed: Tensor) -> Tensor:
    """Exposed linear colour to the sRGB-encoded curve x / (1 + x) that quality is scored on."""
    x = exposed.clamp(min=0)
    return linear_rgb_to_rgb(x / (1 + x))


def shown_by_halves(reference: Tensor, half: Tensor) -> Tensor:
    """Codes of the light that a noisy ``reference`` has in the mean; ``half`` is made of half of
    its samples, or is the reference itself where that has no noise."""
    other = (2 * reference - half).clamp(min=0)
    return ops.without_bias(display, half, other)


def certainty(reference: Tensor, half: Tensor) -> Tensor:
    """Weight (N, 1, 1, 1) of the squared errors of each picture against a noisy ``reference``,
    whose ``half`` is made of half of its samples. Noise of references leaves the minimum where it
    is, but hides it, and a few noisy clips would decide every step."""
    variance = (display(half) - display(reference)).square().mean((1, 2, 3), keepdim=True)
    return USUAL_SQUARED_ERROR / (USUAL_SQUARED_ERROR + variance)


def seen_error(result: Tensor, target: Tensor, at: Tensor) -> Tensor:
    """Error of light times the slope of the display curve ``at`` some light: the error of what is
    seen, where it is small. Unlike the difference of display codes, it is linear in the target, so
    noise of the target averages out where this error is squared."""
    return (result - target) * display_slope(at)


def display_slope(light: Tensor) -> Tensor:
    """The derivative of `display`: of x / (1 + x), and of the sRGB curve (IEC 61966-2-1)."""
    light = light.clamp(min=DARKEST)
    shown = light / (1 + light)
    coded = torch.where(shown <= 0.0031308, 12.92, 1.055 / 2.4 * shown ** (1 / 2.4 - 1))
    return coded / (1 + light).square()


def gradient(image: Tensor) -> tuple[Tensor, Tensor]:
    """Differences to the right and to the lower neighbour, (..., H, W - 1) and (..., H - 1, W)."""
    return image[..., :, 1:] - image[..., :, :-1], image[..., 1:, :] - image[..., :-1, :]


def huber(error: Tensor, knee: float) -> Tensor:
    """Mean of an error that is squared below ``knee`` and absolute above (pseudo-Huber). References
    keep some noise, which is skewed: squared small errors find its mean, absolute ones would find
    its median, which is darker."""
    return ((error.square() + knee**2).sqrt() - knee).mean()


def frame_loss(output: Tensor, reference: Tensor, scale: Tensor) -> Tensor:
    """Error of two display-encoded pictures, times ``scale`` (N, 1, 1, 1): of values, squared (as
    in PSNR), of gradients, of coarser pictures, which show blotches, and, without the scale, as the
    eye sees it (as in FLIP)."""
    error = (output - reference) * scale
    edges = sum(change.abs().mean() for change in gradient(error))
    blotches = sum(huber(F.avg_pool2d(error, size), COARSE_KNEE) for size in COARSE)
    seen = difference(output, reference)
    return huber(error, KNEE) + 4 * error.square().mean() + 0.5 * edges + blotches + SEEN * seen


def noisy_frame_loss(output: Tensor, reference: Tensor, scale: Tensor) -> Tensor:
    """Error of two display-encoded pictures of which the reference holds noise of its own, as in
    Noise2Noise (Lehtinen et al., 2018): squared errors of pixels and of coarser pictures, each
    times ``scale`` (N, 1, 1, 1). All of it is least at the mean of such references."""
    error = (output - reference) * scale
    pictures = [error, *(F.avg_pool2d(error, size) for size in COARSE)]
    return SQUARED * sum(picture.square().mean() for picture in pictures)


def light_loss(output: Tensor, reference: Tensor, knee: float = LIGHT[1]) -> Tensor:
    """Relative error of the light in cells of 16x16 output pixels, of exposed linear pictures: the
    display curve alone would let uncertain lamps fade. Errors below ``knee`` are squared, so that
    they find the mean and not the median."""
    found, wanted = (F.avg_pool2d(x.clamp(max=LIGHT_MOST), LIGHT_CELL) for x in (output, reference))
    return huber((found - wanted) / (wanted.mean(1, keepdim=True) + LIGHT_FLOOR), knee)


def reflectance_loss(planes: Inputs, share: Tensor, wanted: Tensor) -> Tensor:
    """Relative error of the planes' reflectance, trusted by ``share`` (N, 1, h, w), against the
    ``wanted`` one (N, 3, h, w). NaN in it does not count."""
    found = trust_reflectance(ops.demodulation(planes.diffuse_albedo, planes.specular_albedo),
                              share)
    known = ~wanted.isnan()
    ratio = (found + DARK_REFLECTANCE) / (torch.where(known, wanted, found) + DARK_REFLECTANCE)
    return huber(ratio.log(), REFLECTANCE_KNEE)


def guides_loss(found: Tensor, surface: Inputs) -> Tensor:
    """Error of albedo and normal without their noise, ``found`` (N, 6, h, w), against those of the
    true ``surface``. NaN in it does not count."""
    wanted = guide_codes(surface.diffuse_albedo + surface.specular_albedo, surface.denoising_albedo,
                         surface.normal)
    return huber(torch.where(wanted.isnan(), 0.0, found - wanted), GUIDES_KNEE)


def error_loss(predicted: Tensor, output: Tensor, reference: Tensor) -> Tensor:
    """Loss of the ``predicted`` logarithm (N, 1, h, w) of the expected squared error of the
    display-encoded ``output`` (N, 3, H, W), of the same size or larger.

    Like a Poisson likelihood, it is least where the expected error is the mean of the squared
    error. The smaller a pixel's expected error is, the greater is its weight.
    """
    h, w = predicted.shape[-2:]
    squared = F.adaptive_avg_pool2d((output - reference).detach().square().mean(1, keepdim=True),
                                    (h, w))
    expected = predicted.exp()
    weight = 1 / (expected.detach().sqrt() + ERROR_FLOOR)
    return (weight * (expected - squared * predicted)).mean()


def flicker_loss(output: Tensor, previous: Tensor, reference: Tensor, reference_previous: Tensor,
                 explained: Tensor, scale: Tensor, is_noisy: bool = False) -> Tensor:
    """Error of the motion-compensated temporal difference, times ``scale`` (N, 1, 1, 1), in pixels
    whose change in the reference is explained by motion. It is squared where references are
    noisy."""
    change = ((output - previous) - (reference - reference_previous)) * scale
    error = SQUARED * change.square() if is_noisy else change.abs()
    return (error * explained).sum() / (3 * explained.sum() + 1)


def explained_by_motion(reference: Tensor, reference_previous: Tensor) -> Tensor:
    """1 where the reprojected reference stays within 0.1 of the new one, (N, 1, H, W)."""
    return ((reference - reference_previous).abs().amax(1, keepdim=True) < 0.1).to(reference.dtype)


def reproject_reference(reference: Tensor, motion: Tensor) -> Tensor:
    """The previous reference (N, 3, H, W) moved by motion (N, 2, h, w) in render pixels."""
    return ops.warp(reference, ops.enlarge_motion(motion, *reference.shape[-2:]))


def even_scale(colour: Tensor, reference: Tensor, most: float) -> Tensor:
    """(N, 1, 1, 1): factor on errors of display-encoded pictures that gives frames of many samples
    the weight of frames of few: ``NOISY`` over the error of the input ``colour`` (N, 3, h, w), 1 to
    ``most``."""
    error = colour - F.adaptive_avg_pool2d(reference, colour.shape[-2:])
    return (NOISY / error.square().mean((1, 2, 3), keepdim=True).sqrt().clamp(min=1e-6)).clamp(1,
                                                                                               most)


def psnr(output: Tensor, reference: Tensor) -> Tensor:
    """PSNR in dB of two display-encoded pictures, a value for each batch entry."""
    return -10 * torch.log10((output - reference).square().flatten(1).mean(1) + 1e-12)


# Loss of a clip -----------------------------------------------------------------------------------
# The loss of clips that run through the recurrent step, forwards or both ways.

OWN = 0.5
"""Weight of the losses of the two directions of a clip that runs both ways; their blend has the
rest."""

Scores = tuple[Tensor, Tensor, Tensor]
"""Loss; PSNR in dB and flicker, both without gradient."""
Results = tuple[Tensor, Tensor, Tensor, State]
"""`Scores`, and the history after the last frame."""


class Truth:
    """References of a clip, their motion, and the factors on errors: 1 or, with ``even``, larger
    for inputs with less noise."""

    def __init__(self, batch: Batch, even: float = 0.0, light: tuple[float, float] = LIGHT,
                 is_noisy: bool = False):
        self.light, self.knee = light
        self.is_noisy, self.quiet = is_noisy, batch.quiet
        self.references = batch.references
        self.shown = list(map(shown_by_halves, batch.references, batch.halves) if is_noisy
                          else map(display, batch.references))
        ones = torch.ones_like(batch.keep[0])
        self.scale = [even_scale(display(inputs.colour), shown, even) if even else ones
                      for inputs, shown in zip(batch.frames, self.shown, strict=True)]
        if is_noisy:
            weights = map(certainty, batch.references, batch.halves)
            self.scale = [scale * weight.sqrt()
                          for scale, weight in zip(self.scale, weights, strict=True)]
        self.motion = batch.true_motion or [inputs.motion for inputs in batch.frames]
        self.moved = self._move(self.shown)
        self.explained = [explained_by_motion(now, moved) * keep
                          for now, moved, keep in zip(self.shown[1:], self.moved, batch.keep[1:],
                                                      strict=True)]

    def _move(self, pictures: list[Tensor]) -> list[Tensor]:
        """All but the last of the clip's pictures, each moved to the next frame."""
        return [reproject_reference(before, motion)
                for before, motion in zip(pictures[:-1], self.motion[1:], strict=True)]

    def scores(self, outputs: list[Tensor], weight: float) -> Scores:
        """Loss of the exposed linear ``outputs`` with a ``weight`` of flicker, the mean PSNR of the
        clip's second half and the mean flicker."""
        shown = [display(output) for output in outputs]
        picture_loss = noisy_frame_loss if self.is_noisy else frame_loss
        pictures = sum(map(picture_loss, shown, self.shown, self.scale))
        pictures = pictures + self.light * sum(light_loss(*pair, self.knee) for pair
                                              in zip(outputs, self.references, strict=True))
        flicker = torch.stack([self._flicker(shown, t) for t in range(1, len(shown))])
        late = range(len(shown) // 2, len(shown))
        quality = torch.stack([psnr(shown[t].detach(), self.shown[t]).mean() for t in late])
        return ((pictures + weight * flicker.sum()) / len(shown), quality.mean(),
                flicker.detach().mean())

    def error_score(self, outputs: list[Tensor], errors: list[Tensor | None]) -> Tensor | float:
        """Loss of the predicted ``errors`` of the exposed linear ``outputs``; 0 if the network
        predicts none."""
        if errors[0] is None:
            return 0.0
        if self.is_noisy:  # the noise of a reference is no error of the picture
            errors = [torch.where(self.quiet, error, error.detach())  # type: ignore[union-attr]
                      for error in errors]
        found = [error_loss(error, display(output.detach()), shown)
                 for error, output, shown in zip(errors, outputs, self.shown, strict=True)]
        return ERROR * sum(found) / len(found)

    def _flicker(self, shown: list[Tensor], t: int) -> Tensor:
        moved = reproject_reference(shown[t - 1], self.motion[t])
        return flicker_loss(shown[t], moved, self.shown[t], self.moved[t - 1],
                            self.explained[t - 1], self.scale[t], self.is_noisy)


class ClipLoss(nn.Module):
    """Run a clip through the recurrent step and sum the losses of its frames.

    A batch with inverse motion also runs backwards: each direction has a loss, and so has their
    blend. A batch with a state continues its history.

    Args:
        model: The network to train.
        flicker: Weight of `flicker_loss`.
        reset: Chance that a frame drops its history.
        even: Largest weight of a frame with little noise (`even_scale`); with 0, all frames weigh
            the same.
        light: Weight and knee of `light_loss`.
        reflectance: Weight of `reflectance_loss`.
        guides: Weight of `guides_loss`.
        is_noisy: Whether the references hold noise of their own.
    """

    def __init__(self, model: DenoiseUpscale, flicker: float, reset: float, even: float = 0.0,
                 light: tuple[float, float] = LIGHT, reflectance: float = 0.0, guides: float = 0.0,
                 is_noisy: bool = False):
        super().__init__()
        self.model = model
        self.flicker = flicker
        self.reset = reset
        self.even = even
        self.light = light
        self.reflectance = reflectance
        self.guides = guides
        self.is_noisy = is_noisy

    def forward(self, batch: Batch) -> Results:
        # One context for the whole clip, so that weights are cast once and not once a frame.
        with torch.autocast(batch.references.device.type, torch.bfloat16):
            return self._clip(batch)

    def _clip(self, batch: Batch) -> Results:
        truth = Truth(batch, self.even, self.light, self.is_noisy)
        begin = batch.state or empty_state(batch.frames[0], *batch.references.shape[-2:])
        steps, counts = self._run(batch.frames, list(batch.keep), begin)
        ahead, end = [step.output for step in steps], steps[-1].state
        besides = self._trust(batch, steps) + self._planes(batch, steps)
        if batch.inverse is None:
            loss, *rest = truth.scores(ahead, self.flicker)
            return (loss + besides + truth.error_score(ahead, [step.error for step in steps]),
                    *rest, end)
        back_steps, back_counts = (x[::-1] for x in self._run(*backwards(batch), begin))
        back = [step.output for step in back_steps]
        both = [torch.lerp(b, a, n / (n + m))
                for a, b, n, m in zip(ahead, back, counts, back_counts, strict=True)]
        own = [truth.scores(outputs, self.flicker)[0] for outputs in (ahead, back)]
        loss, quality, flicker = truth.scores(both, self.flicker)
        return OWN * (own[0] + own[1]) / 2 + (1 - OWN) * loss + besides, quality, flicker, end

    def _trust(self, batch: Batch, steps: list[Step]) -> Tensor | float:
        """Loss of the trust in each frame's planes, (N, 1, h, w), the last hidden channel."""
        if not self.reflectance:
            return 0.0
        trust = [step.state.hidden[:, -1:] for step in steps]
        errors = map(reflectance_loss, batch.frames, trust, batch.reflectance())
        return self.reflectance * sum(errors) / len(trust)

    def _planes(self, batch: Batch, steps: list[Step]) -> Tensor | float:
        """Loss of albedo and normal without their noise."""
        if not self.guides:
            return 0.0
        assert batch.surfaces is not None, "a batch of clips has the true planes"
        errors = [guides_loss(step.planes, surface)
                  for step, surface in zip(steps, batch.surfaces, strict=True)]
        return self.guides * sum(errors) / len(errors)

    def _run(self, frames: list[Inputs], keep: list[Tensor],
             state: State) -> tuple[list[Step], list[Tensor]]:
        """The `Step` of each frame, and how many frames it has seen, itself included, (N, 1, 1,
        1)."""
        steps, counts = [], [torch.zeros_like(keep[0])]
        for inputs, kept in zip(frames, keep, strict=True):
            kept = (torch.rand_like(kept) >= self.reset) * kept
            steps.append(self.model.step(inputs, state.drop(kept)))
            state = steps[-1].state
            counts.append(1 + kept * counts[-1])
        return steps, counts[1:]


def backwards(batch: Batch) -> tuple[list[Inputs], list[Tensor]]:
    """The frames from last to first with motion to the next frame, and where history continues."""
    assert batch.inverse is not None, "the clips run backwards, too"
    frames = [replace(inputs, motion=motion)
              for inputs, motion in zip(batch.frames, batch.inverse, strict=True)]
    return frames[::-1], [torch.zeros_like(batch.keep[0]), *batch.keep[1:].flip(0)]
