"""Renderer profiles: how a renderer names its planes and what its numbers mean, as data.

A profile is a TOML file; the built-in ones are in `profiles/`. Format (all keys but `name` may be
left out):

    name = "studio"
    title = "Our farm's names"
    extends = "generic"                  # its planes and header keys come after ours: a built-in
                                         # profile, or a file beside ours by its name or path
    source = "manual"                    # where its names are from: file (read by us), code (the
                                         # renderer's source), listing (channels of a file that
                                         # others listed) or manual (documents alone)
    marker = "Combined.R"                # what precedes this channel name is {layer} below

    [[detect]]                           # any of these tables suffices; all conditions in one must
                                         # hold
    header = { Software = "^Blender 5" } # regular expressions on header attributes
    channels = ["{layer}Vector.X"]       # these channels must exist
    without = ["Albedo.R"]               # none of these may exist

    [header]                             # header attributes, first one found counts
    samples = ["cycles.{layer}samples"]

    [camera]
    fov_x = 50.0                         # degrees, when no header says it
    near = 0.1                           # distances of the near and far plane, when no header says
                                         # them
    far = 1000.0
    column_vectors = true                # worldToCamera is stored for column vectors
    max_velocity = 20                    # pixels, of motion in unit "velocity", when no header says
                                         # it
    shutter = 0.5                        # frames, of motion per shutter, when no header says it

    [[plane]]
    role = "motion"                      # a plane role of postfx
    names = ["Vector", "velocity"]       # layer names in order of preference; "" is no layer, *
                                         # matches anything
    channels = ["XY", "RG"]              # channel letters in order of preference, or a list of
                                         # whole names
    requires = ["Albedo.R"]              # the plane is looked for only where these channels exist,
                                         # too
    without = ["Specular.R"]             # and only where none of these exists
    source = "manual"                    # of this plane's names, where it is another than the
                                         # profile's
    scale = [1, -1]                      # value = (stored + offset) * scale; a normal stored as 0,
                                         # 0, 0 stays zero
    unit = "pixels"                      # motion: pixels, uv (0..1 of the image), ndc (-1..1),
                                         # width (parts of the image's width, along both axes) or
                                         # velocity (-1..1 of max_velocity)
    per = "frame"                        # motion: from frame to frame, or while the shutter is open
                                         # ("shutter")
    space = "world"                      # normals: world, camera (along the axes of worldToCamera)
                                         # or view (x right, y up, z to the viewer, whatever the
                                         # axes of worldToCamera; right-handed world)
    kind = "planar"                      # depth: planar, ray (distance from the eye), device (a
                                         # depth buffer: 0 at the near, 1 at the far plane) or
                                         # normalised (linear between the two planes)
    reversed = true                      # device and normalised depth: 1 at the near plane
    miss = 0.0                           # depth: value of pixels that hit nothing
    clamp = [0, 1]
    enable = "where the renderer switches this plane on"

    [[part]]                             # layers that add up to the picture, for --aov
    names = ["RGBA_*", "{layer}Emission"]  # * stands for the name of a light group
    kind = "light"                       # light, diffuse, specular, scatter or emission: see
                                         # docs/howto/parts.md
    group = "light groups"               # the layers of one group add up to the picture
    factor = "{layer}Diffuse Color"      # the layer that they are stored divided by
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property, lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from postfx.errors import ProfileError, offer
from postfx.files import parse_toml, read_text
from postfx.frame import ADDITIVE, ROLES, Role


class Kind(NamedTuple):
    """A kind of value: in words, and whether something is one."""

    words: str
    fits: Callable[[Any], bool]


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and math.isfinite(value) and abs(value) <= 1e30


def _is_pattern(value: Any) -> bool:
    try:
        re.compile(value)
    except (re.error, RecursionError, OverflowError, TypeError):
        return False
    return True


def _list_of(kind: Kind, words: str) -> Kind:
    return Kind(words, lambda value: isinstance(value, list) and all(map(kind.fits, value)))


TEXT = Kind("a text", lambda value: isinstance(value, str))
YES_NO = Kind("true or false", lambda value: isinstance(value, bool))
NUMBER = Kind("a number", _is_number)
LENGTH = Kind("a number above 0", lambda value: _is_number(value) and value > 0)
DISTANCE = Kind("a number or inf", lambda value: _is_number(value) or value == math.inf)
TABLE = Kind("a table", lambda value: isinstance(value, dict))
TABLES = _list_of(TABLE, "tables in double brackets")
TEXTS = _list_of(TEXT, "a list of texts")
NUMBER_LIST = _list_of(NUMBER, "a list of numbers")
RANGE = Kind("two numbers, the lower first",
             lambda value: NUMBER_LIST.fits(value) and len(value) == 2 and value[0] <= value[1])
LETTERS = Kind("a list of texts or of lists of texts", lambda value: isinstance(value, list)
               and all(TEXT.fits(item) or TEXTS.fits(item) for item in value))
PATTERNS = Kind("a table of regular expressions",
                lambda value: isinstance(value, dict) and all(map(_is_pattern, value.values())))

PROFILE = {"name": TEXT, "title": TEXT, "extends": TEXT, "source": TEXT, "marker": TEXT,
           "detect": TABLES, "header": TABLE, "camera": TABLE, "plane": TABLES, "part": TABLES}
PART_KEYS = {"names": TEXTS, "kind": TEXT, "group": TEXT, "factor": TEXT}
CAMERA_KEYS = {"fov_x": NUMBER, "near": NUMBER, "far": DISTANCE, "column_vectors": YES_NO,
               "max_velocity": LENGTH, "shutter": LENGTH}
DETECT = {"header": PATTERNS, "channels": TEXTS, "without": TEXTS}
PLANE_KEYS = {"role": TEXT, "names": TEXTS, "channels": LETTERS, "requires": TEXTS,
              "without": TEXTS, "source": TEXT, "scale": NUMBER_LIST, "offset": NUMBER_LIST,
              "unit": TEXT, "per": TEXT, "space": TEXT, "kind": TEXT,
              "reversed": YES_NO, "miss": NUMBER, "clamp": RANGE, "enable": TEXT}


def check(table: Mapping[str, Any], kinds: Mapping[str, Kind], path: Path,
          where: str = "profile") -> None:
    """ProfileError for a key that is not known, and for a value of another kind than its key
    has."""
    for key in sorted(table):
        if key not in kinds:
            raise ProfileError(f"{path}: {where}: unknown key '{key}'{offer(key, kinds)}")
        if not kinds[key].fits(table[key]):
            raise ProfileError(f"{path}: {where}: {key} must be {kinds[key].words}")


BUILTIN = Path(__file__).parent / "profiles"
HEADER_KEYS = ("samples", "fov_x", "exposure", "exposure_ev", "jitter", "reset", "world_to_camera",
               "near", "far", "max_velocity", "shutter")
_MOST_BYTES = 1 << 18
DEPTH_KINDS = ("planar", "ray", "device", "normalised")
NAME_SOURCES = {
    "file": "seen in files of the renderer",
    "code": "from the renderer's source code",
    "listing": "from lists of channels that others published",
    "manual": "from its maker's documents, not seen in a file",
}
"""Where a profile's names are from -> in words."""
_CHOICES = {"unit": ("pixels", "uv", "ndc", "width", "velocity"), "per": ("frame", "shutter"),
            "space": ("world", "camera", "view"), "kind": DEPTH_KINDS,
            "source": ("", *NAME_SOURCES)}


