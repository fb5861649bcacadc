"""Where all that is read of a frame lies: found once, for all frames whose headers are alike.

The frames of a sequence differ in their pixels and in what their headers say of the camera and the
moment. Their parts, channels and windows are the same. So the channels are matched with a profile
for the first frame, and a plan is kept. A later frame with the same key takes it; only its header's
facts are read anew.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from postfx.caching import LRUCache
from postfx.errors import MissingPlaneError, ReadError, offer
from postfx.frame import ColourSource, Role
from postfx.io.channels import Channel, ChannelIndex, Parts, are_together
from postfx.io.colours import COLOUR_ATTRIBUTES
from postfx.io.convert import Camera, DepthOption, fill_value, is_converted
from postfx.io.facts import read_facts, tell_colours
from postfx.io.image_file import ImageFile
from postfx.io.layout import (
    Layout,
    Match,
    PictureChoice,
    choose_picture,
    drop_smaller_planes,
    make_layout,
    planes_that_guide,
    take_larger_planes,
    take_opaque_colour,
    telling_names,
)
from postfx.io.parts import FoundPart, find_parts
from postfx.io.profile import load_profile
from postfx.io.read_options import ReadOptions
from postfx.io.windows import PICTURE_ATTRIBUTE, Part, Window
from postfx.streams import make_printable

_ALL_BUT_COLOUR = frozenset(Role) - {Role.COLOUR}
_AXES = {"z": 0, "w": 1}
"""Axes of Blender's motion to the next frame, by letter."""


class Area(NamedTuple):
    """A display window, and the rectangle that planes with this display window are read in."""

    display: Window
    window: Window


class Settled(NamedTuple):
    """What a sequence has settled before it opens a frame.

    Attributes:
        view: the view that is read; None for the file's first.
        layer: the view layer that is read; None for the one with the most planes.
        area: what planes of the first frame covered, which is kept: all frames are of one size.
        named: whether all names of `leave` were found, which need not be in every frame.
    """

    view: str | None = None
    layer: str | None = None
    area: Area | None = None
    named: bool = False


MOST_READ_PLANS = 32
"""That are kept: a sequence has one for each view, and for each kind of header that its frames
have."""
Plans = LRUCache[object, "ReadPlan"]
"""The plans of a sequence by their keys."""


class RowsPlan(NamedTuple):
    """How rows of planes of one size are read.

    Attributes:
        matches: the planes.
        size: width and height.
        fills: channel -> the value of pixels without data.
        chunk: rows in which whole chunks lie.
        parts: word of a file, part, and of each plane the columns that its rows are read from at
            once; None where a file does not store them so.
        converted: planes whose stored values are not what they become.
    """

    matches: Mapping[Role, Match]
    size: tuple[int, int]
    fills: Mapping[Channel, float]
    chunk: int
    parts: tuple[tuple[str, Part, Mapping[Role, np.ndarray]], ...] | None
    converted: tuple[Role, ...]


def plan_rows(matches: Mapping[Role, Match], files: Mapping[str, ImageFile]) -> list[RowsPlan]:
    """A plan for the planes of each size. Raises ReadError for channels of one plane that differ in
    size."""
    sizes: dict[tuple[int, int], dict[Role, Match]] = {}
    for role, match in matches.items():
        areas = {(channel.part.area.width, channel.part.area.height) for channel in match.channels}
        if len(areas) > 1:
            raise ReadError(
                f"{files[match.channels[0].word].path}: channels {match.names} differ in size; "
                "write them as one part"
            )
        sizes.setdefault(areas.pop(), {})[role] = match
    return [_plan_rows(found, size, files) for size, found in sizes.items()]


def _plan_rows(matches: Mapping[Role, Match], size: tuple[int, int],
               files: Mapping[str, ImageFile]) -> RowsPlan:
    fills = {
        channel: fill_value(match.rule) for match in matches.values() for channel in match.channels
    }
    chunk = max(channel.part.chunk for channel in fills)
    converted = tuple(role for role, match in matches.items() if is_converted(match.rule))
    return RowsPlan(matches, size, fills, chunk, _find_columns(matches, files), converted)


