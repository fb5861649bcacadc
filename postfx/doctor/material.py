"""What the checks look at: a few consecutive frames, and what is computed from them once for all checks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

from postfx.doctor.geometry import Fit, fit_rotation
from postfx.doctor.motion_variants import Warped, warp_pair
from postfx.doctor.statistics import Values, count_values
from postfx.frame import Frame, Role

MOST_PAIRS = 7


@dataclass
class Material:
    """Frames in order, without a hole between them, converted to the one convention but not clamped.

    Attributes:
        frames: at least one.
        stored: role -> counts of odd values in the first frame as it is stored; what is absent is counted in `frames`.
        enable: role -> where the renderer switches a missing plane on.
        unreadable: why reading stopped early, '' when it did not.
    """

    frames: Sequence[Frame]
    stored: dict[Role, Values] = field(default_factory=dict)
    enable: dict[Role, str] = field(default_factory=dict)
    unreadable: str = ""

    def __post_init__(self) -> None:
        first = self.frames[0]
        self.stored = {role: count_values(first[role]) for role in first.planes} | self.stored

    @property
    def first(self) -> Frame:
        """The first frame."""
        return self.frames[0]

    @property
    def middle(self) -> Frame:
        """A frame that single pictures are judged by: not the first, which renderers often treat apart."""
        return self.frames[len(self.frames) // 2]

    @cached_property
    def pairs(self) -> list[tuple[Frame, Frame]]:
        """Neighbours of one size, cuts included."""
        both = zip(self.frames, self.frames[1:], strict=False)
        return [(a, b) for a, b in both if a.spec.width == b.spec.width and a.spec.height == b.spec.height]

    @cached_property
    def warped(self) -> list[Warped]:
        """Scores of the motion's variants for each pair that has motion and contrast."""
        return [warped for pair in self.pairs[:MOST_PAIRS] if (warped := warp_pair(*pair))]

    @cached_property
    def shots(self) -> list[Warped]:
        """The same without marked cuts and without pairs that have nothing in common."""
        return [warped for warped in self.warped if not warped.now.reset and warped.is_related]

    @cached_property
    def fit(self) -> Fit | None:
        """Rotation between the normals of depth and the stored ones, of `middle`."""
        if Role.DEPTH not in self.middle or Role.NORMAL not in self.middle:
            return None
        return fit_rotation(self.middle)
