"""Sequences of frames on the disk."""

from __future__ import annotations

import copy
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import replace
from functools import update_wrapper
from inspect import Signature, signature
from itertools import takewhile
from numbers import Integral
from operator import index
from pathlib import Path
from typing import TYPE_CHECKING, Concatenate, ParamSpec

import numpy as np

from postfx.errors import ColourError, MissingFrameError, PostfxError, SequenceError, offer, suggest
from postfx.frame import LOG, Frame, Role, find_role
from postfx.io.colours import ColourSpace, InputColours, parse_colourspace
from postfx.io.frame_reader import READ_ALL, FrameFiles
from postfx.io.pattern import (
    VIEW_FIELD,
    Pattern,
    Source,
    describe_absence,
    format_frames,
    locate,
    parse_frames,
)
from postfx.io.read_options import AUTO_MOTION, ReadOptions, parse_views
from postfx.io.read_plan import MOST_READ_PLANS, Area, Plans, ReadPlan, Settled
from postfx.io.windows import scale_windows
from postfx.masks.cryptomatte import Coverage
from postfx.motion import MOTION_SOURCES
from postfx.planes import is_finite
from postfx.repair import Fireflies, clamp_fireflies
from postfx.spelling import in_our_spelling
from postfx.streams import make_printable

if TYPE_CHECKING:
    from postfx.motion.estimated import Picture

Given = ParamSpec("Given")
Frames = dict[int, dict[str, Path]]
"""Frame number -> plane word -> file."""


