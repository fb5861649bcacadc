"""How much of some frames is left as it is, and what leaves it so."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass
class Shares:
    """Sums over frames of shares of their pixels, 0..1.

    Attributes:
        frames: how many were added.
        alone: pixels of strength 0.
        covered: entry -> what it covers, pixels that it covers in part counted as such.
        missed: misses; None where nobody looked for them.
        basis: entry -> what tells that it is so, in words, where that is a plane.
    """

    frames: int = 0
    alone: float = 0.0
    covered: dict[str, float] = field(default_factory=dict)
    missed: float | None = None
    basis: dict[str, str] = field(default_factory=dict)

    def add(self, other: Shares) -> None:
        """Add those of other frames."""
        self.frames += other.frames
        self.alone += other.alone
        self.basis |= other.basis
        for name, share in other.covered.items():
            self.covered[name] = self.covered.get(name, 0.0) + share
        if other.missed is not None:
            self.missed = (self.missed or 0.0) + other.missed

    def as_dict(self) -> dict[str, Any]:
        """Means over the frames, of which there is one at least, in plain types."""
        covered = {name: round(share / self.frames, 4) for name, share in self.covered.items()}
        missed = {} if self.missed is None else {"misses": round(self.missed / self.frames, 4)}
        basis = {"basis": self.basis} if self.basis else {}
        share = round(self.alone / self.frames, 4)
        return {"frames": self.frames, "share": share, "covered": covered, **missed, **basis}

    def __str__(self) -> str:
        means = self.as_dict()
        parts = [f"{name} covers {_percent(share)}{self._by(name)}" for name, share in means["covered"].items()]
        if "misses" in means:
            parts.append(f"{_percent(means['misses'])} are misses, of which edges and noisy ones are denoised")
        return f"{_percent(means['share'])} of the pixels are not denoised at all: {', '.join(parts)}"

    def _by(self, name: str) -> str:
        return f" by {self.basis[name]}" if name in self.basis else ""


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"
