"""The frames of a benchmark: noisy ones, perhaps guides, and the references that results are held to."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from postfx.errors import BenchError, MissingFrameError
from postfx.frame import Frame, FrameSpec, Role
from postfx.io.sequence import Sequence

LEAST, MOST = 1.0, 3.0


@dataclass(frozen=True)
class Sources:
    """What the user named: patterns, a frame range and a renderer profile."""

    noisy: str
    reference: str
    guides: str | None = None
    frames: str | None = None
    profile: str | None = None


class Material:
    """Noisy frames and their references, checked before anything is measured.

    Attributes:
        noisy: the frames to process.
        spec: size, planes and guides of the first one.
        size: height and width of the references, which is the output's.
        scale: output size over render size, 1 to 3.

    Raises BenchError when sizes do not fit, MissingFrameError when a frame has no reference, and what reading raises.
    """

    def __init__(self, sources: Sources) -> None:
        self.sources = sources
        self.noisy = Sequence(sources.noisy, sources.frames, sources.profile, guides=sources.guides)
        self._references = Sequence(sources.reference)
        self._lone = len(self.noisy) == 1 and len(self._references) == 1
        self.spec = _one_spec(self.noisy, self.noisy.numbers)
        target = _one_spec(self._references, [self._reference_number(number) for number in self.noisy.numbers])
        self.size = (target.height, target.width)
        self.scale = _scale(self.spec, target, self._references)
        _check_guides(self.spec, target)

    def reference(self, number: int) -> Frame:
        """Reference of a frame: its colour and header."""
        return self._references.read(self._reference_number(number), [Role.COLOUR])

    def motion(self, number: int) -> Frame:
        """The noisy frame with colour and, if it has any, motion only."""
        roles = [role for role in (Role.COLOUR, Role.MOTION) if self.spec.has(role)]
        return self.noisy.read(number, roles)

    def result(self, pattern: str, number: int) -> Frame:
        """A method's result, from the file that it wrote."""
        return next(iter(Sequence(pattern.replace("{number}", f"{number:04d}"), planes=[Role.COLOUR])))

    def _reference_number(self, number: int) -> int:
        """Frame numbers must agree, unless there is one frame and one reference."""
        if self._lone:
            return self._references.numbers[0]
        if number not in self._references.present():
            path = self._references.pattern.path(number)
            raise MissingFrameError(
                f"{path}: frame {number} has no reference: render it, or choose frames that have one by --frames"
            )
        return number


def _one_spec(sequence: Sequence, numbers: list[int] | tuple[int, ...]) -> FrameSpec:
    """Spec of the first frame; BenchError when others differ in size."""
    first: FrameSpec | None = None
    for number in numbers:
        with sequence.open(number) as files:
            spec, path = files.spec(), files.path
        first = first or spec
        if (spec.width, spec.height) != (first.width, first.height):
            raise BenchError(
                f"{path}: is {spec.width}x{spec.height}, the first frame {first.width}x{first.height}: "
                f"measure frames of one size, chosen by --frames"
            )
    assert first is not None, "a sequence has frames"
    return first


def _scale(spec: FrameSpec, target: FrameSpec, references: Sequence) -> float:
    """A scale that leads from one size to the other, as the denoiser rounds sizes."""
    sides = ((target.width, spec.width), (target.height, spec.height))
    low = max(LEAST, *((out - 0.5) / side for out, side in sides))
    high = min(MOST, *((out + 0.5) / side for out, side in sides))
    for scale in (target.width / spec.width, target.height / spec.height, (low + high) / 2):
        fits = [round(side * scale) == out for out, side in sides]
        if LEAST <= scale <= MOST and all(fits):
            return scale
    raise BenchError(
        f"{references.pattern}: references are {target.width}x{target.height}, frames {spec.width}x{spec.height}: "
        f"references must be 1 to 3 times as large, by the same factor both ways"
    )


def _check_guides(spec: FrameSpec, target: FrameSpec) -> None:
    guides = spec.guides
    if guides and (guides.width, guides.height) != (target.width, target.height):
        raise BenchError(
            f"{guides.source}: guides are {guides.width}x{guides.height}, references {target.width}x{target.height}: "
            f"render both at one size, the output's"
        )


def output_pattern(folder: Path, method: str) -> str:
    """Where a method's results go; '{number}' stands for the frame number."""
    return str(folder / "frames" / method / "frame.{number}.exr")
