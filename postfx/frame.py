"""Frames as named planes, and what the planes mean: the one convention that all code relies on once
a file was read."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from functools import cached_property, lru_cache
from typing import Any, NamedTuple, Self

import numpy as np

from postfx.colour.displays import DISPLAY_KINDS, parse_display
from postfx.errors import ColourError, FrameError, GuideError, offer
from postfx.system import host_floats

LOG = logging.getLogger("postfx")
"""The library's logger; it is silent unless a program sets up logging."""
LOG.addHandler(logging.NullHandler())
TOLD = LOG.getChild("told")
"""Part of it, for lines that commands pass on to their users, each kind once. The first argument is
the file or frame."""


class Role(StrEnum):
    """What a plane means. `ROLES` holds channels, unit, space, range and direction of each."""

    COLOUR = "colour"
    ALPHA = "alpha"
    DEPTH = "depth"
    MOTION = "motion"
    NORMAL = "normal"
    DIFFUSE_ALBEDO = "diffuse_albedo"
    SPECULAR_ALBEDO = "specular_albedo"
    ROUGHNESS = "roughness"
    SPECULAR_HIT_DISTANCE = "specular_hit_distance"
    STRENGTH = "strength"
    REACTIVE = "reactive"
    OPAQUE_COLOUR = "opaque_colour"
    OVERLAY = "overlay"
    LATER = "later"
    PARTNER = "partner"
    DENOISING_ALBEDO = "denoising_albedo"
    DENOISING_NORMAL = "denoising_normal"
    ERROR = "error"
    VARIANCE_OF_MEAN = "variance_of_mean"
    SAMPLE_VARIANCE = "sample_variance"
    SECOND_MOMENT = "second_moment"
    SAMPLE_COUNT = "sample_count"

    @classmethod
    def _missing_(cls, value: object) -> Role | None:
        """Other words for a role: 'color', 'opaque_color', 'albedo'."""
        return _OTHER_WORDS.get(value) if isinstance(value, str) else None


_OTHER_WORDS = {"color": Role.COLOUR, "opaque_color": Role.OPAQUE_COLOUR,
                "albedo": Role.DIFFUSE_ALBEDO}


def find_role(word: Role | str, kind: str = "plane", where: str = "") -> Role:
    """The role that a word names; FrameError that suggests one where it names none.

    kind, where: for the message: what the role is of, such as 'guide' and ' of frame 3'.
    """
    try:
        return Role(word)
    except ValueError:
        raise FrameError(f"{kind} '{word}'{where} has no meaning here"
                         f"{offer(str(word), Role, 'roles are')}") from None


class RoleInfo(NamedTuple):
    """Convention of one role: channel count, unit, space, range and direction."""

    channels: int
    unit: str
    space: str
    range: str
    direction: str


_REFLECTANCE = "linear Rec.709"
_OF_COLOUR = "the colour's"