@dataclass(frozen=True)
class PlaneRule:
    """Where a plane may be found and how its stored values become the one convention."""

    role: Role
    names: tuple[str, ...]
    channels: tuple[tuple[str, ...], ...]
    requires: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    source: str = ""
    scale: tuple[float, ...] = (1.0,)
    offset: tuple[float, ...] = (0.0,)
    unit: str = "pixels"
    per: str = "frame"
    space: str = "world"
    kind: str = "planar"
    reversed: bool = False
    miss: float | None = None
    clamp: tuple[float, float] | None = None
    enable: str = ""

    @cached_property
    def is_affine(self) -> bool:
        """Whether stored values are scaled or shifted."""
        return any(self.offset) or any(scale != 1 for scale in self.scale)

    @cached_property
    def is_per_pixel(self) -> bool:
        """Whether stored motion is in pixels of a frame."""
        return self.unit == "pixels" and self.per == "frame"

    def candidates(self, layer: str) -> tuple[tuple[str, ...], ...]:
        """Full channel names to look for, best first; `layer` replaces {layer}."""
        return _full_names(self.names, self.channels, layer)


@dataclass(frozen=True)
class PartRule:
    """Which layers are parts of the picture."""

    names: tuple[str, ...]
    kind: str = "light"
    group: str = ""
    factor: str = ""


