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
from postfx.errors import WriteError
from postfx.frame import Frame, Role
from postfx.io.metadata import kept_attributes, scaled_window, set_attributes
from postfx.io.srgb import srgb_decode, srgb_encode

LINEAR_FORMATS = (".exr",)
JPEG = (".jpg", ".jpeg")
DISPLAY_FORMATS = (".png", ".tif", ".tiff", *JPEG)
WRITABLE = LINEAR_FORMATS + DISPLAY_FORMATS
_BITS = {".tif": 16, ".tiff": 16}
_STORAGE = {"float16": "half", "float32": "float", "uint16": "uint16", "uint8": "uint8"}
_HALF_MAX = 65504.0
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
    provenance: Mapping[str, str] | None = None,
) -> Path:
    """Write colour and alpha of a frame; returns the path.

    EXR holds linear light (a display-encoded frame is decoded), half floats unless `half` is False, ZIP compression,
    the input's display window scaled to the frame's size and its useful header attributes. PNG and JPEG hold 8 bits,
    TIFF 16 bits of sRGB code values; a scene-linear frame is clipped to 0..1 there, so tone-map it first. The file
    appears under its name only when it is complete; folders are made. `relax` is called again and again meanwhile.
    `provenance` are attributes for an EXR header that tell how the frame came about.

    Raises FrameError when the frame has no colour, WriteError when the file cannot be written.
    """
    path = Path(path)
    display = is_display_format(path)
    convert = _display_pixels(frame, path) if display else _linear_pixels(frame, half)
    spec = _spec(frame, convert(slice(0, 1)), path, display)
    if not display:
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


def _linear_pixels(frame: Frame, half: bool) -> Pixels:
    def convert(rows: slice) -> np.ndarray:
        colour = frame[Role.COLOUR][rows]
        colour = srgb_decode(colour) if frame.encoding == "srgb" else colour
        pixels = _with_alpha(colour, frame, rows)
        return np.clip(pixels, -_HALF_MAX, _HALF_MAX).astype(np.float16) if half else pixels

    return convert


def _display_pixels(frame: Frame, path: Path) -> Pixels:
    opaque = Role.ALPHA not in frame or path.suffix.lower() in JPEG or frame[Role.ALPHA].min() >= 1
    bits = _BITS.get(path.suffix.lower(), 8)

    def convert(rows: slice) -> np.ndarray:
        colour = frame[Role.COLOUR][rows]
        encoded = colour if frame.encoding == "srgb" else srgb_encode(colour)
        pixels = encoded if opaque else _with_alpha(encoded, frame, rows)
        scaled = np.nan_to_num(np.clip(pixels, 0, 1)) * (2**bits - 1)
        return np.rint(scaled).astype(np.uint16 if bits == 16 else np.uint8)

    return convert


def _with_alpha(colour: np.ndarray, frame: Frame, rows: slice) -> np.ndarray:
    return np.concatenate([colour, frame[Role.ALPHA][rows]], axis=2) if Role.ALPHA in frame else colour


def _spec(frame: Frame, pixels: np.ndarray, path: Path, display: bool) -> oiio.ImageSpec:
    height, width, channels = len(frame[Role.COLOUR]), *pixels.shape[1:]
    spec = oiio.ImageSpec(width, height, channels, oiio.TypeDesc(_STORAGE[pixels.dtype.name]))
    spec.channelnames = ("R", "G", "B", "A")[:channels]
    if display:
        spec.attribute("oiio:ColorSpace", "sRGB")
        spec.attribute("CompressionQuality", 95)
        return spec
    window = scaled_window(frame, width, height)
    spec.x, spec.y = spec.full_x, spec.full_y = window.x0, window.y0
    set_attributes(spec, kept_attributes(frame))
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