def _find_columns(
    matches: Mapping[Role, Match], files: Mapping[str, ImageFile]
) -> tuple[tuple[str, Part, dict[Role, np.ndarray]], ...] | None:
    """Of each part the columns of its planes; None where some are not stored as they are or by
    ZIP, or spread over parts."""
    parts: dict[tuple[str, Part], tuple[str, Part, dict[Role, np.ndarray]]] = {}
    for role, match in matches.items():
        word, part, _ = match.channels[0]
        names = [channel.name for channel in match.channels]
        together = are_together(match.channels)
        columns = files[word].plain_columns(part, names) if together else None
        if columns is None:
            return None
        parts.setdefault((word, part), (word, part, {}))[2][role] = columns
    return tuple(parts.values())


class Choice(NamedTuple):
    """What is read of a frame where some planes and guides are asked for.

    Attributes:
        planes: roles of the frame's planes, those that are made of others included.
        first: the first channel: of its file and part the frame is.
        rows: how planes of the frame's size are read.
        guide_rows: the same of guides.
    """

    planes: tuple[Role, ...]
    first: Channel
    rows: list[RowsPlan]
    guide_rows: list[RowsPlan]


@dataclass(frozen=True, eq=False)
class ReadPlan:
    """Where all that is read of a frame lies.

    Attributes:
        index: all channels of the frame's files.
        layout: planes of the frame's size; its attributes, camera and paths are those of the frame
            that was matched.
        guides: planes at output size, of these files or of files of their own.
        guiding: the plan of files of their own; None without any.
        parts: layers that are parts of the picture, by name.
        views: of stereo files, those that hold a colour, the one that is read first; empty for
            files of one view.
        area: rectangle that the planes cover; None without any.
        colours: what headers say of the colours in the part that the colour is in; None without a
            colour.
        source: where the colour is, for whoever writes the frame, without attributes; None if it is
            in several parts.
        known: which numbers of the camera the header told, on which the planes depend that could be
            used.
        choices: what is read, by what is asked for.
    """

    index: ChannelIndex
    layout: Layout
    guides: dict[Role, Match]
    guiding: ReadPlan | None
    parts: Mapping[str, FoundPart]
    views: tuple[str, ...]
    area: Area | None
    colours: Mapping[str, Any] | None
    source: ColourSource | None
    known: tuple[bool, ...]
    choices: dict[tuple[object, ...], Choice] = field(default_factory=dict)

    def tell_layout(
        self, attributes: Mapping[str, Any], depth: DepthOption | None,
        files: Mapping[str, ImageFile]
    ) -> Layout | None:
        """The layout of another frame, of its merged attributes and open files; depth: what the
        user says of the camera. None where other numbers of the camera are known: then other planes
        may be used."""
        if self.colours is not None:
            rest = {name: value
                    for name, value in attributes.items() if name not in COLOUR_ATTRIBUTES}
            attributes = {**rest, **self.colours}

        # The camera, as the header and the user say.
        facts = read_facts(self.layout.profile, self.layout.layer, attributes)
        camera = depth.camera(facts.camera) if depth else facts.camera
        if known_of(camera) != self.known:
            return None
        if self.area and self.area.window != self.area.display:
            camera = camera_over(camera, self.area)
        paths = {word: file.path for word, file in files.items()}
        return replace(self.layout, facts=facts, camera=camera, attributes=attributes, paths=paths)


def camera_over(camera: Camera, area: Area) -> Camera:
    """The camera of planes that cover an area: its field of view and motion still refer to the
    display window."""
    display, window = area
    shift = (_middle(window.x0, window.x1) - _middle(display.x0, display.x1),
             _middle(window.y0, window.y1) - _middle(display.y0, display.y1))
    return replace(camera, display_size=(display.width, display.height), shift=shift)


