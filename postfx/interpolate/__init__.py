"""Frames between frames: what a sequence shows at times at which no frame was rendered.

Steps: `paths` lead both frames through the time between them, for cells of a few pixels, and are
splatted to the time that is asked for; `flow` estimates motion where vectors tell nothing; `choose`
decides between the paths that meet, and `blend` takes the picture from both frames along them.
`timing` says which times, numbers and time codes a sequence gets, how light goes on through four of
its frames, and keeps that of sparks. docs/lab/interpolation.md.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property, partial
from numbers import Real
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from postfx.caching import reuse_memory
from postfx.cuts import CutDetector
from postfx.errors import FrameError
from postfx.frame import ALBEDOS, DEPTH_MISS, Frame, Role
from postfx.interpolate import paths
from postfx.interpolate.blend import (
    DARK,
    Mixture,
    Pair,
    Planes,
    compose,
    join_cells,
    split_planes,
    stack_planes,
)
from postfx.interpolate.choose import (
    MARGIN,
    Arrived,
    Flows,
    Toned,
    choose_paths,
    measure_change,
    measure_detail,
    measure_misfits,
    merge_sides,
)
from postfx.interpolate.light import change_of_light, lit_at
from postfx.interpolate.lost import motion_of_lost
from postfx.interpolate.overlays import COVERED, find_overlay, measure_clearness, remove_overlay
from postfx.interpolate.parts import (
    Sets,
    changes_of_parts,
    find_common_sets,
    follow_picture,
    light_parts,
)
from postfx.interpolate.thin import Seen, where_flow_is_right
from postfx.interpolate.timing import (
    Sparks,
    camera_between,
    find_sparks,
    follow_light,
    keep_sparks,
    settle_sparks,
)
from postfx.interpolate.ways import (
    AS_EVEN,
    AS_EVEN_ALONE,
    CLEARLY_BETTER,
    DOUBTING_ROWS,
    FLOW_HANDICAP,
    LEAST_LEFT_OF_FLOW,
    LEAST_UNEVEN,
    LESS_EVEN_THAN_FLOW,
    MORE_EVEN,
    MOSTLY_NOISE,
    REST_HANDICAP,
    Ways,
    compare_ways,
    rest_of,
    shares_of,
    straight_course,
    unevenness,
)
from postfx.motion.flow import (
    bring_to_time,
    consistent_motion,
    enlarge_motion,
    estimate_motion,
    halve,
    middle_light,
    tone,
)
from postfx.planes import is_same_plane, largest_bits_of
from postfx.sampling import bilinear
from postfx.system import at_once, begin
from postfx.temporal.reverse_motion import LOST, invert_motion

MIXED_PLANES = (*ALBEDOS, Role.ROUGHNESS, Role.ALPHA)
"""Planes that are mixed from both frames, as the colour is."""
DATA = (Role.DEPTH, Role.NORMAL, Role.SPECULAR_HIT_DISTANCE, Role.STRENGTH, Role.REACTIVE)
"""Planes that are taken from one frame's nearest pixel."""
LEAST_OF_CELLS = 64
"""Pixels along a picture's shorter side from which paths are found for cells of 2x2 pixels."""
LEAST_SEARCHED = 240
"""Pixels along the shorter side of the picture in which motion is estimated, at least where there
are as many."""
MOST_COUNTED_LIGHT = np.float32(1e18)
"""Light that is counted at most: sums of its squares are finite."""
BETTER_INVERTED = 0.9
"""Misfit of estimated motion from the other side, in that of this one, below which it counts."""
MOST_GROWN_PX = 64
"""Pixels by which an overlay that was found in the picture is grown, at most."""
Three: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray]


class Shares(NamedTuple):
    """How much each picture of a time counts; the sum is 1.

    Attributes:
        vectors: of the one along the vectors, or along estimated motion where there are none.
        flow: of the one along estimated motion, beside vectors.
        mean: of the mean of both frames.
        over_shot: of a shot that moves by the vectors and goes over into another one.
    """

    vectors: float = 0.0
    flow: float = 0.0
    mean: float = 0.0
    over_shot: float = 0.0


BY_VECTORS = Shares(vectors=1.0)
BY_FLOW = Shares(flow=1.0)
BY_MEAN = Shares(mean=1.0)
AFTER_SHARE = "share of the frame after"
"""What is mixed beside parts: 0 in the frame before, 1 in the one after."""
OVERLAYS = ("mix", "hold")
CAMERA_ATTRIBUTES = ("worldToCamera", "worldToNDC")
"""Attributes of a camera, of which the first one is made for the time."""
CUT_REASON = "another shot begins"
STILL_REASON = "nothing changes"


