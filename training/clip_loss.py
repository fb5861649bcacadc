"""The loss of clips that run through the recurrent step, forwards or both ways."""
from dataclasses import replace

import torch
from torch import Tensor, nn

from training import losses
from training.dataset import Batch
from training.networks import ops
from training.networks.denoise_upscale import DenoiseUpscale, Inputs, empty_state

OWN = 0.5  # share of the two directions' own losses in that of clips run both ways; the rest is the blend's

Scores = tuple[Tensor, Tensor, Tensor]  # loss, and without gradient PSNR and flicker


class Truth:
    """What the frames of a clip should show, how that moves, and by what errors are multiplied: 1, or if clips are to
    count ``even``, the more the less noise their input has."""

    def __init__(self, batch: Batch, even: bool = False):
        self.shown = [ops.display(reference) for reference in batch.references]
        ones = torch.ones_like(batch.keep[0])
        self.scale = [losses.even_scale(ops.display(inputs.colour), shown) if even else ones
                      for inputs, shown in zip(batch.frames, self.shown, strict=True)]
        self.motion = [inputs.motion for inputs in batch.frames]
        self.moved = [losses.reproject_reference(before, motion)
                      for before, motion in zip(self.shown[:-1], self.motion[1:], strict=True)]
        self.explained = [losses.explained_by_motion(now, moved) * keep
                          for now, moved, keep in zip(self.shown[1:], self.moved, batch.keep[1:], strict=True)]

    def scores(self, outputs: list[Tensor], weight: float) -> Scores:
        """Loss of the exposed linear ``outputs`` with a ``weight`` of flicker, the mean PSNR of the clip's second half
        and the mean flicker."""
        shown = [ops.display(output) for output in outputs]
        pictures = sum(map(losses.frame_loss, shown, self.shown, self.scale))
        flicker = torch.stack([self._flicker(shown, t) for t in range(1, len(shown))])
        late = range(len(shown) // 2, len(shown))
        quality = torch.stack([losses.psnr(shown[t].detach(), self.shown[t]).mean() for t in late])
        return (pictures + weight * flicker.sum()) / len(shown), quality.mean(), flicker.detach().mean()

    def _flicker(self, shown: list[Tensor], t: int) -> Tensor:
        moved = losses.reproject_reference(shown[t - 1], self.motion[t])
        return losses.flicker_loss(shown[t], moved, self.shown[t], self.moved[t - 1], self.explained[t - 1],
                                   self.scale[t])


class ClipLoss(nn.Module):
    """Run a clip through the recurrent step and sum the losses of its frames.

    ``flicker`` is the weight of the temporal difference, ``reset`` the chance that a frame drops its history; ``even``
    lets clips of little noise count as much as noisy ones. A batch with inverse motion is run backwards, too: each
    direction has its own loss, and their blend has one.
    """

    def __init__(self, model: DenoiseUpscale, flicker: float, reset: float, even: bool = False):
        super().__init__()
        self.model, self.flicker, self.reset, self.even = model, flicker, reset, even

    def forward(self, batch: Batch) -> Scores:
        # One context for the whole clip, so that weights are cast once and not once a frame.
        with torch.autocast(batch.references.device.type, torch.bfloat16):
            return self._clip(batch)

    def _clip(self, batch: Batch) -> Scores:
        truth, size = Truth(batch, self.even), batch.references.shape[-2:]
        ahead, counts = self._run(batch.frames, list(batch.keep), size)
        if batch.inverse is None:
            return truth.scores(ahead, self.flicker)
        back, back_counts = (x[::-1] for x in self._run(*backwards(batch), size))
        both = [torch.lerp(b, a, n / (n + m)) for a, b, n, m in zip(ahead, back, counts, back_counts, strict=True)]
        own = [truth.scores(outputs, self.flicker)[0] for outputs in (ahead, back)]
        loss, quality, flicker = truth.scores(both, self.flicker)
        return OWN * (own[0] + own[1]) / 2 + (1 - OWN) * loss, quality, flicker

    def _run(self, frames: list[Inputs], keep: list[Tensor],
             size: tuple[int, int]) -> tuple[list[Tensor], list[Tensor]]:
        """Exposed linear outputs, and how many frames each has seen, itself included, (N, 1, 1, 1)."""
        state, outputs, counts = empty_state(frames[0], *size), [], [torch.zeros_like(keep[0])]
        for inputs, kept in zip(frames, keep, strict=True):
            kept = (torch.rand_like(kept) >= self.reset) * kept
            output, state, _ = self.model(inputs, state.drop(kept))
            outputs.append(output)
            counts.append(1 + kept * counts[-1])
        return outputs, counts[1:]


def backwards(batch: Batch) -> tuple[list[Inputs], list[Tensor]]:
    """The frames from last to first, with motion to the frame after, and where history goes on there."""
    frames = [replace(inputs, motion=motion) for inputs, motion in zip(batch.frames, batch.inverse, strict=True)]
    return frames[::-1], [torch.zeros_like(batch.keep[0]), *batch.keep[1:].flip(0)]
