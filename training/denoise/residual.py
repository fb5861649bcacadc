"""A trunk of residual blocks that begins at the render size: the network of the denoiser at 1x.

The trunk of `model.py` sees the picture through a stem of stride 2, and levels of plain ReLU can
die. Here every level carries a linear stream to which blocks add, so a level that learns slowly
still passes on what it gets, and the finest level has the render size. The inputs and the heads are
those of `model.Trunk`, so the operations around the network stay the same.

At first every logit is drawn one way, towards sharper filters, and without a norm fourteen
convolutions in a row grow together: the stream rose from 1 to 10^7 within 40 steps, all heads left
their range, and nothing was learnt from then on. (Split filters and lower rates for filters of many
inputs only put it off.) Each head therefore reads the stream divided by its root mean square over
the channels, so its scale no longer matters.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from postfx.kernels import denoise as layout
from postfx.kernels.denoise import FEATURES, FINE, KERNEL, MIRRORED, MIX, SHARPEN
from postfx.kernels.denoise.network_io import LEAST_LOG_ERROR, MOST_LOG_ERROR
from training.denoise.model import LEVELS, NO_SHARPENING, activate_fine, filters

BRANCH = 0.2  # of the usual first weights of what a block adds
STEEPEST = float(layout.STEEPEST)  # logits stay within this; torch compiles no numbers of NumPy
LEAST_SQUARE = 1e-6  # added to a mean square before its root
HEAD_STD = 0.01  # of the heads' first weights: filters start nearly even
USUAL_ERROR = -6.0  # logarithm of a squared error in code values: 26 dB


@dataclass(frozen=True)
class ResidualConfig:
    """Layout of the trunk.

    ``widths`` are the channels of the levels at 1, 1/2, 1/4, 1/8 and 1/16 of the render size;
    ``down`` and ``up`` the residual blocks of each level before and after the coarser ones. The
    coarsest level has no blocks of ``up``. A ``mirrored`` network also reads Blender's Denoising
    Albedo and Denoising Normal, and predicts its error.
    """

    widths: tuple[int, ...] = (32, 80, 112, 144, 176)
    down: tuple[int, ...] = (1, 1, 2, 2, 3)
    up: tuple[int, ...] = (1, 2, 2, 2)
    trust: bool = True
    guides: bool = False
    mirrored: bool = True

    def __post_init__(self) -> None:
        if not len(self.widths) == len(self.down) == len(self.up) + 1 == LEVELS + 1:
            raise ValueError(f"{LEVELS + 1} widths and counts down, and {LEVELS} counts up: {self}")

    @property
    def align(self) -> int:
        """Height and width of the network's input are multiples of this."""
        return 2 ** LEVELS

    @property
    def reach(self) -> int:
        """Pixels of the render size that the network sees around each."""
        counts = (down + up for down, up in zip(self.down, (*self.up, 0), strict=True))
        return 1 + sum(2 * count << level for level, count in enumerate(counts))

    @property
    def sees(self) -> int:
        """Pixels of the render size that the network and the filters that it predicts see around
        each."""
        return self.reach + 2 * sum(1 << level for level in range(LEVELS + 1))

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)

    @classmethod
    def from_dict(cls, config: dict[str, Any]) -> ResidualConfig:
        known = {field.name: config[field.name] for field in fields(cls) if field.name in config}
        lists = {name: tuple(value)
                 for name, value in known.items() if isinstance(value, list | tuple)}
        return cls(**{**known, **lists})

    def products(self) -> float:
        """Multiplications of the network a render pixel."""
        inputs = FEATURES + (MIRRORED if self.mirrored else 0)
        total, area = 9.0 * inputs * self.widths[0] + FINE * self.widths[0], 1.0
        for level, width in enumerate(self.widths):
            blocks = self.down[level] + (self.up[level] if level < LEVELS else 0)
            total += area * blocks * 2 * 9 * width * width
            total += area * width * (KERNEL + 1) if level else 0
            if level < LEVELS:
                # to the coarser level: 2x2 pixels, a quarter of them
                total += area * width * self.widths[level + 1]
                total += area / 4 * width * self.widths[level + 1]  # and back
            area /= 4
        return total


