"""Renders of one frame with different seeds as one render, each pixel weighted by its samples.

What a renderer averages over the samples of a pixel is averaged again: light, alpha, reflectance,
noise estimates. What cannot be averaged is taken from one file, the first that has the pixel: ids
and Cryptomattes, depth, positions, motion. Normals that have unit length in all files keep it.

A file counts only where it was rendered: within its data windows, and where its plane of sample
counts is above 0. Without such a plane it counts within the smallest rectangle that holds all of
its light, if that of all files is larger: Blender writes border renders at full size with black
around them. Where samples then differ from pixel to pixel, a plane of counts is written, so that
what is merged can be merged again.

All is written as ZIP-compressed scanlines, with the types that the channels have in the first file.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from postfx.errors import FrameError, ReadError
from postfx.files import output_file
from postfx.frame import Role
from postfx.io.channels import read_channels
from postfx.io.exr import ChannelInfo, Header, text
from postfx.io.exr.container import (
    FLOAT_KIND,
    HALF_KIND,
    ExrContainer,
    NewPart,
    picture_part,
    write_container,
)
from postfx.io.exr.passthrough import resize_header
from postfx.io.frame_reader import FrameFiles
from postfx.io.read_options import ReadOptions
from postfx.io.render_time import AVERAGED, SUMMED, format_time, parse_time
from postfx.io.windows import Part, Window
from postfx.masks.noise import count_unit
from postfx.other_shots import Squares, is_other_picture, squares_of
from postfx.planes import LARGEST_HALF
from postfx.repeats import is_same_render


class Rule(StrEnum):
    """What becomes of the values of one channel."""

    MEAN = "mean"
    DIRECTION = "direction"
    ONE = "one"
    SUM = "sum"
    COUNT = "count"
    VARIANCE_OF_MEAN = "variance of the mean"


_OF_ROLES = {
    Role.DEPTH: Rule.ONE,
    Role.MOTION: Rule.ONE,
    Role.NORMAL: Rule.DIRECTION,
    Role.SAMPLE_COUNT: Rule.COUNT,
    Role.SPECULAR_HIT_DISTANCE: Rule.ONE,
    Role.VARIANCE_OF_MEAN: Rule.VARIANCE_OF_MEAN,
}
_OF_NAMES = (
    (Rule.ONE, re.compile(r"crypto", re.IGNORECASE)),
    (Rule.COUNT, re.compile(r"sample[ _]?count", re.IGNORECASE)),
    (Rule.SUM, re.compile(r"debug (bvh|ray|render time)", re.IGNORECASE)),
    (Rule.DIRECTION, re.compile(r"normal|(^|[._ ])(n|ng|ns|nn)[._ ]", re.IGNORECASE)),
    (Rule.ONE, re.compile(r"depth|position|point|motion|vector|velocity|forward|backward|[._ "
                          r"]t$|(^|[._ ])(z|p|pref|pworld|ids?|uv|st|index(ob|ma)?)([._ "
                          r"]|$)|(?-i:[a-z]I[dD]([._ ]|$))", re.IGNORECASE)),
)
"""Of channels that the profile does not know, such as those of other view layers; the first that is
found counts."""
_UNIT = 2e-3
"""By how much the length of a unit vector of half floats may differ from 1."""
_SAME = 0.95
"""Share of a rectangle's area from which on another one within it is taken for the same."""
_BLOCK_ROWS = 64
"""Rows that are looked at together."""
_COMPARED_ROWS = 16
"""About so many rows, spread over the picture, tell whether two files hold the same noise."""
_SAMPLES = re.compile(r"cycles\..+\.samples|postfx:spp|samplesPerPixel")
_SPP = "postfx:spp"
_MERGED = "postfx:merged"
_COUNT_NAME = "sample_count.Y"


@dataclass
class Merged:
    """What became of one frame: its samples a pixel where it has most, and what the user should
    know."""

    path: Path
    samples: int
    notes: list[str] = field(default_factory=list)


def merge_renders(
    paths: Sequence[Path], target: Path, samples: Sequence[int | None] | None = None,
    profile: str | None = None
) -> Merged:
    """Write the renders of one frame as one; samples: a pixel of each file, where the headers do
    not say it; None for those that do.

    Raises ReadError for a file that is broken, is no OpenEXR file or does not tell its samples,
    FrameError where files are not of one frame, show other pictures than the first or hold the same
    noise, WriteError where the result
    cannot be written.
    """
    with ExitStack() as stack:
        given: Sequence[int | None] = samples or [None] * len(paths)
        renders = [stack.enter_context(Render(path, count, profile))
                   for path, count in zip(paths, given, strict=True)]
        merge = _Merge(renders)
        with output_file(target) as temporary:
            write_container(temporary, merge.parts())
    return Merged(target, merge.samples, merge.notes)


