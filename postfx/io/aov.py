"""The planes of one frame, read from its files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from postfx.errors import MissingPlaneError, ReadError
from postfx.frame import Frame, FrameSpec, Role
from postfx.io.channels import COLOUR_FILES, Channel, ChannelIndex
from postfx.io.convert import Camera, convert, fill_value
from postfx.io.exr import ImageFile, Part
from postfx.io.layout import Header, Match, make_layout
from postfx.io.profile import load_profile


def is_plane_word(word: str) -> bool:
    """Whether a word in file names stands for a plane: one for the colour, or a layer name of the generic profile."""
    layers = {name for rule in load_profile("generic").planes for name in rule.names if name}
    return word.lower() in {*COLOUR_FILES, *layers}


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
        index = ChannelIndex(self._files)
        self.layout = make_layout(index, self._attributes(), load_profile(profile) if profile else None)

    def __enter__(self) -> FrameFiles:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

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

    def _attributes(self) -> dict[str, Any]:
        """Header attributes of all parts; where several parts have one, the first part's counts."""
        merged: dict[str, Any] = {}
        for file in self._files.values():
            for part in file.parts:
                merged = {**part.attributes, **merged}
        return merged

    def _frame(self, number: int, planes: dict[Role, np.ndarray], part: Part) -> Frame:
        header, camera = Header(self.layout), self.layout.camera
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
