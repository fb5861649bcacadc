"""The planes of one frame, read from its files."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from itertools import chain, repeat
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import OpenImageIO as oiio

from postfx.errors import MissingPlaneError, ReadError
from postfx.files import file_threads, make_printable, run_in_order
from postfx.frame import ROLES, ColourSource, Frame, FrameSpec, Role, stops_of_factor
from postfx.io.channels import Channel, ChannelIndex, are_together, read_channels
from postfx.io.colours import INTEROP, gather_attributes, is_given
from postfx.io.convert import SEEN, Camera, DepthOption, convert, fill_background_motion, fill_value
from postfx.io.exr.container import rows_of_task
from postfx.io.image_file import ImageFile
from postfx.io.layout import (
    GuideLayout,
    Header,
    Layout,
    Match,
    drop_smaller_planes,
    larger_planes,
    make_layout,
    planes_that_guide,
    take_opaque_colour,
)
from postfx.io.masks import LeftAlone
from postfx.io.parts import PartOptions, find_parts, read_parts
from postfx.io.profile import Profile, load_profile
from postfx.io.windows import AREA, Part, Window
from postfx.masks.cryptomatte import Entry
from postfx.system import Scratch

_MOTION = re.compile(r"motion|veloc|vector|flow|(^|[._ ])(mv\d?|forward|backward)([._ ]|$)", re.IGNORECASE)
"""Names of layers that may hold motion."""


class Area(NamedTuple):
    """A display window, and the rectangle that planes with this display window are read in."""

    display: Window
    window: Window

    @property
    def is_wider(self) -> bool:
        """Whether there is more than the display window."""
        return self.window != self.display


def area_of(layout: Layout, given: Area | None = None) -> Area | None:
    """Display window and data window together, of the colour or else of the first plane; None without planes.

    Where a frame before had the same display window, `given`, that frame's area is kept: all frames are of one size.
    """
    match = layout.planes.get(Role.COLOUR) or next(iter(layout.planes.values()), None)
    if match is None:
        return None
    part = match.channels[0].part
    if given is not None and given.display == part.display:
        return given
    return Area(part.display, part.display.around(part.data))


def camera_over(camera: Camera, area: Area) -> Camera:
    """The camera of planes that cover an area: its field of view and motion still refer to the display window."""
    display, window = area
    shift = (_middle(window.x0, window.x1) - _middle(display.x0, display.x1),
             _middle(window.y0, window.y1) - _middle(display.y0, display.y1))
    return replace(camera, display_size=(display.width, display.height), shift=shift)


def _middle(first: int, last: int) -> float:
    return (first + last + 1) / 2


_ROWS = 64, 256
"""Rows that OpenImageIO reads at once, with few threads and with many: they stay in the cache, and each has a chunk."""


def read_planes(
    matches: Mapping[Role, Match], camera: Camera, scratch: Scratch | None = None
) -> dict[Role, np.ndarray]:
    """Planes at the sizes that they have, some rows of all at a time, in arrays of `scratch` if it is given."""
    for match in matches.values():
        _check(match)
    new = scratch.empty if scratch else partial(np.empty, dtype=np.float32)
    planes = {role: new((match.size[1], match.size[0], ROLES[role].channels)) for role, match in matches.items()}
    for size in {match.size for match in matches.values()}:
        _Rows({role: match for role, match in matches.items() if match.size == size}, planes, camera).read(scratch)
    return planes


class _Rows:
    """Reads rows of planes of one size."""

    def __init__(self, matches: Mapping[Role, Match], planes: Mapping[Role, np.ndarray], camera: Camera) -> None:
        self._matches, self._planes, self._camera = matches, {role: planes[role] for role in matches}, camera
        self._height = len(self._planes[next(iter(matches))])
        self._channels = {channel: fill_value(match.rule) for match in matches.values() for channel in match.channels}
        self._chunk = max(channel.part.chunk for channel in self._channels)
        parts: dict[tuple[ImageFile, int], tuple[Part, dict[Role, list[str]]]] = {}
        for role, match in matches.items():
            first = match.channels[0]
            names = parts.setdefault((first.file, first.part.index), (first.part, {}))[1]
            names[role] = [channel.name for channel in match.channels]
        self._parts = [(file, part, names) for (file, _), (part, names) in parts.items()]

    def read(self, scratch: Scratch | None) -> None:
        """Read all rows: by several threads, if the files are stored so that it can be done."""
        count = oiio.get_int_attribute("threads")
        straight = all(are_together(match.channels) for match in self._matches.values()) and all(
            file.reads_planes(part, chain.from_iterable(names.values())) for file, part, names in self._parts)
        if scratch:
            held = 8 * sum(plane.nbytes for plane in self._planes.values())  # twice, with channels that nobody wants
            for rows in scratch.pieces(self._height, held // self._height):
                if not (straight and self._read_straight(rows)):
                    self._read_any(rows)
            return
        step = rows_of_task(count) if straight else min(max(_ROWS[0], 16 * count), _ROWS[1])
        step = -(-step // self._chunk) * self._chunk
        pieces = [(first, min(self._height, first + step)) for first in range(0, self._height, step)]
        tasks = [partial(self._read_straight, rows) for rows in pieces]
        done = run_in_order(file_threads(count), tasks, 2 * count) if straight else repeat(False)
        for rows, is_done in zip(pieces, done, strict=False):
            if not is_done:
                self._read_any(rows)

    def _read_any(self, rows: tuple[int, int]) -> None:
        pixels, pieces = read_channels(self._channels, rows), {}
        for role, match in self._matches.items():
            stored = [pixels[channel] for channel in match.channels]
            pieces[role] = np.stack(stored, axis=-1, out=self._planes[role][slice(*rows)])
        self._convert(pieces, rows[0])

    def _read_straight(self, rows: tuple[int, int]) -> bool:
        """Read rows into planes as they are unpacked; False where a file is broken."""
        pieces = {role: plane[slice(*rows)] for role, plane in self._planes.items()}
        done = all(file.read_planes(part, [(own, pieces[role]) for role, own in names.items()], rows)
                   for file, part, names in self._parts)
        if done:
            self._convert(pieces, rows[0])
        return done

    def _convert(self, pieces: Mapping[Role, np.ndarray], first: int) -> None:
        for role, piece in pieces.items():
            found = convert(piece, self._matches[role].rule, self._camera, first, self._height)
            if found is not piece:
                piece[:] = found


def _check(match: Match) -> None:
    areas = [channel.part.area for channel in match.channels]
    if len({(area.width, area.height) for area in areas}) > 1:
        raise ReadError(f"{match.channels[0].file.path}: channels {match.names} differ in size; write them as one part")


_SHOWN = 12  # layers in a message
_ALL_BUT_COLOUR = frozenset(Role) - {Role.COLOUR}
_AXES = {"z": 0, "w": 1}
"""Axes of Blender's motion to the next frame, by letter."""


