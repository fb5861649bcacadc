"""Frames as named planes: the one convention that everything after reading relies on."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from postfx.colour.displays import KINDS, parse_display
from postfx.errors import ColourError, FrameError, GuideError
from postfx.roles import ROLES, Role
from postfx.stored import Stored

DEPTH_MISS = 1e10
"""Depth of a pixel whose ray hit nothing."""

LINEAR = ("scene-linear", "display-linear")
ENCODINGS = (*LINEAR, *KINDS)
"""Meanings of the colour plane: light in the scene, light of a display (1 is white), both in Rec.709; and code values
0..1 for displays by name, with peak and white where they are HDR ('pq,peak=1000,white=203')."""


GUIDE_ROLES = (Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO, Role.NORMAL, Role.ROUGHNESS, Role.DEPTH)
"""Planes at output size that make edges exact."""

OUTPUT_SIZE_ROLES = (*GUIDE_ROLES, Role.OVERLAY, Role.LATER)
"""Planes that may come at output size: guides, in the widest sense."""


@dataclass(frozen=True)
class GuideSpec:
    """Size and roles of a frame's guides, which are planes at output size.

    `roles` may be any of `OUTPUT_SIZE_ROLES`, kept in the order of `Role`; none when no pass reads the guides. `source`
    is the file they come from, for messages: it does not count when specs are compared.
    """

    width: int
    height: int
    roles: tuple[Role, ...]
    source: str | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        wanted = {Role(role) for role in self.roles}
        for role in wanted - set(OUTPUT_SIZE_ROLES):
            raise GuideError(f"plane '{role}' cannot be a guide: those are {', '.join(OUTPUT_SIZE_ROLES)}")
        object.__setattr__(self, "roles", tuple(role for role in Role if role in wanted))


@dataclass(frozen=True)
class FrameSpec:
    """Everything about a frame that passes are compiled for: size, planes (role -> channels), encoding and guides.

    `planes` may be given as a mapping, as pairs or as roles; it is kept as pairs in the order of `Role`, so specs
    compare and hash by meaning. `guides` is None for a frame without planes at output size. `source` is the file the
    frame comes from, for messages: it does not count when specs are compared.
    """

    width: int
    height: int
    planes: tuple[tuple[Role, int], ...]
    encoding: str = "scene-linear"
    guides: GuideSpec | None = None
    source: str | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise FrameError(f"frame size {self.width}x{self.height}: both sides must be at least 1 pixel")
        object.__setattr__(self, "encoding", _known_encoding(self.encoding))
        object.__setattr__(self, "planes", _ordered_planes(self.planes))

    @property
    def roles(self) -> tuple[Role, ...]:
        """Roles of the planes, in the order of `Role`."""
        return tuple(role for role, _ in self.planes)

    @property
    def guide_roles(self) -> tuple[Role, ...]:
        """Roles of the guides, in the order of `Role`."""
        return self.guides.roles if self.guides else ()

    def has(self, role: Role) -> bool:
        """Whether the frame holds a plane of this role."""
        return role in self.roles

    def channels(self, role: Role) -> int:
        """Channel count of a plane; FrameError when the frame does not hold it."""
        for held, channels in self.planes:
            if held == role:
                return channels
        raise FrameError(f"the frame has no plane '{role}': it has {', '.join(self.roles)}")


def _known_encoding(encoding: str) -> str:
    """An encoding with everything that it leaves out."""
    try:
        return encoding if encoding in LINEAR else str(parse_display(encoding))
    except ColourError as error:
        raise FrameError(f"unknown colour encoding '{encoding}': use {', '.join(LINEAR)}; {error}") from error


def _ordered_planes(planes: Mapping[Role, int] | Iterable[Any]) -> tuple[tuple[Role, int], ...]:
    items = planes.items() if isinstance(planes, Mapping) else [_pair(item) for item in planes]
    held = {Role(role): int(channels) for role, channels in items}
    for role, channels in held.items():
        if channels != ROLES[role].channels:
            raise FrameError(f"plane '{role}' has {channels} channels: it needs {ROLES[role].channels}")
    return tuple((role, held[role]) for role in Role if role in held)


def _pair(item: Any) -> tuple[Role, int]:
    return (Role(item), ROLES[Role(item)].channels) if isinstance(item, str) else tuple(item)


@dataclass
class Frame:
    """One image of a sequence: planes of one size, perhaps guides of the output's, and what the passes must know.

    Attributes:
        planes: role -> float32 C-contiguous array (height, width, channels); units and directions are in `ROLES`.
        number: frame number in its sequence.
        jitter: sub-pixel sample position minus 0.5, pixels of this frame, x right, y down; (0, 0) when the samples
            are spread over the pixel.
        exposure: multiplier that the scene's author suggests for the tone mapper, or None.
        reset: True at a cut: history must be dropped before this frame.
        samples: samples per pixel, or None when unknown.
        world_to_camera: 4x4 float64, row vectors (p_camera = p_world @ M), or None.
        fov_x: horizontal field of view in degrees, or None.
        metadata: header attributes to keep on writing, by EXR name; windows are kept under 'displayWindow' and
            'dataWindow' as (x0, y0, x1, y1), bounds included, the rectangle that the planes cover under 'postfx:area'
            (without it, the display window).
        source: file that the frame, of several files its colour, was read from, or None.
        stored: where the colour is in `source`, if it is in one part of it.
        encoding: meaning of the colour plane, see `ENCODINGS`.
        guides: role -> array like those of `planes`, at output size; roles are among `OUTPUT_SIZE_ROLES`.
        guide_size: width and height of the guides; given only for a frame whose guides were not read.
        guide_jitter: like `jitter`, of the guides' samples, in pixels of the guides.
        guide_source: file that the guides were read from, or None.

    Raises FrameError when a plane or guide has a wrong shape, channel count or data type, or when sizes differ;
    GuideError, one of its kind, when a guide is of another role.
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
    stored: Stored | None = None

    def __post_init__(self) -> None:
        if not self.planes:
            raise FrameError(f"frame {self._name()} has no planes")
        self.planes = self._all_checked(self.planes, "plane", self.source)
        self.guides = self._all_checked(self.guides, "guide", self.guide_source)
        if self.guides:
            self.guide_size = next(iter(self.guides.values())).shape[1::-1]
        if self.world_to_camera is not None:
            self.world_to_camera = np.asarray(self.world_to_camera, np.float64).reshape(4, 4)

    @property
    def spec(self) -> FrameSpec:
        """Size, planes and encoding of this frame."""
        height, width = next(iter(self.planes.values())).shape[:2]
        channels = {role: plane.shape[2] for role, plane in self.planes.items()}
        guides = GuideSpec(*self.guide_size, tuple(self.guides), self.guide_source) if self.guide_size else None
        return FrameSpec(width, height, channels, self.encoding, guides, self.source)

    def __getitem__(self, role: Role) -> np.ndarray:
        """Plane of a role, (height, width, channels); FrameError when the frame does not hold it."""
        if role not in self.planes:
            raise FrameError(f"frame {self._name()} has no plane '{role}': it has {', '.join(self.planes)}")
        return self.planes[Role(role)]

    def __contains__(self, role: object) -> bool:
        return role in self.planes

    def _all_checked(self, planes: dict[Role, np.ndarray], kind: str, source: str | None) -> dict[Role, np.ndarray]:
        checked = {Role(role): self._checked(Role(role), plane, kind) for role, plane in planes.items()}
        if len({plane.shape[:2] for plane in checked.values()}) > 1:
            sizes = ", ".join(f"{role} {plane.shape[1]}x{plane.shape[0]}" for role, plane in checked.items())
            raise FrameError(f"{kind}s of frame {self._name(source)} differ in size: {sizes}")
        return checked

    def _checked(self, role: Role, plane: np.ndarray, kind: str) -> np.ndarray:
        if kind == "guide" and role not in OUTPUT_SIZE_ROLES:
            usable = ", ".join(OUTPUT_SIZE_ROLES)
            raise GuideError(f"plane '{role}' of frame {self._name()} cannot be a guide: use {usable}")
        if not isinstance(plane, np.ndarray) or not np.issubdtype(plane.dtype, np.floating):
            found = getattr(plane, "dtype", type(plane).__name__)
            raise FrameError(f"{kind} '{role}' of frame {self._name()} is {found}: give a NumPy array of floats")
        channels = ROLES[role].channels
        if plane.ndim == 2 and channels == 1:
            plane = plane[:, :, None]
        if plane.ndim != 3 or plane.shape[2] != channels or 0 in plane.shape:
            expected = f"(height, width, {channels})"
            raise FrameError(f"{kind} '{role}' of frame {self._name()} has shape {plane.shape}: it needs {expected}")
        return np.ascontiguousarray(plane, np.float32)

    def _name(self, source: str | None = None) -> str:
        source = source or self.source
        return f"{self.number} ({source})" if source else str(self.number)