ROLES: Mapping[Role, RoleInfo] = {
    Role.COLOUR: RoleInfo(3, "radiance", "scene-linear Rec.709", "0..inf",
                          "none; premultiplied by alpha"),
    Role.ALPHA: RoleInfo(1, "coverage", "none", "0..1", "0 transparent, 1 opaque"),
    Role.DEPTH: RoleInfo(1, "scene units", "camera", "0..1e10",
                         "along the view axis, away from the camera; miss 1e10"),
    Role.MOTION: RoleInfo(2, "pixels of this frame", "image", "any; NaN unknown",
                          "previous - current; x right, y down; no jitter"),
    Role.NORMAL: RoleInfo(3, "none", "world", "-1..1",
                          "facing the viewer; unit length not forced, zero at misses"),
    Role.DIFFUSE_ALBEDO: RoleInfo(3, "reflectance", _REFLECTANCE, "0..1", "none"),
    Role.SPECULAR_ALBEDO: RoleInfo(3, "reflectance", _REFLECTANCE, "0..1",
                                   "Fresnel towards the viewer"),
    Role.ROUGHNESS: RoleInfo(1, "none", "linear (not squared)", "0..1", "0 mirror, 1 rough"),
    Role.SPECULAR_HIT_DISTANCE: RoleInfo(1, "scene units", "world", "0..inf",
                                         "primary surface to the reflected hit"),
    Role.STRENGTH: RoleInfo(1, "none", "none", "0..1", "0 leave as it is, 1 denoise fully"),
    Role.REACTIVE: RoleInfo(1, "none", "none", "0..1", "0 use the history, 1 ignore it"),
    Role.OPAQUE_COLOUR: RoleInfo(3, "radiance", "scene-linear Rec.709", "0..inf",
                                 "colour before transparency"),
    Role.OVERLAY: RoleInfo(4, "radiance and coverage", "scene-linear Rec.709", "0..inf",
                           "RGBA, premultiplied"),
    Role.LATER: RoleInfo(4, "radiance and weight", "scene-linear Rec.709", "0..inf",
                         "RGBA, times weight"),
    Role.PARTNER: RoleInfo(3, "radiance", "scene-linear Rec.709", "0..inf", "of another denoiser"),
    Role.DENOISING_ALBEDO: RoleInfo(3, "reflectance", _REFLECTANCE, "0..1",
                                    "also of what mirrors and glass show"),
    Role.DENOISING_NORMAL: RoleInfo(3, "none", "camera, as in files", "-1..1",
                                    "also of what mirrors and glass show"),
    Role.ERROR: RoleInfo(1, "squared code values", "sRGB of x / (1 + x)", "0..1",
                         "expected of the denoised colour"),
    Role.VARIANCE_OF_MEAN: RoleInfo(3, "radiance squared", _OF_COLOUR, "0..inf",
                                    "squared standard error of the pixel"),
    Role.SAMPLE_VARIANCE: RoleInfo(3, "radiance squared", _OF_COLOUR, "0..inf",
                                   "of a pixel's samples"),
    Role.SECOND_MOMENT: RoleInfo(3, "radiance squared", _OF_COLOUR, "0..inf",
                                 "mean of a pixel's squared samples"),
    Role.SAMPLE_COUNT: RoleInfo(1, "samples a pixel", "none", "0..inf",
                                "or shares, 0..1, of the header's number"),
}

VARIANCES = (Role.SAMPLE_VARIANCE, Role.SECOND_MOMENT, Role.VARIANCE_OF_MEAN)
"""Planes that tell a pixel's error; the first one that a frame has is used."""
ERROR_ROLES = (*VARIANCES, Role.SAMPLE_COUNT)
"""Planes that tell how far a render has converged. They are only read for masks of converged
pixels, so no pass misses them."""

DEPTH_MISS = 1e10
"""Depth of a pixel whose ray hit nothing."""

LINEAR = ("scene-linear", "display-linear")
ENCODINGS = (*LINEAR, *DISPLAY_KINDS)
"""Meanings of the colour plane: light in the scene, light of a display (1 is white), both in
Rec.709; and code values 0..1 of a display by its name, with peak and white for HDR
('pq,peak=1000,white=203')."""

ALBEDOS = (Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO)
"""Planes whose sum is a surface's reflectance."""

GUIDE_ROLES = (*ALBEDOS, Role.NORMAL, Role.ROUGHNESS, Role.DEPTH)
"""Planes that make edges exact if they come at output size."""

OUTPUT_SIZE_ROLES = (*GUIDE_ROLES, Role.OVERLAY, Role.LATER)
"""All planes that may come at output size, as guides."""

KEY = 0.18
"""Light of middle grey, to which exposure brings the mean of a picture."""


def factor_of_stops(stops: float) -> float:
    """2 ** stops: infinite or 0 where no number holds it, NaN for NaN."""
    return float(np.exp2(np.float64(stops)))


def stops_of_factor(factor: float) -> float:
    """log2(factor): infinite for 0 and infinity, NaN for what is below 0 and for NaN."""
    if factor > 0:
        return float(np.log2(np.float64(factor)))
    return -math.inf if factor == 0 else math.nan


PART_KINDS = ("light", "diffuse", "specular", "scatter", "emission", "albedo", "normal", "position",
              "depth", "mist", "shadow", "ao", "factor")
