"""Whether later frames hold what the first one does, whose plan all frames follow."""

from __future__ import annotations

from collections.abc import Iterable

from postfx.errors import PostfxError
from postfx.frame import FrameSpec, Role
from postfx.io.sequence import Sequence
from postfx.pipeline import Pipeline
from postfx.plan import Plan


def later_frames(sequence: Sequence, first: int) -> list[int]:
    """The second, the middle and the last frame."""
    others = [number for number in sequence.numbers if number > first and sequence.holds(number)]
    if not others:
        return []
    return list(dict.fromkeys([others[0], others[len(others) // 2], others[-1]]))


class FirstFrame:
    """The frame that a run's plan was made for, to compare others with.

    Args:
        number: of the frame.
        planes: that its files hold; its plan may have more, such as motion that is estimated.
        any_size: whether later frames may have any size.
    """

    def __init__(self, number: int, plan: Plan, planes: Iterable[Role], any_size: bool) -> None:
        self._number = number
        self._plan = plan
        self._held = {*planes}
        self._any_size = any_size

    def compare(self, sequence: Sequence, pipeline: Pipeline, numbers: list[int]) -> list[str]:
        """A warning where one of these frames has another size, or lacks planes that the first one
        has; or else where one has planes that the first one lacks."""
        spare = ""
        for number in numbers:
            try:
                with sequence.reader().open(number) as files:
                    spec = files.spec()
                    has_motion = Role.MOTION in files.layout.planes
                if other := self._other_size(number, spec):
                    return [other]
                planes = {*pipeline.explain(spec).planes}
            except PostfxError:  # which is told where the frame's turn comes
                continue
            if lack := self._lack(number, planes):
                return [lack]
            spare = spare or self._spare(number, planes, has_motion)
        return [spare] if spare else []

    def _other_size(self, number: int, spec: FrameSpec) -> str:
        """A warning where a frame has not the first one's size; '' where it has, or any may."""
        first = self._plan.input
        if self._any_size or (spec.width, spec.height) == (first.width, first.height):
            return ""
        return (f"frame {number} is {spec.width}x{spec.height}, frame {self._number} "
                f"{first.width}x{first.height}: the run ends there; render it at one size, or give "
                "the output's with --size")

    def _lack(self, number: int, planes: set[Role]) -> str:
        """A warning where a frame lacks planes of the first one; '' where it lacks none."""
        fewer = {role for role in self._plan.planes if role in self._held} - planes
        fewer.discard(Role.MOTION)
        if not fewer:
            return ""
        names = ", ".join(sorted(map(str, fewer)))
        return (f"frame {number} has no {names}, but frame {self._number} has: frame {number} "
                "cannot be denoised; render it again, or choose other frames (--frames)")

    def _spare(self, number: int, planes: set[Role], has_motion: bool) -> str:
        """A warning where a frame has planes that the first one lacks; '' where it has none."""
        # a plan may hold motion that is estimated, so files tell of that
        more = planes - {*self._plan.planes, Role.MOTION}
        if has_motion and Role.MOTION not in self._held:
            more.add(Role.MOTION)
        if not more:
            return ""
        names = ", ".join(sorted(map(str, more)))
        return (f"frame {self._number} has no {names}, but frame {number} has: no frame uses what "
                "is not in all; render it for every frame, or choose frames that have it "
                "(--frames)")