class Sequence:
    """Frames of a pattern, a folder or a single file; iterating reads them one by one.

    A frame read after another than its predecessor on the disk is marked as a cut (`Frame.reset`),
    because its motion vectors lead to a frame that was left out; while iterating, what else is read
    meanwhile does not count.

    Attributes:
        pattern: how the files are named.
        guides: sequence of the files of the planes at output size, None where they are in the same
            files or absent.
        numbers: frame numbers, in order of processing. Holes in what is on the disk are kept as
            numbers: reading such a frame raises MissingFrameError.
        colours: in which primaries the files hold colours, and whether they are converted to
            Rec.709; may be replaced.
        warnings: oddities of the files read so far, each once.
        coverage: how much of the frames read so far was left as it is.
        options: how it is read; may be replaced.
        view: of stereo files, the view that frames are of; None for the first, until a frame was
            opened. Where views have files of their own ({view} in `pattern`), all are read if none
            is asked for.
        fireflies: what `clamp_fireflies` took of the frames that were read.
        views: other views that are read with each frame, into `Frame.views`; those of 'all' are
            known as soon as a frame was opened.
    """

    def __init__(self, source: Source, options: ReadOptions = READ_ALL) -> None:
        self.options = options
        self.fireflies = Fireflies()
        # Of each view's frame that was read last.
        self._pictures: dict[str | None, tuple[int, Picture | None]] = {}
        self._plans = Plans(MOST_READ_PLANS)
        options.check()
        self._layer = options.layer
        self.view, self.views, self._all_views = parse_views(options.view)

        # Which files there are.
        self.pattern, named = locate(source)
        self._found = _files_of(self.pattern)
        if not self._found:
            raise SequenceError(f"{source}: {describe_absence(self.pattern)}")
        if self.pattern.has_views:
            self._choose_views()
        self._known_views = (self.view, *self.views)
        self._named = False
        # The plan and the colours whose warnings were told last, and the space that they mean.
        self._told: tuple[ReadPlan, InputColours] | None = None
        self._space: ColourSpace | None = None
        self._areas: dict[str | None, Area | None] = {}
        self.coverage = Coverage()
        self.colours = parse_colourspace(options.colourspace)
        self.guides = self._find_guides()
        self.warnings: list[str] = []
        self._warn_of_overlooked()
        if options.guides is not None and options.own_size:
            self.warn(f"{options.guides}: guides are not read, as frames keep their own size")

        # Which frames are wanted.
        self._step = _step(self.present())
        self._last: int | None = None
        asked = options.frames if options.frames is not None else named or self._on_disk()
        wanted = [int(asked)] if isinstance(asked, int | Integral) else asked  # or NumPy's
        try:
            self.numbers = tuple(
                parse_frames(wanted) if isinstance(wanted, str) else map(index, wanted)
            )
        except TypeError:
            raise SequenceError(f"frames {wanted!r}: give a text such as '1-100', a whole number, "
                                "or a list of them") from None
        guides = options.guides
        if self.guides and not self.guides.pattern.is_numbered and len(self.numbers) > 1:
            raise SequenceError(
                f"{guides}: one file of guides for {len(self)} frames: name them like "
                "guides.####.exr"
            )
        if self.guides and self.guides.pattern.has_views != self.pattern.has_views:
            raise SequenceError(
                f"{guides}: guides have files for each view where frames do: put {VIEW_FIELD} into "
                "both"
            )

    def __repr__(self) -> str:
        """The files, and which frames of them."""
        return f"Sequence({str(self.pattern)!r}, frames={format_frames(self.numbers)!r})"

    def __reduce__(self) -> tuple[type[Sequence], tuple[str, ReadOptions]]:
        """Pickles which frames there are and how they are read: the copy begins anew."""
        return type(self), (str(self.pattern), replace(self.options, frames=self.numbers))

    def __copy__(self) -> Sequence:
        """Shares what is known of the files; `copy` would pickle it."""
        found = type(self).__new__(type(self))
        found.__dict__ |= self.__dict__
        return found

    def __len__(self) -> int:
        return len(self.numbers)

    def __iter__(self) -> Iterator[Frame]:
        previous = None
        for number in self.numbers:
            yield self._read(number, previous)
            previous = number

    def reader(self, view: str | None = None) -> Sequence:
        """The same frames, of one view alone, to be read independently: `coverage` is its own."""
        found = copy.copy(self)
        found.coverage, found.fireflies = Coverage(), Fireflies()
        found.view, found.views, found._all_views = view or self.view, (), False
        return found

    def first_view(self) -> Sequence:
        """The same frames of the first view alone; a warning names the others."""
        if not self.views:
            return self
        self.warn(f"view {self.view} is used, not {', '.join(self.views)}: --view chooses one")
        return self.reader()

    def pictures(self) -> Sequence:
        """The same frames without guides and without `leave`."""
        found = copy.copy(self)
        found.guides, found.fireflies = None, Fireflies()
        found.options = replace(self.options, guides=None, leave=None)
        return found

    def look_again(self, step: int) -> None:
        """Take notice of files that were written since the sequence was made; step: from one frame
        to the next, which files that are not there yet do not tell."""
        self._found, self._step = _files_of(self.pattern), step
        self._pictures.clear()
        if self.guides:
            self.guides.look_again(step)

    def rewind(self) -> None:
        """The next frame that is read does not count as a cut, whatever was read before."""
        self._last = None

    def before(self, number: int, count: int) -> list[int]:
        """Up to `count` frames that lead to a frame without a hole between them, on the disk and in
        order."""
        earlier = [number - self._step * distance for distance in range(count, 0, -1)]
        return list(takewhile(self.holds, reversed(earlier)))[::-1]

    def read_for_motion(self, number: int) -> list[int]:
        """The frame before one that does not begin a shot, where motion may be estimated from it;
        empty for none."""
        if not self.options.estimates_motion:
            return []
        before = self.before(number, 1)
        if not before or self.begins_shot(number):
            return []
        with self.open(number) as files:
            return before if files.lacks_motion else []

    def after(self, number: int, count: int) -> list[int]:
        """Up to `count` frames that follow a frame without a hole between them, on the disk and in
        order."""
        return list(
            takewhile(
                self.holds, (number + self._step * distance for distance in range(1, count + 1))
            )
        )

    def holds(self, number: int) -> bool:
        """Whether a frame, wanted or not, is on the disk, and its guides are."""
        return all(number in frames for frames in self._read_files()) and (
            self.guides is None or not self.guides.pattern.is_numbered or self.guides.holds(number)
        )

    def present(self) -> list[int]:
        """Numbers of the frames on the disk, wanted or not, also of those that not all views
        have."""
        return sorted(set().union(*self._read_files()))

    def missing(self) -> list[int]:
        """Numbers of wanted frames that are not on the disk, or whose guides are not, in order."""
        return sorted({number for number in self.numbers if not self.holds(number)})

    def refuse_holes(self, numbers: Iterable[int]) -> None:
        """MissingFrameError that names all of these frames that are not on the disk."""
        self.refuse_none()
        numbers = list(numbers)
        missing = sorted({number for number in numbers if not self.holds(number)})
        if len(missing) == 1:
            self.inputs(missing[0])
        elif missing:
            own = (
                self.pattern
                if any(number not in frames for number in missing for frames in self._read_files())
                else None
            )
            pattern = own or f"guides {self.guides.pattern if self.guides else ''}"
            raise MissingFrameError(
                f"{pattern}: {len(missing)} of {len(numbers)} frames are missing: "
                f"{format_frames(missing)}: render them, leave them out with --frames, or give "
                "--on-error skip"
            )

    def refuse_none(self) -> None:
        """MissingFrameError that names what is on the disk where none of the wanted frames is."""
        there = self.present()
        if there and not {*self.numbers} & {*there}:
            raise MissingFrameError(
                f"{self.pattern}: there are frames {format_frames(there)}, none of "
                f"{format_frames(self.numbers)}: give --frames that are there"
            )

    def all_files(self) -> list[Path]:
        """Files of all frames on the disk, wanted or not, and of their guides."""
        own = [
            path
            for frames in self._found.values()
            for words in frames.values()
            for path in words.values()
        ]
        return own + (self.guides.all_files() if self.guides else [])

    def inputs(self, number: int) -> list[Path]:
        """All files that a frame is read from; MissingFrameError when one of them is not there."""
        found: list[Path] = []
        for one in (self, *map(self.reader, self.views if self.pattern.has_views else ())):
            found += one.files(number).values()
            if one.guides:
                found += one._guide_files(number, one.guides).values()
        return found

    def files(self, number: int) -> dict[str, Path]:
        """Plane word ('' where one file holds all planes) -> file of a frame; MissingFrameError
        when it has none."""
        frames = self._found[self._key]
        if number not in frames:
            path = self.pattern.of_view(self.view or "").path(number)
            raise MissingFrameError(
                f"{path}: frame {number} is missing: render it or leave it out with --frames"
            )
        return frames[number]

    def _guide_files(self, number: int, guides: Sequence) -> dict[str, Path]:
        """Files of a frame's guides, by plane word, of those that have files of their own."""
        frames = guides._found[self._key]
        if not guides.pattern.is_numbered:
            return next(iter(frames.values()))
        if number not in frames:
            path = guides.pattern.of_view(self._key).path(number)
            raise MissingFrameError(
                f"{path}: guides of frame {number} are missing: render them or leave the frame out "
                "with --frames"
            )
        return frames[number]

    def shown_size(self, width: int, height: int) -> tuple[int, int]:
        """Width and height of the display window of an output of a size, which is larger where
        there is overscan."""
        found = self._areas.get(self.view)
        if found is None:
            return width, height
        display, area = found
        shown = scale_windows(area, display, display, width, height).display
        return shown.width, shown.height

    def open(self, number: int) -> FrameFiles:
        """Open files of a frame: its header and layout without its pixels. Use as a context
        manager."""
        guides = self._guide_files(number, self.guides) if self.guides else None
        view = None if self._key else self.view
        settled = Settled(view, self._layer, self._areas.get(self.view), self._named)
        files = FrameFiles(self.files(number), self.options, settled, guides, self._plans)
        self._layer = self._layer or files.layout.chosen_layer
        self._named = True  # a thing that was found need not be in every frame
        if self._all_views and files.views:
            self.view, *others = files.views
            self.views, self._known_views, self._all_views = tuple(others), files.views, False
        self._areas[self.view] = self._areas.get(self.view) or files.area
        if self._told != (files.plan, self.colours):
            self._space = self._tell_of(files)
            self._told = files.plan, self.colours
        return files

    def _tell_of(self, files: FrameFiles) -> ColourSpace:
        """Warn of what all frames with the plan of these files have in common; the space of their
        colours. Raises ColourError, and closes the files, where that is not known."""
        try:
            space = self.colours.space(files.layout.attributes)
        except ColourError as error:
            files.close()
            raise ColourError(f"{files.path}: {error}") from None
        for warning in (*files.layout.warnings, *self.colours.warnings(space)):
            self.warn(warning)
        if files.views:
            self._warn_of_views(files.views)
        return space

    def read(
        self,
        number: int,
        planes: Iterable[Role] | None = None,
        guides: Iterable[Role] | None = None,
        hold_rows: bool = False,
    ) -> Frame:
        """One frame with the wanted planes and guides (None: those of the constructor, or all).

        hold_rows: the frame keeps what was unpacked of the colour's part, half of the memory of all
        planes in it, so that `write_frame(keep=True)` need not unpack it again.

        Raises MissingFrameError, MissingPlaneError, GuideError or ReadError; FrameError for a word
        that is no role.
        """
        return self._read(
            number,
            self._last,
            None if planes is None else tuple(find_role(role) for role in planes),
            None if guides is None else tuple(find_role(role, "guide") for role in guides),
            hold_rows=hold_rows,
        )

    def begins_shot(self, number: int) -> bool:
        """Whether a frame is said to begin a shot, by the constructor's cuts or its header, whose
        errors are raised."""
        if self.options.cuts is not None:
            return number in self.options.cuts
        with self.open(number) as files:
            return files.begins_shot

    def coverage_of(self, number: int) -> Coverage:
        """How much of a frame `leave`, which must be given, leaves as it is."""
        with self.open(number) as files:
            files.read(number, [Role.STRENGTH], [])
            assert files.alone is not None, "asked only where --leave is given"
            return files.alone.shares

    def _read(
        self, number: int, previous: int | None, planes: Collection[Role] | None = None,
        guides: Collection[Role] | None = None, is_lenient: bool = False,
        hold_rows: bool = False
    ) -> Frame:
        """A frame that comes after `previous`, with all views; if `is_lenient`, without planes that
        it lacks, except the colour."""
        with self.open(number) as files:
            space = self._space
            wanted, guiding = self.options.planes if planes is None else planes, guides
            if is_lenient:
                wanted, guiding = files.select_present(wanted, guiding)
            is_motion_wanted = files.lacks_motion and (wanted is None or Role.MOTION in wanted)
            more = self._find_motion_sources(files, wanted) if is_motion_wanted else ()
            asked = None if wanted is None else (*wanted, *more)
            frame = files.read(number, asked, guiding, self.options.scratch,
                               hold_rows and not self.views)
            if files.alone:
                self.coverage.add(files.alone.shares)
            lights = [name for name, found in files.parts.items() if found.part.is_light]

        # Planes that are made of those that were read, and light that is mended.
        begins = frame.reset if self.options.cuts is None else number in self.options.cuts
        self._estimate_motion(frame, begins, is_motion_wanted)
        for role in more:
            del frame.planes[role]
        assert space is not None, "it was found where the files were opened"
        self.colours.apply(frame, space)
        if self.options.brightest and Role.COLOUR in frame:
            clamp_fireflies(frame, self.options.brightest, self.fireflies, lights)

        # Where it stands in the sequence.
        self._last = number
        is_after_gap = previous is not None and previous != number - self._step
        if is_after_gap:
            self.warn("frames are not consecutive: the history begins anew after each gap")
        frame.reset = begins or is_after_gap
        for view in self.views:
            frame.views[view] = self.reader(view)._read(
                number, previous, planes, guides, is_lenient=True
            )
        return frame

    def _find_motion_sources(
        self, files: FrameFiles, wanted: Iterable[Role] | None
    ) -> tuple[Role, ...]:
        """Planes that motion is estimated from and nobody else wants."""
        if wanted is None:
            return ()
        return tuple(
            role
            for role in (*MOTION_SOURCES, Role.DEPTH)
            if role in files.layout.planes and role not in wanted
        )

    def _estimate_motion(self, frame: Frame, begins: bool, is_wanted: bool) -> None:
        """Give a frame motion that is estimated from its planes and those of the frame before it on
        the disk, where it is wanted, and where the files hold only zeros or no vector and the
        option is 'auto'."""
        may_fill = self.options.motion == AUTO_MOTION and not is_wanted
        stored = frame.planes.get(Role.MOTION) if may_fill else None
        unknown = None
        if stored is not None and not is_finite(stored):
            unknown = np.isnan(stored).any(axis=2, keepdims=True)
        lacks_vectors = stored is not None and (unknown is not None or not stored.any())
        if not is_wanted and not (lacks_vectors and any(role in frame for role in MOTION_SOURCES)):
            return
        # few need it, and its kernels take time
        from postfx.motion.estimated import motion_between, picture_of

        before = None if begins else self._picture_before(frame.number)
        picture = picture_of(frame)
        assert picture is not None, "one of MOTION_SOURCES was read"
        motion = motion_between(before, picture, frame.planes.get(Role.DEPTH))
        self._pictures[self.view] = frame.number, picture
        if not (is_wanted or unknown is not None or motion.any()):
            return
        if before is not None:
            seen = ", ".join(role for role in (*MOTION_SOURCES, Role.DEPTH) if role in frame.planes)
            some = "" if unknown is None else "some "
            self.warn(
                f"{some}motion is estimated from {seen}, not taken from the files (--motion file: "
                "from them alone)"
            )
        if unknown is not None:
            motion = np.where(unknown, motion, frame.planes[Role.MOTION])
        frame.planes[Role.MOTION] = motion

    def _picture_before(self, number: int) -> Picture | None:
        """Of the frame before on the disk, whatever was read last; None where there is none, or it
        cannot be read."""
        from postfx.motion.estimated import picture_of

        for before in self.before(number, 1):
            kept, picture = self._pictures.get(self.view, (None, None))
            if kept == before:
                return picture
            try:
                with self.open(before) as files:
                    held = [role for role in MOTION_SOURCES if role in files.layout.planes]
                    return picture_of(files.read(before, held, [])) if held else None
            except PostfxError:
                return None
        return None

    def _find_guides(self) -> Sequence | None:
        """Files of guides, of the same views where these have files of their own."""
        options = self.options
        if options.guides is None or options.own_size:
            return None
        own = ",".join(filter(None, self._known_views)) if self.pattern.has_views else None
        return Sequence(
            options.guides, ReadOptions(profile=options.profile, depth=options.depth, view=own)
        )

    def _choose_views(self) -> None:
        """Take the views that are asked for, all by default, where they have files of their own."""
        asked = tuple(filter(None, (self.view, *self.views))) or tuple(self._found)
        if absent := [view for view in asked if view not in self._found]:
            raise SequenceError(
                f"{self.pattern}: no view '{absent[0]}'"
                f"{offer(absent[0], self._found, 'there are files of')}"
            )
        self.view, self.views, self._all_views = asked[0], asked[1:], False

    @property
    def _key(self) -> str:
        """Of the view's files among those that were found."""
        return self.view or "" if self.pattern.has_views else ""

    def _read_files(self) -> list[Frames]:
        """Files of the frames of each view that is read, or of all views where they share files;
        the first ones first.
        """
        return [
            self._found[view]
            for view in (self._key, *(self.views if self.pattern.has_views else ()))
        ]

    def _warn_of_views(self, views: tuple[str, ...]) -> None:
        others = ", ".join(view for view in views[1:] if view not in self._known_views)
        if others:
            self.warn(
                f"only view {views[0]} is read, not {others}: --view all reads all of them"
            )

    def _warn_of_overlooked(self) -> None:
        found = [
            path.name for own in self.pattern.by_view().values() for path in own.find_overlooked()
        ]
        if found:
            names = ", ".join(map(make_printable, found[:3])) + ", ..." * (len(found) > 3)
            self.warn(
                f"{names}: fewer digits than frames of this pattern have: not read; rename them, "
                "or name the frames with one #"
            )

    def warn(self, warning: str) -> None:
        """Keep a warning and tell the log of it, once."""
        if warning not in self.warnings:
            self.warnings.append(warning)
            LOG.warning("%s: %s", self.pattern, warning)

    def _on_disk(self) -> list[int]:
        numbers = self.present()
        if any((number - numbers[0]) % self._step for number in numbers):
            return numbers
        return list(range(numbers[0], numbers[-1] + 1, self._step))