def _middle(first: int, last: int) -> float:
    return (first + last + 1) / 2


def key_of(
    files: Mapping[str, ImageFile],
    attributes: Mapping[str, Any],
    options: ReadOptions,
    settled: Settled,
) -> tuple[object, ...]:
    """All on which a plan depends but the numbers of the camera: frames with one key have one
    plan. Files whose parts are alike share these."""
    parts = tuple([(word, file.parts) for word, file in files.items()])
    colours = tuple([str(header.get(name)) for file in files.values()
                     for header in file.headers.values() for name in COLOUR_ATTRIBUTES])
    told = tuple([str(attributes.get(name, "")) for name in telling_names()])
    picture = str(attributes.get(PICTURE_ATTRIBUTE))
    return parts, colours, told, picture, options.matching, settled


def known_of(camera: Camera) -> tuple[bool, ...]:
    """Which numbers of a camera are known."""
    numbers = (
        camera.world_to_camera,
        camera.fov_x,
        camera.near,
        camera.far,
        camera.max_velocity,
        camera.shutter,
    )
    return tuple([number is not None for number in numbers])


class Planner:
    """Makes the plan of one frame, of the facts of its headers alone.

    Raises ProfileError when near, far or field of view of a depth is missing, MissingPlaneError for
    a layer or view that is not there.
    """

    def __init__(
        self, files: Mapping[str, ImageFile], attributes: Mapping[str, Any],
        options: ReadOptions, settled: Settled
    ) -> None:
        self._files = {word: file.parts for word, file in files.items()}
        self._paths = {word: file.path for word, file in files.items()}
        self._path = next(iter(self._paths.values()))
        self._attributes = attributes
        self._options, self._settled = options, settled
        self._layer = settled.layer or options.layer
        self._choice: PictureChoice | None = None

        # Where the planes are within the display window, then within all that holds data.
        self.index, self._layout = self._look()
        self._area = _area_of(self._layout, settled.area)
        if self._area and self._area.window != self._area.display:
            display, window = self._area
            self._files = {
                word: _widen(parts, display, window) for word, parts in self._files.items()
            }
            self.index, self._layout = self._look()

        # Whose header tells of colours is decided by the render's own colour.
        self._colours: dict[str, Any] | None = None
        if colour := self._layout.planes.get(Role.COLOUR):
            first = colour.channels[0]
            told = tell_colours(attributes, files[first.word], first.part.index)
            self._colours = {name: told[name] for name in COLOUR_ATTRIBUTES if name in told}
        drop_smaller_planes(self._layout)
        self._guides = take_larger_planes(self._layout)
        others = [view for view in self.index.views[1:] if self._holds_colour(view)]
        self._views = (self.index.views[0], *others) if others else ()

    def finish(self, guiding: ReadPlan | None, path: Path | None) -> ReadPlan:
        """The plan. guiding, path: of guides in files of their own."""
        layout, guides = self._layout, self._guides
        if guides and self._options.own_size:
            layout.warnings.append(f"AOVs {', '.join(guides)} are larger than the colour: not read")
            guides = {}
        if guiding and path:
            if guides:
                layout.warnings.append(
                    f"AOVs {', '.join(guides)} are larger than the colour: not read beside the "
                    "guides given"
                )
            layout.warnings += [f"guides: {warning}" for warning in guiding.layout.warnings]
            guides = planes_that_guide(guiding.layout, path)
        if Role.OVERLAY in layout.planes or Role.OVERLAY in guides:
            take_opaque_colour(layout, self.index)
        parts: Mapping[str, FoundPart] = {}
        if self._options.parts:
            colour = layout.planes.get(Role.COLOUR)
            if colour is None:
                raise missing_error(Role.COLOUR, layout, ChannelIndex(self._files))
            parts = find_parts(
                self._options.parts, self.index, layout, str(self._path), colour.size
            )
        if self._choice and not self._settled.layer:
            layout.warnings += self._choice.told(layout, [p.channels for p in parts.values()])
        return ReadPlan(
            self.index,
            layout,
            guides,
            guiding,
            parts,
            self._views,
            self._area,
            self._colours,
            _find_source(self.index, layout, parts),
            known_of(layout.camera),
        )

    def _look(self) -> tuple[ChannelIndex, Layout]:
        """Index of all channels, and the layout of the planes; a lone picture in a layer is the
        colour."""
        view, layer, options = self._settled.view, self._layer, self._options
        index = ChannelIndex(self._files, view, layer or "")
        if view and view not in index.views:
            known = offer(view, index.views or ["one view without a name"], "it holds")
            raise MissingPlaneError(f"{self._path}: no view '{view}'{known}")
        if layer and not index.has_layer(layer):
            known = offer(layer, index.layers() or ["none"], "it holds")
            raise MissingPlaneError(f"{self._path}: no layer '{layer}'{known}")
        chosen = load_profile(options.profile) if options.profile else None
        given = self._paths, self._attributes, chosen, options.stored_depth, options.absent
        layout = make_layout(index, *given, layer)
        if Role.COLOUR in layout.planes and not options.layer and not layout.chosen_layer:
            self._choice = choose_picture(layout, index)
            if self._choice:
                layout = make_layout(index, *given, layer)
                layout.chosen_layer = self._choice.name
        if Role.COLOUR in {*layout.planes, *options.absent} or layer:
            return index, layout
        lone = index.find_lone_picture()
        if lone:
            index = ChannelIndex(self._files, view, lone)
            layout = make_layout(index, *given)
            layout.warnings.append(
                f"layer {make_printable(lone)} is read as the picture: no other holds colours"
            )
        return index, layout

    def _holds_colour(self, view: str) -> bool:
        index, profile = ChannelIndex(self._files, view), self._layout.profile
        layout = make_layout(index, self._paths, {}, profile, without=_ALL_BUT_COLOUR)
        return Role.COLOUR in layout.planes


