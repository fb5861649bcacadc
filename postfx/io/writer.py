"""Writing frames: complete files or none, linear light in EXR, display code values elsewhere."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from os import PathLike
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from postfx import __version__
from postfx.colour.curves import SRGB
from postfx.colour.displays import Display, parse_display
from postfx.errors import WriteError
from postfx.frame import LINEAR, Frame, Role
from postfx.io.dither import Dither, quantise
from postfx.io.metadata import kept_attributes, scaled_window, set_attributes
from postfx.io.tags import JPEG, tag_codes, tag_light

LINEAR_FORMATS = (".exr",)
DISPLAY_FORMATS = (".png", ".tif", ".tiff", *JPEG)
WRITABLE = LINEAR_FORMATS + DISPLAY_FORMATS
_DEEP = (".tif", ".tiff")  # 16 bits, which PNG has for HDR displays only
_STORAGE = {"float16": "half", "float32": "float", "uint16": "uint16", "uint8": "uint8"}
_HALF_MAX = 65504.0
OVERLAY_LAYER = ("overlay.R", "overlay.G", "overlay.B", "overlay.A")
_PIECE = 16 << 20  # bytes in float32 that are converted and written at once
Pixels = Callable[[slice], np.ndarray]  # rows -> pixels as they are stored


def is_display_format(path: str | PathLike[str]) -> bool:
    """Whether files of this name hold display-encoded pictures; WriteError when the format cannot be written."""
    suffix = Path(path).suffix.lower()
    if suffix not in WRITABLE:
        raise WriteError(f"{path}: unknown format '{suffix}': use {', '.join(WRITABLE)}")
    return suffix in DISPLAY_FORMATS


def write_frame(
    path: str | PathLike[str],
    frame: Frame,
    half: bool = True,
    relax: Callable[[], None] | None = None,
    dither: Dither | str = Dither.MOVING,
    provenance: Mapping[str, str] | None = None,
) -> Path:
    """Write colour and alpha of a frame; returns the path.

    EXR holds linear light (a display-encoded frame is decoded, in its display's primaries, 1 is white), half floats
    unless `half` is False, ZIP compression, the input's display window scaled to the frame's size and its useful header
    attributes; beside scene-linear colour also an overlay that was not composited, as a layer of that name. Other files
    hold code values: JPEG and PNG 8 bits, dithered (`dither`: moving, static or none), TIFF and PNG for HDR displays 16
    bits. They are tagged with the display that they are for, see `postfx.io.tags`. Linear frames are clipped to 0..1
    there and encoded as sRGB, so tone-map them first. The file appears under its name only when it is complete; folders
    are made. `relax` is called again and again meanwhile. `provenance` are attributes for an EXR header that tell how
    the frame came about.

    Raises FrameError when the frame has no colour, WriteError when the file cannot be written or its format cannot
    hold an HDR picture.
    """
    path = Path(path)
    convert = _code_pixels(frame, path, Dither(dither)) if is_display_format(path) else _linear_pixels(frame, half)
    spec = _spec(frame, convert(slice(0, 1)), path)
    if not is_display_format(path):
        set_attributes(spec, {"postfx:version": __version__, **(provenance or {})})
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _write(temporary, spec, convert, relax)
        os.replace(temporary, path)
    except OSError as error:
        reason = (error.strerror or str(error)).replace(str(temporary), str(path))
        raise WriteError(f"{path}: cannot be written: {reason}; check the folder's rights and free space") from error
    finally:
        with suppress(OSError):
            temporary.unlink()
    return path


def is_complete(path: str | PathLike[str], width: int, height: int) -> bool:
    """Whether a file holds a readable image of this size: every pixel is decoded."""
    image = oiio.ImageInput.open(str(path)) if Path(path).is_file() else None
    if image is None:
        oiio.geterror()
        return False
    spec = image.spec()
    same = (spec.full_width, spec.full_height) == (width, height)
    readable = same and image.read_image(oiio.UINT8) is not None
    image.geterror()
    image.close()
    return readable and _is_ended(Path(path))


def _is_ended(path: Path) -> bool:
    """Whether a JPEG ends with its end marker; its decoder takes shortened files without complaint."""
    if path.suffix.lower() not in JPEG:
        return True
    with path.open("rb") as file:
        file.seek(-2, os.SEEK_END)
        return file.read() == b"\xff\xd9"


def _display_of(frame: Frame) -> Display | None:
    """Display that a frame's code values are for, None where its colour is light."""
    return None if frame.encoding in LINEAR else parse_display(frame.encoding)


def _linear_pixels(frame: Frame, half: bool) -> Pixels:
    display = _display_of(frame)

    def convert(rows: slice) -> np.ndarray:
        colour = frame[Role.COLOUR][rows]
        colour = display.decode(colour).astype(np.float32) if display else colour
        pixels = _with_layer(_with_alpha(colour, frame, rows), frame, rows)
        return np.clip(pixels, -_HALF_MAX, _HALF_MAX).astype(np.float16) if half else pixels

    return convert


def _code_pixels(frame: Frame, path: Path, dither: Dither) -> Pixels:
    suffix, display = path.suffix.lower(), _display_of(frame)
    if display and display.hdr and suffix in JPEG:
        raise WriteError(f"{path}: JPEG has too few bits for {display.kind.title}: write PNG or TIFF")
    opaque = Role.ALPHA not in frame or suffix in JPEG or frame[Role.ALPHA].min() >= 1
    bits = 16 if suffix in _DEEP or (display and display.hdr) else 8

    def convert(rows: slice) -> np.ndarray:
        colour = frame[Role.COLOUR][rows]
        codes = colour if display else SRGB.encode(colour)
        pixels = codes if opaque else _with_alpha(codes, frame, rows)
        return quantise(pixels, bits, dither, frame.number, rows.start)

    return convert


def _with_alpha(colour: np.ndarray, frame: Frame, rows: slice) -> np.ndarray:
    return np.concatenate([colour, frame[Role.ALPHA][rows]], axis=2) if Role.ALPHA in frame else colour


def _with_layer(pixels: np.ndarray, frame: Frame, rows: slice) -> np.ndarray:
    return np.concatenate([pixels, frame[Role.OVERLAY][rows]], axis=2) if _has_layer(frame) else pixels


def _has_layer(frame: Frame) -> bool:
    """Whether the overlay is written: it cannot be composited with light of a display."""
    return Role.OVERLAY in frame and frame.encoding == "scene-linear"


def _spec(frame: Frame, pixels: np.ndarray, path: Path) -> oiio.ImageSpec:
    height, width, channels = len(frame[Role.COLOUR]), *pixels.shape[1:]
    spec = oiio.ImageSpec(width, height, channels, oiio.TypeDesc(_STORAGE[pixels.dtype.name]))
    layer = OVERLAY_LAYER if _has_layer(frame) and not is_display_format(path) else ()
    spec.channelnames = ("R", "G", "B", "A")[: channels - len(layer)] + layer
    display = _display_of(frame)
    if is_display_format(path):
        tag_codes(spec, display or parse_display("srgb"), path)
        spec.attribute("CompressionQuality", 95)
        return spec
    window = scaled_window(frame, width, height)
    spec.x, spec.y = spec.full_x, spec.full_y = window.x0, window.y0
    set_attributes(spec, kept_attributes(frame))
    if display:
        tag_light(spec, display.kind.primaries, display.white)
    spec.attribute("compression", "zip")
    return spec


def _write(path: Path, spec: oiio.ImageSpec, convert: Pixels, relax: Callable[[], None] | None) -> None:
    output = oiio.ImageOutput.create(str(path))
    if output is None:
        raise OSError(oiio.geterror())
    written = output.open(str(path), spec)
    step = max(16, _PIECE // (4 * spec.width * spec.nchannels) // 16 * 16)
    for first in range(0, spec.height, step):
        last = min(spec.height, first + step)
        pixels = np.ascontiguousarray(convert(slice(first, last)))
        written = written and output.write_scanlines(spec.y + first, spec.y + last, 0, pixels)
        if relax is not None:
            relax()
    closed = output.close()
    if not (written and closed):
        raise OSError(output.geterror().splitlines()[0] if output.has_error else "unknown reason")