"""Meanings of a part. The first five are light, which adds up to the picture: light with all of the
reflectance in it, with the diffuse or the specular one, or with none (fog; lamps and a background,
which are seen directly). The others add up to nothing. Files divide some parts by a factor; it is
not filtered, only brought to the output's size."""
ADDITIVE = PART_KINDS[:5]
"""Kinds of parts that are light."""


@dataclass(frozen=True)
class Part:
    """A named plane that is denoised with the picture's filters.

    Attributes:
        name: as the frame's `parts` name it.
        kind: one of `PART_KINDS`.
        group: parts of one group add up to the picture, or to some of it. The same picture may be
            divided in several ways, each a group.
        factor: name of the part of the kind 'factor' that this one is divided by in files. Where
            the factor is 0, the part is, too.

    Raises FrameError for another kind.
    """

    name: str
    kind: str = "light"
    group: str = ""
    factor: str = ""

    def __post_init__(self) -> None:
        if self.kind not in PART_KINDS:
            raise FrameError(f"part '{self.name}' is of the unknown kind '{self.kind}'"
                             f"{offer(self.kind, PART_KINDS)}")

    @property
    def is_light(self) -> bool:
        """Whether it is added up to the picture."""
        return self.kind in ADDITIVE


@dataclass(frozen=True)
class GuideSpec:
    """Size and roles of a frame's guides, which are planes at output size.

    `roles` may be any of `OUTPUT_SIZE_ROLES` and are kept in the order of `Role`; empty if no pass
    reads the guides. `source` is the file that they come from, for messages: comparisons ignore it.
    """

    width: int
    height: int
    roles: tuple[Role, ...]
    source: str | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        wanted = {find_role(role, "guide") for role in self.roles}
        for role in wanted - set(OUTPUT_SIZE_ROLES):
            raise GuideError(f"plane '{role}' cannot be a guide: those are "
                             f"{', '.join(OUTPUT_SIZE_ROLES)}")
        object.__setattr__(self, "roles", tuple(role for role in Role if role in wanted))


@dataclass(frozen=True, init=False)
class FrameSpec:
    """Everything about a frame that passes are compiled for: size, planes, encoding and guides.

    Attributes:
        width, height: pixels.
        planes: role and channel count of each plane, in the order of `Role`, so specs compare and
            hash by meaning. They may be given as a mapping, as pairs or as roles only.
        encoding: meaning of the colour plane, see `ENCODINGS`.
        guides: None for a frame without planes at output size.
        source: file that the frame comes from, for messages: comparisons ignore it.
        parts: name and channel count of each part, in the order of the names; given as a mapping or
            as pairs.

    Raises FrameError for an empty size, a wrong channel count and an unknown encoding.
    """

    width: int
    height: int
    planes: tuple[tuple[Role, int], ...]
    encoding: str = "scene-linear"
    guides: GuideSpec | None = None
    source: str | None = field(default=None, compare=False)
    parts: tuple[tuple[str, int], ...] = ()

    def __init__(
        self,
        width: int,
        height: int,
        planes: Mapping[Role, int] | Iterable[Role | str | tuple[Role, int]],
        encoding: str = "scene-linear",
        guides: GuideSpec | None = None,
        source: str | None = None,
        parts: Mapping[str, int] | Iterable[tuple[str, int]] = (),
    ) -> None:
        if width < 1 or height < 1:
            raise FrameError(f"frame size {width}x{height}: both sides must be at least 1 pixel")
        fixed = {"width": width, "height": height, "planes": _order_planes(planes),
                 "encoding": _complete_encoding(encoding), "guides": guides, "source": source,
                 "parts": tuple(sorted(dict(parts).items()))}
        for name, value in fixed.items():
            object.__setattr__(self, name, value)

    def of_files(self, source: str | None, guide_source: str | None) -> FrameSpec:
        """This spec, with the files that a frame comes from."""
        found = object.__new__(FrameSpec)
        found.__dict__.update(self.__dict__, source=source)
        if self.guides:
            found.__dict__["guides"] = replace(self.guides, source=guide_source)
        return found

    @cached_property
    def roles(self) -> tuple[Role, ...]:
        """Roles of the planes, in the order of `Role`."""
        return tuple([role for role, _ in self.planes])

    @cached_property
    def guide_roles(self) -> tuple[Role, ...]:
        """Roles of the guides, in the order of `Role`."""
        return self.guides.roles if self.guides else ()

    @property
    def part_names(self) -> tuple[str, ...]:
        """Names of the parts, in their order."""
        return tuple(name for name, _ in self.parts)

    def has(self, role: Role) -> bool:
        """Whether the frame holds a plane of this role."""
        return role in self.roles

    def channels(self, role: Role) -> int:
        """Channel count of a plane; FrameError when the frame does not hold it."""
        for held, channels in self.planes:
            if held == role:
                return channels
        raise FrameError(f"the frame has no plane '{role}': it has {', '.join(self.roles)}")


