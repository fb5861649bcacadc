"""The networks that the sweep compares: several sizes, and what differs from one of them in one way each."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

from training.networks.trunk import PHASES


@dataclass(frozen=True)
class Variant:
    """How a network is built.

    widths: channels of the levels, of which the finest lies at 1/stride of the render size.
    depth: convolutions a level and direction. stride: of the stem, 1, 2 or 4.
    taps: side of the filter kernels of all pyramid levels, 3 or 5. hidden: channels of the recurrent state.
    blend: the last output, reprojected, is mixed in at output size; without it history remains at render size.
    """

    widths: tuple[int, ...] = (64, 128, 192, 256)
    depth: int = 2
    stride: int = 2
    taps: int = 5
    hidden: int = 8
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
        return {"kernel": self.kernel, "phases": PHASES, "blend": 4 * self.blend, "sharpen": 4, "mix": 1, "distrust": 1,
                "importance": 1, "hidden": self.hidden}

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)

    @classmethod
    def from_dict(cls, config: dict[str, Any]) -> Variant:
        """From what a checkpoint holds."""
        return cls(**{**config, "widths": tuple(config["widths"])})


BASE = Variant()
VARIANTS = {
    "w16": replace(BASE, widths=(16, 32, 48, 64), depth=1),
    "w32": replace(BASE, widths=(32, 64, 96, 128), depth=1),
    "w64": BASE,
    "w96": replace(BASE, widths=(96, 160, 224, 320)),
    "w128": replace(BASE, widths=(128, 192, 288, 384)),
    "depth1": replace(BASE, depth=1),
    "depth3": replace(BASE, depth=3),
    "stem1": replace(BASE, stride=1, widths=(16, *BASE.widths)),
    "stem4": replace(BASE, stride=4, widths=BASE.widths[1:]),
    "levels3": replace(BASE, widths=BASE.widths[:3]),
    "levels5": replace(BASE, widths=(*BASE.widths, 256)),
    "kernel3": replace(BASE, taps=3),
    "hidden0": replace(BASE, hidden=0),
    "hidden4": replace(BASE, hidden=4),
    "hidden16": replace(BASE, hidden=16),
    "no_blend": replace(BASE, blend=False),
}
"""Name -> network. `w96` and `w128` are built as the models `m` and `l`, `w32` as `s` but for its stem; others differ
from `w64`."""


def chosen(names: str | None) -> dict[str, Variant]:
    """The variants of a list with commas between, or all. Raises ValueError for a name that there is not."""
    wanted = names.split(",") if names else list(VARIANTS)
    unknown = [name for name in wanted if name not in VARIANTS]
    if unknown:
        raise ValueError(f"no variant '{unknown[0]}': there are {', '.join(VARIANTS)}")
    return {name: VARIANTS[name] for name in wanted}