def _by_options(make: Callable[Given, ReadOptions]) -> Callable[
    [Callable[[Source, ReadOptions], Sequence]], Callable[Concatenate[Source, Given], Sequence]
]:
    """Let a function that takes options be called with each of them, by position or by name, in
    either spelling of colour."""

    def wrap(
        function: Callable[[Source, ReadOptions], Sequence],
    ) -> Callable[Concatenate[Source, Given], Sequence]:
        def call(pattern: Source, *given: Given.args, **named: Given.kwargs) -> Sequence:
            ours = in_our_spelling(named)
            for unknown in ours.keys() - options.keys():
                raise TypeError(f"{function.__name__} has no argument '{unknown}'"
                                f"{suggest(unknown, options)}")
            return function(pattern, make(*given, **ours))

        options = signature(make).parameters
        update_wrapper(call, function)
        pattern, *_ = signature(function).parameters.values()
        parameters = [pattern, *options.values()]
        call.__signature__ = Signature(parameters, return_annotation="Sequence")  # type: ignore[attr-defined]
        return call  # type: ignore[return-value]  # the pattern may be given by its name, too

    return wrap


@_by_options(ReadOptions)
def read_sequence(pattern: Source, options: ReadOptions) -> Sequence:
    """Frames of a sequence, read one at a time while iterating.

    Args:
        pattern: file name with %04d, ####, @@@@ or $F4 for the frame number, {plane} for the plane
            where every plane has its own file, and {view} (in Nuke %V) for the view where every
            view has its own files; or a folder; or a single file; or wildcards such as shot.*.exr;
            or files in a list. A leading ~ is the home folder.
        options: those of `ReadOptions`, each by its name: `read_sequence("shot.####.exr",
            frames="1-100")`.

    Raises SequenceError when nothing is found; iterating raises MissingFrameError,
    MissingPlaneError, GuideError, ReadError or StrengthError.
    """
    return Sequence(pattern, options)


def _files_of(pattern: Pattern) -> dict[str, Frames]:
    """Files on the disk, by view; '' -> all where views share their files."""
    found = {view: own.find_frames() for view, own in pattern.by_view().items()}
    return {view: frames for view, frames in found.items() if frames}


def _step(numbers: list[int]) -> int:
    """Least distance between neighbours."""
    return min(
        (after - before for before, after in zip(numbers, numbers[1:], strict=False)), default=1
    )
