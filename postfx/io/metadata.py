"""Header attributes that outlive processing, and the types they are written with."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from fractions import Fraction
from typing import Any

import OpenImageIO as oiio

from postfx.frame import Frame
from postfx.io.windows import AREA, EXR_NAMES

_OUTDATED = (
    "postfx:jitter", "postfx:models", "postfx:reset", "postfx:settings", "postfx:spp", "postfx:version", "preview",
    "thumbnail",
)
# What describes the input's storage, its samples or channels that are not written.
_DROPPED = (
    *_OUTDATED,
    AREA,
    "blendermultichannel",
    "compression",
    "cryptomatte/",
    "datawindow",
    "displaywindow",
    "fovcot",
    "name",
    "oiio:",
    "openexr:",
    "textureformat",
    "tiff:",
    "wrapmodes",
)
_SCENE_REFERRED = ("chromaticities", "colorinteropid", "postfx:exposure")
_NAMED_TYPES = {"timeCode": "timecode", "keyCode": "keycode", "framesPerSecond": "rational"}
_STORED_NAMES = {name: stored for stored, name in EXR_NAMES.items()}
_TUPLE_TYPES = {(float, 9): "matrix33", (float, 16): "matrix", (float, 3): "vector", (int, 2): "vector2i"}
_WORDS = {float: "float", int: "int", str: "string"}


def kept_attributes(frame: Frame) -> dict[str, Any]:
    """Header attributes to write with a frame: time code, camera, credits and the like.

    Left out: what describes the input's storage, its jitter and sample count, and for a picture made for a display
    whatever says that its colours are those of the scene.
    """
    dropped = _DROPPED if frame.encoding == "scene-linear" else _DROPPED + _SCENE_REFERRED
    return {name: value for name, value in frame.metadata.items() if not name.lower().startswith(dropped)}


def is_outdated(name: str, frame: Frame) -> bool:
    """Whether an attribute of the input is not true of the picture any more, whatever else is written with it."""
    outdated = _OUTDATED if frame.encoding == "scene-linear" else _OUTDATED + _SCENE_REFERRED
    return name.lower().startswith(outdated)


def set_attributes(spec: oiio.ImageSpec, attributes: Mapping[str, Any]) -> None:
    """Put attributes into an image's spec with the EXR types they had; values of other types are left out."""
    for name, value in attributes.items():
        kind = _NAMED_TYPES.get(name) or _type_of(value)
        with suppress(TypeError, ValueError):  # not what its name promises, or text that is none
            if kind == "rational":
                value = Fraction(value).limit_denominator(1001).as_integer_ratio()
            if kind:
                spec.attribute(_STORED_NAMES.get(name, name), oiio.TypeDesc(kind), value)


def _type_of(value: Any) -> str:
    if isinstance(value, tuple):
        kinds = {type(item) for item in value}
        if len(kinds) != 1:
            return ""
        kind = kinds.pop()
        return _TUPLE_TYPES.get((kind, len(value)), f"{_WORDS[kind]}[{len(value)}]" if kind in _WORDS else "")
    return _WORDS.get(type(value), "")