class Between:
    """The time between two frames that follow each other.

    Args:
        before, after: the two frames, scene-linear.
        later: the frame that follows, if there is one. It bends the paths of what turns or speeds
            up, and so does the motion of the frame before.
        flow: whether motion is also estimated where there are vectors, as shadows do not move along
            with their surface, and light that changes from one frame to the other is evened out.
            Where the estimated motion fits better than the vectors in the picture as a whole, these
            are not used.
        overlay: 'mix' or 'hold' (keep the earlier one's) the plane overlay.
        composited: whether the overlay is in the colour, too. It is taken out, and put over the
            result.
        is_cut: whether another shot begins between the two, as `reset` of the frame after says,
            too.
        last: the time before this one, whose findings about frames of both are taken over. With
            `later`, too, light that changes where nothing moves goes on through four frames.

    Attributes:
        reason: why there is nothing to interpolate, or None: `frame` then gives the nearer one of
            the two.

    Raises FrameError for a frame without scene-linear colour.
    """

    def __init__(self, before: Frame, after: Frame, later: Frame | None = None, *,
                 flow: bool = True, overlay: str = "mix", composited: bool = False,
                 is_cut: bool = False, last: Between | None = None) -> None:
        if overlay not in OVERLAYS:
            raise FrameError(f"overlay '{overlay}' between frames: use {' or '.join(OVERLAYS)}")
        for frame in (before, after):
            _require_frame(frame)
            if Role.COLOUR not in frame or frame.encoding != "scene-linear":
                raise FrameError(f"frame {frame.number} ({frame.source or 'of no file'}) has no "
                                 "scene-linear colour: interpolate before the display transform")
        self.before, self.after = before, after
        self._earlier: Frame | None = None
        self._later = later
        self._memory = reuse_memory()
        self._gathered: list[tuple[Frame, Pair]] = []
        self._inverted: list[tuple[Frame, Frame, np.ndarray]] = []
        self._known_sets: Sets | None = None
        if last is not None:
            self._take_over(last)
        self._found_sets: Sets | None = self._known_sets
        self._options: dict[str, Any] = {"flow": flow, "overlay": overlay, "composited": composited}
        self._flow = flow
        self._overlay = overlay
        self._composited = composited and self._both_have(Role.OVERLAY)
        self.reason = self._find_reason(is_cut)

    def _take_over(self, last: Between) -> None:
        """Keep what the time before this one found of frames of both."""
        if last.after is self.before:
            self._earlier = last.before
        self._gathered = [(frame, cells) for frame, cells in last._gathered
                          if frame is self.before or frame is self.after]
        self._inverted = [one for one in last._inverted if one[0] is self.before]
        self._known_sets = last._found_sets

    def frame(self, t: float, number: int | None = None, previous: float = 0.0) -> Frame:
        """What is seen at a time t: 0 is the frame before, 1 the one after; those are given as they
        are.

        number: of the new frame. previous: the time to which the plane motion leads, -1 to t.
        Planes that only one of the two frames has are left out, and so are guides.

        Raises FrameError for another time.
        """
        is_time = isinstance(t, Real) and isinstance(previous, Real)
        if not (is_time and 0 <= t <= 1 and -1 <= previous <= t):
            raise FrameError(f"time {t} with motion to {previous}: give 0 <= t <= 1 and -1 <= "
                             "previous <= t")
        nearer = self.before if t < 0.5 else self.after
        number = nearer.number if number is None else number
        if self.reason is not None or t in (0, 1):
            return replace(nearer, number=number)
        views = {name: Between(view, self.after.views[name], **self._options)
                       .frame(t, number, previous)
                 for name, view in self.before.views.items() if name in self.after.views}
        planes, parts = self._make_planes(t, previous)
        camera = camera_between(self.before.world_to_camera, self.after.world_to_camera, t)
        metadata = {name: value for name, value in self.before.metadata.items()
                    if name not in CAMERA_ATTRIBUTES}
        if camera is not None and CAMERA_ATTRIBUTES[0] in self.before.metadata:
            metadata[CAMERA_ATTRIBUTES[0]] = tuple(camera.ravel().tolist())
        return replace(self.before, planes=planes, parts=parts, number=number, jitter=(0.0, 0.0),
                       reset=False,
                       metadata=metadata, guides={}, guide_size=None, samples=None, views=views,
                       world_to_camera=camera)

    def motion_of_after(self, previous: float) -> np.ndarray:
        """Motion (h, w, 2) of the frame after to a time between, `previous`: what its plane is once
        a frame is there.
        """
        _, last = self._paths
        whole = (last.ends[..., :2]
                 - np.array(self.after.jitter, np.float32) / np.float32(self._scale))
        bend = last.bend
        if self._scale > 1:
            whole, bend = (enlarge_motion(np.ascontiguousarray(one), *self._size)
                           for one in (whole, bend))
        if self._has_vectors:
            given = _without_lost(self.after[Role.MOTION], self._longest)
            whole = np.where(np.isnan(given), whole, given)
        motion: np.ndarray = (whole * np.float32(1 - previous)
                              + bend * np.float32(previous * (previous - 1)))
        return motion

    def _both_have(self, role: Role) -> bool:
        return role in self.before and role in self.after

    def _find_reason(self, is_cut: bool) -> str | None:
        one, other = self.before.spec, self.after.spec
        if (one.width, one.height) != (other.width, other.height):
            return f"sizes differ: {one.width}x{one.height} and {other.width}x{other.height}"
        if is_cut or self.after.reset:
            return CUT_REASON
        planes = [role for role in (Role.COLOUR, Role.ALPHA, Role.OVERLAY) if self._both_have(role)]
        same = all(is_same_plane(self.before[role], self.after[role]) for role in planes)
        return STILL_REASON if same else None

    # What is found once for all times

    @cached_property
    def _size(self) -> tuple[int, int]:
        """Height and width of the pictures."""
        h, w = self.before[Role.COLOUR].shape[:2]
        return h, w

    @cached_property
    def _scale(self) -> int:
        """Pixels along a side of the cells that paths are found for."""
        return 2 if min(self._size) >= LEAST_OF_CELLS else 1

    @cached_property
    def _longest(self) -> np.float32:
        """Pixels beyond which a vector stands for none, as some renderers write it."""
        return np.float32(max(self._size))

    @cached_property
    def _grid(self) -> tuple[int, int]:
        """Rows and columns of cells."""
        return -(-self._size[0] // self._scale), -(-self._size[1] // self._scale)

    @cached_property
    def _overlays(self) -> tuple[np.ndarray, np.ndarray]:
        """Overlays (h, w, 4) that are in the colours."""
        return _finite(self.before[Role.OVERLAY]), _finite(self.after[Role.OVERLAY])

    @cached_property
    def _colours(self) -> tuple[np.ndarray, np.ndarray]:
        """Colours as they are in the frames."""
        first, last = at_once([lambda: _finite(self.before[Role.COLOUR]),
                               lambda: _finite(self.after[Role.COLOUR])])
        return first, last

    @cached_property
    def _pictures(self) -> tuple[np.ndarray, np.ndarray]:
        """Colours without overlays."""
        if self._both_have(Role.OPAQUE_COLOUR):
            return _finite(self.before[Role.OPAQUE_COLOUR]), _finite(self.after[Role.OPAQUE_COLOUR])
        if not self._composited:
            return self._colours
        first, last = (remove_overlay(*both)
                       for both in zip(self._colours, self._overlays, strict=True))
        return first, last

    @cached_property
    def _toned(self) -> tuple[np.ndarray, np.ndarray]:
        """Grey pictures with margins (h + 2 MARGIN, w + 2 MARGIN), by which paths are compared."""
        first, last = (tone(picture, self._level, MARGIN) for picture in self._lit(0.5))
        return first, last

    @cached_property
    def _level(self) -> np.float32:
        """Light that is toned to about the middle."""
        return middle_light(self._lit(0.5))

    @cached_property
    def _change(self) -> np.ndarray | None:
        """How light changes from the frame before to the one after; None where it does not."""
        if Role.MOTION in self.after and not self._flow:
            return None
        return change_of_light(*self._pictures, self.after.planes.get(Role.MOTION),
                               float(self._longest))

    def _lit(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Colours without overlays, in the light of a time."""
        return self._pictures if self._change is None else lit_at(*self._pictures, self._change, t)

    @cached_property
    def _light_parts(self) -> dict[str, Pair]:
        """Parts of both frames that are mixed as the picture is."""
        before, after = self.before, self.after
        return {name: (_finite(before.parts[name]), _finite(after.parts[name]))
                for name in self._shared_parts if not self._is_exact(name)}

    @property
    def _shared_parts(self) -> list[str]:
        """Names of the parts that both frames have."""
        return [name for name, part in self.before.parts.items()
                if name in self.after.parts and part.shape == self.after.parts[name].shape]

    def _is_exact(self, name: str) -> bool:
        """Whether a part is taken from one frame's nearest pixel."""
        source = self.before.part_sources.get(name)
        return source is not None and source.exact

    @cached_property
    def _part_changes(self) -> dict[str, np.ndarray]:
        """How the light of parts changes."""
        if not self._light_parts or (Role.MOTION in self.after and not self._flow):
            return {}
        motion = (self.after[Role.MOTION] if self._has_vectors else
                  np.float32(self._scale) * self._estimated_back)
        if motion.shape[:2] != self._size:
            motion = enlarge_motion(np.ascontiguousarray(motion / np.float32(self._scale)),
                                    *self._size)
        return changes_of_parts(self._light_parts, motion, float(self._longest))

    @cached_property
    def _sets(self) -> Sets:
        """Parts that add up to the picture in both frames."""
        self._found_sets = find_common_sets(self._pictures, self._light_parts, self._known_sets)
        return self._found_sets

    @cached_property
    def _dim(self) -> np.float32:
        """Light, summed over channels, that counts as dark."""
        return np.float32(DARK * self._level)

    @cached_property
    def _sparks(self) -> Sparks | None:
        """Sparks of both frames; None without, without flow, and where overlays left black
        pixels."""
        if not self._flow or self._composited or not self._has_vectors:
            return None
        marks = [find_sparks(picture, self._scale, float(self._dim), self._grid)
                 for picture in self._pictures]
        is_there = marks[0].any() or marks[1].any()
        return Sparks(self._pictures, marks, self._scale, float(self._dim)) if is_there else None

    @cached_property
    def _compared(self) -> Toned:
        """Grey pictures of both frames, by which paths are compared."""
        return Toned(*self._toned, *self._known, self._scale)

    @cached_property
    def _small(self) -> tuple[np.ndarray, np.ndarray]:
        """The grey pictures at one pixel a cell."""
        first, last = (_at_cells(toned, self._scale) for toned in self._toned)
        return first, last

    @cached_property
    def _depths(self) -> Pair:
        """Depth (h, w, 1) of both frames; empty where one has none."""
        if not self._has_depth:
            return np.empty((0, 0, 1), np.float32), np.empty((0, 0, 1), np.float32)
        return (np.ascontiguousarray(self.before[Role.DEPTH]),
                np.ascontiguousarray(self.after[Role.DEPTH]))

    @cached_property
    def _known(self) -> tuple[np.ndarray, np.ndarray]:
        """(h, w) of each frame: where it shows the scene, and not an overlay."""
        if self._composited:
            first, last = (overlay[..., 3] < COVERED for overlay in self._overlays)
            return first, last
        known = np.ones(self._size, np.bool_)
        if (self._both_have(Role.MOTION) and self._has_vectors
            and not self._both_have(Role.OPAQUE_COLOUR)):
            motion = _without_lost(self.after[Role.MOTION], self._longest)
            some = _finite(motion[::4, ::4])
            size = np.abs(some[..., 0]) + np.abs(some[..., 1])
            find_overlay(*self._pictures, motion,
                         min(MOST_GROWN_PX, math.ceil(float(np.quantile(size, 0.99)))), known)
        return known, known

    @cached_property
    def _masked(self) -> bool:
        """Whether anything is hidden by overlays."""
        first, last = self._known
        return not (first.all() and last.all())

    @cached_property
    def _estimated(self) -> tuple[np.ndarray, np.ndarray]:
        """Motion of both frames to the other one, estimated from the pictures, in pixels of a
        picture that is halved as often as it keeps enough of them."""
        pictures = self._small
        while min(pictures[0].shape) >= 2 * LEAST_SEARCHED:
            pictures = halve(pictures[0]), halve(pictures[1])
        ahead, back = at_once([lambda: estimate_motion(*pictures, 2 - self._scale),
                                lambda: estimate_motion(*pictures[::-1], 2 - self._scale)])
        return ahead, back

    @cached_property
    def _estimated_back(self) -> np.ndarray:
        """Estimated motion (rows, columns, 2) of the frame after, in cells: as it was searched for,
        or that of the frame before inverted where that fits better. A search may be caught by a
        pattern that repeats, and from the other side it is not."""
        ahead, back = (self._enlarge(motion) for motion in self._estimated)
        even = np.ones((*self._grid, 1), np.float32)
        inverted = invert_motion(ahead, even, even)
        inverted = np.where(inverted < LOST / 2, inverted, back)
        found = compare_ways(*self._small, back, inverted)
        is_better = found is not None and found.motion < BETTER_INVERTED * found.flow
        return inverted if is_better else back

    @cached_property
    def _has_vectors(self) -> bool:
        """Whether the frame after has motion that fits the pictures at least as well as what is
        estimated."""
        ways = self._ways
        return Role.MOTION in self.after if ways is None else ways.vectors_fit

    @cached_property
    def _ways(self) -> Ways | None:
        """How well vectors and estimated motion explain the pictures; None where nothing is to be
        compared."""
        if Role.MOTION not in self.after or not self._flow:
            return None
        motion, _ = self._cells_of(self.after)
        return compare_ways(*self._small, self._estimated_back, motion)

    @property
    def _all_lit(self) -> bool:
        return all(picture.any() for picture in self._pictures)

    @cached_property
    def _without_vectors(self) -> Between:
        """The time between both frames by estimated motion alone."""
        return Between(_without_motion(self.before), _without_motion(self.after), **self._options)

    @cached_property
    def _shares(self) -> Shares:
        """How much each picture counts. The mean alone does where one frame is black, as nothing
        shows how its light changed."""
        if not self._all_lit:
            return BY_MEAN
        if self._ways is None:
            return self._shares_without_vectors
        certain = self._certain_shares(self._ways)
        return self._shares_by_unevenness(self._ways) if certain is None else certain

    def _certain_shares(self, ways: Ways) -> Shares | None:
        """The shares where it is plain which pictures count; None where they are to be measured."""
        frames = len(self._row)
        if ways.vectors_fit and ways.is_thin:
            vectors, flow = ways.shares_of_thin(frames)
            return Shares(vectors, flow)
        if not ways.vectors_fit and ways.is_thin_along_flow:
            return BY_FLOW
        if self._vectors_blend:
            # light may change, and goes on through four frames
            is_known = self._both_have(Role.DEPTH) or (ways.vectors_fit and frames == 2)
            return BY_VECTORS if is_known else None
        is_doubted = self._doubt > (AS_EVEN_ALONE if frames == 2 else AS_EVEN)
        return BY_VECTORS if ways.vectors_fit and not (ways.in_doubt or is_doubted) else None

    def _shares_by_unevenness(self, ways: Ways) -> Shares:
        """The shares by how evenly colours go on along each way through the frames around."""
        measure = self._unevenness
        flow = np.float32(self._scale) * self._without_vectors._estimated_back
        flowing = FLOW_HANDICAP * measure(flow)
        mean = measure(np.zeros_like(flow))
        over_shot = given = math.inf
        if len(self._row) == 4:
            over_shot = REST_HANDICAP * measure(flow, shot=self._vectors)
        if ways.vectors_fit:
            given = measure(self._vectors)
        if ways.vectors_fit and self._vectors_blend:
            if min(flowing, over_shot) > CLEARLY_BETTER * given:
                return BY_VECTORS
            mean = math.inf  # it is what such vectors show
        return Shares(*shares_of((given, flowing, mean, over_shot)))

    @cached_property
    def _doubt(self) -> float:
        """`_unevenness_along` vectors that explain little; 0 for others."""
        ways = self._ways
        if ways is None or not ways.vectors_explain_little(len(self._row)):
            return 0.0
        return self._unevenness_along(self._vectors)

    @property
    def _vectors_blend(self) -> bool:
        """Whether vectors stand still, so that they show a blend, and that is no worse."""
        ways = self._ways
        return ways is not None and ways.vectors_stand_still and self._doubt <= MORE_EVEN

    @property
    def _shares_without_vectors(self) -> Shares:
        """The shares where there are no vectors: estimated motion alone counts, unless it explains
        little and colours go on about as evenly at the same place."""
        if Role.MOTION in self.after or not self._flow:
            return BY_VECTORS
        flow = self._estimated_back
        explained = compare_ways(*self._small, flow, flow)
        if explained is None or explained.is_thin_along_flow:
            return BY_VECTORS
        if explained.flow < LEAST_LEFT_OF_FLOW * explained.still:
            return BY_VECTORS
        way = np.float32(self._scale) * flow
        if self._unevenness_along(way) <= LESS_EVEN_THAN_FLOW:
            return BY_VECTORS
        flowing, mean = shares_of((self._unevenness(way), self._unevenness(np.zeros_like(way))))
        return Shares(vectors=flowing, mean=mean)

    @property
    def _vectors(self) -> np.ndarray:
        """Motion (rows, columns, 2) by vectors, in pixels; estimated where there are none."""
        scale, motion = np.float32(self._scale), self._cells_of(self.after)[0]
        is_lost = np.isnan(motion[..., :1])
        known = np.where(is_lost, self._estimated_back, motion) if is_lost.any() else motion
        found: np.ndarray = scale * known
        return found

    @property
    def _unevenness(self) -> partial[float]:
        """`unevenness` of the frames around, along a way."""
        row = self._row
        colours = [_finite(frame[Role.COLOUR]) for frame in row]
        return partial(unevenness, colours, row.index(self.before), level=float(self._level))

    def _unevenness_along(self, way: np.ndarray) -> float:
        """How unevenly colours go on along a way (rows, columns, 2), in how they do at the same
        place: about 1 and more where another shot comes in. Only what cells beside have in common
        tells it, and nothing does where noise is most of all, which is as uneven along every way:
        then it is 0."""
        measure = partial(self._unevenness, rows=DOUBTING_ROWS)
        along = measure(way, alone=0.0)
        worse = along / max(measure(np.zeros_like(way), alone=0.0), LEAST_UNEVEN)
        is_noise = worse > AS_EVEN and along <= MOSTLY_NOISE * measure(way)
        return 0.0 if is_noise else worse

    @cached_property
    def _row(self) -> list[Frame]:
        """Both frames, and those beside them of this shot and size that are known and no copies of
        them: nothing goes on evenly where frames are held."""
        row = [self.before, self.after]
        earlier, later = self._earlier, self._later
        if earlier is not None and not self.before.reset and not _is_held(earlier, self.before):
            row.insert(0, earlier)
        if later is not None and not later.reset and not _is_held(self.after, later):
            row.append(later)
        is_even = all(frame[Role.COLOUR].shape[:2] == self._size for frame in row)
        return row if is_even else [self.before, self.after]

    @cached_property
    def _has_depth(self) -> bool:
        """Whether depth tells what is in front, for all but what is estimated in place of
        vectors."""
        return self._both_have(Role.DEPTH) and (self._has_vectors or Role.MOTION not in self.after)

    @cached_property
    def _flows(self) -> tuple[np.ndarray, np.ndarray]:
        """Estimated motion of both frames to the other one, for cells (rows, columns, 2), in
        pixels: NaN where the way there and back does not end where it began; empty if not asked
        for."""
        if not self._flow or not self._has_vectors:
            return np.empty((0, 0, 2), np.float32), np.empty((0, 0, 2), np.float32)
        found = consistent_motion(*self._estimated, self._scale)
        ahead, back = at_once([lambda: self._enlarge(found[0]), lambda: self._enlarge(found[1])])
        return ahead, back

    @cached_property
    def _mirrored(self) -> np.ndarray:
        """Motion of what the frame after reflects, for cells, in pixels; empty where nothing tells
        of it."""
        needed = (Role.MOTION, Role.DEPTH, Role.SPECULAR_HIT_DISTANCE)
        if not (self._has_vectors and all(role in self.after for role in needed)):
            return np.empty((0, 0, 2), np.float32)
        motion, depth = self._cells_of(self.after)
        length = _finite(self.after[Role.SPECULAR_HIT_DISTANCE])[::self._scale, ::self._scale]
        found: np.ndarray = self._scale * paths.motion_of_reflections(motion, depth, length,
                                                                      self.after.fov_x)
        return found

    def _enlarge(self, motion: np.ndarray) -> np.ndarray:
        """Motion of a smaller picture for cells: in pixels of the picture if they were that of
        cells."""
        return enlarge_motion(motion, *self._grid)

    def _guess(self, side: int, is_lost: np.ndarray) -> np.ndarray:
        """Motion (rows, columns, 2) of the frame before (0) or after (1) to the other one, in
        cells, for those that lost their vectors."""
        consistent = self._flows[side] / np.float32(self._scale)
        return motion_of_lost(self._enlarge(self._estimated[side]), consistent, is_lost)

    def _cells_of(self, frame: Frame) -> tuple[np.ndarray, np.ndarray]:
        """Motion (rows, columns, 2), in cells, and depth (rows, columns, 1) of a frame that has
        either."""
        for known, cells in self._gathered:
            if known is frame:
                return cells
        motion, depth = (np.ascontiguousarray(frame[role]) if role in frame else
                         np.full((1, self._size[1], count), DEPTH_MISS, np.float32)
                         for role, count in ((Role.MOTION, 2), (Role.DEPTH, 1)))
        found = paths.gather_cells(motion, depth, self._scale, float(self._longest), self._grid)
        self._gathered.append((frame, found))
        return found

    def _invert(self, motions: list[tuple[Frame, Frame, Three]]) -> list[np.ndarray]:
        """Motion of frames to the ones after them, by those, their motion and depth of both."""
        def find(before: Frame, after: Frame) -> np.ndarray | None:
            return next((way for one, other, way in self._inverted
                         if one is before and other is after), None)

        new = [motion for motion in motions if find(*motion[:2]) is None]
        found = at_once([partial(invert_motion, *planes) for _, _, planes in new])
        for (before, after, (motion, *_)), way in zip(new, found, strict=True):
            paths.refine(motion, way)
            self._inverted.append((before, after, way))
        return [way for motion in motions if (way := find(*motion[:2])) is not None]

    @cached_property
    def _where_flow_is_right(self) -> np.ndarray | None:
        """How much the picture by estimated motion counts in place of that by vectors (h, w, 1),
        where these lead a thin thing nowhere right; None where they do not."""
        ways = self._ways
        if ways is None or not (ways.vectors_fit and self._both_have(Role.DEPTH)):
            return None
        motion, depth = self._cells_of(self.after)
        depths = self._cells_of(self.before)[1], depth
        seen = Seen(self._lit(0.5), float(self._level), self.after[Role.DEPTH], motion, depths,
                    self._scale)
        found = where_flow_is_right(seen, self._enlarge(self._estimated[0]), self._estimated_back,
                                    ways.apart)
        if found is None:
            return None
        rows, columns = (np.minimum(np.arange(side) // self._scale, count - 1)
                         for side, count in zip(self._size, self._grid, strict=True))
        return found[rows[:, None], columns][..., None]

    @cached_property
    def _paths(self) -> tuple[paths.Paths, paths.Paths]:
        """Paths of cells of both frames through the time between."""
        has_depth = self._has_depth
        later = self._later if has_depth and self._goes_on else None
        frames = [self.before, self.after, *([] if later is None else [later])]
        (came, near), (motion, far), *beyond = at_once([partial(self._cells_of, frame)
                                                        for frame in frames])
        if not self._has_vectors:
            motion, later, beyond = self._estimated_back, None, []
        elif self._flow and (is_lost := np.isnan(motion[..., 0])).any():
            motion = np.where(is_lost[..., None], self._guess(1, is_lost), motion)
            no_way = np.isnan(came[..., 0])
            came = np.where(no_way[..., None], -self._guess(0, no_way), came)
        if not has_depth:
            near, far = self._rank(motion)
        known_from_before = (self._has_vectors and Role.MOTION in self.before
                             and not self.before.reset)
        motions: list[tuple[Frame, Frame, Three]] = [(self.before, self.after, (motion, far, near))]
        motions += [(self.after, frames[2], (onward, farther, far)) for onward, farther in beyond]
        ahead, *goes = self._invert(motions)
        first, last = paths.paths_of(motion, ahead, near, far, came if known_from_before else None,
                                     *goes)
        for side, frame in ((first, self.before), (last, self.after)):
            if any(frame.jitter):
                side.ends += np.array(frame.jitter * 2, np.float32) / np.float32(self._scale)
        return first, last

    @property
    def _goes_on(self) -> bool:
        """Whether the frame that follows is known, of this shot and size, and has motion and
        depth."""
        later = self._later
        if later is None or later.reset:
            return False
        return all(role in later and later[role].shape[:2] == self._size
                   for role in (Role.MOTION, Role.DEPTH))

    def _rank(self, motion: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Order of surfaces by the misfit of their paths, in place of depth, of both frames."""
        first, last = self._small
        even = np.ones((*self._grid, 1), np.float32)
        ahead = invert_motion(motion, even, even)
        return paths.rank_paths(first, last, ahead), paths.rank_paths(last, first, motion)

    @cached_property
    def _noise(self) -> np.float32:
        """Misfit of paths that are right, which is noise: the median."""
        _, last = self._paths
        found = measure_misfits(self._compared, last)
        found = found[found >= 0]
        return np.float32(np.median(found) if found.size else 0)

    # What is made for a time

    def _choose(self, t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """What `compose` takes of the cells at a time, their paths by planes alone, and marks of
        `settle_sparks`, None without sparks."""
        _ = (self._grid if self._both_have(Role.DEPTH) and Role.MOTION in self.after
             and not self._flow else self._toned)
        leading = begin(lambda: self._paths)
        _ = self._toned
        looking = begin(lambda: self._sparks)
        at_once([lambda: self._flows, lambda: self._known], waiting=True)
        first, last = leading.result()
        (one, near), (other, far), ahead, back = at_once([
            lambda: paths.splat_paths(first, t), lambda: paths.splat_paths(last, t),
            lambda: bring_to_time(self._flows[0], first.ends[..., 2:], *self._small, self._scale,
                                  t),
            lambda: bring_to_time(self._flows[1], last.ends[..., :2], *self._small[::-1],
                                  self._scale, 1 - t)])
        arrived = Arrived(one, other, near, far)
        own = merge_sides(arrived, self._scale)
        if any((*self.before.jitter, *self.after.jitter)):
            shift = np.array((*self.before.jitter, *self.after.jitter), np.float32)
            own[..., :4] -= shift
            for side in (one, other):
                side[..., :4] -= shift / np.float32(self._scale)
        at_once([lambda: paths.fill_holes(own, np.minimum(near, far)), lambda: self._noise])
        measure_change(arrived, self._scale, own)
        cells = choose_paths(self._compared, own, arrived, Flows(ahead, back, self._mirrored),
                             (first, last), (t, float(self._noise)))
        sparks = looking.result()
        marks = None if sparks is None else settle_sparks(sparks, t, own, cells)
        join_cells(cells)
        measure_detail(self._compared, float(self._noise), cells)
        return cells, own, marks

    def _make_planes(self, t: float,
                     previous: float) -> tuple[dict[Role, np.ndarray], dict[str, np.ndarray]]:
        """Planes and parts at a time."""
        before, after = self.before, self.after
        light: dict[Role | str, Pair] = {role: (_finite(before[role]), _finite(after[role]))
                                         for role in MIXED_PLANES if self._both_have(role)}
        light |= self._light_parts
        if self._part_changes:
            light[AFTER_SHARE] = self._even(0), self._even(1)
        data: dict[Role | str, Pair] = {role: (before[role], after[role])
                                        for role in DATA if self._both_have(role)}
        data |= {name: (before.parts[name], after.parts[name]) for name in self._shared_parts
                 if self._is_exact(name)}
        stacks = self._stack(light), self._stack(data)
        (picture, mixed, taken, motion), own, marks = self._compose(t, previous, *stacks)
        picture, mixed = self._weigh(t, (picture, mixed), light)
        if self._pictures is self._colours:
            follow_light((self._earlier, before, after, self._later), t, picture)
        if self._sparks is not None and marks is not None:
            keep_sparks(self._sparks, t, own, marks, picture)
        made = split_planes(mixed, light)
        if self._part_changes:
            light_parts(made, self._part_changes, t, made.pop(AFTER_SHARE))
        follow_picture(made, self._sets, picture)
        made |= split_planes(taken, data)
        made[Role.COLOUR] = self._put_over(picture, t)
        if Role.MOTION in after:
            made[Role.MOTION] = motion
        if self._both_have(Role.OPAQUE_COLOUR):
            made[Role.OPAQUE_COLOUR] = picture
        if self._both_have(Role.OVERLAY):
            made[Role.OVERLAY] = self._overlay_at(t)
        return ({role: plane for role, plane in made.items() if isinstance(role, Role)},
                {name: plane for name, plane in made.items() if not isinstance(name, Role)})

    def _compose(self, t: float, previous: float, light: Pair, data: Pair,
                 pictures: Pair | None = None
                 ) -> tuple[tuple[np.ndarray, ...], np.ndarray, np.ndarray | None]:
        """What `compose` makes of both frames along paths, of planes that are mixed and of those
        that are taken; then the last two of `_choose`. pictures: in place of the colours."""
        cells, own, marks = self._choose(t)
        # to an earlier time, of paths at t: Lagrange's polynomial through their places at 0, t and
        # 1
        back = (previous - t) * (previous - 1) / t, previous * (previous - t) / (1 - t)
        planes = Planes(pictures or self._lit(t), self._known, self._depths, light, data)
        mixture = Mixture(t, self._scale, float(self._level), self._masked, back)
        return compose(cells, planes, mixture, Role.MOTION in self.after), own, marks

    def _stack(self, planes: dict[Role | str, Pair]) -> Pair:
        """All channels of planes of both frames."""
        return (stack_planes([pair[0] for pair in planes.values()], self._size),
                stack_planes([pair[1] for pair in planes.values()], self._size))

    def _even(self, value: float) -> np.ndarray:
        """A plane (h, w, 1) of one number."""
        return np.full((*self._size, 1), value, np.float32)

    def _weigh(self, t: float, made: Pair, planes: dict[Role | str, Pair]) -> Pair:
        """The picture of a time and planes that are mixed like it, by all ways as they count;
        `made` along paths. planes: those of both frames."""
        shares, by_flow = self._shares, self._where_flow_is_right
        if shares == BY_VECTORS and by_flow is None:
            return made
        stacked = self._stack(planes)
        ways = [made, made, (_mean_at(self._pictures, t), _mean_at(stacked, t)), made]
        if shares[1] or shares[3] or by_flow is not None:
            flowing = self._without_vectors._compose(t, 0.0, stacked, self._stack({}))[0]
            ways[1] = flowing[0], flowing[1]
        if shares[3]:
            ways[3] = self._over_shot(t, planes)
        picture, mixed = np.zeros_like(made[0]), np.zeros_like(made[1])
        for share, way in zip(shares, ways, strict=True):
            if share:
                picture += np.float32(share) * way[0]
                mixed += np.float32(share) * way[1]
        if by_flow is not None:
            picture += by_flow * (ways[1][0] - picture)
            mixed += by_flow * (ways[1][1] - mixed)
        return picture, mixed

    def _over_shot(self, t: float, planes: dict[Role | str, Pair]) -> Pair:
        """The picture of a shot that moves by the vectors and goes over into another one, or the
        reverse, and planes that are mixed like it: the straight course of each point along the
        vectors, and what is beside it along estimated motion."""
        way = enlarge_motion(self._vectors / np.float32(self._scale), *self._size)
        led = partial(_led, way) if way.any() else (lambda picture, _: picture)
        row = [_finite(frame[Role.COLOUR]) for frame in self._row]
        stacks = [self._stack_of(number, planes) for number in range(len(row))]
        courses, rests = [], []
        for frames in (row, stacks):
            at_time = [led(one, 1 + t - number) for number, one in enumerate(frames)]
            mean, growth = straight_course(at_time)
            courses.append(mean + np.float32(t - 0.5) * growth)
            rests.append([led(rest_of(at_time, number), number - 1 - t) for number in (1, 2)])
        before, after = rests[0]
        least = min(before.min(), after.min())  # pictures are not below 0
        moved = self._without_vectors._compose(t, 0.0, (rests[1][0], rests[1][1]), self._stack({}),
                                               (before - least, after - least))[0]
        return courses[0] + moved[0] + least, courses[1] + moved[1]

    def _stack_of(self, number: int, planes: dict[Role | str, Pair]) -> np.ndarray:
        """All channels of planes and parts of a frame of `_row`; those that it has not are of the
        nearer one of both frames."""
        frame, found = self._row[number], []
        for name, pair in planes.items():
            nearer = pair[0 if number < 2 else 1]
            if name == AFTER_SHARE:
                plane = self._even(number - 1)
            elif isinstance(name, Role):
                plane = frame.planes.get(name, nearer)
            else:
                plane = frame.parts.get(name, nearer)
            found.append(_finite(plane if plane.shape == nearer.shape else nearer))
        return stack_planes(found, self._size)

    def _overlay_at(self, t: float) -> np.ndarray:
        one, other = self._overlays
        mixed: np.ndarray = one + np.float32(0 if self._overlay == "hold" else t) * (other - one)
        return mixed

    def _put_over(self, picture: np.ndarray, t: float) -> np.ndarray:
        """The picture between with what lies over it."""
        if self._composited:
            overlay = self._overlay_at(t)
            covered: np.ndarray = overlay[..., :3] + (1 - overlay[..., 3:]) * picture
            return covered
        one, other = self._colours
        if self._both_have(Role.OPAQUE_COLOUR):
            clear = measure_clearness(one, other, *self._pictures)
            mean = self._pictures[0] + np.float32(t) * (self._pictures[1] - self._pictures[0])
            drawn: np.ndarray = one + np.float32(t) * (other - one) + clear * (picture - mean)
            return drawn
        return np.where(self._known[0][..., None], picture, one) if self._masked else picture


class Interpolator:
    """Frames between the last two frames of a stream, for live use. Stateful: push frames in order.

    Options are those of `Between`. `push` finds cuts. The frame before the last two bends motion, a
    later one does not.

    Attributes:
        between: the time between the last two frames; None before there are two.
    """

    def __init__(self, *, flow: bool = True, overlay: str = "mix",
                 composited: bool = False) -> None:
        self._options: dict[str, Any] = {"flow": flow, "overlay": overlay, "composited": composited}
        self._detector, self._times = CutDetector(), [0.0, 0.0]
        self._last: Frame | None = None
        self.between: Between | None = None

    @property
    def ready(self) -> bool:
        """Whether two frames were pushed."""
        return self.between is not None

    @property
    def reason(self) -> str | None:
        """Why nothing is interpolated between the last two frames; None if it is."""
        return "there are no two frames yet" if self.between is None else self.between.reason

    def push(self, frame: Frame, delta: float = 1.0) -> None:
        """Take the next frame, `delta` after the one before it, in any unit of time above 0."""
        _require_frame(frame)
        if not (isinstance(delta, Real) and delta > 0):
            raise FrameError(f"frame {frame.number} comes {delta} after the one before: give a "
                             "time above 0")
        is_cut = self._detector(frame)
        if self._last is not None:
            self.between = Between(self._last, frame, is_cut=is_cut, last=self.between,
                                   **self._options)
        self._last, self._times = frame, [self._times[1], self._times[1] + delta]

    def frame(self, t: float, number: int | None = None) -> Frame:
        """What is seen at a time between the last two frames, 0 to 1. FrameError before there are
        two."""
        if self.between is None:
            raise FrameError("nothing to interpolate: push two frames first")
        return self.between.frame(t, number)

    def at(self, time: float, number: int | None = None) -> Frame:
        """What is seen at a time in the unit of `push`, counted from the first frame's delta on.
        FrameError before there are two frames."""
        first, last = self._times
        return self.frame((time - first) / (last - first), number)


def _without_motion(frame: Frame) -> Frame:
    """A frame without motion, and depth, which belongs to it; nor other views."""
    planes = dict(frame.planes)
    planes.pop(Role.MOTION, None)
    planes.pop(Role.DEPTH, None)
    return replace(frame, views={}, planes=planes)


def _is_held(one: Frame, other: Frame) -> bool:
    """Whether a frame is shown twice."""
    pictures = one[Role.COLOUR], other[Role.COLOUR]
    return pictures[0].shape == pictures[1].shape and is_same_plane(*pictures)


def _mean_at(pair: Pair, t: float) -> np.ndarray:
    """The mean of a plane of both frames, by time."""
    mean: np.ndarray = pair[0] + np.float32(t) * (pair[1] - pair[0])
    return mean


def _led(way: np.ndarray, picture: np.ndarray, time: float) -> np.ndarray:
    """A picture (h, w, channels) along motion (h, w, 2) to the frame before, after so many frames'
    time of it."""
    h, w = way.shape[:2]
    y, x = np.indices((h, w), np.float32)
    moved = np.float32(time) * way
    found: np.ndarray = bilinear(picture, (x + moved[..., 0]).ravel(), (y + moved[..., 1]).ravel())
    return np.ascontiguousarray(found.reshape(picture.shape))


def _at_cells(toned: np.ndarray, scale: int) -> np.ndarray:
    """A grey picture with margins, at one pixel a cell."""
    return (halve(toned, MARGIN) if scale == 2
            else np.ascontiguousarray(toned[MARGIN:-MARGIN, MARGIN:-MARGIN]))


def _without_lost(motion: np.ndarray, longest: np.float32) -> np.ndarray:
    """Motion with NaN where it is longer than any, or where it is not finite."""
    is_kept = np.abs(motion).max(axis=2, keepdims=True) <= longest
    return motion if is_kept.all() else np.where(is_kept, motion, np.float32(np.nan))


def _finite(plane: np.ndarray) -> np.ndarray:
    """The plane with 0 for what is not finite, within MOST_COUNTED_LIGHT; itself if all of it is
    and it lies in one piece."""
    plane = np.ascontiguousarray(plane)
    if largest_bits_of(plane) <= MOST_COUNTED_LIGHT.view(np.uint32):
        return plane
    found: np.ndarray = np.nan_to_num(plane, nan=0, posinf=0, neginf=0).clip(-MOST_COUNTED_LIGHT,
                                                                             MOST_COUNTED_LIGHT)
    return found


def _require_frame(frame: object) -> None:
    """FrameError for anything else."""
    if not isinstance(frame, Frame):
        raise FrameError(f"frames between are made of postfx.Frame, not {type(frame).__name__}: "
                         "give Frame({'colour': array})")