@lru_cache(16)
def _spec_of(shapes: tuple[tuple[Role, tuple[int, ...]], ...], encoding: str,
             guides: tuple[Any, ...] | None, parts: tuple[tuple[str, int], ...]) -> FrameSpec:
    """The spec of frames with planes of these shapes, without their files; made once."""
    height, width, _ = shapes[0][1]
    planes = {role: shape[2] for role, shape in shapes}
    sharp = GuideSpec(*guides) if guides else None
    return FrameSpec(width, height, planes, encoding, sharp, parts=parts)


def _complete_encoding(encoding: str) -> str:
    """An encoding with its peak and white, if these were left out."""
    try:
        return encoding if encoding in LINEAR else str(parse_display(encoding))
    except ColourError as error:
        raise FrameError(f"unknown colour encoding '{encoding}': use {', '.join(LINEAR)}; "
                         f"{error}") from error


def _order_planes(
    planes: Mapping[Role, int] | Iterable[Role | str | tuple[Role, int]]
) -> tuple[tuple[Role, int], ...]:
    items = planes.items() if isinstance(planes, Mapping) else [_pair(item) for item in planes]
    held = {find_role(role): int(channels) for role, channels in items}
    for role, channels in held.items():
        if channels != ROLES[role].channels:
            raise FrameError(f"plane '{role}' has {channels} channels: it needs "
                             f"{ROLES[role].channels}")
    return tuple((role, held[role]) for role in Role if role in held)


def _pair(item: Role | str | tuple[Role, int]) -> tuple[Role, int]:
    if not isinstance(item, str):
        return item
    role = find_role(item)
    return role, ROLES[role].channels


class StoredRows(NamedTuple):
    """Parts of a file as they were unpacked, for whoever writes channels of them again.

    Attributes:
        identity: what tells the file from others, and from what it may become.
        parts: index of a part -> words of its rows, (height, words) uint16.
    """

    identity: tuple[int, ...]
    parts: Mapping[int, np.ndarray]


@dataclass(frozen=True)
class ColourSource:
    """Where a frame's colour is in the file that it was read from.

    Attributes:
        part: part of the file, counted from 0.
        channels: names of red, green and blue there.
        attributes: header attributes as they were read.
        renders: part and name of every channel that stands for the render's colour or its alpha,
            the layers beside the one that was read included.
        pixels: part and name of channels whose values are distances in pixels -> their axis, 0
            across and 1 down.
        rows: of the file, as they were unpacked; None where nobody asked for them.
    """

    part: int
    channels: tuple[str, ...]
    attributes: Mapping[str, Any]
    renders: frozenset[tuple[int, str]] = frozenset()
    pixels: Mapping[tuple[int, str], int] = field(default_factory=dict)
    rows: StoredRows | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True)
class PartSource:
    """How a part is stored in the file that it was read from, and is written again.

    Attributes:
        channels: full names there.
        factor: name of the part that it is divided by there, as Cycles divides light by the colour
            of surfaces.
        exact: whether its numbers are places or distances, which half floats do not hold.
    """

    channels: tuple[str, ...]
    factor: str | None = None
    exact: bool = False


