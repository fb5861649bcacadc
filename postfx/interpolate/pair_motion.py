"""How things move between two frames: by their vectors where these fit the pictures, and as it is
estimated from the pictures.

Motion is kept for cells of a few pixels. Unless a text says pixels, it is in cells.
"""

from __future__ import annotations

import math
from functools import cached_property, partial
from typing import TypeAlias

import numpy as np

from postfx.frame import DEPTH_MISS, Frame, Role
from postfx.interpolate.blend import Pair
from postfx.interpolate.choose import Toned, measure_misfits
from postfx.interpolate.lost import motion_of_lost
from postfx.interpolate.overlays import COVERED, find_overlay
from postfx.interpolate.paths import (
    Paths,
    gather_cells,
    motion_of_reflections,
    paths_of,
    rank_paths,
    refine,
)
from postfx.interpolate.pictures import PairPictures, finite
from postfx.interpolate.thin import ThinInputs, where_flow_is_right
from postfx.interpolate.ways import MotionFit, compare_motion
from postfx.motion.flow import consistent_motion, enlarge_motion, estimate_motion, halve
from postfx.system import at_once
from postfx.temporal.reverse_motion import LOST, invert_motion

LEAST_SEARCHED_PX = 240
"""Length of the shorter side of the picture in which motion is estimated, at least where there are
as many pixels."""
BETTER_INVERTED = 0.9
"""Misfit of estimated motion from the other side, over that of this side, below which it counts."""
MOST_GROWN_PX = 64
"""Pixels by which an overlay that was found in the picture is grown, at most."""
Three: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray]


