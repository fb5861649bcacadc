"""A small upscaler for tests."""

from __future__ import annotations

from dataclasses import replace

import torch

from training.denoise.model import DenoiseUpscale, Trunk, TrunkConfig
from training.denoise.residual import ResidualConfig, ResidualTrunk

SMALL = TrunkConfig((16, 16, 16, 16), 1)
LOW = TrunkConfig((16, 16), 1)
"""Without the coarse levels, whose filters are the same at all pixels."""
DOUBTING = TrunkConfig((16, 16), 1, trust=True)
"""Says how far planes are trusted."""


RESIDUAL = ResidualConfig((8, 8, 8, 8, 8), (1, 1, 1, 1, 1), (1, 1, 1, 1))
"""From the render size on: reads planes that follow mirrors and glass, and predicts its error."""


def small_model(guides: bool = False,
                config: TrunkConfig | ResidualConfig = SMALL) -> DenoiseUpscale:
    """A network whose weights make all its outputs vary."""
    torch.manual_seed(0)
    model = DenoiseUpscale(trunk=ResidualTrunk(config) if isinstance(config, ResidualConfig)
                                 else Trunk(replace(config, guides=guides)))
    with torch.no_grad():
        for parameter in model.parameters():
            parameter += torch.randn_like(parameter) * 0.05
    return model
