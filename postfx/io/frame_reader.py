"""The planes of one frame, read from its files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, repeat
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from postfx.errors import MissingPlaneError
from postfx.files import file_threads, run_in_order
from postfx.frame import ROLES, Frame, FrameSpec, Role, StoredRows
from postfx.io.channels import Channel, ChannelIndex, read_channels
from postfx.io.convert import Camera, convert, fill_background_motion
from postfx.io.exr.container import ExrContainer, read_rows, rows_of_task
from postfx.io.facts import merge_headers, read_facts
from postfx.io.image_file import ImageFile
from postfx.io.layout import GuideLayout, Layout, Match
from postfx.io.masks import LeftAlone
from postfx.io.parts import find_known_parts, read_parts
from postfx.io.read_options import ReadOptions
from postfx.io.read_plan import (
    Choice,
    Planner,
    Plans,
    ReadPlan,
    RowsPlan,
    Settled,
    find_unread,
    find_unread_motion,
    key_of,
    missing_error,
    plan_rows,
)
from postfx.io.windows import AREA
from postfx.motion import MOTION_SOURCES
from postfx.streams import make_printable
from postfx.system import Scratch

FEWEST_ROWS = 64
"""That OpenImageIO reads at once, with few threads: they stay in the cache."""
MOST_CHUNK_ROWS = 256
"""With many threads: each has a chunk."""
READING_FACTOR = 8
"""Memory that is kept free to read rows, in parts of their planes: they are there twice for a
moment, with channels that nobody wants."""
MOST_PICTURE_CHANNELS = 4
"""Red, green, blue and alpha: of a part with more channels a picture replaces only some."""
READ_ALL = ReadOptions()
"""All planes that are there, as they are."""
UNSETTLED = Settled()
"""Before the first frame of a sequence."""


def read_planes(
    files: Mapping[str, ImageFile],
    plans: Iterable[RowsPlan],
    camera: Camera,
    scratch: Scratch | None = None,
) -> dict[Role, np.ndarray]:
    """Planes at the sizes that they have, some rows of all at a time, in arrays of `scratch` if it
    is given."""
    new = scratch.empty if scratch else partial(np.empty, dtype=np.float32)
    planes: dict[Role, np.ndarray] = {}
    for plan in plans:
        width, height = plan.size
        made = {role: new((height, width, ROLES[role].channels)) for role in plan.matches}
        _Rows(files, plan, made, camera).read(scratch)
        planes |= made
    return planes


@dataclass(frozen=True)
class _Rows:
    """Reads rows of planes of one size."""

    files: Mapping[str, ImageFile]
    plan: RowsPlan
    planes: Mapping[Role, np.ndarray]
    camera: Camera

    def read(self, scratch: Scratch | None) -> None:
        """Read all rows: by several threads, if the files are stored so that it can be done."""
        _, height = self.plan.size
        if scratch:
            row_bytes = READING_FACTOR * sum(plane[0].nbytes for plane in self.planes.values())
            for rows in scratch.pieces(height, row_bytes):
                if not self._read_straight(rows):
                    self._read_any(rows)
            return
        threads = oiio.get_int_attribute("threads")
        is_straight = self.plan.parts is not None
        step = (rows_of_task(threads) if is_straight
                else min(max(FEWEST_ROWS, 16 * threads), MOST_CHUNK_ROWS))
        whole_chunks = -(-step // self.plan.chunk) * self.plan.chunk
        pieces = [(first, min(height, first + whole_chunks))
                  for first in range(0, height, whole_chunks)]
        tasks = [partial(self._read_straight, rows) for rows in pieces]
        done = (run_in_order(file_threads(threads), tasks, 2 * threads) if is_straight
                else repeat(False))
        for rows, is_done in zip(pieces, done, strict=False):
            if not is_done:
                self._read_any(rows)

    def _read_any(self, rows: tuple[int, int]) -> None:
        """Read rows by OpenImageIO, where this package cannot unpack all of them."""
        for file in self.files.values():
            if file.container:
                file.container.unpacked.clear()
        pixels = read_channels(self.files, self.plan.fills, rows)
        for role, match in self.plan.matches.items():
            stored = [pixels[channel] for channel in match.channels]
            np.stack(stored, axis=-1, out=self.planes[role][slice(*rows)])
        self._convert(rows)

    def _read_straight(self, rows: tuple[int, int]) -> bool:
        """Read rows into planes as they are unpacked; False where a file is broken or is not stored
        so."""
        if self.plan.parts is None:
            return False
        for word, part, columns in self.plan.parts:
            wanted = [(own, self.planes[role][slice(*rows)]) for role, own in columns.items()]
            container = self.files[word].container
            if container is None or not read_rows(container, part.index, wanted, *rows):
                return False
        self._convert(rows)
        return True

    def _convert(self, rows: tuple[int, int]) -> None:
        for role in self.plan.converted:
            piece, rule = self.planes[role][slice(*rows)], self.plan.matches[role].rule
            found = convert(piece, rule, self.camera, rows[0], self.plan.size[1])
            if found is not piece:
                piece[:] = found


class FrameFiles(ExitStack):
    """The open files of one frame. Use as a context manager.

    `paths` maps a plane's word ('' where one file holds all planes) to its file; `guides` likewise,
    where planes at output size have files of their own. Else the planes that are larger than the
    colour are guides. Where there is an overlay, the colour is that before transparents, if it is
    there. With options that estimate motion, a frame without motion vectors, but with planes to
    estimate them from, is said to have the plane motion, which whoever reads it adds. `plans` holds
    those of frames before: one whose headers are alike is not matched again.

    Raises ProfileError when near, far or field of view of such a depth is missing,
    MissingFrameError or ReadError when a file cannot be opened, MissingPlaneError when `guides`
    hold no guide, and for a layer or view that is not there, StrengthError when what to leave is
    not there.

    Attributes:
        files: the open files by their words.
        plan: where all that is read of them lies.
        layout: planes of the frame's size.
        guides: planes at output size, or None.
        alone: the parts of the picture that --leave keeps, or None.
        parts: layers that are parts of the picture, by name, of those that were asked for.
        views: of stereo files, those that hold a colour, the one that is read first.
        area: rectangle that the planes cover; None without any.
        lacks_motion: whether the plane motion is to be estimated from the others.
    """

    def __init__(
        self,
        paths: Mapping[str, Path],
        options: ReadOptions = READ_ALL,
        settled: Settled = UNSETTLED,
        guides: Mapping[str, Path] | None = None,
        plans: Plans | None = None,
    ) -> None:
        super().__init__()
        self._options = options
        self._guiding: FrameFiles | None = None
        try:
            self.files = {
                word: self.enter_context(ImageFile(path)) for word, path in paths.items()
            }
            self.path = next(iter(self.files.values())).path
            self.plan, self.layout = self._find_plan(
                settled, guides, Plans(1) if plans is None else plans
            )
            self.guides = self._find_guides() if self.plan.guides else None
            entries = options.left_alone
            self.alone = (
                LeftAlone(entries, self.plan.index, self.layout, self.files, not settled.named)
                if entries
                else None
            )
        except BaseException:
            self.close()
            raise
        self.parts, self.views, self.area = self.plan.parts, self.plan.views, self.plan.area

        # Planes that are not in the files but are made from them.
        made = {Role.STRENGTH} if self.alone else set()
        if options.estimates_motion and {*MOTION_SOURCES} & self.layout.planes.keys():
            made.add(Role.MOTION)
        self._derived = made - self.layout.planes.keys()
        self.lacks_motion = Role.MOTION in self._derived

    def _find_plan(
        self, settled: Settled, guides: Mapping[str, Path] | None, plans: Plans
    ) -> tuple[ReadPlan, Layout]:
        """The plan of a frame whose headers are alike, or a new one, and the layout that it tells
        with this header."""
        attributes, depth = merge_headers(self.files.values()), self._options.stored_depth
        key = key_of(self.files, attributes, self._options, settled)
        plan = plans.find(key)
        layout = plan.tell_layout(attributes, depth, self.files) if plan else None
        planner = (None if layout
                   else Planner(self.files, attributes, self._options, settled))

        # Files of guides have a plan of their own, on which this one depends.
        if guides:
            views = planner.index.views if planner else plan.index.views if plan else ()
            self._guiding = self._open_guides(guides, views, plans)
        guiding = self._guiding.plan if self._guiding else None
        if plan and layout and plan.guiding is guiding:
            return plan, layout
        planner = planner or Planner(self.files, attributes, self._options, settled)
        plan = planner.finish(guiding, self._guiding.path if self._guiding else None)
        plans.keep(key, plan)
        layout = plan.tell_layout(attributes, depth, self.files)
        assert layout is not None, "the plan is of this header"
        return plan, layout

    def _open_guides(
        self, paths: Mapping[str, Path], views: tuple[str, ...], plans: Plans
    ) -> FrameFiles:
        """Files of guides, of the view that is read where they hold several as well."""
        view = None
        if views:
            with ImageFile(next(iter(paths.values()))) as file:
                view = next(
                    (own for own in ChannelIndex({"": file.parts}).views if own == views[0]), None
                )
        return self.enter_context(
            FrameFiles(paths, self._options.of_guides, Settled(view), plans=plans)
        )

    def _find_guides(self) -> GuideLayout:
        """Guides, and the camera that the header of their file or part tells."""
        planes = self.plan.guides
        if self._guiding:
            return GuideLayout(self._guiding.path, planes, self._guiding.layout.camera)
        first, layout = next(iter(planes.values())).channels[0], self.layout
        file = self.files[first.word]
        own = read_facts(layout.profile, layout.layer, file.headers[first.part.index])
        return GuideLayout(file.path, planes, replace(layout.camera, jitter=own.camera.jitter))

    @property
    def begins_shot(self) -> bool:
        """Whether the header says so."""
        return self.layout.facts.begins_shot

    def spec(self) -> FrameSpec:
        """Size, planes and guides of the frame; MissingPlaneError when there is no colour."""
        width, height = self.match(Role.COLOUR).size
        guides = self.guides.spec() if self.guides else None
        planes = (*self.layout.planes, *self._derived)
        parts = {name: len(part.channels) for name, part in self.parts.items()}
        return FrameSpec(width, height, planes, guides=guides, source=str(self.path), parts=parts)

    def read(
        self,
        number: int,
        roles: Iterable[Role] | None = None,
        guides: Iterable[Role] | None = None,
        scratch: Scratch | None = None,
        hold_rows: bool = False,
    ) -> Frame:
        """Frame with the planes of `roles` (None: all that are there) and these guides, in arrays
        of `scratch`; see `Sequence.read` for `hold_rows`.

        Without `guides`, `roles` tells what to read at whatever size it is there. Raises
        MissingPlaneError when one of them is not there, ReadError when pixels cannot be decoded.
        """
        asked = (None if roles is None else tuple(roles),
                 None if guides is None else tuple(guides))
        key = (*asked, self.lacks_motion, self.alone and self.alone.reads)
        # Who looks for mistakes, as `postfx inspect`, tries other rules than the plan's on the same
        # files.
        guiding = self.guides.planes if self.guides else None
        is_as_planned = (self.layout.planes is self.plan.layout.planes
                         and guiding is (self.plan.guides or None))
        choices = self.plan.choices if is_as_planned else {}
        choice = choices.get(key)
        if choice is None:
            choice = choices[key] = self._choose(*asked)

        container = self._hold_rows(choice) if hold_rows else None
        planes = read_planes(self.files, choice.rows, self.layout.camera, scratch)
        motion, depth = planes.get(Role.MOTION), planes.get(Role.DEPTH)
        if motion is not None and depth is not None and motion.shape[:2] == depth.shape[:2]:
            fill_background_motion(motion, depth)
        guide_planes: dict[Role, np.ndarray] = {}
        if choice.guide_rows and self.guides:
            of = self._guiding or self
            guide_planes = read_planes(
                of.files, choice.guide_rows, self.guides.camera, scratch
            )
        if self.alone and Role.STRENGTH in choice.planes:
            planes[Role.STRENGTH] = self.alone.strength(planes, scratch)
            planes = {role: planes[role] for role in choice.planes if role in planes}
        frame = self._frame(number, planes, guide_planes, choice.first)
        if container and frame.colour_source:
            rows = StoredRows(container.identity, container.unpacked)
            frame.colour_source = replace(frame.colour_source, rows=rows)
        if self.parts and Role.COLOUR in planes:
            frame.parts = read_parts(self.files, self.parts)
            frame.part_sources = {name: part.source for name, part in self.parts.items()}
        return frame

    def _hold_rows(self, choice: Choice) -> ExrContainer | None:
        """Let the colour's file keep the rows that are unpacked of its part; None where nothing but
        a picture is in it, or not all rows are unpacked here."""
        word, part, _ = choice.first
        unpacked = {(name, own) for plan in choice.rows for name, own, _ in plan.parts or ()}
        container = self.files[word].container
        if container is None or (word, part) not in unpacked:
            return None
        if len(part.channels) <= MOST_PICTURE_CHANNELS:
            return None
        storage = container.storages[part.index]
        rows = np.empty((storage.height, storage.line_bytes // 2), np.uint16)
        container.unpacked[part.index] = rows
        return container

    def _choose(
        self, roles: Iterable[Role] | None, guides: Iterable[Role] | None
    ) -> Choice:
        """What to read where these planes and guides are asked for."""
        wanted, guiding = self._split_roles(roles, guides)
        if not wanted:
            raise self.missing_error(Role.COLOUR)
        alone = self.alone if Role.STRENGTH in wanted else None
        stored = {*wanted, *(alone.reads if alone else ())} - self._derived
        matches = {role: self.match(role) for role in Role if role in stored}
        guide_matches = {role: self.guide(role) for role in guiding}
        return Choice(
            planes=tuple(wanted),
            first=next(iter(matches.values())).channels[0],
            rows=plan_rows(matches, self.files),
            guide_rows=plan_rows(guide_matches, (self._guiding or self).files),
        )

    def select_present(
        self, roles: Iterable[Role] | None, guides: Iterable[Role] | None
    ) -> tuple[list[Role] | None, list[Role] | None]:
        """Those of these roles and guides that are there, and the colour whether it is or not."""
        offered = self.guides.planes if self.guides else {}
        there = {
            *self.layout.planes,
            *self._derived,
            Role.COLOUR,
            *(offered if guides is None else ()),
        }
        return (None if roles is None else [Role(role) for role in roles if role in there],
                None if guides is None else [Role(role) for role in guides if role in offered])

    def guide(self, role: Role) -> Match:
        """Where a guide is; MissingPlaneError when it is not there at output size."""
        if self.guides is None or role not in self.guides.planes:
            path = self.guides.path if self.guides else self.path
            raise MissingPlaneError(
                f"{path}: no AOV '{role}' at output size, unlike frames before: render it so"
            )
        return self.guides.planes[role]

    def match(self, role: Role) -> Match:
        """Where a plane is; MissingPlaneError when the profile finds none."""
        if role not in self.layout.planes:
            raise self.missing_error(role)
        return self.layout.planes[role]

    def missing_error(self, role: Role) -> MissingPlaneError:
        """The error for a plane that is not there: what was looked for, and the fix."""
        return missing_error(role, self.layout, self.plan.index)

    def unread(self) -> list[str]:
        """Layers of the frame's files that no plane, part or guide is read from: 'AO.R,G,B'."""
        return find_unread(self.plan, self.layout)

    def copies(self) -> list[str]:
        """Layers that hold the same picture as the colour, as Mitsuba writes it: 'image'."""
        colour = self.match(Role.COLOUR).channels
        candidates = [names for rule in self.layout.profile.rules(Role.COLOUR)
                      for names in rule.candidates(self.layout.layer)]
        found = [channels for names in candidates if (channels := self.plan.index.find(names))
                 and len(channels) == len(colour) and not {*channels} & {*colour}]
        if not found:
            return []
        pixels = read_channels(self.files, dict.fromkeys(chain(colour, *found), 0.0))
        same = [channels for channels in found
                if all(np.array_equal(pixels[one], pixels[other])
                       for one, other in zip(colour, channels, strict=True))]
        names = [channels[0].name.rpartition(".")[0] or channels[0].part.name for channels in same]
        return list(dict.fromkeys(map(make_printable, names)))

    def known_parts(self) -> list[str]:
        """Layers of the frame's files that are light groups or passes by their profile, whether
        they are read or not."""
        return find_known_parts(self.plan.index, self.layout)

    def possible_pictures(self) -> dict[str, tuple[Channel, ...]]:
        """Layers that may be the colour by their names, and their channels R, G, B and, if they
        have one, A; none where a colour is read."""
        if Role.COLOUR in self.layout.planes:
            return {}
        index = self.plan.index
        return {layer: (*channels, *(index.find([f"{layer}.A"]) or ()))
                for channels, layer in index.possible_pictures().items()}

    def unread_motion(self) -> dict[str, tuple[Channel, ...]]:
        """Layers of the colour's size whose names suggest motion, and their channels; none where
        motion is read."""
        return find_unread_motion(self.plan, self.layout)

    def _split_roles(
        self, roles: Iterable[Role] | None, guides: Iterable[Role] | None
    ) -> tuple[list[Role], list[Role]]:
        """Roles to read as planes and as guides."""
        held, offered = self.layout.planes, self.guides.planes if self.guides else {}
        planes = [*held, *self._derived] if roles is None else [Role(role) for role in roles]
        if guides is not None:
            return planes, [Role(role) for role in guides]
        if roles is None:
            return planes, list(offered)
        here = [role for role in planes if role in held or role not in offered]
        return here, [role for role in planes if role in offered]

    def _frame(
        self,
        number: int,
        planes: dict[Role, np.ndarray],
        guides: dict[Role, np.ndarray],
        first: Channel,
    ) -> Frame:
        layout, camera, part = self.layout, self.layout.camera, first.part
        source = self.plan.source if Role.COLOUR in layout.planes else None
        source = source and replace(source, attributes=layout.attributes)
        windows = {
            "displayWindow": tuple(part.display),
            "dataWindow": tuple(part.data),
            AREA: tuple(part.area),
        }
        return Frame(
            planes,
            number=number,
            jitter=camera.jitter,
            exposure=layout.facts.exposure,
            reset=layout.facts.begins_shot,
            samples=layout.facts.samples,
            world_to_camera=camera.world_to_camera,
            fov_x=camera.fov_over(next(iter(planes.values())).shape[1]),
            metadata={**layout.attributes, **windows},
            source=str(self.files[first.word].path),
            colour_source=source,
            guides=guides,
            guide_size=self.guides.size if self.guides else None,
            guide_jitter=self.guides.camera.jitter if self.guides else (0.0, 0.0),
            guide_source=str(self.guides.path) if self.guides else None,
        )