class PairMotion:
    """The motion between two frames. Everything is made when it is first asked for, and may be
    asked for from several threads.

    Args:
        pictures: of the two frames.
        later: the frame that follows, whose motion bends paths; None if it is not known.
        flow: whether motion is also estimated where there are vectors.
        last: the motion between the frames before, of which what belongs to a frame of both pairs
            is taken over.
    """

    def __init__(self, pictures: PairPictures, later: Frame | None, flow: bool,
                 last: PairMotion | None = None) -> None:
        self.before, self.after = pictures.before, pictures.after
        self._pictures, self._later, self._flow = pictures, later, flow
        self._gathered: list[tuple[Frame, Pair]] = []
        self._inverted: list[tuple[Frame, Frame, np.ndarray]] = []
        if last is not None:
            self._gathered = [(frame, cells) for frame, cells in last._gathered
                              if frame is self.before or frame is self.after]
            self._inverted = [one for one in last._inverted if one[0] is self.before]

    # Estimated motion, and whether vectors fit

    @cached_property
    def _estimated(self) -> Pair:
        """Motion (rows, columns, 2) of both frames to the other one, estimated from the pictures;
        of a picture that is halved as often as it keeps enough pixels, and in its pixels."""
        pictures, scale = self._pictures.small, self._pictures.scale
        while min(pictures[0].shape) >= 2 * LEAST_SEARCHED_PX:
            pictures = halve(pictures[0]), halve(pictures[1])
        ahead, back = at_once([lambda: estimate_motion(*pictures, 2 - scale),
                               lambda: estimate_motion(*pictures[::-1], 2 - scale)])
        return ahead, back

    @cached_property
    def estimated_back(self) -> np.ndarray:
        """Estimated motion (rows, columns, 2) of the frame after: as it was searched for, or that
        of the frame before inverted where this fits better. A search may be caught by a pattern
        that repeats, and is not from the other side."""
        ahead, back = (self._enlarge(motion) for motion in self._estimated)
        even = np.ones((*self._pictures.grid, 1), np.float32)
        inverted = invert_motion(ahead, even, even)
        inverted = np.where(inverted < LOST / 2, inverted, back)
        found = compare_motion(*self._pictures.small, back, inverted)
        is_better = found is not None and found.vectors < BETTER_INVERTED * found.flow
        return inverted if is_better else back

    @cached_property
    def fit(self) -> MotionFit | None:
        """How well vectors and estimated motion explain the pictures; None if there is only one of
        the two."""
        if Role.MOTION not in self.after or not self._flow:
            return None
        motion, _ = self.cells_of(self.after)
        return compare_motion(*self._pictures.small, self.estimated_back, motion)

    @cached_property
    def has_vectors(self) -> bool:
        """Whether the frame after has motion that fits the pictures at least as well as what is
        estimated."""
        fit = self.fit
        return Role.MOTION in self.after if fit is None else fit.vectors_fit

    @property
    def vectors_px(self) -> np.ndarray:
        """Motion (rows, columns, 2) by vectors, in pixels; estimated where there are none."""
        motion = self.cells_of(self.after)[0]
        is_lost = np.isnan(motion[..., :1])
        known = np.where(is_lost, self.estimated_back, motion) if is_lost.any() else motion
        found: np.ndarray = np.float32(self._pictures.scale) * known
        return found

    @cached_property
    def flows_px(self) -> Pair:
        """Estimated motion (rows, columns, 2) of both frames to the other one, in pixels: NaN where
        the way there and back does not end where it began; empty if not asked for."""
        if not self._flow or not self.has_vectors:
            return np.empty((0, 0, 2), np.float32), np.empty((0, 0, 2), np.float32)
        found = consistent_motion(*self._estimated, self._pictures.scale)
        ahead, back = at_once([lambda: self._enlarge(found[0]), lambda: self._enlarge(found[1])])
        return ahead, back

    @cached_property
    def mirrored_px(self) -> np.ndarray:
        """Motion (rows, columns, 2) of what the frame after reflects, in pixels; empty where
        nothing tells of it."""
        needed = (Role.MOTION, Role.DEPTH, Role.SPECULAR_HIT_DISTANCE)
        if not (self.has_vectors and all(role in self.after for role in needed)):
            return np.empty((0, 0, 2), np.float32)
        scale = self._pictures.scale
        motion, depth = self.cells_of(self.after)
        length = finite(self.after[Role.SPECULAR_HIT_DISTANCE])[::scale, ::scale]
        found: np.ndarray = scale * motion_of_reflections(motion, depth, length, self.after.fov_x)
        return found

    @cached_property
    def where_flow_is_right(self) -> np.ndarray | None:
        """How much the picture along estimated motion counts in place of the one along vectors
        (h, w, 1), where these lead a thin thing nowhere right; None where they do not."""
        fit, pictures = self.fit, self._pictures
        if fit is None or not (fit.vectors_fit and pictures.both_have(Role.DEPTH)):
            return None
        motion, depth = self.cells_of(self.after)
        depths = self.cells_of(self.before)[1], depth
        seen = ThinInputs(pictures.lit(0.5), float(pictures.level), self.after[Role.DEPTH], motion,
                    depths, pictures.scale)
        found = where_flow_is_right(seen, self._enlarge(self._estimated[0]), self.estimated_back,
                                    fit.apart)
        if found is None:
            return None
        rows, columns = (np.minimum(np.arange(side) // pictures.scale, count - 1)
                         for side, count in zip(pictures.size, pictures.grid, strict=True))
        return found[rows[:, None], columns][..., None]

    def _enlarge(self, motion: np.ndarray) -> np.ndarray:
        """Motion of a smaller picture for cells: in pixels of the picture if they were that of
        cells."""
        return enlarge_motion(motion, *self._pictures.grid)

    # Depth, and what the frames show of the scene

    @cached_property
    def has_depth(self) -> bool:
        """Whether depth tells what is in front. It does not where motion is estimated in place of
        vectors that do not fit."""
        return (self._pictures.both_have(Role.DEPTH)
                and (self.has_vectors or Role.MOTION not in self.after))

    @cached_property
    def depths(self) -> Pair:
        """Depth (h, w, 1) of both frames; empty where one has none."""
        if not self.has_depth:
            return np.empty((0, 0, 1), np.float32), np.empty((0, 0, 1), np.float32)
        return (np.ascontiguousarray(self.before[Role.DEPTH]),
                np.ascontiguousarray(self.after[Role.DEPTH]))

    @cached_property
    def known(self) -> Pair:
        """(h, w) of each frame: where it shows the scene, and not an overlay."""
        pictures = self._pictures
        if pictures.composited:
            first, last = (overlay[..., 3] < COVERED for overlay in pictures.overlays)
            return first, last
        known = np.ones(pictures.size, np.bool_)
        if (pictures.both_have(Role.MOTION) and self.has_vectors
            and not pictures.both_have(Role.OPAQUE_COLOUR)):
            motion = without_lost(self.after[Role.MOTION], pictures.longest_px)
            some = finite(motion[::4, ::4])
            size = np.abs(some[..., 0]) + np.abs(some[..., 1])
            find_overlay(*pictures.scene, motion,
                         min(MOST_GROWN_PX, math.ceil(float(np.quantile(size, 0.99)))), known)
        return known, known

    @cached_property
    def is_masked(self) -> bool:
        """Whether overlays hide any of the scene."""
        first, last = self.known
        return not (first.all() and last.all())

    @cached_property
    def compared(self) -> Toned:
        """Grey pictures of both frames, by which paths are compared."""
        return Toned(*self._pictures.toned, *self.known, self._pictures.scale)

    # Paths

    @cached_property
    def paths(self) -> tuple[Paths, Paths]:
        """Paths of the cells of both frames through the time between."""
        has_depth = self.has_depth
        frames = [self.before, self.after]
        if self._later is not None and has_depth and self._goes_on:
            frames.append(self._later)
        (came, near), (motion, far), *beyond = at_once([partial(self.cells_of, frame)
                                                        for frame in frames])
        if not self.has_vectors:
            motion, beyond = self.estimated_back, []
        elif self._flow and (is_lost := np.isnan(motion[..., 0])).any():
            motion = np.where(is_lost[..., None], self._guess(1, is_lost), motion)
            no_way = np.isnan(came[..., 0])
            came = np.where(no_way[..., None], -self._guess(0, no_way), came)
        if not has_depth:
            near, far = self._rank(motion)
        known_from_before = (self.has_vectors and Role.MOTION in self.before
                             and not self.before.reset)
        motions: list[tuple[Frame, Frame, Three]] = [(self.before, self.after, (motion, far, near))]
        motions += [(self.after, frames[2], (onward, farther, far)) for onward, farther in beyond]
        ahead, *goes = self._invert(motions)
        first, last = paths_of(motion, ahead, near, far, came if known_from_before else None,
                               *goes)
        for side, frame in ((first, self.before), (last, self.after)):
            if any(frame.jitter):
                side.ends += (np.array(frame.jitter * 2, np.float32)
                              / np.float32(self._pictures.scale))
        return first, last

    @cached_property
    def noise(self) -> np.float32:
        """Misfit of paths that are right, which is noise: the median."""
        _, last = self.paths
        found = measure_misfits(self.compared, last)
        found = found[found >= 0]
        return np.float32(np.median(found) if found.size else 0)

    def cells_of(self, frame: Frame) -> Pair:
        """Motion (rows, columns, 2) and depth (rows, columns, 1) of a frame's cells; the frame has
        at least one of the two planes."""
        for known, cells in self._gathered:
            if known is frame:
                return cells
        pictures = self._pictures
        motion, depth = (np.ascontiguousarray(frame[role]) if role in frame else
                         np.full((1, pictures.size[1], count), DEPTH_MISS, np.float32)
                         for role, count in ((Role.MOTION, 2), (Role.DEPTH, 1)))
        found = gather_cells(motion, depth, pictures.scale, float(pictures.longest_px),
                             pictures.grid)
        self._gathered.append((frame, found))
        return found

    @property
    def _goes_on(self) -> bool:
        """Whether the frame that follows is known, of this shot and size, and has motion and
        depth."""
        later = self._later
        if later is None or later.reset:
            return False
        return all(role in later and later[role].shape[:2] == self._pictures.size
                   for role in (Role.MOTION, Role.DEPTH))

    def _guess(self, side: int, is_lost: np.ndarray) -> np.ndarray:
        """Motion (rows, columns, 2) of the frame before (0) or after (1) to the other one, for
        cells that lost their vectors."""
        consistent = self.flows_px[side] / np.float32(self._pictures.scale)
        return motion_of_lost(self._enlarge(self._estimated[side]), consistent, is_lost)

    def _rank(self, motion: np.ndarray) -> Pair:
        """Order of surfaces of both frames by the misfit of their paths, in place of depth."""
        first, last = self._pictures.small
        even = np.ones((*self._pictures.grid, 1), np.float32)
        ahead = invert_motion(motion, even, even)
        return rank_paths(first, last, ahead), rank_paths(last, first, motion)

    def _invert(self, motions: list[tuple[Frame, Frame, Three]]) -> list[np.ndarray]:
        """Motion of frames to the ones after them, from a frame, the one after it, and the motion
        of the latter with the depth of both."""
        def find(before: Frame, after: Frame) -> np.ndarray | None:
            return next((way for one, other, way in self._inverted
                         if one is before and other is after), None)

        new = [motion for motion in motions if find(*motion[:2]) is None]
        found = at_once([partial(invert_motion, *planes) for _, _, planes in new])
        for (before, after, (motion, *_)), way in zip(new, found, strict=True):
            refine(motion, way)
            self._inverted.append((before, after, way))
        return [way for motion in motions if (way := find(*motion[:2])) is not None]


def without_lost(motion: np.ndarray, longest_px: np.float32) -> np.ndarray:
    """Motion (h, w, 2) in pixels, NaN where it is not finite or longer than any can be."""
    is_kept = np.abs(motion).max(axis=2, keepdims=True) <= longest_px
    return motion if is_kept.all() else np.where(is_kept, motion, np.float32(np.nan))