class Render:
    """An open render: its planes, and how many samples its pixels have. Use as a context manager.

    Attributes:
        samples: a pixel, where the file says no more.
        lit: the rectangle that it was rendered in, None for all.
    """

    def __init__(self, path: Path, samples: int | None, profile: str | None) -> None:
        self.path = path
        self._stack = ExitStack()
        if path.suffix.lower() != ".exr":
            raise ReadError(f"{path}: only OpenEXR files are merged: write the render as EXR")
        try:
            self._files = self._stack.enter_context(FrameFiles({"": path},
                                                               ReadOptions(profile=profile)))
            self.container = self._stack.enter_context(ExrContainer(path))
            self._read_facts(samples)
        except BaseException:
            self._stack.close()
            raise

    def __enter__(self) -> Render:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def _read_facts(self, samples: int | None) -> None:
        colour, layout = self._files.match(Role.COLOUR), self._files.layout
        self.file, self.attributes, self.layout = self._files.files[""], layout.attributes, layout
        self.colour = colour.channels
        if any(part.is_picture for part in self.file.parts):
            raise ReadError(f"{self.path}: is a picture that postfx made: merge the renders, then "
                            "process the result")
        self.samples = samples or layout.facts.samples or 0
        self._counts: tuple[Window, np.ndarray] | None = None
        if Role.SAMPLE_COUNT in layout.planes:
            (channel,) = self._files.match(Role.SAMPLE_COUNT).channels
            stored = self.file.read_stored(channel.part, [channel.name], 0,
                                           channel.part.data.height)[0]
            counts = np.maximum(stored.astype(np.float32), 0) * count_unit(stored, self.samples)
            self._counts = channel.part.data, counts
            self.samples = self.samples or int(np.rint(counts.max(initial=0)))
        if not self.samples:
            raise ReadError(f"{self.path}: its header does not say how many samples a pixel it "
                            "has: give --samples with a number for each file, such as --samples "
                            "16,64")
        self.lit: Window | None = None

    def find_light(self) -> Window | None:
        """The smallest rectangle that holds all light; None where there is none."""
        data, light = self.colour[0].part.data, (self.read_colour() != 0).any(axis=2)
        rows, columns = np.flatnonzero(light.any(axis=1)), np.flatnonzero(light.any(axis=0))
        if not len(rows):
            return None
        return Window(data.x0 + int(columns[0]), data.y0 + int(rows[0]), data.x0 + int(columns[-1]),
                      data.y0 + int(rows[-1]))

    def read_colour(self) -> np.ndarray:
        """Red, green and blue of its data window (height, width, 3), float32."""
        data, area = self.colour[0].part.data, self.colour[0].part.area
        pixels = read_channels(self._files.files, dict.fromkeys(self.colour, 0.0))
        whole = np.stack([pixels[channel] for channel in self.colour], axis=-1)
        y, x = data.y0 - area.y0, data.x0 - area.x0
        return whole[y : y + data.height, x : x + data.width]

    @property
    def has_counts(self) -> bool:
        """Whether it tells the samples of each pixel."""
        return self._counts is not None

    @property
    def is_even(self) -> bool:
        """Whether all pixels of its data window have the same samples."""
        return self._counts is None and self.lit is None

    def weight(self, window: Window) -> np.ndarray:
        """Samples of the pixels of a rectangle (height, width), 0 where it was not rendered."""
        if self._counts is not None:
            return place(self._counts[1], self._counts[0], window, np.float32(0))
        own = self.lit or self.colour[0].part.data
        found = np.zeros(_shape(window), np.float32)
        if inside := own.common(window):
            found[_within(inside, window)] = self.samples
        return found

    def find(self, part: Part, name: str) -> Part | None:
        """The part that holds this channel of a part of another file: that of the same name, or the
        only one."""
        holding = [own for own in self.file.parts if name in own.channels]
        named = [own for own in holding if (own.name, own.view) == (part.name, part.view)]
        found = named or (holding if len(holding) == 1 else [])
        return found[0] if found else None

    def read(self, part: Part, names: Sequence[str],
             window: Window) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Channels of a part of another file, by name, in a rectangle: their values, and where they
        have any."""
        sources: dict[Part, list[str]] = {}
        for name in names:
            if own := self.find(part, name):
                sources.setdefault(own, []).append(name)
        found: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        for own, held in sources.items():
            if not (inside := own.data.common(window)):
                nothing = np.zeros(_shape(window), np.float32), np.zeros(_shape(window), bool)
                found |= dict.fromkeys(held, nothing)
                continue
            there = place(np.ones(_shape(inside), bool), inside, window, False)
            rows = own.data._replace(y0=inside.y0, y1=inside.y1)
            stored = self.file.read_stored(own, held, inside.y0 - own.data.y0,
                                           inside.y1 + 1 - own.data.y0)
            for name, pixels in zip(held, stored, strict=True):
                found[name] = place(pixels, rows, window, pixels.dtype.type(0)), there
        return found

    def rules(self) -> dict[tuple[int, str], Rule]:
        """What becomes of each channel, by the number of its part and its name."""
        known = {(channel.part.index, channel.name): _OF_ROLES.get(role, Rule.MEAN)
                 for role, match in self.layout.planes.items() for channel in match.channels}
        found = {}
        for part in self.file.parts:
            for name, kind in zip(part.channels, part.formats, strict=True):
                full = name if "." in name else f"{part.name}.{name}"
                own = next((rule for rule, words in _OF_NAMES if words.search(full)), Rule.MEAN)
                found[part.index, name] = (Rule.ONE if kind == "uint"
                                           else known.get((part.index, name), own))
        return found


class _Merge:
    """Open renders of one frame, and the parts of the file that they become."""

    def __init__(self, renders: Sequence[Render]) -> None:
        self._renders, self._first = renders, renders[0]
        self.samples = sum(render.samples for render in renders)
        self.notes: list[str] = []
        self._rules = self._first.rules()
        self._check_frames()
        self._find_regions()
        self._refuse_same_noise()
        self._refuse_other_pictures()
        self._is_uneven = any(not render.is_even for render in renders) or len(
            {render.colour[0].part.data for render in renders}) > 1
        self._shares = self._first.layout.profile.name.startswith("cycles")

    def _check_frames(self) -> None:
        first, told = self._first, {}
        for render in self._renders[1:]:
            own, other = render.colour[0].part.display, first.colour[0].part.display
            if own != other:
                raise FrameError(f"{render.path}: its picture has {own.width}x{own.height} pixels, "
                                 f"that of {first.path} {other.width}x{other.height}: render both "
                                 "at one size, and regions of it without cropping the picture")
            lacking = [name for part in first.file.parts
                       for name in part.channels if render.find(part, name) is None]
            told[render.path.name] = lacking
            more = [name for part in render.file.parts
                    for name in part.channels if first.find(part, name) is None]
            if more:
                self.notes.append(f"{render.path}: {_listed(more)} not in {first.path}: left out")
        self.notes += [f"{name}: has no {_listed(lacking)}: taken from the others"
                       for name, lacking in told.items() if lacking]
        deep = [header.name or "deep"
                for header in first.container.headers if header.part_type.startswith("deep")]
        self.notes += [f"{first.path}: deep part {name} is copied, not merged" for name in deep]

    def _find_regions(self) -> None:
        """Let renders count only where their light is, if that of all renders covers clearly
        more."""
        boxes = {number: box
                 for number, render in enumerate(self._renders) if (box := render.find_light())}
        every = [*boxes.values()]
        for box in boxes.values():
            every[0] = every[0].around(box)
        for number, box in boxes.items():
            render = self._renders[number]
            if (not render.has_counts
                and box.width * box.height < _SAME * every[0].width * every[0].height):
                render.lit = box
                self.notes.append(f"{render.path}: has light only in {box.width}x{box.height} "
                                  f"pixels from ({box.x0}, {box.y0}) on: merged there alone")

    def _refuse_same_noise(self) -> None:
        """FrameError where two files hold the same noise: the samples would count twice."""
        seen: list[tuple[Path, np.ndarray]] = []
        for render in self._renders:
            colour = render.read_colour()
            rows = colour[::max(colour.shape[0] // _COMPARED_ROWS, 1)]
            for path, other in seen:
                if is_same_render(rows, other):
                    raise FrameError(f"{render.path}: has the same noise as {path}: render it with "
                                     "another seed, or leave it out")
            seen.append((render.path, rows))

    def _refuse_other_pictures(self) -> None:
        """FrameError where two files show different pictures: the mean would show both."""
        display = self._first.colour[0].part.display
        seen: list[tuple[Path, Squares]] = []
        for render in self._renders:
            colour = place(render.read_colour(), render.colour[0].part.data, display, np.float32(0))
            own = squares_of(colour, render.weight(display) > 0)
            for path, other in seen:
                if is_other_picture(own, other):
                    raise FrameError(f"{render.path}: shows another picture than {path}: give "
                                     "renders of one frame of one shot that differ in their seed")
            seen.append((render.path, own))

    def parts(self) -> list[NewPart]:
        """All parts of the output."""
        flat = {part.index: part for part in self._first.file.parts}
        parts = []
        for index, header in enumerate(self._first.container.headers):
            if index in flat:
                parts.append(self._merge_part(flat[index], header))
            else:
                stored = self._first.container
                parts.append(NewPart(header, stored.counts[index], stored.copy_chunks(index)))
        return parts

    def _merge_part(self, part: Part, stored: Header) -> NewPart:
        window = part.data
        for render in self._renders:
            for own in {one for name in part.channels if (one := render.find(part, name))}:
                window = window.around(own.data)
        channels = list(stored.channels)
        if (part.index == self._first.colour[0].part.index and self._is_uneven
            and self._lacks_counts()):
            channels.append(ChannelInfo(self._count_name(), FLOAT_KIND, 0, 1, 1))
        header = resize_header(Header(dict(stored.attributes)), window, channels)
        for name in ("dwaCompressionLevel", "preview", "thumbnail"):
            header.attributes.pop(name, None)
        self._sum_attributes(header, part.index == self._first.colour[0].part.index)
        order = header.channels
        unit = self._unit_layers(part)

        def rows(first: int, last: int) -> list[np.ndarray]:
            some = window._replace(y0=window.y0 + first, y1=window.y0 + last - 1)
            return self._merge_rows(part, order, some, unit)

        return picture_part(header, rows)

    def _lacks_counts(self) -> bool:
        return Rule.COUNT not in self._rules.values()

    def _count_name(self) -> str:
        rules = self._first.layout.profile.rules(Role.SAMPLE_COUNT)
        names = [names for rule in rules for names in rule.candidates(self._first.layout.layer)]
        return names[0][0] if names else _COUNT_NAME

    def _merge_rows(self, part: Part, order: list[ChannelInfo], window: Window,
                    unit: set[str]) -> list[np.ndarray]:
        """Channels of some rows of a part, in the order of its header."""
        weights = np.stack([render.weight(window) for render in self._renders]).astype(np.float64)
        rules = {channel.name: self._rules.get((part.index, channel.name), Rule.COUNT)
                 for channel in order}
        stored = [render.read(part, [name for name in rules if rules[name] is not Rule.COUNT],
                              window)
                  for render in self._renders]
        found: dict[str, np.ndarray] = {}
        for name, rule in rules.items():
            if rule is Rule.COUNT:
                found[name] = weights.sum(axis=0) / (self.samples if self._shares else 1)
                continue
            held = [number for number, channels in enumerate(stored) if name in channels]
            there = np.stack([stored[number][name][1] for number in held])
            values = np.stack([stored[number][name][0] for number in held])
            found[name] = _combine(rule, values, weights[held] * there, there)
        for layer in unit:
            _lengthen([found[name] for name in found if _layer(name) == layer])
        return [_as_stored(found[channel.name], channel.kind) for channel in order]

    def _unit_layers(self, part: Part) -> set[str]:
        """Layers of normals of a part that have unit length, or are 0, in all pixels of all
        renders."""
        layers: dict[str, list[str]] = {}
        for name in part.channels:
            if self._rules[part.index, name] is Rule.DIRECTION:
                layers.setdefault(_layer(name), []).append(name)
        return {layer for layer, names in layers.items() if len(names) == 3
                and all(_is_unit(render, part, names) for render in self._renders)}

    def _sum_attributes(self, header: Header, is_picture: bool) -> None:
        """Samples and times of all renders in the header of a part."""
        own = set(self._first.layout.profile.header.get("samples", ()))
        main = {name.replace("{layer}", self._first.layout.layer) for name in own}
        for name, attribute in list(header.attributes.items()):
            each = [render.attributes.get(name) for render in self._renders]
            if name in main:
                each = [render.samples for render in self._renders]
            if name in main or _SAMPLES.fullmatch(name):
                _set_number(header, name, attribute.kind,
                            sum(int(float(value or 0)) for value in each))
            elif SUMMED.fullmatch(name) or AVERAGED.fullmatch(name):
                seconds = [parse_time(str(value)) for value in each]
                count = len(seconds) if AVERAGED.fullmatch(name) else 1
                header.set_text(name, format_time(sum(seconds) / count, text(attribute.value)))
        if is_picture and not main & header.attributes.keys():
            _set_number(header, _SPP, "int", self.samples)
        if is_picture:
            header.set_text(_MERGED, ", ".join(f"{render.path.name} {render.samples}"
                                               for render in self._renders))


def place(pixels: np.ndarray, own: Window, window: Window, fill: Any) -> np.ndarray:
    """Pixels of one rectangle in another one, `fill` where they have none."""
    if own == window:
        return pixels
    found = np.full((*_shape(window), *pixels.shape[2:]), fill, pixels.dtype)
    if inside := own.common(window):
        found[_within(inside, window)] = pixels[_within(inside, own)]
    return found


def _shape(window: Window) -> tuple[int, int]:
    return window.height, window.width


def _within(inner: Window, outer: Window) -> tuple[slice, slice]:
    y, x = inner.y0 - outer.y0, inner.x0 - outer.x0
    return slice(y, y + inner.height), slice(x, x + inner.width)


def _combine(rule: Rule, stack: np.ndarray, weights: np.ndarray, there: np.ndarray) -> np.ndarray:
    """One channel of all renders (renders, height, width) as one; where none has samples, the first
    that is there."""
    numbers = np.argmax(np.where(weights.any(axis=0), weights > 0, there), axis=0)
    first: np.ndarray = np.take_along_axis(stack, numbers[None], axis=0)[0]
    if rule is Rule.ONE:
        return first
    weights = np.where(np.isfinite(stack), weights, 0)
    stack = np.where(weights > 0, stack, 0).astype(np.float64)
    if rule is Rule.SUM:
        return np.asarray(stack.sum(axis=0))
    power = 2 if rule is Rule.VARIANCE_OF_MEAN else 1
    total = weights.sum(axis=0)
    mean = (stack * weights**power).sum(axis=0) / np.where(total > 0, total, 1) ** power
    return np.where(total > 0, mean, first)


def _as_stored(values: np.ndarray, kind: int) -> np.ndarray:
    """Values in the type of a channel; what half floats cannot hold is cut to what they can."""
    if kind == HALF_KIND and values.dtype != np.float16:
        values = np.where(np.isfinite(values), np.clip(values, -LARGEST_HALF, LARGEST_HALF),
                          values)
    return values.astype((np.uint32, np.float16, np.float32)[kind])


def _is_unit(render: Render, part: Part, names: Iterable[str]) -> bool:
    """Whether vectors have unit length wherever they are not 0."""
    own = [render.find(part, name) for name in names]
    if own[0] is None or any(one is not own[0] for one in own):
        return False
    for first in range(0, own[0].data.height, _BLOCK_ROWS):
        last = min(own[0].data.height, first + _BLOCK_ROWS)
        squares = sum(np.square(pixels.astype(np.float32))
                      for pixels in render.file.read_stored(own[0], list(names), first, last))
        if not ((squares == 0) | (np.abs(np.sqrt(squares) - 1) < _UNIT)).all():
            return False
    return True


def _lengthen(vector: list[np.ndarray]) -> None:
    """Give vectors unit length in place; 0 stays."""
    length = np.sqrt(sum(np.square(part) for part in vector))
    for part in vector:
        part /= np.where(length > 0, length, 1)


def _layer(name: str) -> str:
    return name.rpartition(".")[0]


def _listed(names: list[str]) -> str:
    layers = list(dict.fromkeys(_layer(name) or name for name in names))
    return ", ".join(layers[:4]) + (f" and {len(layers) - 4} more" if len(layers) > 4 else "")


def _set_number(header: Header, name: str, kind: str, value: int) -> None:
    """Write a number in the type that an attribute has."""
    pack: dict[str, Callable[[], bytes]] = {"int": lambda: struct.pack("<i", value),
                                            "float": lambda: struct.pack("<f", value)}
    if kind in pack:
        header.set(name, kind, pack[kind]())
    else:
        header.set_text(name, str(value))
