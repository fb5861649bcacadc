"""A small upscaler for tests."""

from __future__ import annotations

from dataclasses import replace

import torch

from training.denoise.model import DenoiseUpscale, TrunkConfig

SMALL = TrunkConfig((16, 16, 16, 16), 1)
LOW = TrunkConfig((16, 16), 1)
"""Without the coarse levels, whose filters are the same at all pixels."""
DOUBTING = TrunkConfig((16, 16), 1, trust=True)
"""Says how far planes are trusted."""


def small_model(guides: bool = False, config: TrunkConfig = SMALL) -> DenoiseUpscale:
    """A network whose weights make all its outputs vary."""
    torch.manual_seed(0)
    model = DenoiseUpscale(replace(config, guides=guides))
    with torch.no_grad():
        for parameter in model.parameters():
            parameter += torch.randn_like(parameter) * 0.05
    return model