@dataclass(frozen=True)
class DetectRule:
    """Conditions that must all hold for a file to be of a profile."""

    header: tuple[tuple[str, str], ...] = ()
    channels: tuple[str, ...] = ()
    without: tuple[str, ...] = ()


@dataclass(frozen=True)
class Profile:
    """One renderer's conventions.

    Attributes:
        file: path of a user's own profile; '' for a built-in one.
    """

    name: str
    file: str = ""
    title: str = ""
    source: str = ""
    marker: str = ""
    detect: tuple[DetectRule, ...] = ()
    header: dict[str, tuple[str, ...]] = field(default_factory=dict, hash=False)
    planes: tuple[PlaneRule, ...] = ()
    parts: tuple[PartRule, ...] = ()
    fov_x: float | None = None
    near: float | None = None
    far: float | None = None
    column_vectors: bool = False
    max_velocity: float | None = None
    shutter: float | None = None

    @property
    def reference(self) -> str:
        """What `extends` of any other profile calls it."""
        return self.file or self.name

    def rules(self, role: Role) -> tuple[PlaneRule, ...]:
        """Rules for a role, best first."""
        return tuple(rule for rule in self.planes if rule.role == role)


@cache
def profile_names() -> tuple[str, ...]:
    """Names of the built-in profiles, in the order of detection: the generic one last."""
    names = sorted(path.stem for path in BUILTIN.glob("*.toml"))
    return (*(name for name in names if name != "generic"), "generic")


@cache
def load_profile(name: str) -> Profile:
    """Built-in profile by name, or a user's own by the path of its TOML file; ProfileError when
    neither."""
    path = BUILTIN / f"{name}.toml"
    if not os.path.isfile(path):
        path = Path(name)
        if path.suffix != ".toml":
            raise ProfileError(f"{_unknown(name)}, or the path of a TOML file")
    try:
        return _parse(_read_table(path), path)
    except OSError as error:
        raise ProfileError(f"{path}: profile cannot be read: {error.strerror or error}") from error
    except RecursionError as error:
        raise ProfileError(f"{path}: profile extends itself, or its values are nested without "
                           "end") from error


def _read_table(path: Path) -> dict[str, Any]:
    try:
        return parse_toml(read_text(path, _MOST_BYTES))
    except ValueError as error:
        raise ProfileError(f"{path}: profile is not valid TOML: {error}") from error


def _parse(table: dict[str, Any], path: Path) -> Profile:
    check(table, PROFILE, path)
    base = _load_base(table["extends"], path) if "extends" in table else Profile("")
    camera = table.get("camera", {})
    check(camera, CAMERA_KEYS, path, "[camera]")
    header = table.get("header", {})
    check(header, dict.fromkeys(HEADER_KEYS, TEXTS), path, "[header]")
    own = {key: tuple(names) for key, names in header.items()}
    source = table.get("source", "")
    _check_choices(table, ("source",), path, "profile")
    return Profile(
        name=table.get("name", path.stem),
        file="" if path.parent == BUILTIN else os.path.abspath(path),
        title=table.get("title", ""),
        source=source,
        marker=table.get("marker", base.marker),
        detect=tuple(_detect(rule, path) for rule in table.get("detect", [])),
        header={key: own.get(key, ()) + base.header.get(key, ()) for key in HEADER_KEYS},
        planes=tuple(_plane({"source": source, **rule}, path) for rule in table.get("plane", []))
               + base.planes,
        parts=tuple(_part(rule, path) for rule in table.get("part", [])) + base.parts,
        fov_x=camera.get("fov_x", base.fov_x),
        near=camera.get("near", base.near),
        far=camera.get("far", base.far),
        column_vectors=camera.get("column_vectors", base.column_vectors),
        max_velocity=camera.get("max_velocity", base.max_velocity),
        shutter=camera.get("shutter", base.shutter),
    )


