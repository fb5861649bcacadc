"""What can be said about a sequence that is read: every option once, with its words and what they
mean."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from os import PathLike
from typing import Any

from postfx.errors import SequenceError, offer
from postfx.frame import Role, find_role
from postfx.io.convert import DepthOption, parse_depth
from postfx.io.parts import PartOptions, parse_parts
from postfx.io.pattern import Source
from postfx.masks.cryptomatte import Entry, parse_leave
from postfx.repair import parse_limit
from postfx.system import Scratch

AUTO_MOTION = "auto"
FILE_MOTION = "file"
ESTIMATED_MOTION = "estimate"
MOTIONS = (AUTO_MOTION, FILE_MOTION, ESTIMATED_MOTION)
"""Where motion comes from: estimated where files have none, only zeros, or no vector; from files
alone; always estimated."""

ALL_VIEWS = "all"
_WORDS = ("profile", "depth", "leave", "colourspace", "layer", "view", "aov", "aov_denoise")
"""Options that are texts or None."""


@dataclass(frozen=True, eq=False)
class ReadOptions:
    """How a sequence is read. Raises the error of an option that cannot be, such as SequenceError.

    Attributes:
        frames: '1-100x2', '1,5,8-12', a number or numbers; None for all that are on the disk.
        profile: name of a built-in renderer profile or path of a TOML file; None to detect it.
        planes: roles to read, of planes and guides; None for all that are there.
        guides: files of planes at output size (albedos, normal, roughness, depth), named like those
            of the sequence; frame numbers must match. None: planes there that are larger than the
            colour, if there are any.
        depth: what the depth plane holds, in place of what the profile says: 'reversed,near=0.1',
            'ray,fov=54.4', 'planar,miss=0', see `postfx.io.convert.parse_depth`.
        cuts: frame numbers at which a shot begins, in place of what the headers say; empty for
            nowhere. None: by the headers (postfx:reset). Frames after a gap are marked anyway.
        leave: what is left as it is, which becomes the plane strength: names in a Cryptomatte, ids,
            'auto' for sky and misses, such as 'auto,logo,glass_*=0.5,7-9@id', see
            `postfx.masks.parse_leave`.
        colourspace: linear primaries of colours and reflectances, guides included: rec709, p3,
            rec2020, acescg or aces2065-1, in place of what headers say (chromaticities,
            colorInteropID; Rec.709 without any). They are converted to Rec.709, where light outside
            its gamut is negative. 'native' leaves them as they are.
        without: roles of planes to take as absent, such as `Role.OVERLAY`.
        layer: view layer or other layer whose channels are read; None for that with the most
            planes.
        view: of stereo files, such as 'left'; None for the first, or for all where {view} in the
            name says that each has files of its own. Several, such as 'left,right', or 'all': each
            frame is of the first one and holds the others in `Frame.views`.
        aov: layers that add up to the picture, 'key,fill', or 'auto' for those that the profile
            knows, which become `Frame.parts`.
        aov_denoise: other layers by their kind, 'normal=N,depth=Z', which become parts as well.
        clamp_fireflies: how many times as bright as the pixels around it a pixel may be; see
            `postfx.repair.clamp_fireflies`.
        motion: 'file' takes motion from the files alone. 'auto' estimates it from albedo, normal
            and depth, and those of the frame before, where files have none, or zeros although the
            planes move; 'estimate' always does.
        own_size: whether guides are left out, in files of their own and among the frames' AOVs.
        scratch: memory that planes lie in, and are read into piece by piece; None for arrays of
            NumPy.
    """

    frames: str | int | Iterable[int] | None = None
    profile: str | None = None
    planes: Iterable[Role] | None = None
    guides: Source | None = None
    depth: str | None = None
    cuts: Iterable[int] | None = None
    leave: str | None = None
    colourspace: str | None = None
    without: Iterable[Role] = ()
    layer: str | None = None
    view: str | None = None
    aov: str | None = None
    aov_denoise: str | None = None
    clamp_fireflies: float | None = None
    motion: str = FILE_MOTION
    own_size: bool = False
    scratch: Scratch | None = None

    def __post_init__(self) -> None:
        if self.motion not in MOTIONS:
            raise SequenceError(f"motion '{self.motion}'{offer(self.motion, MOTIONS, 'give')}")
        for name in _WORDS:
            word = getattr(self, name)
            if word is not None and not isinstance(word, str | PathLike):
                raise SequenceError(f"{name} {word!r}: give a text")
        try:
            self._keep("planes", None if self.planes is None else tuple(map(Role, self.planes)))
        except (TypeError, ValueError):
            raise SequenceError(f"planes {self.planes!r}: give a list of "
                                f"{', '.join(Role)}") from None
        self._keep("cuts", None if self.cuts is None else frozenset(self.cuts))
        self._keep("without", frozenset(find_role(role) for role in self.without))

    def _keep(self, name: str, value: object) -> None:
        """Replace an option by a form of it that can be looked at more than once."""
        object.__setattr__(self, name, value)

    @cached_property
    def absent(self) -> frozenset[Role]:
        """Roles of planes that count as absent; motion that is always estimated is not read."""
        return frozenset(self.without) | (
            {Role.MOTION} if self.motion == ESTIMATED_MOTION else set()
        )

    @cached_property
    def stored_depth(self) -> DepthOption | None:
        """What the depth plane holds; None: what the profile says."""
        return None if self.depth is None else parse_depth(self.depth)

    @cached_property
    def left_alone(self) -> tuple[Entry, ...]:
        """What is left as it is."""
        return () if self.leave is None else parse_leave(self.leave)

    @cached_property
    def parts(self) -> PartOptions | None:
        """Which layers are read as parts of the picture; None for none."""
        return parse_parts(self.aov, self.aov_denoise)

    @cached_property
    def brightest(self) -> float | None:
        """How many times as bright as those around it a pixel may be; None for any."""
        return parse_limit(self.clamp_fireflies)

    def check(self) -> None:
        """Raise the errors of words that are looked at when they are needed: OptionError,
        DepthOptionError or StrengthError."""
        _ = self.brightest, self.parts, self.stored_depth, self.left_alone

    @cached_property
    def estimates_motion(self) -> bool:
        """Whether motion that files lack is estimated."""
        return self.motion != FILE_MOTION

    @cached_property
    def matching(self) -> tuple[Any, ...]:
        """All that decides where in a file the planes are found."""
        return self.profile, self.stored_depth, self.absent, self.parts, self.layer

    @cached_property
    def of_guides(self) -> ReadOptions:
        """How files with guides alone are read."""
        return ReadOptions(profile=self.profile, depth=self.depth, without=self.absent)

    def without_parts(self) -> ReadOptions:
        """The same, but the picture is read whole."""
        return replace(self, aov=None, aov_denoise=None)


def parse_views(text: str | None) -> tuple[str | None, tuple[str, ...], bool]:
    """First view (None for the file's first), the others, and whether all are meant, of 'left',
    'left,right' or 'all'.

    Raises SequenceError where a name is given twice or is empty.
    """
    if text is None or text == ALL_VIEWS:
        return None, (), text == ALL_VIEWS
    names = [name.strip() for name in text.split(",")]
    if not all(names) or len(set(names)) < len(names):
        raise SequenceError(f"views '{text}': name each view once, like left,right, or give all")
    return names[0], tuple(names[1:]), False
