"""Clips for the network that enlarges what another one has denoised at the render's size.

`postfx` denoises a frame that is to be enlarged at its own size first, mixes the result with the
noisy colour, and hands the mixture to the network that enlarges. This makes such mixtures of clips:
`train.py --first` calls it for each clip that it loads.
"""

from __future__ import annotations

import random
import threading
from dataclasses import replace
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor

from training.denoise.checkpoint import read
from training.denoise.clips import CHANNELS, DEPTH, MOTION, Clip
from training.denoise.dataset import frame_inputs
from training.denoise.model import empty_state
from training.denoise.picture import (
    PictureConfig,
    PictureDenoiser,
    PictureNetwork,
    layout_from,
)

HALF_MAX = 65504.0
SHARES = 0.6, 0.9
"""Bounds of the denoised colour's share in a mixture, which is drawn for each render of a clip."""


class FirstStage:
    """Shrinks clips whose reference has the render's size to half, and mixes their colour with what
    a picture network makes of it.

    Args:
        checkpoint: of a picture network.
        device: where the clips are.

    Raises ValueError for a checkpoint of another kind of network.
    """

    def __init__(self, checkpoint: Path, device: torch.device) -> None:
        saved = read(checkpoint)
        if not saved["config"].get("picture"):
            raise ValueError(f"{checkpoint}: does not give the picture itself: take a checkpoint "
                             "of train.py --picture")
        config = layout_from(saved["config"])
        assert isinstance(config, PictureConfig), "as it says"
        self._model = PictureDenoiser(PictureNetwork(config))
        self._model.load_state_dict({name: values.float()
                                     for name, values in saved["weights"].items()})
        self._model.to(device).eval()
        self._lock = threading.Lock()  # clips are loaded by several threads

    @torch.compiler.disable(recursive=True)
    @torch.no_grad()
    def __call__(self, clip: Clip) -> Clip:
        small = shrink(clip)
        with self._lock:
            denoised = self._denoise(small)
        shares = torch.tensor([random.uniform(*SHARES) for _ in small.planes],
                              device=denoised.device)
        colour = torch.lerp(small.planes[:, :, :3].float(), denoised,
                            shares[:, None, None, None, None])
        return replace(small, planes=torch.cat((colour.half(), small.planes[:, :, 3:]), 2))

    def _denoise(self, clip: Clip) -> Tensor:
        """The renders' colour (V, T, 3, h, w), denoised one frame after another."""
        exposure = torch.full((len(clip.planes), 1, 1, 1), clip.exposure,
                              device=clip.planes.device)
        state, found = None, []
        for time, keep in enumerate(clip.keep.tolist()):
            inputs = frame_inputs(clip.planes[:, time, :CHANNELS].float(), clip.jitter[:, time],
                                  None, exposure)
            if state is None or not keep:
                state = empty_state(inputs, *inputs.colour.shape[-2:])
            done = self._model.step(inputs, state)
            state = done.state
            found.append((done.output / exposure).clamp(max=HALF_MAX))
        return torch.stack(found, 1)


def shrink(clip: Clip) -> Clip:
    """A clip with its renders at half the size, so that the reference is twice as large.

    A pixel is the mean of four, and has their samples. Depth and motion are those of one of them,
    as means of two surfaces lie on neither. A clip that is already smaller than its reference stays
    as it is.
    """
    if clip.planes.shape[-2:] != clip.reference.shape[-2:]:
        return clip
    planes = clip.planes.float()
    one = planes[..., 1::2, 1::2]
    half = F.avg_pool2d(planes.flatten(0, 1), 2).unflatten(0, planes.shape[:2])
    half[:, :, DEPTH] = one[:, :, DEPTH]
    half[:, :, MOTION:] = one[:, :, MOTION:] / 2
    return replace(clip, planes=half.half(), jitter=clip.jitter / 2,
                   samples=[4 * count for count in clip.samples])