def _load_base(name: str, path: Path) -> Profile:
    """The profile that the one in a file extends: a built-in one, or a file by its path or, if it
    lies beside, by its name. ProfileError where there is none."""
    if name in profile_names():
        return load_profile(name)
    if name.endswith(".toml"):
        beside = path.parent / name
        return load_profile(str(beside) if os.path.isfile(beside) else name)
    found = _find_beside(name, path)
    if found is None:
        raise ProfileError(f"{path}: extends: {_unknown(name)}, or a TOML file by its path, or by "
                           f"its name if it lies in {path.parent}")
    return load_profile(str(found))


def _find_beside(name: str, path: Path) -> Path | None:
    """The profile in the folder of another one whose file has a name, or that says the name
    itself."""
    by_file = path.parent / f"{name}.toml"
    if os.path.isfile(by_file):
        return by_file
    others = (other for other in sorted(path.parent.glob("*.toml")) if other != path)
    return next((other for other in others if _told_name(other) == name), None)


def _told_name(path: Path) -> Any:
    """The name that a TOML file says, None where it says none or cannot be read."""
    try:
        return _read_table(path).get("name")
    except (OSError, ProfileError, RecursionError):
        return None


def _unknown(name: str) -> str:
    """What an error says of a name that no built-in profile has."""
    return f"unknown profile '{name}'{offer(name, profile_names(), 'use one of')}"


def _check_choices(table: Mapping[str, Any], keys: Iterable[str], path: Path, where: str) -> None:
    """ProfileError for a word that is none of those that its key knows."""
    for key in keys:
        allowed = _CHOICES[key]
        if table.get(key, allowed[0]) not in allowed:
            known = offer(table[key], filter(None, allowed), "use one of")
            raise ProfileError(f"{path}: {where}: {key} = {table[key]!r}{known}")


def _part(table: dict[str, Any], path: Path) -> PartRule:
    where = f"[[part]] names = {table.get('names')!r}"
    check(table, PART_KEYS, path, where)
    if not table.get("names"):
        raise ProfileError(f"{path}: {where}: give the names of layers")
    if table.get("kind", "light") not in ADDITIVE:
        known = offer(table["kind"], ADDITIVE, "use one of")
        raise ProfileError(f"{path}: {where}: kind = {table['kind']!r}{known}")
    return PartRule(**{**table, "names": tuple(table["names"])})


def _detect(table: dict[str, Any], path: Path) -> DetectRule:
    check(table, DETECT, path, "[[detect]]")
    names = (tuple(table.get(key, ())) for key in ("channels", "without"))
    return DetectRule(tuple(table.get("header", {}).items()), *names)


def _plane(table: dict[str, Any], path: Path) -> PlaneRule:
    where = f"[[plane]] role = {table.get('role')!r}"
    check(table, PLANE_KEYS, path, where)
    if table.get("role") not in list(Role):
        known = offer(table.get("role", ""), Role, "use one of")
        raise ProfileError(f"{path}: {where}: unknown role{known}")
    _check_choices(table, _CHOICES, path, where)
    role, listed = Role(table["role"]), {"names", "channels", "requires", "without", "scale",
                                         "offset", "clamp"}
    channels = tuple(tuple(letters) for letters in table.get("channels", []))
    if not channels or any(len(letters) != ROLES[role].channels for letters in channels):
        raise ProfileError(f"{path}: {where}: each entry of channels needs {ROLES[role].channels} "
                           "channels")
    for key in ("scale", "offset"):
        if len(table.get(key, [1])) not in (1, ROLES[role].channels):
            raise ProfileError(f"{path}: {where}: {key} needs 1 or {ROLES[role].channels} numbers")
    values: dict[str, Any] = {key: tuple(value) if key in listed else value
                              for key, value in table.items() if key != "role"}
    return PlaneRule(role, **{"names": ("",), **values, "channels": channels})


@lru_cache(1024)
def _full_names(names: tuple[str, ...], channels: tuple[tuple[str, ...], ...], layer: str) -> \
        tuple[tuple[str, ...], ...]:
    layers = [name.replace("{layer}", layer) for name in names]
    return tuple(tuple(_join(name, letter) for letter in letters) for name in layers
                 for letters in channels)


def _join(name: str, letter: str) -> str:
    return f"{name}.{letter}" if name and letter else name + letter
