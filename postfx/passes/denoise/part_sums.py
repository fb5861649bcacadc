"""Sums of parts: light of one group adds up to the picture, or to some of it, and still does after
the filters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from postfx.frame import Part, Role
from postfx.passes import ResidentFrame
from postfx.passes.denoise.geometry import Size
from postfx.passes.denoise.graph import BALANCED, run_steps
from postfx.passes.denoise.history import some_of
from postfx.passes.denoise.kinds import KINDS, LIGHT_KIND, Kind
from postfx.passes.signed_light import SignedLight
from postfx.runtime import CommandBuffer, Device, Tensor
from postfx.sampling import three_by_three

PART_SUM_TOLERANCE = 2e-3
"""Parts are all of the picture if their sum differs by less than this share of its light."""
BRIGHTER_THAN_PICTURE = 1.5
"""How many times that share they must be brighter than the picture, in places, to be no parts of
it: half floats are rounded."""
SAMPLED_ROW_STEP = 8
"""One row in so many is looked at for that."""
# Shares of lit pixels around lit ones from which a part counts as a surface's and not as sparse
# light: it begins to at the first, and does fully at the second.
DENSE = 0.6
DENSER = 0.8


@dataclass
class Group:
    """Parts that add up to the picture or to some of it.

    Attributes:
        first: place of the first one in a stack of layers; the others follow.
        names: of the parts.
    """

    first: int
    names: list[str] = field(default_factory=list)


def groups_of(parts: Sequence[Part]) -> list[Group]:
    """The groups of parts that are light, in the order of the stack."""
    groups: dict[str, Group] = {}
    for i, part in enumerate(part for part in parts if part.is_light):
        groups.setdefault(part.group, Group(i + 1)).names.append(part.name)
    return list(groups.values())


class PartSums:
    """Brings the light of groups of parts to the picture's, for frames of one size.

    Args:
        groups: the groups.
        parts: all parts by name.
        render: size of the frames.
        signed: for parts with negative light.
    """

    def __init__(self, device: Device, groups: Sequence[Group], parts: Mapping[str, Part],
                 render: Size, signed: SignedLight) -> None:
        self._device, self._groups, self._parts = device, groups, parts
        self._render, self._signed = render, signed
        new = device.heap.tensor
        self._complete = {group.first: new("complete", (1,)) for group in groups}
        self._everywhere = {group.first: new("everywhere", (len(group.names), 1, 1))
                            for group in groups}
        for tensor in self._everywhere.values():
            tensor.fill(1)
        self._reached = dict(self._everywhere)
        self._reaches: dict[str, Tensor] = {}

    def look(self, frame: ResidentFrame) -> bool:
        """Look at a frame's parts: at which groups are all of its picture, and where each part has
        light. Returns whether all groups are all of the picture."""
        are_complete = True
        for group in self._groups:
            complete = completeness(frame, group.names)
            self._complete[group.first].upload([complete])
            are_complete &= complete > 0
            self._reached[group.first] = self._reach(frame, group)
        return are_complete

    def look_at_sums(self, frame: ResidentFrame) -> None:
        """Look only at which groups are all of the picture: for parts that are not filtered."""
        for group in self._groups:
            self._complete[group.first].upload([completeness(frame, group.names)])
        self._reached = dict(self._everywhere)

    def balance(self, commands: CommandBuffer, group: Group, stack: Tensor,
                pictures: tuple[Tensor, Tensor], balanced: Tensor,
                negatives: Sequence[Tensor]) -> None:
        """Record the work that brings a group's parts to a picture.

        Args:
            stack: holds the parts.
            pictures: what the parts add up to now, and what they are to add up to.
            balanced: the stack that the result goes to.
            negatives: the negative layers of the parts.
        """
        count = len(group.names)
        whole, picture = (
            self._signed.sum_of_positive(commands, f"{what} above 0 of {group.first}", light,
                                         negatives)
            for what, light in zip(("whole", "picture"), pictures, strict=True))
        run_steps(commands, BALANCED, {
            "parts": some_of(stack, group.first, count), "whole": whole,
            "picture": picture, "reached": self._reached[group.first],
            "complete": self._complete[group.first],
            "balanced": some_of(balanced, group.first, count)})

    def _reach(self, frame: ResidentFrame, group: Group) -> Tensor:
        """Where the parts of a group have light in a frame, (n, h, w), or (n, 1, 1) for everywhere.
        Lamps, reflections, and what files divide by a colour show it themselves."""
        planes = [self._parts[name].factor or (name if self._kind(name).is_seen else "")
                  for name in group.names]
        if not any(planes):
            return self._everywhere[group.first]
        name = f"reached by {group.first}"
        if name not in self._reaches:
            self._reaches[name] = self._device.heap.tensor(name,
                                                           (len(group.names), *self._render))
        reached = np.ones((len(group.names), *self._render), np.float32)
        for i, plane in enumerate(planes):
            if plane in frame.host_parts:
                reached[i] = coverage(frame.host_parts[plane].max(axis=2) > 0,
                                      self._kind(plane).is_sparse)
        self._reaches[name].upload(reached)
        return self._reaches[name]

    def _kind(self, name: str) -> Kind:
        return KINDS[self._parts[name].kind] if name in self._parts else LIGHT_KIND


def completeness(frame: ResidentFrame, names: Sequence[str]) -> float:
    """1 where parts add up to the picture, 0 where they are some of it, and -1 where they are
    brighter than it, so that it does not hold them; by every eighth row."""
    colour = frame.host_planes.get(Role.COLOUR)
    if colour is None:
        return 0.0
    seen = colour[::SAMPLED_ROW_STEP]
    total = sum((frame.host_parts[name][::SAMPLED_ROW_STEP] for name in names), np.zeros_like(seen))
    with np.errstate(invalid="ignore", over="ignore"):
        apart, light = total - seen, np.abs(seen)
    valid = np.isfinite(apart)
    apart, least = apart[valid], PART_SUM_TOLERANCE * light[valid].sum(dtype=np.float64)
    if np.abs(apart).sum(dtype=np.float64) <= least:
        return 1.0
    is_brighter = np.maximum(apart, 0).sum(dtype=np.float64) > BRIGHTER_THAN_PICTURE * least
    return -1.0 if is_brighter else 0.0


def coverage(lit: np.ndarray, may_be_sparse: bool) -> np.ndarray:
    """How far render pixels (h, w) have light of a part: 1 where there is some, else the share of
    3x3 pixels.

    Light that `may_be_sparse` misses pixels by chance, so all pixels have it unless lit ones lie
    together.
    """
    seen = lit.astype(np.float32)
    share = three_by_three(seen, 1, np.add) / np.float32(9)
    unlit = (1 - seen) * (1 - share)
    if may_be_sparse:
        around, together = (three_by_three(plane, 3, np.add) for plane in (
            share, three_by_three(seen * share, 1, np.add) / np.float32(9)))
        dense = np.clip((together / np.maximum(around, 1e-6) - DENSE) / (DENSER - DENSE), 0, 1)
        unlit *= np.where(around > 1e-6, three_by_three(dense, 3, np.maximum), 1)
    return 1 - unlit
