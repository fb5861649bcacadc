"""What the validation set holds: which scene a clip shows and which noisy renders of it there are."""

from __future__ import annotations

from dataclasses import dataclass

SCENES = (
    ("interior", "moving"), ("product", "metal"), ("outdoor", "bending"), ("interior", "cut"),
    ("product", "glass"), ("room", "flicker"), ("outdoor", "moving"), ("interior", None),
)
"""Family and trait (see held_out) of the clips, in turn; 'cut' goes on from another view halfway."""
STYLES = ("realtime", "box")
"""In turn: all samples of a frame at one jittered position, or spread over the pixel."""
GUIDE_SPP = 4
"""Samples a pixel of guides where samples are spread; else they are the planes of the full-size frame."""


@dataclass(frozen=True)
class Render:
    """A noisy render of all frames, `scale` times smaller than the output, with `spp` samples a pixel."""

    name: str
    scale: float
    spp: int

    def size(self, output: tuple[int, int]) -> tuple[int, int]:
        """Width and height for an output's."""
        return round(output[0] / self.scale), round(output[1] / self.scale)


FULL, HALF = Render("x1", 1.0, 1), Render("x2", 2.0, 4)
"""Two ways to spend as many light paths."""


def renders(index: int) -> tuple[Render, ...]:
    """Of a clip; the samples of the scales between change every other clip, so that both styles meet all counts."""
    turn = index // len(STYLES) % 4
    return FULL, Render("x1.5", 1.5, (2, 4, 1, 8)[turn]), HALF, Render("x3", 3.0, (4, 2, 8, 1)[turn])
