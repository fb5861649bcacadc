"""Where a frame's planes are: every channel of its files under all its names, matched by a renderer profile.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from typing import Any, NamedTuple

import numpy as np

from postfx.frame import Role, pixel_aspect
from postfx.io.convert import Camera, DepthOption, missing_error, missing_number
from postfx.io.image_file import ImageFile
from postfx.io.profile import PlaneRule, Profile, load_profile, profile_names
from postfx.io.windows import PICTURE, Part

COLOUR_FILES = ("beauty", "rgba", "rgb", "colour", "color", "combined", "image", "noisy")
"""Words that stand for the colour plane where every plane has its own file."""


def is_plane_word(word: str) -> bool:
    """Whether a word in file or part names stands for a plane: one for the colour, or a generic profile's layer."""
    layers = {name for rule in load_profile("generic").planes for name in rule.names if name}
    return word.lower() in {*COLOUR_FILES, *layers}


class Channel(NamedTuple):
    """One channel of one part of one of a frame's files."""

    file: ImageFile
    part: Part
    name: str


class ChannelIndex:
    """Channels by full name: 'albedo.R' is channel R of part or file albedo, or a channel of that very name.

    `files` maps a plane's word ('' where one file holds all planes) to its file. A channel R without more is that of
    a part named after the colour, else of the first part that is not named after another plane. Letter case does not
    count. Parts of another view than the first part's are left out.
    """

    def __init__(self, files: Mapping[str, ImageFile]) -> None:
        self._channels: dict[str, Channel] = {}
        for word, file in files.items():
            parts = [part for part in file.parts if part.view in ("", file.parts[0].view)]
            plain = _plain(parts) if word == "" or word.lower() in COLOUR_FILES else []
            for part in plain + [part for part in parts if part not in plain]:
                self._add(word, file, part, part in plain)

    def find(self, names: Iterable[str]) -> tuple[Channel, ...] | None:
        """Channels by full name, * matching anything; None unless all are there."""
        found: list[Channel] = []
        for name in names:
            channel = self._find_one(name.lower())
            if channel is None:
                return None
            found.append(channel)
        return tuple(found)

    def matching(self, name: str) -> list[Channel]:
        """A channel or those of a layer, by full name or the end of it, * matching anything; each once."""
        for pattern in (name, f"{name}.*", f"*.{name}", f"*.{name}.*"):
            found = [channel for key, channel in self._channels.items() if fnmatchcase(key, pattern.lower())]
            if found:
                return list(dict.fromkeys(found))
        return []

    def ending_in(self, name: str) -> Iterator[Channel]:
        """Channels whose full name ends like this."""
        return (channel for key, channel in self._channels.items() if key.endswith(name.lower()))

    def _find_one(self, name: str) -> Channel | None:
        if "*" not in name:
            return self._channels.get(name)
        return next((channel for key, channel in self._channels.items() if fnmatchcase(key, name)), None)

    def _add(self, word: str, file: ImageFile, part: Part, plain: bool) -> None:
        for name in part.channels:
            full = [name] if plain or "." in name else []
            full += [f"{part.name}.{name}"] if part.name else []
            for key in full + ([f"{word}.{name}"] if word else []):
                self._channels.setdefault(key.lower(), Channel(file, part, name))


def read_channels(
    fills: Mapping[Channel, float], rows: tuple[int, int] | None = None
) -> dict[Channel, np.ndarray]:
    """Every channel once, or some of its rows, with one read of each part that holds any; each with what it is filled
    with where there is no data."""
    wanted: dict[tuple[ImageFile, int], list[Channel]] = {}
    for channel in fills:
        wanted.setdefault((channel.file, channel.part.index), []).append(channel)
    pixels: dict[Channel, np.ndarray] = {}
    for (file, _), channels in wanted.items():
        read = file.read(channels[0].part, {channel.name: fills[channel] for channel in channels}, rows)
        pixels.update({channel: read[channel.name] for channel in channels})
    return pixels


def _plain(parts: list[Part]) -> list[Part]:
    """Parts whose channels go by their bare names as well, best first."""
    colour = [part for part in parts if part.is_picture]
    colour += [part for part in parts if part.name.lower() in COLOUR_FILES and part not in colour]
    return colour + [part for part in parts if not is_plane_word(part.name)] or parts


_PICTURE_RULES = (
    PlaneRule(Role.COLOUR, ("",), (("R", "G", "B"),)),
    PlaneRule(Role.ALPHA, ("",), (("A",),)),
)


class Match(NamedTuple):
    """A plane that was found: the rule that fits and its channels."""

    rule: PlaneRule
    channels: tuple[Channel, ...]

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the plane, which are those of its area."""
        area = self.channels[0].part.area
        return area.width, area.height

    @property
    def names(self) -> str:
        """Channel names, the common part once: 'albedo.R,G,B'."""
        heads, tails = zip(*(channel.name.rpartition(".")[::2] for channel in self.channels), strict=True)
        joined = ",".join(tails)
        same = len(set(heads)) == 1
        return (f"{heads[0]}.{joined}" if heads[0] else joined) if same else ", ".join(c.name for c in self.channels)


@dataclass
class Layout:
    """What a frame's files hold, by the eyes of a profile."""

    profile: Profile
    layer: str
    planes: dict[Role, Match]
    camera: Camera
    attributes: Mapping[str, Any]
    warnings: list[str] = field(default_factory=list)
    unused: dict[Role, str] = field(default_factory=dict)
    """Why a plane that is there is not used, as long as no other one of its role is."""
    barred: set[tuple[Channel, ...]] = field(default_factory=set)
    """Channels that no later rule may take either, as they are in a space that cannot be left."""