@dataclass(eq=False, repr=False)
class Frame:
    """One image of a sequence: planes of one size, perhaps guides at output size, and what the
    passes must know.

    Attributes:
        planes: role -> float32 C-contiguous array (height, width, channels); units and directions
            are in `ROLES`. Roles may be given as text ("colour" or "color"), arrays of floats by
            any library that has `__dlpack__`, in the host's memory: NumPy's and PyTorch's are not
            copied if they are of that type and layout.
        number: frame number in its sequence.
        jitter: sub-pixel sample position minus 0.5, pixels of this frame, x right, y down; (0, 0)
            when the samples are spread over the pixel.
        exposure: stops that the scene's author suggests for the tone mapper, or None.
        reset: True at a cut: history must be dropped before this frame.
        samples: samples per pixel, or None when unknown.
        world_to_camera: 4x4 float64, row vectors (p_camera = p_world @ M), or None.
        fov_x: horizontal field of view in degrees, or None.
        metadata: header attributes to keep on writing, by EXR name; windows are kept under
            'displayWindow' and 'dataWindow' as (x0, y0, x1, y1), bounds included, the rectangle
            that the planes cover under 'postfx:area' (without it, the display window).
        source: file that the frame, of several files its colour, was read from, or None.
        colour_source: where the colour is in `source`, if it is in one part of it.
        encoding: meaning of the colour plane, see `ENCODINGS`.
        guides: role -> array like those of `planes`, at output size; roles are among
            `OUTPUT_SIZE_ROLES`.
        guide_size: width and height of the guides; given only for a frame whose guides were not
            read.
        guide_jitter: like `jitter`, of the guides' samples, in pixels of the guides.
        guide_source: file that the guides were read from, or None.
        parts: name -> array (height, width, 1 or 3) of a part of the picture, such as a light
            group, in radiance like the colour; or of another plane that is to be denoised with it.
        part_sources: name of a part -> how files store it.
        views: name -> frame of another view of the same moment, such as the right eye of a stereo
            pair; the frame itself is the first view.

    Two frames are equal if all of these are, NaN being equal to NaN; only the files that they come
    from may differ. `print` shows a table of the planes, and a notebook shows the picture as well.

    Raises FrameError when a plane or guide has a wrong shape, channel count or data type, or when
    sizes differ; GuideError, one of its kind, when a guide is of another role.
    """

    planes: dict[Role, np.ndarray]
    number: int = 1
    jitter: tuple[float, float] = (0.0, 0.0)
    exposure: float | None = None
    reset: bool = False
    samples: int | None = None
    world_to_camera: np.ndarray | None = None
    fov_x: float | None = None
    metadata: dict[str, Any] = field(default_factory=dict)
    source: str | None = None
    encoding: str = "scene-linear"
    guides: dict[Role, np.ndarray] = field(default_factory=dict)
    guide_size: tuple[int, int] | None = None
    guide_jitter: tuple[float, float] = (0.0, 0.0)
    guide_source: str | None = None
    colour_source: ColourSource | None = None
    parts: dict[str, np.ndarray] = field(default_factory=dict)
    part_sources: dict[str, PartSource] = field(default_factory=dict)
    views: dict[str, Frame] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in _NAMED_FIELDS:
            if not isinstance(getattr(self, name), Mapping):
                raise FrameError(f"frame {self._name()} has {name} of type "
                                 f"{type(getattr(self, name)).__name__}: give a dict by name, such "
                                 f"as {_NAMED_FIELDS[name]}")
        if not self.planes:
            raise FrameError(f"frame {self._name()} has no planes")
        if not isinstance(self.encoding, str):
            raise FrameError(f"frame {self._name()} has encoding {self.encoding!r}: give a word, "
                             "such as 'scene-linear'")
        if not isinstance(self.number, int | np.integer):
            raise FrameError(f"frame {self._name()} has number {self.number!r}: give a whole one")
        self.planes = self._check_all(self.planes, "plane", self.source)
        self.guides = self._check_all(self.guides, "guide", self.guide_source)
        self.parts = {str(name): self._checked_part(name, part)
                      for name, part in self.parts.items()}
        if self.guides:
            self.guide_size = next(iter(self.guides.values())).shape[1::-1]
        if self.world_to_camera is not None:
            self.world_to_camera = self._numbers("world_to_camera", 16).reshape(4, 4)
        for name in ("jitter", "guide_jitter"):
            if not np.isfinite(self._numbers(name, 2)).all():
                raise FrameError(f"frame {self._name()} has {name} {getattr(self, name)}: give "
                                 "finite numbers")
        for name in ("exposure", "samples", "fov_x"):
            if getattr(self, name) is not None:
                self._numbers(name, 1)

    @property
    def exposure_factor(self) -> float | None:
        """What light is multiplied by for `exposure`: 2 ** stops, or None."""
        return None if self.exposure is None else factor_of_stops(self.exposure)

    def _numbers(self, name: str, count: int) -> np.ndarray:
        """A field's numbers, flat; FrameError where it holds others, or anything else."""
        value = getattr(self, name)
        try:
            # None would become NaN
            found = np.asarray(value) * np.float64(1)
        except (TypeError, ValueError):
            found = np.empty(0)
        is_nested = found.ndim > 0 if count == 1 else found.ndim > 1 and name != "world_to_camera"
        if found.size != count or found.dtype != np.float64 or is_nested:
            words = "a number" if count == 1 else f"{count} numbers"
            shown = " ".join(repr(value).split())[:60]
            raise FrameError(f"frame {self._name()} has {name} {shown}: give {words}")
        return found.ravel()

    @property
    def spec(self) -> FrameSpec:
        """Size, planes and encoding of this frame."""
        shapes = tuple([(role, plane.shape) for role, plane in self.planes.items()])
        guides = (*self.guide_size, tuple(self.guides)) if self.guide_size else None
        parts = tuple([(name, part.shape[2]) for name, part in self.parts.items()])
        alike = _spec_of(shapes, self.encoding, guides, parts)
        return alike.of_files(self.source, self.guide_source)

    def copy_with(self, check: bool = False, **fields: Any) -> Self:
        """A copy with other values of some fields. They are taken as they are, unless `check` has
        the whole frame checked anew."""
        copied = object.__new__(type(self))
        copied.__dict__.update(self.__dict__, **fields)
        if check:
            copied.__post_init__()
        return copied

    def __getitem__(self, role: Role | str) -> np.ndarray:
        """Plane of a role, (height, width, channels); FrameError when the frame does not hold
        it."""
        if isinstance(role, Role) and role in self.planes:
            return self.planes[role]
        if role not in self:
            raise FrameError(f"frame {self._name()} has no plane '{role}': it has "
                             f"{', '.join(self.planes)}")
        return self.planes[Role(role)]

    def __contains__(self, role: object) -> bool:
        return (role in self.planes
                or (isinstance(role, str) and _OTHER_WORDS.get(role) in self.planes))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Frame):
            return NotImplemented
        names = (item.name for item in fields(self) if item.name not in _ORIGIN)
        return all(_is_same(getattr(self, name), getattr(other, name)) for name in names)

    def __repr__(self) -> str:
        rows = [_COLUMNS, *self._rows()]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
        return "\n  ".join([f"Frame {self._name()}: {self.spec.width}x{self.spec.height}, "
                            f"{self.encoding}", *lines])

    def _repr_html_(self) -> str:
        """Table of the planes under the picture, for notebooks."""
        from postfx.thumbnails import notebook_page

        return notebook_page(repr(self).partition("\n")[0], _COLUMNS, self._rows(),
                             self._repr_png_())

    def _repr_png_(self) -> bytes | None:
        """The colour as a PNG file at most 640 pixels wide or high, for notebooks; None without a
        colour."""
        from postfx.thumbnails import notebook_picture

        if Role.COLOUR not in self:
            return None
        return notebook_picture(self[Role.COLOUR], self.encoding, self.exposure_factor or 1)

    def _rows(self) -> list[tuple[str, str, str, str]]:
        """Name, size and channels, type, and range of each plane, guide and part."""
        planes = [(str(role), plane) for role, plane in self.planes.items()]
        planes += [(f"guide {role}", plane) for role, plane in self.guides.items()]
        planes += [(f"part {name}", part) for name, part in self.parts.items()]
        return [(name, f"{plane.shape[1]}x{plane.shape[0]}x{plane.shape[2]}", str(plane.dtype),
                 _range(plane))
                for name, plane in planes]

    def _check_all(self, planes: dict[Role, np.ndarray], kind: str,
                   source: str | None) -> dict[Role, np.ndarray]:
        named = {role if type(role) is Role else self._role(role, kind): plane
                 for role, plane in planes.items()}
        if len(named) < len(planes):
            raise FrameError(f"{kind}s of frame {self._name(source)} name a role twice: "
                             f"{', '.join(planes)}")
        checked = {role: self._check(role, plane, kind) for role, plane in named.items()}
        if len({plane.shape[:2] for plane in checked.values()}) > 1:
            sizes = ", ".join(f"{role} {plane.shape[1]}x{plane.shape[0]}"
                              for role, plane in checked.items())
            raise FrameError(f"{kind}s of frame {self._name(source)} differ in size: {sizes}")
        return checked

    def _role(self, role: Role | str, kind: str) -> Role:
        return find_role(role, kind, f" of frame {self._name()}")

    def _check(self, role: Role, plane: np.ndarray, kind: str) -> np.ndarray:
        if kind == "guide" and role not in OUTPUT_SIZE_ROLES:
            raise GuideError(f"plane '{role}' of frame {self._name()} cannot be a guide: use "
                             f"{', '.join(OUTPUT_SIZE_ROLES)}")
        channels = ROLES[role].channels
        if (type(plane) is np.ndarray and plane.dtype == _FLOAT32 and plane.ndim == 3
                and plane.flags.c_contiguous and plane.shape[2] == channels and plane.size):
            return plane  # as nearly all are
        plane = host_floats(plane, f"{kind} '{role}' of frame {self._name()}")
        if plane.ndim == 2 and channels == 1:
            plane = plane[:, :, None]
        if plane.ndim != 3 or plane.shape[2] != channels or 0 in plane.shape:
            expected = f"(height, width, {channels})"
            raise FrameError(f"{kind} '{role}' of frame {self._name()} has shape {plane.shape}: it "
                             f"needs {expected}")
        return np.ascontiguousarray(plane, np.float32)

    def _checked_part(self, name: str, part: np.ndarray) -> np.ndarray:
        size = next(iter(self.planes.values())).shape[:2]
        part = host_floats(part, f"part '{name}' of frame {self._name()}")
        part = part[:, :, None] if part.ndim == 2 else part
        if part.ndim != 3 or part.shape[:2] != size or part.shape[2] not in (1, 3):
            expected = f"({size[0]}, {size[1]}, 1 or 3)"
            raise FrameError(f"part '{name}' of frame {self._name()} has shape {part.shape}: it "
                             f"needs {expected}")
        return np.ascontiguousarray(part, np.float32)

    def _name(self, source: str | None = None) -> str:
        source = source or self.source
        return f"{self.number} ({source})" if source else str(self.number)


