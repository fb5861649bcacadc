"""U-Net that looks at a frame's features and says how to filter it: the machine-learning part of the upscaler."""
from dataclasses import asdict, dataclass, fields

import torch
import torch.nn.functional as F
from torch import Tensor, nn

HIDDEN = 8
KERNEL = 25
PHASES = 36
# Channels of the fine head, in order: 5x5 kernel, 3x3 weights at four phases, history blend and sharpening at four
# phases each, mix, distrust, importance, hidden state.
BLEND = KERNEL + PHASES
SHARPEN = BLEND + 4
MIX, DISTRUST, IMPORTANCE = BLEND + 8, BLEND + 9, BLEND + 10
MEMORY = BLEND + 11
FINE = MEMORY + HIDDEN
FEATURES = 27 + HIDDEN
GUIDES = 4 * 11  # diffuse and specular albedo, normal, roughness, depth at each of the four phases
NO_SHARPENING = -3.0  # where the head's biases start
LEVELS = 4  # of the filter pyramid, below the render size


@dataclass(frozen=True)
class TrunkConfig:
    """Channels of the levels at 1/2, 1/4, 1/8 and 1/16 of the render size, convolutions a level, guides read or not;
    channels of the stem, the first level's if None, and its side: 4 pixels, or the 2 that each of its places holds.

    The network may have fewer levels than the filter pyramid: the coarser ones then have one filter each.
    """

    widths: tuple[int, ...] = (64, 128, 192, 256)
    depth: int = 2
    guides: bool = False
    stem: int | None = None
    reach: int = 4

    @property
    def first(self) -> int:
        """Channels of the stem."""
        return self.stem or self.widths[0]

    @property
    def align(self) -> int:
        """What height and width of the network's input are multiples of."""
        return 2 ** len(self.widths)

    @property
    def heads(self) -> tuple[int, ...]:
        """Channels of the heads of all levels of the pyramid: 5x5 kernel and, but for the coarsest, mix."""
        return (*[KERNEL + 1] * (LEVELS - 1), KERNEL)

    def as_dict(self) -> dict:
        return asdict(self)

    @classmethod
    def from_dict(cls, config: dict) -> "TrunkConfig":
        """From what a checkpoint holds; older ones do not name all."""
        known = {field.name: config[field.name] for field in fields(cls) if field.name in config}
        return cls(**{**known, "widths": tuple(config["widths"])})


def weights_from(logits: Tensor) -> Tensor:
    """Positive filter weights; bounded so that sums in half precision neither vanish nor overflow."""
    return torch.exp(logits.clamp(-8, 8))


def activated(fine: Tensor) -> Tensor:
    """The fine head (N, 80, h, w) from its logits."""
    return torch.cat((weights_from(fine[:, :BLEND]), torch.sigmoid(fine[:, BLEND:MEMORY]),
                      torch.tanh(fine[:, MEMORY:])), 1)


def filters(head: Tensor) -> Tensor:
    """A level's 5x5 kernel and mix, if it has one, from their logits."""
    return torch.cat((weights_from(head[:, :KERNEL]), torch.sigmoid(head[:, KERNEL:])), 1)


def logits_of(head: Tensor) -> Tensor:
    """The inverse of `filters`."""
    return torch.cat((head[:, :KERNEL].log(), head[:, KERNEL:].logit(1e-6)), 1)


class Block(nn.Sequential):
    """3x3 convolutions with ReLU, no normalisation: half-precision friendly and cheap everywhere."""

    def __init__(self, inputs: int, outputs: int, depth: int):
        layers: list[nn.Module] = []
        for i in range(depth):
            layers += [nn.Conv2d(inputs if i == 0 else outputs, outputs, 3, padding=1), nn.ReLU()]
        super().__init__(*layers)


def stem(config: TrunkConfig, inputs: int, bias: bool = True) -> nn.Conv2d:
    """What reads some planes of render size and writes half as many rows and columns."""
    return nn.Conv2d(inputs, config.first, config.reach, stride=2, padding=config.reach // 2 - 1, bias=bias)


class Trunk(nn.Module):
    """Features (N, 35, h, w) and guides (N, 44, h, w) or none, h and w multiples of ``config.align`` -> the heads, all
    activated.

    ``fine`` (N, 80, h, w); ``level1`` .. ``level3`` (N, 26, h/2 .. h/8, w/2 .. w/8): 5x5 kernel and mix;
    ``level4`` (N, 25, h/16, w/16): 5x5 kernel. Levels that the network does not have are (1, 26 or 25, 1, 1): the same
    at all pixels.
    """

    def __init__(self, config: TrunkConfig | None = None):
        super().__init__()
        self.config = config or TrunkConfig()
        w, d = self.config.widths, self.config.depth
        count, heads, self.align = len(w), self.config.heads, self.config.align
        self.stem = stem(self.config, FEATURES)
        self.guide_stem = stem(self.config, GUIDES, bias=False) if self.config.guides else None
        above = (self.config.first, *w)
        self.down = nn.ModuleList([Block(above[i], w[i], 1 if i == 0 else d) for i in range(count)])
        self.lift = nn.ModuleList([nn.Conv2d(w[i + 1], w[i], 1) for i in range(count - 1)])
        self.up = nn.ModuleList([Block(w[i], w[i], d) for i in range(min(count, LEVELS - 1))])
        self.heads = nn.ModuleList([nn.Conv2d(c, k, 1) for c, k in zip(w, heads[:count], strict=True)])
        self.alike = nn.ParameterList([nn.Parameter(torch.zeros(1, k, 1, 1)) for k in heads[count:]])
        self.rest = nn.Parameter(torch.zeros(1, w[-1], 1, 1)) if self.alike else None
        self.fine = nn.Conv2d(w[0], 4 * FINE, 1)
        for head in (*self.heads, self.fine):
            nn.init.normal_(head.weight, std=0.01)
            nn.init.zeros_(head.bias)
        nn.init.constant_(self.fine.bias[4 * SHARPEN:4 * MIX], NO_SHARPENING)

    def forward(self, features: Tensor, guides: Tensor | None = None) -> tuple[Tensor, ...]:
        return self.behind(self.stem(features), guides)

    def behind(self, x: Tensor, guides: Tensor | None) -> tuple[Tensor, ...]:
        """The heads from what the stem makes of the features."""
        x = F.relu(x if self.guide_stem is None else x + self.guide_stem(guides))
        skips = []
        for i, block in enumerate(self.down):
            x = block(F.max_pool2d(x, 2) if i else x)
            skips.append(x)
        levels = [filters(logits) for logits in self.alike]
        for i in reversed(range(len(skips))):
            x = self._up(i, skips[i], x)
            levels.insert(0, filters(self.heads[i](x)))
        return (self._fine(x), *levels)

    def _up(self, level: int, skip: Tensor, coarser: Tensor) -> Tensor:
        """What a level makes of its own and of what comes from the coarser one; of the coarsest that is a constant,
        where the pyramid goes on, or nothing."""
        if level + 1 < len(self.down):
            return self.up[level](skip + F.interpolate(self.lift[level](coarser), scale_factor=2.0, mode="nearest"))
        return skip if self.rest is None else self.up[level](skip + self.rest)

    def _fine(self, x: Tensor) -> Tensor:
        return activated(F.pixel_shuffle(self.fine(x), 2))
