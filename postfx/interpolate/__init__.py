"""Frames between frames: what a sequence shows at times at which no frame was rendered.

`Between` is the time between two frames. A reader may follow it in this order:

    pictures     what both frames show, without overlays, in the light of a time
    pair_motion  how things move: by vectors, or as `postfx.motion.flow` estimates it from pictures
    paths        paths of cells of a few pixels through the time between; both frames' paths are
                 splatted to the time that is asked for
    choose       which of the paths that meet at a cell shows it
    blend        the picture, taken from both frames along the chosen paths
    shares       how much this picture counts, beside the one along estimated motion and a blend
    timing       which times and numbers new frames get; the course of light through four frames

docs/lab/interpolation.md has the measurements.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property, partial
from numbers import Real
from typing import Any, NamedTuple

import numpy as np

from postfx.caching import reuse_memory
from postfx.cuts import CutDetector
from postfx.errors import FrameError
from postfx.frame import ALBEDOS, Frame, Role
from postfx.interpolate.blend import (
    Mixture,
    Pair,
    PairPlanes,
    compose,
    join_cells,
    split_planes,
    stack_planes,
)
from postfx.interpolate.choose import (
    Arrived,
    Flows,
    choose_paths,
    measure_change,
    measure_detail,
    merge_sides,
)
from postfx.interpolate.overlays import measure_clearness
from postfx.interpolate.pair_motion import PairMotion, without_lost
from postfx.interpolate.parts import (
    Sets,
    changes_of_parts,
    find_common_sets,
    follow_picture,
    light_parts,
)
from postfx.interpolate.paths import fill_holes, splat_paths
from postfx.interpolate.pictures import PairPictures, finite
from postfx.interpolate.shares import (
    BY_MEAN,
    BY_VECTORS,
    Neighbours,
    Shares,
    shares_beside_vectors,
    shares_without_vectors,
)
from postfx.interpolate.timing import (
    Sparks,
    camera_between,
    find_sparks,
    follow_light,
    keep_sparks,
    settle_sparks,
)
from postfx.interpolate.ways import compare_motion, rest_of, straight_course
from postfx.motion.flow import bring_to_time, enlarge_motion
from postfx.planes import is_same_plane
from postfx.sampling import bilinear
from postfx.system import at_once, begin

MIXED_PLANES = (*ALBEDOS, Role.ROUGHNESS, Role.ALPHA)
"""Planes that are mixed from both frames, as the colour is."""
TAKEN_PLANES = (Role.DEPTH, Role.NORMAL, Role.SPECULAR_HIT_DISTANCE, Role.STRENGTH, Role.REACTIVE)
"""Planes that are taken from one frame's nearest pixel."""
AFTER_SHARE = "share of the frame after"
"""Name of a plane that is mixed beside parts: 0 in the frame before, 1 in the one after."""
OVERLAYS = ("mix", "hold")
"""Values of the option `overlay`."""
CAMERA_ATTRIBUTES = ("worldToCamera", "worldToNDC")
"""Attributes of a camera, of which the first one is made for the time."""
CUT_REASON = "another shot begins"
STILL_REASON = "nothing changes"


class Chosen(NamedTuple):
    """The paths of the cells at a time.

    Attributes:
        cells: (rows, columns, 8) the path that each cell follows, see `blend`.
        own: (rows, columns, 8) the paths by planes alone, before others were chosen.
        spark_marks: of `settle_sparks`; None without sparks.
    """

    cells: np.ndarray
    own: np.ndarray
    spark_marks: np.ndarray | None