def _widen(parts: Parts, display: Window, window: Window) -> Parts:
    """The parts, those with this display window read in a larger one."""
    return tuple(replace(part, area=window) if part.display == display else part for part in parts)


def _area_of(layout: Layout, given: Area | None) -> Area | None:
    """Display window and data window together, of the colour or else of the first plane; None
    without planes.

    Where a frame before had the same display window, `given`, that frame's area is kept: all frames
    are of one size.
    """
    match = layout.planes.get(Role.COLOUR) or next(iter(layout.planes.values()), None)
    if match is None:
        return None
    part = match.channels[0].part
    if given is not None and given.display == part.display:
        return given
    return Area(part.display, part.display.around(part.data))


_SHOWN_LAYERS = 12
"""In a message."""


def missing_error(role: Role, layout: Layout, index: ChannelIndex) -> MissingPlaneError:
    """The error for a plane that is not there: what was looked for, and the fix. index: of all
    channels."""
    profile, rules = layout.profile, layout.profile.rules(role)
    looked = [names for rule in rules for names in rule.candidates(layout.layer)][:2]
    hint = next((rule.enable for rule in rules if rule.enable), "")
    remedy = f"switch it on ({hint})" if hint else "render it"
    tried = " or ".join(", ".join(names) for names in looked) or "nothing"
    held = index.contents()
    more = f" and {len(held) - _SHOWN_LAYERS} more" if len(held) > _SHOWN_LAYERS else ""
    there = f"; it holds {'; '.join(held[:_SHOWN_LAYERS])}{more}" if role is Role.COLOUR else ""
    choose = ", choose a layer (--layer NAME)" if role is Role.COLOUR else ""
    return MissingPlaneError(
        f"{next(iter(layout.paths.values()))}: no AOV '{role}': profile {profile.name} looks for "
        f"{tried}; {remedy}{choose}, or name it in a profile (--profile FILE.toml){there}"
    )


