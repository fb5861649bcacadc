"""Finding the planes of a frame among the channels of its files."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from postfx.errors import MissingPlaneError, ReadError
from postfx.frame import Frame, FrameSpec, Role
from postfx.io.convert import Camera, convert, fill_value
from postfx.io.exr import ImageFile, Part
from postfx.io.profile import PlaneRule, Profile, load_profile, profile_names

COLOUR_FILES = ("beauty", "rgba", "rgb", "colour", "color", "combined", "image", "noisy")
"""Words that stand for the colour plane where every plane has its own file."""

REC709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
"""Chromaticities of red, green, blue and white (ITU-R BT.709-6, table 1)."""


def is_plane_word(word: str) -> bool:
    """Whether a word in file names stands for a plane: one for the colour, or a layer name of the generic profile."""
    layers = {name for rule in load_profile("generic").planes for name in rule.names if name}
    return word.lower() in {*COLOUR_FILES, *layers}


class Channel(NamedTuple):
    """One channel of one part of one of a frame's files."""

    file: ImageFile
    part: Part
    name: str


class Match(NamedTuple):
    """A plane that was found: the rule that fits and its channels."""

    rule: PlaneRule
    channels: tuple[Channel, ...]

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


class FrameFiles:
    """The open files of one frame. Use as a context manager.

    `paths` maps a plane's word ('' where one file holds all planes) to its file. Raises MissingFrameError or ReadError
    when one of them cannot be opened.
    """

    def __init__(self, paths: Mapping[str, Path], profile: str | None = None) -> None:
        self._stack = ExitStack()
        try:
            self._files = {word: self._stack.enter_context(ImageFile(path)) for word, path in paths.items()}
        except BaseException:
            self._stack.close()
            raise
        self.path = next(iter(self._files.values())).path
        self.channels = _index(self._files)
        self.layout = _layout(self, load_profile(profile) if profile else None)

    def __enter__(self) -> FrameFiles:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def attributes(self) -> dict[str, Any]:
        """Header attributes of all parts; where several parts have one, the first part's counts."""
        merged: dict[str, Any] = {}
        for file in self._files.values():
            for part in file.parts:
                merged = {**part.attributes, **merged}
        return merged

    def find(self, names: Iterable[str]) -> tuple[Channel, ...] | None:
        """Channels by full name, letter case ignored and * matching anything; None unless all are there."""
        found = [self._find_one(name.lower()) for name in names]
        return tuple(found) if all(found) else None

    def spec(self) -> FrameSpec:
        """Size and planes of the frame; MissingPlaneError when there is no colour."""
        display = self.match(Role.COLOUR).channels[0].part.display
        return FrameSpec(display.width, display.height, tuple(self.layout.planes))

    def read(self, number: int, roles: Iterable[Role] | None = None) -> Frame:
        """Frame with the planes of `roles` (None: all that are there).

        Raises MissingPlaneError when one of `roles` is not there, ReadError when pixels cannot be decoded.
        """
        wanted = list(self.layout.planes) if roles is None else [Role(role) for role in roles]
        if not wanted:
            raise self.missing(Role.COLOUR)
        matches = {role: self.match(role) for role in wanted}
        pixels = _read_channels(matches.values())
        camera = self.layout.camera
        planes = {role: _assemble(match, pixels, camera) for role, match in matches.items()}
        return self._frame(number, planes, next(iter(matches.values())).channels[0].part)

    def match(self, role: Role) -> Match:
        """Where a plane is; MissingPlaneError when the profile finds none."""
        if role not in self.layout.planes:
            raise self.missing(role)
        return self.layout.planes[role]

    def missing(self, role: Role) -> MissingPlaneError:
        """Error that says what was looked for and how to mend it."""
        profile, rules = self.layout.profile, self.layout.profile.rules(role)
        looked = [names for rule in rules for names in rule.candidates(self.layout.layer)][:2]
        hint = next((rule.enable for rule in rules if rule.enable), "")
        mend = f"switch it on ({hint})" if hint else "render it"
        tried = " or ".join(", ".join(names) for names in looked) or "nothing"
        return MissingPlaneError(
            f"{self.path}: no plane '{role}': profile {profile.name} looks for {tried}; "
            f"{mend}, or name it in a profile (--profile FILE.toml)"
        )

    def _find_one(self, name: str) -> Channel | None:
        if "*" not in name:
            return self.channels.get(name)
        return next((channel for key, channel in self.channels.items() if fnmatchcase(key, name)), None)

    def _frame(self, number: int, planes: dict[Role, np.ndarray], part: Part) -> Frame:
        header, camera = _Header(self.layout), self.layout.camera
        windows = {"displayWindow": tuple(part.display), "dataWindow": tuple(part.data)}
        return Frame(
            planes,
            number=number,
            jitter=camera.jitter,
            exposure=header.number("exposure"),
            reset=bool(header.number("reset")),
            samples=int(header.number("samples") or 0) or None,
            world_to_camera=camera.world_to_camera,
            fov_x=camera.fov_x,
            metadata={**self.layout.attributes, **windows},
            source=str(self.path),
        )