_FLOAT32 = np.dtype(np.float32)
_NAMED_FIELDS = {"planes": "{'colour': array}", "guides": "{'normal': array}",
                 "parts": "{'key': array}", "metadata": "{'owner': 'me'}",
                 "views": "{'right': frame}"}
"""Fields that are dicts, and what one may be."""
_ORIGIN = ("part_sources", "source", "guide_source", "colour_source")
"""Fields of a frame that tell where it was read from."""

_COLUMNS = ("plane", "size", "type", "range")


def _is_same(one: Any, other: Any) -> bool:
    """Whether two values are equal, arrays element by element."""
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        floats = np.asarray(one).dtype.kind == np.asarray(other).dtype.kind == "f"
        return np.array_equal(one, other, equal_nan=floats)
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(_is_same(value, other[key])
                                                  for key, value in one.items())
    return bool(one == other)


def _range(plane: np.ndarray) -> str:
    """Smallest and largest finite value, and how many values are not finite."""
    finite = plane[np.isfinite(plane)]
    text = f"{finite.min():.4g} to {finite.max():.4g}" if finite.size else "nothing finite"
    wrong = plane.size - finite.size
    return f"{text}, {wrong} not finite" if wrong and finite.size else text


def pixel_aspect(header: Mapping[str, Any]) -> float:
    """Width of a pixel over its height, by the attributes of a header or a frame's metadata; 1
    without."""
    return float(header.get("pixelAspectRatio", 1.0)) or 1.0