class Header:
    """Header attributes by the names that a profile gives them."""

    def __init__(self, layout: Layout) -> None:
        self._layout = layout

    def value(self, key: str) -> Any:
        names = [name.replace("{layer}", self._layout.layer) for name in self._layout.profile.header.get(key, ())]
        return next((self._layout.attributes[name] for name in names if name in self._layout.attributes), None)

    def numbers(self, key: str, count: int) -> np.ndarray | None:
        """Attribute of `count` numbers as float64; None when it is absent or something else."""
        try:
            numbers = np.asarray(self.value(key), np.float64).ravel()
        except (TypeError, ValueError):
            return None
        return numbers if numbers.size == count and np.isfinite(numbers).all() else None

    def number(self, key: str) -> float | None:
        numbers = self.numbers(key, 1)
        return None if numbers is None else float(numbers[0])

    def camera(self) -> Camera:
        matrix, jitter = self.numbers("world_to_camera", 16), self.numbers("jitter", 2)
        if matrix is not None:
            matrix = matrix.reshape(4, 4)
            matrix = matrix.T if self._layout.profile.column_vectors else matrix
        return Camera(
            world_to_camera=matrix,
            fov_x=self.number("fov_x") or self._layout.profile.fov_x,
            jitter=(0.0, 0.0) if jitter is None else (float(jitter[0]), float(jitter[1])),
            near=_first(self.number("near"), self._layout.profile.near),
            far=_first(self.number("far"), self._layout.profile.far),
            max_velocity=_first(self.number("max_velocity"), self._layout.profile.max_velocity),
            shutter=_first(self.number("shutter"), self._layout.profile.shutter),
            pixel_aspect=pixel_aspect(self._layout.attributes),
        )


def make_layout(
    index: ChannelIndex,
    attributes: Mapping[str, Any],
    profile: Profile | None = None,
    depth: DepthOption | None = None,
    without: Collection[Role] = (),
) -> Layout:
    """Where the planes are, by a profile or, without one, by the first that fits; `depth` replaces what it says of it.

    Planes of the roles `without` are taken as absent.

    Raises ProfileError when the depth plane needs numbers of the camera that are not known.
    """
    profile = profile or _detect(index, attributes)
    if PICTURE in attributes:
        profile = replace(profile, planes=_PICTURE_RULES + profile.planes)
    layout = Layout(profile, _layer(index, profile), {}, Camera(), attributes)
    camera = Header(layout).camera()
    layout.camera = depth.camera(camera) if depth else camera
    for rule in profile.planes:
        if rule.role not in layout.planes and rule.role not in without:
            if depth is not None and rule.role is Role.DEPTH:
                _match_rule(index, layout, depth.rule(rule), given=True)
            else:
                _match_rule(index, layout, rule, given=False)
    layout.warnings += [reason for role, reason in layout.unused.items() if role not in layout.planes]
    layout.warnings += _colour_warnings(layout)
    return layout


def _colour_warnings(layout: Layout) -> list[str]:
    match, warnings = layout.planes.get(Role.COLOUR), []
    part = match.channels[0].part if match else None
    if part and not part.area.holds(part.data):
        warnings.append("overscan beyond that of the first frame is cut off")
    return warnings


def _match_rule(index: ChannelIndex, layout: Layout, rule: PlaneRule, given: bool) -> None:
    """Find a plane; `given` tells that the user says what it holds, not the profile."""
    found = [channels for channels in map(index.find, rule.candidates(layout.layer)) if channels]
    channels = next((channels for channels in found if channels not in layout.barred), None)
    if channels is None or index.find(name.replace("{layer}", layout.layer) for name in rule.requires) is None:
        return
    match = Match(rule, channels)
    if rule.role is Role.NORMAL and rule.space == "camera" and layout.camera.world_to_camera is None:
        layout.unused[rule.role] = f"normals {match.names} are in camera space and no worldToCamera header: not used"
        layout.barred.update(found)
        return
    if rule.role is Role.MOTION and rule.unit == "velocity" and layout.camera.max_velocity is None:
        layout.unused[rule.role] = (
            f"motion {match.names} is scaled by a largest velocity that the file does not hold: not used; give "
            "max_velocity, in pixels, under [camera] in a profile"
        )
        return
    number = missing_number(rule, layout.camera) if rule.role is Role.DEPTH else None
    if number == "fov" and not given:
        layout.warnings.append(
            f"depth {match.names} is distance from the eye, used as it is: give --depth ray,fov=DEGREES, "
            "or fov_x under [camera] in a profile"
        )
    elif number:
        raise missing_error(channels[0].file.path, match.names, rule, number)
    layout.planes[rule.role] = match


def _detect(index: ChannelIndex, attributes: Mapping[str, Any]) -> Profile:
    profiles = [load_profile(name) for name in profile_names()]
    return next((profile for profile in profiles if _fits(index, profile, attributes)), profiles[-1])


def _fits(index: ChannelIndex, profile: Profile, attributes: Mapping[str, Any]) -> bool:
    layer = _layer(index, profile)
    return any(
        all(re.search(pattern, str(attributes.get(name, ""))) for name, pattern in rule.header)
        and index.find(name.replace("{layer}", layer) for name in rule.channels) is not None
        and not any(index.find([name.replace("{layer}", layer)]) for name in rule.without)
        for rule in profile.detect
    )


def _layer(index: ChannelIndex, profile: Profile) -> str:
    """What precedes the profile's marker channel: 'ViewLayer.' of 'ViewLayer.Combined.R'; '' without a marker."""
    found = next(index.ending_in(profile.marker), None) if profile.marker else None
    return found.name[: -len(profile.marker)] if found else ""


def _first(*values: float | None) -> float | None:
    return next((value for value in values if value is not None), None)