class ResidualBlock(nn.Module):
    """x + conv(ReLU(conv(x))). It begins near the identity."""

    def __init__(self, width: int):
        super().__init__()
        self.first = nn.Conv2d(width, width, 3, padding=1)
        self.second = nn.Conv2d(width, width, 3, padding=1)
        with torch.no_grad():
            self.second.weight.mul_(BRANCH)
            self.second.bias.zero_()

    def forward(self, x: Tensor) -> Tensor:
        return x + self.second(F.relu(self.first(x)))


def bound(logits: Tensor) -> Tensor:
    """Logits within `STEEPEST`, where filters are clamped anyway, but with the gradient of the
    unbounded ones: clamped logits have none, so a head that once left the range for all pixels
    would never come back."""
    logits = logits.float()
    return logits + (logits.clamp(-STEEPEST, STEEPEST) - logits).detach()


def normalise(stream: Tensor) -> Tensor:
    """The stream over its root mean square over the channels of each pixel."""
    stream = stream.float()
    return stream * torch.rsqrt(stream.square().mean(1, keepdim=True) + LEAST_SQUARE)


def blocks(width: int, count: int) -> nn.Sequential:
    return nn.Sequential(*(ResidualBlock(width) for _ in range(count)))


class ResidualTrunk(nn.Module):
    """Features (N, 35, h, w), h and w multiples of 16 -> the activated heads of `model.Trunk`.

    A ``mirrored`` network also reads `model.mirrored_features` (N, 6, h, w), and after the heads
    gives the logarithm of the expected squared error of each pixel, (N, 1, h, w).
    """

    def __init__(self, config: ResidualConfig | None = None):
        super().__init__()
        self.config = config or ResidualConfig()
        widths = self.config.widths
        self.align = self.config.align
        inputs = FEATURES + (MIRRORED if self.config.mirrored else 0)
        self.stem = nn.Conv2d(inputs, widths[0], 3, padding=1)
        self.down = nn.ModuleList(map(blocks, widths, self.config.down))
        self.up = nn.ModuleList(map(blocks, widths, self.config.up))
        self.shrink = nn.ModuleList(nn.Conv2d(widths[i], widths[i + 1], 2, stride=2)
                                    for i in range(LEVELS))
        self.lift = nn.ModuleList(nn.Conv2d(widths[i + 1], widths[i], 1) for i in range(LEVELS))
        counts = [KERNEL + 1] * (LEVELS - 1) + [KERNEL]
        self.heads = nn.ModuleList(nn.Conv2d(widths[i + 1], counts[i], 1) for i in range(LEVELS))
        self.fine = nn.Conv2d(widths[0], FINE, 1)
        for head in (*self.heads, self.fine):
            nn.init.normal_(head.weight, std=HEAD_STD)
            nn.init.zeros_(head.bias)
        nn.init.constant_(self.fine.bias[SHARPEN:MIX], NO_SHARPENING)
        self.error = None
        if self.config.mirrored:
            self.error = nn.Sequential(nn.Conv2d(widths[0], widths[0], 1), nn.ReLU(),
                                       nn.Conv2d(widths[0], 1, 1))
            nn.init.constant_(self.error[-1].bias, USUAL_ERROR)

    def forward(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        return self.behind(self.stem(torch.cat(inputs, 1)))

    def behind(self, x: Tensor) -> tuple[Tensor, ...]:
        """The heads from the stem's output: ``fine`` (N, 80, h, w), ``level1`` .. ``level4``,
        ``error``."""
        skips = []
        for level, stack in enumerate(self.down):
            x = stack(self.shrink[level - 1](x) if level else x)
            skips.append(x)
        levels = [self.level_head(self.heads[-1], x)]
        for level in reversed(range(LEVELS)):
            lifted = F.interpolate(self.lift[level](x), scale_factor=2.0, mode="nearest")
            x = self.up[level](skips[level] + lifted)
            if level:
                levels.insert(0, self.level_head(self.heads[level - 1], x))
        return self.all_heads(normalise(x), levels)

    def level_head(self, head: nn.Conv2d, stream: Tensor) -> Tensor:
        """A coarser level's kernel and mix."""
        return filters(bound(head(normalise(stream))))

    def all_heads(self, stream: Tensor, levels: list[Tensor]) -> tuple[Tensor, ...]:
        """The finest level's heads from its normalised stream, and those of the others."""
        fine = activate_fine(bound(self.fine(stream)))
        if self.error is None:
            return fine, *levels
        return fine, *levels, self.error(stream).float().clamp(LEAST_LOG_ERROR, MOST_LOG_ERROR)
