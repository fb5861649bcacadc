"""Views and look-up tables through OpenColorIO."""

from __future__ import annotations

import codecs
import os
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from postfx.colour import ACES2065_1, ACESCG, matrix_between
from postfx.colour.displays import Display, parse_display
from postfx.colour.ocio_library import Colours, Config, load
from postfx.errors import ColourError

PREFIX = "ocio:"
BUILT_IN_CONFIG = "ocio://studio-config-v4.0.0_aces-v2.0_ocio-v2.5"
INTERCHANGE = "aces_interchange"
"""The role that a config must have; its space is ACES2065-1."""
LUTS = (".cube", ".clf", ".ctf", ".3dl", ".spi3d", ".csp")
DISPLAYS = {
    "srgb": ("sRGB - Display", "sRGB"),
    "p3": ("Display P3 - Display", "Display P3"),
    "rec709": ("Rec.1886 Rec.709 - Display", "Rec.1886 / Rec.709 Video - Display", "Rec.1886",
               "Rec.709"),
    "rec2020": ("Rec.1886 Rec.2020 - Display", "Rec.1886 / Rec.2020 Video - Display", "Rec.2020"),
    "pq": ("Rec.2100-PQ - Display", "Rec.2100-PQ"),
    "hlg": ("Rec.2100-HLG - Display", "Rec.2100-HLG"),
}
"""Names that configs give to our displays: first those of the ACES configs, then older ones."""
_NOTE = re.compile(r"^#\s*postfx: input=(.+), output=(\S+)$", re.MULTILINE)
_HEAD = 4096
"""Bytes at the beginning of a file in which a note of ours stands."""
_ODD_LINE = re.compile(rb"^.*\b(?:nan|inf)\b.*$", re.MULTILINE | re.IGNORECASE)
_ODD = re.compile(r"[-+]?(nan|inf)", re.IGNORECASE)
_NUMBER = re.compile(r"[-+]?[\d.]+(e[-+]?\d+)?", re.IGNORECASE)


class Transform(NamedTuple):
    """A function from linear ACEScg (..., 3) of any sign to code values, their display, and a
    title."""

    apply: Callable[[np.ndarray], np.ndarray]
    display: Display
    title: str


def config_name() -> str:
    """The config in use: $OCIO, or the ACES 2 studio config that is built into OpenColorIO."""
    return os.environ.get("OCIO") or BUILT_IN_CONFIG


def view_transform(text: str, display: Display) -> Transform:
    """'VIEW' or 'VIEW@DISPLAY' of the config. VIEW may be part of a view's name; without one, it is
    the display's default or, on an HDR display, the first for its peak. Raises ColourError, which
    lists the views."""
    name, config = config_name(), _config(config_name())
    wanted, _, named = text.partition("@")
    shown = _display_name(config, name, named or display.name,
                          (named,) if named else DISPLAYS[display.name])
    own = next((parse_display(key) for key, names in DISPLAYS.items() if shown in names), display)
    own = display if own.name == display.name else own
    view = _view_name(config, shown, wanted, own)
    nits = re.search(r"(\d+) nits", view)
    if own.name == "pq" and nits:
        own = replace(own, peak=max(float(nits[1]), own.white or 0.0))

    colours = config.show(INTERCHANGE, shown, view)
    return Transform(lambda x: _run(colours, x, f"{PREFIX}{text}"), own, f"{view}, {shown}")


def file_transform(text: str) -> Transform:
    """A look-up table in a file: 'FILE,input=SPACE,output=DISPLAY'.

    SPACE is OpenColorIO's name of the table's input colour space, DISPLAY the display of its result
    (default: srgb). Tables written by postfx name both themselves. Raises ColourError if the file
    cannot be read or the space is unknown.
    """
    path, *settings = text.split(",")
    given = dict(item.partition("=")[::2] for item in settings)
    unknown = given.keys() - {"input", "output"}
    if unknown:
        raise ColourError(f"{text}: '{unknown.pop()}' is neither input nor output: "
                          f"{path},input=ACEScct,output=srgb")
    if not os.path.isfile(path):
        raise ColourError(f"{path}: no such look-up table: check the path and its rights")
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise ColourError(f"{path}: look-up table cannot be read: {error.strerror}; check its "
                          "rights") from error
    _check_numbers(path, content)
    note = _NOTE.search(content[:_HEAD].decode("utf-8", "replace"))
    space, output = note.groups() if note else (None, "srgb")
    space, output = given.get("input", space), given.get("output", output)
    if space is None:
        raise ColourError(f"{path}: does not say which colours it takes: give e.g. "
                          f"{path},input=ACEScct")
    name, config = config_name(), _config(config_name())
    if not config.resolve(space):
        raise ColourError(f"{path}: {name} has no colour space '{space}': use ACEScct, 'Linear "
                          "Rec.709 (sRGB)' or such")
    file = str(Path(path).resolve())

    own, table = config.convert(INTERCHANGE, space), config.look_up(file)
    return Transform(lambda x: _run(lambda light: table(own(light)), x, path),
                     parse_display(output), f"{Path(path).name}, takes {space}")