class FrameFiles:
    """The open files of one frame. Use as a context manager.

    `paths` maps a plane's word ('' where one file holds all planes) to its file; `guides` likewise, where planes at
    output size have files of their own. Else the planes that are larger than the colour are guides. `depth` replaces
    what the profile says about depth; `leave` and `strict` are for `LeftAlone`, which makes a strength or multiplies
    that of the files; planes of the roles `without` are taken as absent; `area` is that of
    frames before; `layer` and `view` choose among several. Where there is an overlay, the colour is that before
    transparents, if it is there. With `estimates`, a frame without motion vectors, but with planes to estimate
    them from, is said to have the plane motion, which whoever reads it adds.

    Raises ProfileError when near, far or field of view of such a depth is missing, MissingFrameError or ReadError when
    a file cannot be opened, MissingPlaneError when `guides` hold no guide, and for a layer or view that is not there,
    StrengthError when what to leave is not there.

    Attributes:
        layout: planes of the frame's size.
        guides: planes at output size, or None.
        alone: the parts of the picture that --leave keeps, or None.
        area: rectangle that the planes of the frame's size cover, or None without any.
        views: of stereo files, those that hold a colour, the one that is read first; empty for files of one view.
        parts: layers that are parts of the picture, by name, of those that were asked for.
    """

    def __init__(
        self,
        paths: Mapping[str, Path],
        profile: str | None = None,
        guides: Mapping[str, Path] | None = None,
        depth: DepthOption | None = None,
        leave: Iterable[Entry] = (),
        strict: bool = True,
        without: Collection[Role] = (),
        area: Area | None = None,
        layer: str | None = None,
        view: str | None = None,
        parts: PartOptions | None = None,
        estimates: bool = False,
    ) -> None:
        self._stack, self._without = ExitStack(), without
        self._estimates = estimates
        self._layer, self._view = layer, view
        self.views: tuple[str, ...] = ()
        try:
            self._files = {word: self._stack.enter_context(ImageFile(path)) for word, path in paths.items()}
            self.path = next(iter(self._files.values())).path
            self._index, self.layout = self._look(profile, depth)
            self.area = area_of(self.layout, area)
            if self.area and self.area.is_wider:
                self._index, self.layout = self._look_wider(profile, depth, self.area)
            self.layout.attributes = self._attributes_of_colour()
            drop_smaller_planes(self.layout)
            self.guides = larger_planes(self.layout)
            if guides:
                self.guides = self._open_guides(guides, profile, depth)
            if Role.OVERLAY in self.layout.planes or (self.guides and Role.OVERLAY in self.guides.planes):
                take_opaque_colour(self.layout, self._index)
            self.parts = find_parts(parts, self._index, self.layout, str(self.path), self.match(Role.COLOUR).size) \
                if parts else {}
            self.alone = LeftAlone(leave, self._index, self.layout, self.path, strict) if leave else None
        except BaseException:
            self._stack.close()
            raise

    def __enter__(self) -> FrameFiles:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files."""
        self._stack.close()

    @property
    def begins_shot(self) -> bool:
        """Whether the header says so."""
        return bool(Header(self.layout).number("reset"))

    def spec(self) -> FrameSpec:
        """Size, planes and guides of the frame; MissingPlaneError when there is no colour."""
        width, height = self.match(Role.COLOUR).size
        guides = self.guides.spec() if self.guides else None
        planes = (*self.layout.planes, *self._derived())
        parts = {name: len(part.channels) for name, part in self.parts.items()}
        return FrameSpec(width, height, planes, guides=guides, source=str(self.path), parts=parts)

    def read(
        self,
        number: int,
        roles: Iterable[Role] | None = None,
        guides: Iterable[Role] | None = None,
        scratch: Scratch | None = None,
    ) -> Frame:
        """Frame with the planes of `roles` (None: all that are there) and these guides, in arrays of `scratch`.

        Without `guides`, `roles` tells what to read at whatever size it is there. Raises MissingPlaneError when one
        of them is not there, ReadError when pixels cannot be decoded.
        """
        wanted, guiding = self._split_roles(roles, guides)
        if not wanted:
            raise self.missing_error(Role.COLOUR)
        alone = self.alone if Role.STRENGTH in wanted else None
        stored = {*wanted, *(alone.reads if alone else ())} - self._derived()
        matches = {role: self.match(role) for role in Role if role in stored}
        guide_matches = {role: self.guide(role) for role in guiding}
        planes = read_planes(matches, self.layout.camera, scratch)
        motion, depth = planes.get(Role.MOTION), planes.get(Role.DEPTH)
        if motion is not None and depth is not None and motion.shape[:2] == depth.shape[:2]:
            fill_background_motion(motion, depth)
        guide_planes = read_planes(guide_matches, self.guides.camera, scratch) if self.guides and guide_matches else {}
        if alone:
            strength = alone.strength(planes, scratch)
            planes = {role: strength if role is Role.STRENGTH else planes[role] for role in wanted}
        frame = self._frame(number, planes, guide_planes, next(iter(matches.values())).channels[0])
        if self.parts and Role.COLOUR in planes:
            frame.parts = read_parts(self.parts)
            frame.part_sources = {name: part.source for name, part in self.parts.items()}
        return frame

    def select_present(
        self, roles: Iterable[Role] | None, guides: Iterable[Role] | None
    ) -> tuple[list[Role] | None, list[Role] | None]:
        """Those of these roles and guides that are there, and the colour whether it is or not."""
        offered = self.guides.planes if self.guides else {}
        there = {*self.layout.planes, *self._derived(), Role.COLOUR, *(offered if guides is None else ())}
        return (None if roles is None else [Role(role) for role in roles if role in there],
                None if guides is None else [Role(role) for role in guides if role in offered])

    def guide(self, role: Role) -> Match:
        """Where a guide is; MissingPlaneError when it is not there at output size."""
        if self.guides is None or role not in self.guides.planes:
            path = self.guides.path if self.guides else self.path
            raise MissingPlaneError(f"{path}: no plane '{role}' at output size, unlike frames before: render it so")
        return self.guides.planes[role]

    def match(self, role: Role) -> Match:
        """Where a plane is; MissingPlaneError when the profile finds none."""
        if role not in self.layout.planes:
            raise self.missing_error(role)
        return self.layout.planes[role]

    def missing_error(self, role: Role) -> MissingPlaneError:
        """The error for a plane that is not there: what was looked for, and the fix."""
        profile, rules = self.layout.profile, self.layout.profile.rules(role)
        looked = [names for rule in rules for names in rule.candidates(self.layout.layer)][:2]
        hint = next((rule.enable for rule in rules if rule.enable), "")
        remedy = f"switch it on ({hint})" if hint else "render it"
        tried = " or ".join(", ".join(names) for names in looked) or "nothing"
        held = ChannelIndex(self._files).contents()
        more = f" and {len(held) - _SHOWN} more" if len(held) > _SHOWN else ""
        there = f"; it holds {'; '.join(held[:_SHOWN])}{more}" if role is Role.COLOUR else ""
        choose = ", choose a layer (--layer NAME)" if role is Role.COLOUR else ""
        return MissingPlaneError(
            f"{self.path}: no plane '{role}': profile {profile.name} looks for {tried}; "
            f"{remedy}{choose}, or name it in a profile (--profile FILE.toml){there}"
        )

    def unread(self) -> list[str]:
        """Layers of the frame's files that no plane, part or guide is read from: 'AO.R,G,B'."""
        found = [*self.layout.planes.values(), *(self.guides.planes.values() if self.guides else ())]
        used = [channel for each in (*found, *self.parts.values()) for channel in each.channels]
        return self._index.contents(used)

    def unread_motion(self) -> dict[str, tuple[Channel, ...]]:
        """Layers of the colour's size whose names suggest motion, and their channels; none where motion is read."""
        if Role.MOTION in self.layout.planes or Role.COLOUR not in self.layout.planes:
            return {}
        used = {match.channels[0] for match in self.layout.planes.values()}
        size = self.match(Role.COLOUR).size
        return {layer: channels for layer, channels in self._index.pairs_like(_MOTION) if channels[0] not in used
                and (channels[0].part.area.width, channels[0].part.area.height) == size}

    def _derived(self) -> set[Role]:
        """Planes that are not in the files but are made from them."""
        made = {Role.STRENGTH} if self.alone else set()
        made |= {Role.MOTION} if self._estimates and {*SEEN} & self.layout.planes.keys() else set()
        return made - self.layout.planes.keys()

    @property
    def lacks_motion(self) -> bool:
        """Whether the plane motion is to be estimated from the others."""
        return Role.MOTION in self._derived()

    def _look(self, profile: str | None, depth: DepthOption | None) -> tuple[ChannelIndex, Layout]:
        index = ChannelIndex(self._files, self._view, self._layer or "")
        if self._view and self._view not in index.views:
            known = ", ".join(index.views) or "one view without a name"
            raise MissingPlaneError(f"{self.path}: no view '{self._view}': it holds {known}")
        if self._layer and not index.has_layer(self._layer):
            known = ", ".join(index.layers()) or "none"
            raise MissingPlaneError(f"{self.path}: no layer '{self._layer}': it holds {known}")
        chosen = load_profile(profile) if profile else None
        layout = make_layout(index, self._attributes(), chosen, depth, self._without, self._layer)
        lone = None if Role.COLOUR in {*layout.planes, *self._without} or self._layer else index.find_lone_picture()
        if lone:
            index = ChannelIndex(self._files, self._view, lone)
            layout = make_layout(index, self._attributes(), chosen, depth, self._without)
            layout.warnings.append(f"layer {make_printable(lone)} is read as the picture: no other holds colours")
        others = [view for view in index.views[1:] if self._holds_colour(view, layout.profile)]
        self.views = (index.views[0], *others) if others else ()
        return index, layout

    def _holds_colour(self, view: str, profile: Profile) -> bool:
        index = ChannelIndex(self._files, view)
        return Role.COLOUR in make_layout(index, {}, profile, without=_ALL_BUT_COLOUR).planes

    def _look_wider(
        self, profile: str | None, depth: DepthOption | None, area: Area
    ) -> tuple[ChannelIndex, Layout]:
        """Index and layout of planes that cover overscan."""
        for file in self._files.values():
            file.widen(*area)
        index, layout = self._look(profile, depth)
        layout.camera = camera_over(layout.camera, area)
        return index, layout

    def _attributes(self) -> dict[str, Any]:
        """Header attributes of all parts. If several have one, the smallest part's counts, and of those the first's.

        A larger part's jitter belongs to guides. Beside a picture that postfx wrote, other parts do not count.
        """
        merged: dict[str, Any] = {}
        parts = [part for file in self._files.values() for part in file.parts]
        parts = [part for part in parts if part.is_picture] or parts
        for part in sorted(parts, key=lambda part: part.display.width * part.display.height):
            merged = {**part.attributes, **merged}
        return merged

    def _attributes_of_colour(self) -> dict[str, Any]:
        """Header attributes; those about colours are the colour's own."""
        colour = self.layout.planes.get(Role.COLOUR)
        if colour is None:
            return dict(self.layout.attributes)
        channel = colour.channels[0]
        others = (part.attributes for part in channel.file.parts)
        found = gather_attributes(channel.part.attributes, others)
        kept = {name: value for name, value in self.layout.attributes.items()
                if name != INTEROP and is_given(name, value)}
        return kept | found

    def _open_guides(
        self, paths: Mapping[str, Path], profile: str | None, depth: DepthOption | None
    ) -> GuideLayout:
        view = self._guides_view(paths)
        files = self._stack.enter_context(FrameFiles(paths, profile, depth=depth, without=self._without, view=view))
        if self.guides:
            names = ", ".join(self.guides.planes)
            self.layout.warnings.append(f"planes {names} are larger than the colour: not read beside the guides given")
        self.layout.warnings += [f"guides: {warning}" for warning in files.layout.warnings]
        return planes_that_guide(files.layout, files.path)

    def _guides_view(self, paths: Mapping[str, Path]) -> str | None:
        """The view that is read, where the files of the guides hold several as well."""
        if not self._index.views:
            return None
        with ImageFile(next(iter(paths.values()))) as file:
            return next((view for view in ChannelIndex({"": file}).views if view == self._index.views[0]), None)

    def _split_roles(
        self, roles: Iterable[Role] | None, guides: Iterable[Role] | None
    ) -> tuple[list[Role], list[Role]]:
        """Roles to read as planes and as guides."""
        held, offered = self.layout.planes, self.guides.planes if self.guides else {}
        planes = [*held, *self._derived()] if roles is None else [Role(role) for role in roles]
        if guides is not None:
            return planes, [Role(role) for role in guides]
        if roles is None:
            return planes, list(offered)
        return [role for role in planes if role in held or role not in offered], [r for r in planes if r in offered]

    def _frame(
        self, number: int, planes: dict[Role, np.ndarray], guides: dict[Role, np.ndarray], first: Channel
    ) -> Frame:
        header, camera, part = Header(self.layout), self.layout.camera, first.part
        windows = {"displayWindow": tuple(part.display), "dataWindow": tuple(part.data), AREA: tuple(part.area)}
        return Frame(
            planes,
            number=number,
            jitter=camera.jitter,
            exposure=_stops(header),
            reset=self.begins_shot,
            samples=int(header.number("samples") or 0) or None,
            world_to_camera=camera.world_to_camera,
            fov_x=camera.fov_over(part.area.width),
            metadata={**self.layout.attributes, **windows},
            source=str(first.file.path),
            colour_source=self._colour_source(),
            guides=guides,
            guide_size=self.guides.size if self.guides else None,
            guide_jitter=self.guides.camera.jitter if self.guides else (0.0, 0.0),
            guide_source=str(self.guides.path) if self.guides else None,
        )

    def _colour_source(self) -> ColourSource | None:
        """Where the colour is, if it is in one part."""
        if Role.COLOUR not in self.layout.planes:
            return None
        channels = self.layout.planes[Role.COLOUR].channels
        if not are_together(channels):
            return None
        names = tuple(channel.name for channel in channels)
        replaced = self._find_colour() | self._find_parts()
        return ColourSource(channels[0].part.index, names, self.layout.attributes, replaced, self._find_pixel_motion())

    def _find_parts(self) -> frozenset[tuple[int, str]]:
        """Part and name of the channels in the colour's file that are parts of the picture, which replaces them."""
        file = self.layout.planes[Role.COLOUR].channels[0].file
        channels = (channel for found in self.parts.values() for channel in found.channels)
        return frozenset((channel.part.index, channel.name) for channel in channels if channel.file is file)

    def _find_colour(self) -> frozenset[tuple[int, str]]:
        """Part and name of all channels in the colour's file that a profile takes for the colour, with their alpha."""
        file = self.layout.planes[Role.COLOUR].channels[0].file
        names = (names for rule in self.layout.profile.rules(Role.COLOUR)
                 for names in rule.candidates(self.layout.layer))
        found = [self.layout.planes[Role.COLOUR].channels, *filter(None, map(self._index.find, names))]
        for role in (Role.COLOUR, Role.ALPHA):
            found += [self.layout.planes[role].channels] if role in self.layout.planes else []
        alphas = [f"{channels[0].name.rpartition('.')[0]}.A".removeprefix(".") for channels in found]
        found += [(channels[0]._replace(name=alpha),) for channels, alpha in zip(found, alphas, strict=True)
                  if alpha in channels[0].part.channels]
        return frozenset((one.part.index, one.name) for channels in found for one in channels if one.file is file)

    def _find_pixel_motion(self) -> dict[tuple[int, str], int]:
        """Part and name of the colour's file's channels that hold motion in pixels, and their axis; what lies beside
        them in their layer, such as Blender's motion to the next frame, included."""
        match = self.layout.planes.get(Role.MOTION)
        if match is None or match.rule.unit != "pixels":
            return {}
        first, layer = match.channels[0], match.channels[0].name.rpartition(".")[0]
        beside = [name for name in first.part.channels if name.rpartition(".")[0] == layer]
        axes = {name: _AXES[letter] for name in beside if (letter := name[-1:].lower()) in _AXES}
        axes |= {channel.name: axis for axis, channel in enumerate(match.channels)}
        colour = self.layout.planes[Role.COLOUR].channels[0]
        return {(first.part.index, name): axis for name, axis in axes.items()} if first.file is colour.file else {}


def _stops(header: Header) -> float | None:
    """The author's exposure: stops, or a factor, as versions before wrote it."""
    stops, factor = header.number("exposure_ev"), header.number("exposure")
    return stops if stops is not None or factor is None else stops_of_factor(factor)