class _Header:
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
            pixel_aspect=float(self._layout.attributes.get("pixelAspectRatio", 1.0)) or 1.0,
        )


def _index(files: Mapping[str, ImageFile]) -> dict[str, Channel]:
    """Lower-case full name -> channel. Parts of another view than the first part's are left out."""
    index: dict[str, Channel] = {}
    for word, file in files.items():
        own_names = word == "" or word.lower() in COLOUR_FILES
        for part in file.parts:
            if part.view not in ("", file.parts[0].view):
                continue
            for name in part.channels:
                channel = Channel(file, part, name)
                full = [name] if own_names or "." in name else []
                full += [f"{part.name}.{name}"] if part.name else []
                for key in full + ([f"{word}.{name}"] if word else []):
                    index.setdefault(key.lower(), channel)
    return index


def _layout(files: FrameFiles, profile: Profile | None) -> Layout:
    attributes = files.attributes()
    profile = profile or _detect(files, attributes)
    layout = Layout(profile, _layer(files, profile), {}, Camera(), attributes)
    layout.camera = _Header(layout).camera()
    for rule in profile.planes:
        if rule.role not in layout.planes:
            _match_rule(files, layout, rule)
    layout.warnings += _colour_warnings(layout)
    return layout


def _colour_warnings(layout: Layout) -> list[str]:
    match, warnings = layout.planes.get(Role.COLOUR), []
    if match and match.channels[0].part.overscan:
        warnings.append("overscan outside the display window is cut off")
    primaries = layout.attributes.get("chromaticities", REC709)
    if np.size(primaries) == 8 and not np.allclose(primaries, REC709, atol=2e-3):
        warnings.append("colours have other primaries than Rec.709 (chromaticities header): processed as they are")
    return warnings


def _match_rule(files: FrameFiles, layout: Layout, rule: PlaneRule) -> None:
    channels = next(filter(None, map(files.find, rule.candidates(layout.layer))), None)
    if channels is None:
        return
    match = Match(rule, channels)
    if rule.role is Role.NORMAL and rule.space == "camera" and layout.camera.world_to_camera is None:
        layout.warnings.append(f"normals {match.names} are in camera space and no worldToCamera header: not used")
        return
    if rule.role is Role.DEPTH and rule.kind == "ray" and layout.camera.fov_x is None:
        layout.warnings.append(
            f"depth {match.names} is distance from the eye, used as it is: give fov_x under [camera] in a profile"
        )
    layout.planes[rule.role] = match


def _detect(files: FrameFiles, attributes: Mapping[str, Any]) -> Profile:
    profiles = [load_profile(name) for name in profile_names()]
    return next((profile for profile in profiles if _fits(files, profile, attributes)), profiles[-1])


def _fits(files: FrameFiles, profile: Profile, attributes: Mapping[str, Any]) -> bool:
    layer = _layer(files, profile)
    return any(
        all(re.search(pattern, str(attributes.get(name, ""))) for name, pattern in rule.header)
        and files.find(name.replace("{layer}", layer) for name in rule.channels) is not None
        for rule in profile.detect
    )


def _layer(files: FrameFiles, profile: Profile) -> str:
    """What precedes the profile's marker channel: 'ViewLayer.' of 'ViewLayer.Combined.R'; '' without a marker."""
    marker = profile.marker.lower()
    names = [channel.name for key, channel in files.channels.items() if marker and key.endswith(marker)]
    return names[0][: -len(marker)] if names else ""


def _read_channels(matches: Iterable[Match]) -> dict[Channel, np.ndarray]:
    """Every needed channel once, with one read of each part that holds any."""
    wanted: dict[tuple[ImageFile, int], dict[Channel, float]] = {}
    for match in matches:
        for channel in match.channels:
            wanted.setdefault((channel.file, channel.part.index), {})[channel] = fill_value(match.rule)
    pixels: dict[Channel, np.ndarray] = {}
    for (file, _), channels in wanted.items():
        part = next(iter(channels)).part
        read = file.read(part, {channel.name: fill for channel, fill in channels.items()})
        pixels.update({channel: read[channel.name] for channel in channels})
    return pixels


def _assemble(match: Match, pixels: Mapping[Channel, np.ndarray], camera: Camera) -> np.ndarray:
    planes = [pixels[channel] for channel in match.channels]
    if len({plane.shape for plane in planes}) > 1:
        raise ReadError(f"{match.channels[0].file.path}: channels {match.names} differ in size; write them as one part")
    return convert(np.stack(planes, axis=-1), match.rule, camera)