def _check_numbers(path: str, content: bytes) -> None:
    """ColourError for a table that OpenColorIO takes for another one or for none: with numbers that
    are not finite, or a mark before its first word."""
    if content.startswith(codecs.BOM_UTF8):
        raise ColourError(f"{path}: begins with a byte order mark: save it as UTF-8 without one")
    for line in _ODD_LINE.findall(content):
        words = line.decode("ascii", "replace").split()
        is_told = words[0].startswith(("#", "TITLE"))
        # DOMAIN_MAX stands before its numbers
        if not is_told and all(_ODD.fullmatch(word) or _NUMBER.fullmatch(word)
                               for word in words[len(words) > 3:]):
            raise ColourError(f"{path}: has the numbers '{' '.join(words)[:60]}': a look-up table "
                              "of finite ones is needed")


def convert(light: np.ndarray, source: str, target: str) -> np.ndarray:
    """Colours (..., 3) from one colour space of the built-in config to another, float64."""
    return _apply(_config(BUILT_IN_CONFIG).convert(source, target), light, f"{source} to {target}")


def name_of_id(identifier: str) -> str | None:
    """Colour space of the built-in config with this identifier of the Color Interop Forum, None
    where it has none."""
    config = _config(BUILT_IN_CONFIG)
    return next((name for name in config.spaces if config.interop_id(name) == identifier), None)


def is_linear(name: str) -> bool:
    """Whether a colour space of the built-in config is linear."""
    return _config(BUILT_IN_CONFIG).is_linear(name)


def is_lut(text: str) -> bool:
    """Whether a look's name is a file with a look-up table."""
    return Path(text.partition(",")[0]).suffix.lower() in LUTS


def _config(name: str) -> Config:
    config = load(name)
    if INTERCHANGE not in config.roles:
        raise ColourError(f"{name}: has no role {INTERCHANGE}, so its colours are unknown: add the "
                          "role")
    return config


def _display_name(config: Config, name: str, wanted: str, candidates: tuple[str, ...]) -> str:
    there = config.displays
    found = next((display for display in candidates if display in there), None)
    if found is None:
        raise ColourError(f"{name}: no display for '{wanted}': name one by ocio:VIEW@DISPLAY: "
                          f"{', '.join(there)}")
    return found


def _view_name(config: Config, shown: str, wanted: str, display: Display) -> str:
    """The view of a display that is wanted: by its name, by words of it, or '' for the usual one.
    An HDR display takes the one for its peak. ColourError where none or several are meant."""
    there = list(config.views(shown))
    words = wanted.lower().split()
    if words:
        matching = ([view for view in there if view.lower() == wanted.lower()]
                    or [view for view in there if all(word in view.lower() for word in words)])
    else:
        matching = there if display.hdr else [config.default_view(shown)]
    if display.hdr:
        for_peak = [view for view in matching if f" {display.peak:g} nits" in view]
        matching = for_peak or (matching if words else [])
    if not matching or (words and len(matching) > 1):
        what = f"several views are '{wanted}'" if matching else f"no view '{wanted}'"
        what += f" for {display.peak:g} nits" if display.hdr and not words else ""
        raise ColourError(f"display '{shown}': {what}: use one of: {'; '.join(matching or there)}")
    return matching[0]


def _run(colours: Colours, light: np.ndarray, what: str) -> np.ndarray:
    """A transform of linear ACEScg (..., 3), clipped to [0, 1]."""
    codes: np.ndarray = np.clip(_apply(colours, light @ matrix_between(ACESCG, ACES2065_1).T, what),
                                0, 1)
    return codes


def _apply(colours: Colours, light: np.ndarray, what: str) -> np.ndarray:
    try:
        found = colours(np.ascontiguousarray(light.reshape(-1, 3), np.float32))
    except UnicodeDecodeError as error:  # the message has bytes of the file that are no text
        raise ColourError(f"{what}: cannot be read as a colour transform") from error
    except RuntimeError as error:
        why = str(error).partition("\n")[0] or "cannot be read as a colour transform"
        raise ColourError(f"{what}: {why}") from error
    return found.reshape(light.shape).astype(np.float64)