# Where the colour is, for whoever writes the frame ------------------------------------------------


def _find_source(
    index: ChannelIndex, layout: Layout, parts: Mapping[str, FoundPart]
) -> ColourSource | None:
    """Where the colour is, if it is in one part."""
    if Role.COLOUR not in layout.planes:
        return None
    channels = layout.planes[Role.COLOUR].channels
    if not are_together(channels):
        return None
    of_parts = chain.from_iterable(found.channels for found in parts.values())
    replaced = {
        (channel.part.index, channel.name)
        for channel in (*_find_colour(index, layout), *of_parts)
        if channel.word == channels[0].word
    }
    names = tuple(channel.name for channel in channels)
    pixels = _find_pixel_motion(layout)
    return ColourSource(channels[0].part.index, names, {}, frozenset(replaced), pixels)


def _find_colour(index: ChannelIndex, layout: Layout) -> Iterable[Channel]:
    """All channels that a profile takes for the colour, with their alpha."""
    names = (
        names
        for rule in layout.profile.rules(Role.COLOUR)
        for names in rule.candidates(layout.layer)
    )
    found = [layout.planes[Role.COLOUR].channels, *filter(None, map(index.find, names))]
    for role in (Role.COLOUR, Role.ALPHA):
        found += [layout.planes[role].channels] if role in layout.planes else []
    for channels in tuple(found):
        alpha = f"{channels[0].name.rpartition('.')[0]}.A".removeprefix(".")
        if alpha in channels[0].part.channels:
            found.append((channels[0]._replace(name=alpha),))
    return chain.from_iterable(found)


def _find_pixel_motion(layout: Layout) -> dict[tuple[int, str], int]:
    """Part and name of the colour's file's channels that hold motion in pixels, and their axis;
    what lies beside them in their layer, such as Blender's motion to the next frame, included."""
    match, colour = layout.planes.get(Role.MOTION), layout.planes[Role.COLOUR].channels[0]
    if match is None or match.rule.unit != "pixels" or match.channels[0].word != colour.word:
        return {}
    first, layer = match.channels[0], match.channels[0].name.rpartition(".")[0]
    beside = [name for name in first.part.channels if name.rpartition(".")[0] == layer]
    axes = {name: _AXES[letter] for name in beside if (letter := name[-1:].lower()) in _AXES}
    axes |= {channel.name: axis for axis, channel in enumerate(match.channels)}
    return {(first.part.index, name): axis for name, axis in axes.items()}


# What is not read, for whoever looks at the files -------------------------------------------------

_MOTION = re.compile(
    r"motion|veloc|vector|flow|(^|[._ ])(mv\d?|forward|backward)([._ ]|$)", re.IGNORECASE
)
"""Names of layers that may hold motion."""


def find_unread(plan: ReadPlan, layout: Layout) -> list[str]:
    """Layers of a frame's files that no plane, part or guide is read from: 'AO.R,G,B'; those of
    the view that is read."""
    used = [match.channels for match in (*layout.planes.values(), *plan.guides.values())]
    used += [part.channels for part in plan.parts.values()]
    return plan.index.contents(chain.from_iterable(used), of_view=True)


def find_unread_motion(plan: ReadPlan, layout: Layout) -> dict[str, tuple[Channel, ...]]:
    """Layers of the colour's size whose names suggest motion, and their channels; none where motion
    is read."""
    if Role.MOTION in layout.planes or Role.COLOUR not in layout.planes:
        return {}
    used = {match.channels[0] for match in layout.planes.values()}
    size = layout.planes[Role.COLOUR].size
    return {
        layer: channels
        for layer, channels in plan.index.pairs_like(_MOTION)
        if channels[0] not in used
        and (channels[0].part.area.width, channels[0].part.area.height) == size
    }


