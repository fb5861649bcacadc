"""Input of the checks: a few frames that are read without repair, results that checks share, and
the reason why each plane has its role.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from postfx.doctor import Range, Values, count_values, join_ranges, range_of, sum_values
from postfx.doctor.geometry import Fit, explain_by_camera, fit_rotation
from postfx.doctor.motion_convention import ReadMotion, UnreadMotion
from postfx.doctor.motion_variants import PairScores, warp_pair
from postfx.errors import PostfxError
from postfx.frame import Frame, Role
from postfx.io.channels import Channel, read_channels
from postfx.io.frame_reader import FrameFiles
from postfx.io.layout import GuideLayout, Layout, Match
from postfx.io.profile import PlaneRule
from postfx.io.sequence import Sequence

MOST_SCORED_PAIRS = 7
"""Pairs of frames whose motion is scored, which takes long."""


@dataclass
class Material:
    """Consecutive frames, converted to postfx's conventions but not clamped.

    Attributes:
        frames: at least one.
        stored: role -> counts of odd values as files store them; for a role that is absent,
            `frames` are counted.
        enable: role -> where the user switches a missing plane on in the renderer.
        unreadable: why reading stopped early, '' when it did not.
        ranges: role -> range of values in the frames `measured`.
        measured: numbers of the frames that were measured: `frames` and some of the rest of the
            sequence.
        unread: layers that may be motion; empty if a profile reads motion.
        read_motion: how the file's motion is read, if it is.
        whole: width and height of the pictures that the frames are windows of, if they are.
        other_layers: what the first frame's files hold beside the planes: 'AO.R,G,B'.
        known_parts: layers among them that are light groups or passes by the profile.
        pictures: layers that may be the colour and the ends of their channels' names, R, G, B and
            perhaps A; empty if a colour is read.
        profile: what another profile calls the first frame's to extend it.
    """

    frames: list[Frame]
    stored: dict[Role, Values] = field(default_factory=dict)
    enable: dict[Role, str] = field(default_factory=dict)
    unreadable: str = ""
    ranges: dict[Role, Range] = field(default_factory=dict)
    measured: list[int] = field(default_factory=list)
    unread: list[UnreadMotion] = field(default_factory=list)
    read_motion: ReadMotion | None = None
    other_layers: list[str] = field(default_factory=list)
    known_parts: list[str] = field(default_factory=list)
    pictures: dict[str, tuple[str, ...]] = field(default_factory=dict)
    profile: str = ""
    whole: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        self.stored = {role: sum_values(count_values(frame[role])
                                        for frame in self.frames if role in frame)
                       for role in self.frames[0].planes} | self.stored

    def without(self, roles: Collection[str]) -> Material:
        """The material without the planes of some roles, by name; itself if it has none of them, or
        nothing else."""
        held = set(map(str, self.first.planes))
        if not held & set(roles) or held <= set(roles):
            return self
        frames = [replace(frame, planes={role: plane for role, plane in frame.planes.items()
                                         if role not in roles})
                  for frame in self.frames]
        return replace(self, frames=frames)

    @property
    def first(self) -> Frame:
        """The first frame."""
        return self.frames[0]

    @property
    def middle(self) -> Frame:
        """The frame that checks of a single picture use; the first is often special."""
        return self.frames[len(self.frames) // 2]

    @cached_property
    def pairs(self) -> list[tuple[Frame, Frame]]:
        """Pairs of consecutive frames of one size, pairs across a cut included."""
        both = zip(self.frames, self.frames[1:], strict=False)
        return [(a, b)
                for a, b in both if a.spec.width == b.spec.width and a.spec.height == b.spec.height]

    @cached_property
    def pair_scores(self) -> list[PairScores]:
        """Scores of the motion's variants for each pair that has motion and contrast."""
        return [warped for pair in self.pairs[:MOST_SCORED_PAIRS]
                if (warped := warp_pair(*pair, self.whole))]

    @cached_property
    def shots(self) -> list[PairScores]:
        """`pair_scores` without pairs across a marked cut and pairs that have nothing in common."""
        return [warped for warped in self.pair_scores if not warped.now.reset and warped.is_related]

    @cached_property
    def fit(self) -> Fit | None:
        """Rotation between the normals of depth and the stored ones, of `middle`."""
        if Role.DEPTH not in self.middle or Role.NORMAL not in self.middle:
            return None
        return fit_rotation(self.middle)

    @cached_property
    def picture_to_world(self) -> np.ndarray | None:
        """Matrix from the picture's axes to the world's by the middle frame's header; None if it
        does not fit."""
        return explain_by_camera(self.middle, self.fit) if self.fit else None