class Composed(NamedTuple):
    """What both frames make along the chosen paths.

    Attributes:
        picture: colour (h, w, 3).
        mixed: planes (h, w, n) that are mixed as the colour is.
        taken: planes (h, w, m) that are taken from one frame's nearest pixel.
        motion: (h, w, 2) in pixels; empty where it is not asked for.
        chosen: the paths.
    """

    picture: np.ndarray
    mixed: np.ndarray
    taken: np.ndarray
    motion: np.ndarray
    chosen: Chosen


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
        self._earlier = last.before if last is not None and last.after is before else None
        self._later = later
        self._memory = reuse_memory()
        self._pictures = PairPictures(before, after, flow=flow, composited=composited)
        self._motion: PairMotion = PairMotion(self._pictures, later, flow,
                                              last._motion if last else None)
        # sets of parts that were found in the frames before
        self._known_sets: Sets | None = last._found_sets if last else None
        self._found_sets: Sets | None = self._known_sets
        self._options: dict[str, Any] = {"flow": flow, "overlay": overlay, "composited": composited}
        self._flow = flow
        self._holds_overlay = overlay == "hold"
        self.reason = self._find_reason(is_cut)

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
        """Motion (h, w, 2), in pixels, of the frame after to a time between, `previous`: its plane
        `motion` once a frame is there."""
        pictures, motion = self._pictures, self._motion
        _, last = motion.paths
        whole = (last.ends[..., :2]
                 - np.array(self.after.jitter, np.float32) / np.float32(pictures.scale))
        bend = last.bend
        if pictures.scale > 1:
            whole, bend = (enlarge_motion(np.ascontiguousarray(one), *pictures.size)
                           for one in (whole, bend))
        if motion.has_vectors:
            given = without_lost(self.after[Role.MOTION], pictures.longest_px)
            whole = np.where(np.isnan(given), whole, given)
        found: np.ndarray = (whole * np.float32(1 - previous)
                             + bend * np.float32(previous * (previous - 1)))
        return found

    def _both_have(self, role: Role) -> bool:
        return self._pictures.both_have(role)

    def _find_reason(self, is_cut: bool) -> str | None:
        one, other = self.before.spec, self.after.spec
        if (one.width, one.height) != (other.width, other.height):
            return f"sizes differ: {one.width}x{one.height} and {other.width}x{other.height}"
        if is_cut or self.after.reset:
            return CUT_REASON
        planes = [role for role in (Role.COLOUR, Role.ALPHA, Role.OVERLAY) if self._both_have(role)]
        same = all(is_same_plane(self.before[role], self.after[role]) for role in planes)
        return STILL_REASON if same else None

    # What is found once for all times: parts, sparks

    @cached_property
    def _light_parts(self) -> dict[str, Pair]:
        """Parts of both frames that are mixed as the picture is."""
        before, after = self.before, self.after
        return {name: (finite(before.parts[name]), finite(after.parts[name]))
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
        pictures = self._pictures
        scale = np.float32(pictures.scale)
        motion = (self.after[Role.MOTION] if self._motion.has_vectors else
                  scale * self._motion.estimated_back)
        if motion.shape[:2] != pictures.size:
            motion = enlarge_motion(np.ascontiguousarray(motion / scale), *pictures.size)
        return changes_of_parts(self._light_parts, motion, float(pictures.longest_px))

    @cached_property
    def _sets(self) -> Sets:
        """Parts that add up to the picture in both frames."""
        self._found_sets = find_common_sets(self._pictures.scene, self._light_parts,
                                            self._known_sets)
        return self._found_sets

    @cached_property
    def _sparks(self) -> Sparks | None:
        """Sparks of both frames; None without, without flow, and where overlays left black
        pixels."""
        pictures = self._pictures
        if not self._flow or pictures.composited or not self._motion.has_vectors:
            return None
        scene, scale, dim = pictures.scene, pictures.scale, float(pictures.dim)
        marks = [find_sparks(picture, scale, dim, pictures.grid) for picture in scene]
        is_there = marks[0].any() or marks[1].any()
        return Sparks(scene, marks, scale, dim) if is_there else None

    # What is found once for all times: how much each picture counts

    @cached_property
    def _shares(self) -> Shares:
        """How much each picture counts. The mean alone does where one frame is black, as nothing
        shows how its light changed."""
        motion = self._motion
        if not all(picture.any() for picture in self._pictures.scene):
            return BY_MEAN
        if motion.fit is not None:
            return shares_beside_vectors(motion.fit, self._neighbours, motion.vectors_px,
                                         self._both_have(Role.DEPTH), self._find_flow_alone)
        if Role.MOTION in self.after or not self._flow:
            return BY_VECTORS
        flow = motion.estimated_back
        fit = compare_motion(*self._pictures.small, flow, flow)
        scale = np.float32(self._pictures.scale)
        return shares_without_vectors(fit, self._neighbours, scale * flow)

    @cached_property
    def _without_vectors(self) -> Between:
        """The time between both frames by estimated motion alone."""
        return Between(_without_motion(self.before), _without_motion(self.after), **self._options)

    def _find_flow_alone(self) -> np.ndarray:
        """Motion (rows, columns, 2) that is estimated without vectors, in pixels."""
        scale = np.float32(self._pictures.scale)
        found: np.ndarray = scale * self._without_vectors._motion.estimated_back
        return found

    @cached_property
    def _neighbours(self) -> Neighbours:
        """The colours of the frames around."""
        colours = [frame[Role.COLOUR] for frame in self._frames_around]
        first = self._frames_around.index(self.before)
        return Neighbours(colours, first, float(self._pictures.level))

    @cached_property
    def _frames_around(self) -> list[Frame]:
        """Both frames, and those beside them of this shot and size that are known and no copies of
        them: nothing goes on evenly where frames are held."""
        row = [self.before, self.after]
        earlier, later = self._earlier, self._later
        if earlier is not None and not self.before.reset and not _is_held(earlier, self.before):
            row.insert(0, earlier)
        if later is not None and not later.reset and not _is_held(self.after, later):
            row.append(later)
        size = self._pictures.size
        is_even = all(frame[Role.COLOUR].shape[:2] == size for frame in row)
        return row if is_even else [self.before, self.after]

    # What is made for a time

    def _make_planes(self, t: float,
                     previous: float) -> tuple[dict[Role, np.ndarray], dict[str, np.ndarray]]:
        """Planes and parts at a time."""
        before, after, pictures = self.before, self.after, self._pictures
        light: dict[Role | str, Pair] = {role: (finite(before[role]), finite(after[role]))
                                         for role in MIXED_PLANES if self._both_have(role)}
        light |= self._light_parts
        if self._part_changes:
            light[AFTER_SHARE] = self._constant(0), self._constant(1)
        data: dict[Role | str, Pair] = {role: (before[role], after[role])
                                        for role in TAKEN_PLANES if self._both_have(role)}
        data |= {name: (before.parts[name], after.parts[name]) for name in self._shared_parts
                 if self._is_exact(name)}
        composed = self._compose(t, previous, self._stack(light), self._stack(data))
        picture, mixed = self._weigh(t, (composed.picture, composed.mixed), light)
        if pictures.scene is pictures.colours:
            follow_light((self._earlier, before, after, self._later), t, picture)
        _, own, marks = composed.chosen
        if self._sparks is not None and marks is not None:
            keep_sparks(self._sparks, t, own, marks, picture)
        made = split_planes(mixed, light)
        if self._part_changes:
            light_parts(made, self._part_changes, t, made.pop(AFTER_SHARE))
        follow_picture(made, self._sets, picture)
        made |= split_planes(composed.taken, data)
        made[Role.COLOUR] = self._put_over(picture, t)
        if Role.MOTION in after:
            made[Role.MOTION] = composed.motion
        if self._both_have(Role.OPAQUE_COLOUR):
            made[Role.OPAQUE_COLOUR] = picture
        if self._both_have(Role.OVERLAY):
            made[Role.OVERLAY] = self._overlay_at(t)
        return ({role: plane for role, plane in made.items() if isinstance(role, Role)},
                {name: plane for name, plane in made.items() if not isinstance(name, Role)})

    def _compose(self, t: float, previous: float, light: Pair, data: Pair,
                 pictures: Pair | None = None) -> Composed:
        """Both frames along the paths of a time.

        Args:
            light: channels (h, w, n) of both frames that are mixed as colours are.
            data: channels (h, w, m) that are taken from one frame's nearest pixel.
            pictures: colours in place of the frames' own.
        """
        chosen = self._choose(t)
        # motion leads to an earlier time: Lagrange's polynomial through a path's places at the
        # times 0, t and 1
        back = (previous - t) * (previous - 1) / t, previous * (previous - t) / (1 - t)
        motion, own = self._motion, self._pictures
        planes = PairPlanes(pictures or own.lit(t), motion.known, motion.depths, light, data)
        mixture = Mixture(t, own.scale, float(own.level), motion.is_masked, back)
        picture, mixed, taken, vectors = compose(chosen.cells, planes, mixture,
                                                 Role.MOTION in self.after)
        return Composed(picture, mixed, taken, vectors, chosen)

    def _choose(self, t: float) -> Chosen:
        """The paths of the cells at a time."""
        pictures, motion = self._pictures, self._motion
        # Properties are made in this order, each by one thread alone: the paths, which take
        # longest, begin first, after the grey pictures if they need them.
        needs_no_pictures = (self._both_have(Role.DEPTH) and Role.MOTION in self.after
                             and not self._flow)
        _ = pictures.grid if needs_no_pictures else pictures.toned
        leading = begin(lambda: motion.paths)
        _ = pictures.toned
        looking = begin(lambda: self._sparks)
        at_once([lambda: motion.flows_px, lambda: motion.known], waiting=True)
        first, last = leading.result()
        small, scale = pictures.small, pictures.scale
        (one, near), (other, far), ahead, back = at_once([
            lambda: splat_paths(first, t), lambda: splat_paths(last, t),
            lambda: bring_to_time(motion.flows_px[0], first.ends[..., 2:], *small, scale, t),
            lambda: bring_to_time(motion.flows_px[1], last.ends[..., :2], *small[::-1], scale,
                                  1 - t)])
        arrived = Arrived(one, other, near, far)
        own = merge_sides(arrived, scale)
        if any((*self.before.jitter, *self.after.jitter)):
            shift = np.array((*self.before.jitter, *self.after.jitter), np.float32)
            own[..., :4] -= shift
            for side in (one, other):
                side[..., :4] -= shift / np.float32(scale)
        at_once([lambda: fill_holes(own, np.minimum(near, far)), lambda: motion.noise])
        measure_change(arrived, scale, own)
        cells = choose_paths(motion.compared, own, arrived, Flows(ahead, back, motion.mirrored_px),
                             (first, last), (t, float(motion.noise)))
        sparks = looking.result()
        marks = None if sparks is None else settle_sparks(sparks, t, own, cells)
        join_cells(cells)
        measure_detail(motion.compared, float(motion.noise), cells)
        return Chosen(cells, own, marks)

    def _weigh(self, t: float, made: Pair, planes: dict[Role | str, Pair]) -> Pair:
        """The picture of a time, and the planes that are mixed as it is, by all ways as much as
        they count.

        Args:
            made: both along the chosen paths.
            planes: those of both frames.
        """
        shares, by_flow = self._shares, self._motion.where_flow_is_right
        if shares == BY_VECTORS and by_flow is None:
            return made
        stacked = self._stack(planes)
        ways = [made, made, (_mean_at(self._pictures.scene, t), _mean_at(stacked, t)), made]
        if shares.flow or shares.over_shot or by_flow is not None:
            flowing = self._without_vectors._compose(t, 0.0, stacked, self._stack({}))
            ways[1] = flowing.picture, flowing.mixed
        if shares.over_shot:
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
        """The picture of a shot that moves by its vectors and dissolves into another one, or the
        reverse, and the planes that are mixed as it is.

        Each point's light has a straight course along the vectors, through four frames. What is
        left beside that course is the other shot, and goes along estimated motion.
        """
        way = enlarge_motion(self._motion.vectors_px / np.float32(self._pictures.scale),
                             *self._pictures.size)
        led = partial(_led, way) if way.any() else (lambda picture, _: picture)
        row = [finite(frame[Role.COLOUR]) for frame in self._frames_around]
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
                                               (before - least, after - least))
        return courses[0] + moved.picture + least, courses[1] + moved.mixed

    def _stack(self, planes: dict[Role | str, Pair]) -> Pair:
        """All channels of planes of both frames."""
        size = self._pictures.size
        return (stack_planes([pair[0] for pair in planes.values()], size),
                stack_planes([pair[1] for pair in planes.values()], size))

    def _stack_of(self, number: int, planes: dict[Role | str, Pair]) -> np.ndarray:
        """All channels of planes and parts of a frame of `_frames_around`. Those that it lacks are
        taken from the nearer of the two frames."""
        frame, found = self._frames_around[number], []
        for name, pair in planes.items():
            nearer = pair[0 if number < 2 else 1]
            if name == AFTER_SHARE:
                plane = self._constant(number - 1)
            elif isinstance(name, Role):
                plane = frame.planes.get(name, nearer)
            else:
                plane = frame.parts.get(name, nearer)
            found.append(finite(plane if plane.shape == nearer.shape else nearer))
        return stack_planes(found, self._pictures.size)

    def _constant(self, value: float) -> np.ndarray:
        """A plane (h, w, 1) of one number."""
        return np.full((*self._pictures.size, 1), value, np.float32)

    def _overlay_at(self, t: float) -> np.ndarray:
        """The overlay (h, w, 4) of a time."""
        one, other = self._pictures.overlays
        mixed: np.ndarray = one + np.float32(0 if self._holds_overlay else t) * (other - one)
        return mixed

    def _put_over(self, picture: np.ndarray, t: float) -> np.ndarray:
        """The picture between with what lies over it."""
        pictures = self._pictures
        if pictures.composited:
            overlay = self._overlay_at(t)
            covered: np.ndarray = overlay[..., :3] + (1 - overlay[..., 3:]) * picture
            return covered
        one, other = pictures.colours
        if self._both_have(Role.OPAQUE_COLOUR):
            clear = measure_clearness(one, other, *pictures.scene)
            mean = _mean_at(pictures.scene, t)
            drawn: np.ndarray = one + np.float32(t) * (other - one) + clear * (picture - mean)
            return drawn
        if not self._motion.is_masked:
            return picture
        return np.where(self._motion.known[0][..., None], picture, one)


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
    """A picture (h, w, channels) moved along motion (h, w, 2) to the frame before, by so many
    frames of time."""
    h, w = way.shape[:2]
    y, x = np.indices((h, w), np.float32)
    moved = np.float32(time) * way
    found: np.ndarray = bilinear(picture, (x + moved[..., 0]).ravel(), (y + moved[..., 1]).ravel())
    return np.ascontiguousarray(found.reshape(picture.shape))


def _require_frame(frame: object) -> None:
    """FrameError for anything else."""
    if not isinstance(frame, Frame):
        raise FrameError(f"frames between are made of postfx.Frame, not {type(frame).__name__}: "
                         "give Frame({'colour': array})")
