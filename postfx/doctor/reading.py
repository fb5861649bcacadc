"""Reading what the doctor looks at: a few frames whose values are neither clamped nor mended."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from postfx.doctor.material import Material
from postfx.doctor.statistics import count_values
from postfx.errors import PostfxError
from postfx.frame import Frame, Role
from postfx.io.frame_reader import FrameFiles, GuideLayout
from postfx.io.layout import Layout, Match
from postfx.io.sequence import Sequence

MOST_FRAMES, MOST_PIXELS = 8, 8_000_000


@dataclass(frozen=True)
class Reading:
    """The material, and how the first frame's files were understood."""

    material: Material
    layout: Layout
    guides: GuideLayout | None


def read_material(sequence: Sequence) -> Reading:
    """The first frames without a hole: up to 8, of large pictures fewer (8 million pixels, at least two frames).

    Raises what reading the first frame raises; a later frame that cannot be read ends the reading.
    """
    first = sequence.numbers[0]
    with sequence.open(first) as files:
        stored = {role: count_values(plane) for role, plane in _read_stored(files, first).planes.items()}
        frames = [_read_unclamped(files, first)]
        layout, guides = files.layout, files.guides
    material = Material(frames, stored, {role: hint for role in Role if (hint := _hint(layout, role))})
    spec = frames[0].spec
    most = max(2, min(MOST_FRAMES, MOST_PIXELS // (spec.width * spec.height)))
    for before, number in zip(sequence.numbers, sequence.numbers[1:most], strict=False):
        if number not in sequence.present() or sequence.before(number, 1) != [before]:
            break
        try:
            with sequence.open(number) as files:
                frames.append(_read_unclamped(files, number))
        except PostfxError as error:
            material.unreadable = str(error)
            break
    return Reading(material, layout, guides)


def _read_unclamped(files: FrameFiles, number: int) -> Frame:
    _change_rules(files, clamp=None)
    return files.read(number)


def _read_stored(files: FrameFiles, number: int) -> Frame:
    """The numbers as they are in the file, under the role that they have."""
    kept = dict(files.layout.planes)
    guides, files.guides = files.guides, None
    _change_rules(files, clamp=None, role=Role.COLOUR, scale=(1.0,), offset=(0.0,))
    frame = files.read(number)
    files.layout.planes, files.guides = kept, guides
    return frame


def _change_rules(files: FrameFiles, **changes: Any) -> None:
    layouts: list[Layout | GuideLayout] = [files.layout, *([files.guides] if files.guides else [])]
    for layout in layouts:
        layout.planes = {role: _changed(match, changes) for role, match in layout.planes.items()}


def _changed(match: Match, changes: dict[str, Any]) -> Match:
    return match._replace(rule=replace(match.rule, **changes))


def _hint(layout: Layout, role: Role) -> str:
    return next((rule.enable for rule in layout.profile.rules(role) if rule.enable), "")
