"""The networks that the sweep compares: model `m` and what differs from it in one way each."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

from training.networks.trunk import PHASES, REACHES


@dataclass(frozen=True)
class Variant:
    """How a network is built; the defaults are model `m`.

    widths: channels of the levels, of which the finest lies at 1/stride of the render size.
    depth: convolutions a level and direction. stride: of the stem, 1, 2 or 4.
    taps: side of the filter kernels of all pyramid levels, 3 or 5. hidden: channels of the recurrent state.
    wide: the finest level's two 3x3 kernels of wide steps. shade: shading at output size.
    blend: the last output, reprojected, is mixed in at output size; without it history remains at render size.
    """

    widths: tuple[int, ...] = (64, 128, 192, 256)
    depth: int = 2
    stride: int = 2
    taps: int = 5
    hidden: int = 8
    wide: bool = True
    shade: bool = True
    blend: bool = True
    guides: bool = False

    @property
    def shift(self) -> int:
        """Halvings between the render size and the network's finest level."""
        return {1: 0, 2: 1, 4: 2}[self.stride]

    @property
    def levels(self) -> int:
        """Levels of the filter pyramid below the render size."""
        return len(self.widths) - 1 + self.shift

    @property
    def kernel(self) -> int:
        """Taps of a filter kernel."""
        return self.taps**2

    def fine_channels(self) -> dict[str, int]:
        """What the head at render size predicts, in the order of `training.networks.trunk`: name -> channels."""
        return {"kernel": self.kernel, "phases": PHASES, "wide": 9 * len(REACHES) * self.wide, "blend": 4 * self.blend,
                "sharpen": 4, "shade": 4 * self.shade, "mix": 1, "distrust": 1, "importance": 1, "hidden": self.hidden}

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)

    @classmethod
    def from_dict(cls, config: dict[str, Any]) -> Variant:
        """From what a checkpoint holds."""
        return cls(**{**config, "widths": tuple(config["widths"])})


M = Variant()
VARIANTS = {
    "m": M,
    "xs": replace(M, widths=(16, 32, 48, 64), depth=1),
    "s": replace(M, widths=(32, 64, 96, 128), depth=1),
    "l": replace(M, widths=(96, 160, 224, 320)),
    "xl": replace(M, widths=(128, 192, 288, 384)),
    "depth1": replace(M, depth=1),
    "depth3": replace(M, depth=3),
    "stem1": replace(M, stride=1, widths=(16, *M.widths)),
    "stem4": replace(M, stride=4, widths=M.widths[1:]),
    "levels3": replace(M, widths=M.widths[:3]),
    "levels5": replace(M, widths=(*M.widths, 256)),
    "kernel3": replace(M, taps=3),
    "hidden0": replace(M, hidden=0),
    "hidden4": replace(M, hidden=4),
    "hidden16": replace(M, hidden=16),
    "no_wide": replace(M, wide=False),
    "no_shade": replace(M, shade=False),
    "no_blend": replace(M, blend=False),
}
"""Name -> network. `s`, `m` and `l` are built as the models of these names."""


def chosen(names: str | None) -> dict[str, Variant]:
    """The variants of a list with commas between, or all. Raises ValueError for a name that there is not."""
    wanted = names.split(",") if names else list(VARIANTS)
    unknown = [name for name in wanted if name not in VARIANTS]
    if unknown:
        raise ValueError(f"no variant '{unknown[0]}': there are {', '.join(VARIANTS)}")
    return {name: VARIANTS[name] for name in wanted}