MOST_HELD_FRAMES = 8
MOST_HELD_PIXELS = 8_000_000
MOST_SPREAD_FRAMES = 8
"""Frames of the rest of the sequence that only ranges are taken from."""


@dataclass(frozen=True)
class Reading:
    """The material, and how the first frame's files were understood."""

    material: Material
    layout: Layout
    guides: GuideLayout | None


def read_material(sequence: Sequence) -> Reading:
    """Read the first consecutive frames: up to 8, fewer if they are large (8 million pixels, but at
    least two frames).

    Ranges and odd values also count up to 8 more frames, spread evenly over the rest of the
    sequence. Raises the errors of reading the first frame; a later frame that cannot be read ends
    the reading, and the material says why.
    """
    first = sequence.numbers[0]
    with sequence.open(first) as files:
        stored = [_count_stored(files, first)]
        frames = [_read_unclamped(files, first)]
        layout, guides = files.layout, files.guides
        others, known = files.unread(), files.known_parts()
        pictures = {layer: _ends(channels)
                    for layer, channels in files.possible_pictures().items()}
        unread = {layer: [pixels] for layer, pixels in _read_pairs(files).items()}
        names = {layer: _letters(channels) for layer, channels in files.unread_motion().items()}
    material = Material(frames, {}, layout.hints(), other_layers=others, known_parts=known,
                        pictures=pictures, profile=layout.profile.reference)
    most = max(2, min(MOST_HELD_FRAMES,
                      MOST_HELD_PIXELS // (frames[0].spec.width * frames[0].spec.height)))
    ranges = [_ranges(frames[0])]
    numbers = _consecutive(sequence, most)
    rest = [number for number in sequence.numbers
            if number not in numbers and number in sequence.present()]
    spread = rest[:: -(-len(rest) // MOST_SPREAD_FRAMES)][1:] + rest[-1:] if rest else []
    for number in dict.fromkeys([*numbers[1:], *spread]):
        try:
            with sequence.open(number) as files:
                stored.append(_count_stored(files, number))
                frame = _read_unclamped(files, number)
                more = _read_pairs(files) if number in numbers else {}
        except PostfxError as error:
            material.unreadable = str(error)
            break
        ranges.append(_ranges(frame))
        material.measured.append(number)
        if number in numbers:
            frames.append(frame)
            for layer, pixels in more.items():
                unread.setdefault(layer, []).append(pixels)
    material.unread = [UnreadMotion(layer, names[layer], tuple(planes), layout.profile.reference)
                       for layer, planes in unread.items() if layer in names]
    if motion := layout.planes.get(Role.MOTION):
        material.read_motion = ReadMotion(layout.profile.reference,
                                          motion.channels[0].name.rpartition(".")[0],
                                          _letters(motion.channels), motion.rule)
    material.measured.insert(0, first)
    material.stored = _merge(stored, sum_values)
    material.ranges = _merge(ranges, join_ranges)
    return Reading(material, layout, guides)


def _read_pairs(files: FrameFiles) -> dict[str, np.ndarray]:
    """Stored values (height, width, 2) of layers that may be motion."""
    found = files.unread_motion()
    wanted = {channel: 0.0 for channels in found.values() for channel in channels}
    pixels = read_channels(files.files, wanted)
    return {layer: np.stack([pixels[channel] for channel in channels], axis=-1)
            for layer, channels in found.items()}


def _letters(channels: Iterable[Channel]) -> tuple[str, str]:
    x, y = _ends(channels)
    return x, y


def _ends(channels: Iterable[Channel]) -> tuple[str, ...]:
    return tuple(channel.name.rpartition(".")[2] for channel in channels)


def _consecutive(sequence: Sequence, most: int) -> list[int]:
    """Numbers of the first frames, at most `most`, up to the first gap."""
    numbers = list(sequence.numbers[:1])
    for before, number in zip(sequence.numbers, sequence.numbers[1:most], strict=False):
        if number not in sequence.present() or sequence.before(number, 1) != [before]:
            break
        numbers.append(number)
    return numbers


def _ranges(frame: Frame) -> dict[Role, Range]:
    return {role: range_of(plane, role is Role.DEPTH) for role, plane in frame.planes.items()}


Found = TypeVar("Found")


def _merge(found: list[dict[Role, Found]],
           join: Callable[[Iterable[Found]], Found]) -> dict[Role, Found]:
    """For each role of the first frame, what all frames that hold it have together."""
    return {role: join(item[role] for item in found if role in item) for role in found[0]}


def _count_stored(files: FrameFiles, number: int) -> dict[Role, Values]:
    return {role: count_values(plane) for role, plane in _read_stored(files, number).planes.items()}


def _read_unclamped(files: FrameFiles, number: int) -> Frame:
    _change_rules(files, clamp=None)
    return files.read(number)


def _read_stored(files: FrameFiles, number: int) -> Frame:
    """The numbers as they are in the file, under the role that they have."""
    kept = files.layout.planes
    guides, files.guides = files.guides, None
    _change_rules(files, clamp=None, role=Role.COLOUR, scale=(1.0,), offset=(0.0,))
    frame = files.read(number)
    files.layout.planes, files.guides = kept, guides
    return frame


def _change_rules(files: FrameFiles, **changes: Any) -> None:
    layouts: list[Layout | GuideLayout] = [files.layout, *([files.guides] if files.guides else [])]
    for layout in layouts:
        layout.planes = {role: _change(match, changes) for role, match in layout.planes.items()}


def _change(match: Match, changes: dict[str, Any]) -> Match:
    return match._replace(rule=replace(match.rule, **changes))


MOST_NAMED_FRAMES = 3


def explain_roles(reading: Reading) -> dict[str, dict[str, Any]]:
    """Role -> names of the file's channels ('planes', empty when there are none) and the reason
    ('why')."""
    return {str(role): _explain(reading, role) for role in Role}


def _explain(reading: Reading, role: Role) -> dict[str, Any]:
    layout, guides = reading.layout, reading.guides
    match = layout.planes.get(role)
    guide = guides.planes.get(role) if guides else None
    used = match or guide
    if used is None:
        return {"planes": [], "why": _why_not(layout, role)}
    found = {"planes": _names(used), "why": _why(layout, used, _prefix(match, role))}
    return {**found, "guides": _names(guide)} if match and guide else found


def _prefix(match: Match | None, role: Role) -> str:
    if match is None:
        return "guide: "
    return ("colour before transparents, as there is an overlay to composite; "
            if match.rule.role is not role else "")


def _names(match: Match) -> list[str]:
    return [channel.name for channel in match.channels]


def _why(layout: Layout, match: Match, prefix: str) -> str:
    """Why a plane was read from its channels, and what its values went through, in words."""
    rule, role = match.rule, match.rule.role
    known = [name for other in layout.profile.rules(role) for name in other.names]
    preferred = (f"profile {layout.profile.name} knows {_list(known, layout.layer)} for {role}, "
                 "best first")
    steps = [f"(stored + {list(rule.offset)}) x {list(rule.scale)}"] if any(rule.offset) else []
    steps += ([f"times {list(rule.scale)}"] if not any(rule.offset) and set(rule.scale) != {1}
              else [])
    steps += [f"unit {rule.unit}"] if role is Role.MOTION else []
    steps += ["while the shutter is open"] if rule.per == "shutter" else []
    steps += [f"{rule.space} space"] if role is Role.NORMAL else []
    steps += _depth_steps(rule) if role is Role.DEPTH else []
    return prefix + preferred + (f"; read as: {', '.join(steps)}" if steps else "")


def _depth_steps(rule: PlaneRule) -> list[str]:
    known = {"planar": "along the view axis", "ray": "ray distance", "device": "a depth buffer"}
    near = ["1 at the near plane"] if rule.reversed else []
    miss = [] if rule.miss is None else [f"{rule.miss:g} where nothing was hit"]
    return [known.get(rule.kind, rule.kind), *near, *miss]


def _why_not(layout: Layout, role: Role) -> str:
    rules = layout.profile.rules(role)
    colour = layout.planes.get(Role.COLOUR)
    if colour and colour.rule.role is role:
        return "it is the frame's colour, as there is an overlay to composite"
    if not rules:
        return f"profile {layout.profile.name} has no name for it"
    names = [",".join(names) for rule in rules for names in rule.candidates(layout.layer)]
    return f"none of {_list(names, layout.layer)} is there (profile {layout.profile.name})"


def _list(names: list[str], layer: str) -> str:
    shown = [f"'{name.replace('{layer}', layer)}'" for name in dict.fromkeys(names)]
    return ", ".join(shown[:MOST_NAMED_FRAMES]) + (f" and {len(shown) - MOST_NAMED_FRAMES} more"
                                                   if len(shown) > MOST_NAMED_FRAMES else "")
