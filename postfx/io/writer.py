"""Writing frames: which file each goes to, whole or not at all; linear light in EXR, display code
values elsewhere."""

from __future__ import annotations

import errno
import os
import re
import tempfile
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import lru_cache
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio

from postfx.caching import LRUCache
from postfx.colour.displays import SRGB, Display, parse_display
from postfx.errors import FrameError, OutputExistsError, WriteError, offer
from postfx.files import is_utf8, output_file, with_slashes
from postfx.frame import LINEAR, TOLD, Frame, Role
from postfx.io.encoder import cut_pieces, display_of, encode_all, encode_pixel, tag_codes
from postfx.io.exr import Header
from postfx.io.exr.container import COMPRESSIONS, Rows, can_compress
from postfx.io.exr.passthrough import JITTER_ATTRIBUTE
from postfx.io.exr.picture import (
    Picture,
    PictureHeader,
    light_of,
    set_attributes,
    to_halves,
    write_exr,
)
from postfx.io.image_file import reason_of
from postfx.io.jpeg import JPEG_SUFFIXES, write_jpeg
from postfx.io.light_plan import LightPlan, find_light_plan
from postfx.io.pattern import (
    PLANE_FIELD,
    VIEW_FIELD,
    Pattern,
    format_frames,
    parse_pattern,
    split_folder,
)
from postfx.io.png import OWN_CHANNELS, write_png
from postfx.io.quantisation import Dither, quantise
from postfx.io.sequence import Sequence
from postfx.io.wholeness import has_end
from postfx.io.windows import Pixels, Window, crop, output_windows
from postfx.planes import LARGEST_HALF, largest_bits_of
from postfx.streams import make_printable
from postfx.workers import finished_before_the_end

LINEAR_FORMATS = (".exr",)
DISPLAY_FORMATS = (".png", ".tif", ".tiff", *JPEG_SUFFIXES)
WRITABLE = LINEAR_FORMATS + DISPLAY_FORMATS
_VIDEOS = (".mp4", ".mov", ".mkv", ".webm", ".avi", ".gif")
_DEEP = (".tif", ".tiff")
"""Files of 16 bits, which PNG has for HDR displays if not told otherwise."""
_LEVELLED = ("dwaa", "dwab")
_PNG_LEVEL = 3
"""Of compression with alpha: half the time of level 6 and a filter chosen for each row, for 4 %
more."""
_PNG_PAETH = 128
MOST_KINDS_OF_OUTPUTS = 32
"""That are known to be possible."""
_HOLDS_CODES: LRUCache[tuple[object, ...], bool] = LRUCache(MOST_KINDS_OF_OUTPUTS)
"""Whether files hold pictures for a display, by suffix, bits, compression and encoding: those that
can be written."""

NO_LOOK = ("write_frame: a scene-linear frame becomes a picture without exposure and look, clipped "
           "to 0..1 and encoded as sRGB: run it through postfx.Pipeline([postfx.ToneMap()]) first, "
           "as 'postfx run' does, or write .exr; encoding='display-linear' says that 1 is white")
"""Names no file, so that Python shows it once for all frames of a loop."""
SRGB_DISPLAY = parse_display("srgb")
LEAST_FACTOR = np.float32(1 / 256)
"""Black in 8 bits: what light that reached a place without colour is divided by."""
BEYOND_HALF = np.float32(65520)
"""The least number that is not rounded to the largest half float."""
BEYOND_HALF_BITS = int(BEYOND_HALF.view(np.uint32))


def is_display_format(path: str | PathLike[str]) -> bool:
    """Whether files of this name hold display-encoded pictures; WriteError when the format cannot
    be written."""
    suffix = Path(path).suffix.lower()
    if suffix in _VIDEOS:
        stem = str(Path(path).with_suffix("")).rstrip("#@.")
        raise WriteError(f"{path}: postfx writes frames: write '{stem}.####.png', then run ffmpeg "
                         f"-framerate 24 -i {stem}.%04d.png -pix_fmt yuv420p {stem}{suffix}")
    if suffix not in WRITABLE:
        raise WriteError(f"{path}: unknown format '{suffix}'{offer(suffix, WRITABLE)}")
    return suffix in DISPLAY_FORMATS


def check_storage(path: Path, bits: int | None, compression: str, encoding: str) -> None:
    """WriteError where files of this name cannot have so many bits or this compression, or have too
    few bits for code values of an encoding."""
    suffix = path.suffix.lower()
    display = None if encoding in LINEAR else parse_display(encoding)
    may_have = ((16, 32) if suffix in LINEAR_FORMATS else (8,) if suffix in JPEG_SUFFIXES
                else (8, 16))
    if bits is not None and bits not in may_have:
        raise WriteError(f"{path}: cannot have {bits} bits: {suffix[1:].upper()} has "
                         f"{' or '.join(map(str, may_have))}")
    if (suffix not in LINEAR_FORMATS and display and display.hdr
        and (suffix in JPEG_SUFFIXES or bits == 8)):
        few = "JPEG has too few bits" if suffix in JPEG_SUFFIXES else "8 bits are too few"
        raise WriteError(f"{path}: {few} for {display.kind.title}: write PNG or TIFF, of 16 bits")
    check_compression(path, compression)


def check_compression(path: Path, compression: str) -> None:
    """WriteError for a compression that OpenEXR does not have, or that is not for files of this
    name."""
    name, _, level = compression.partition(":")
    if (name not in COMPRESSIONS.values()
        or (level and (name not in _LEVELLED or not level.isdigit()))):
        known = offer(name, COMPRESSIONS.values(), "use one of")
        raise WriteError(f"--compression {compression}{known}, or with a level dwaa:45 or dwab:45")
    if not can_compress(name):
        raise WriteError(f"--compression {name}: OpenImageIO {oiio.__version__}, which is "
                         "installed here, does not write it: install 3.2 or newer, or give zip")
    if compression != "zip" and path.suffix.lower() not in LINEAR_FORMATS:
        raise WriteError(f"{path}: --compression is for EXR files: leave it out")


@finished_before_the_end()
def write_frame(
    path: str | PathLike[str],
    frame: Frame,
    relax: Callable[[], None] | None = None,
    dither: Dither | str = Dither.MOVING,
    provenance: Mapping[str, str | float] | None = None,
    keep: bool | None = False,
    bits: int | None = None,
    compression: str = "zip",
) -> Path:
    """Write colour and alpha of a frame; returns the path. An EXR also holds the plane `error` of a
    frame that has one.

    EXR holds linear light: a display-encoded frame is decoded, in its display's primaries, and 1 is
    white. The input's windows are scaled to the frame's size, and its useful header attributes
    kept. Beside scene-linear colour also an overlay that was not composited, as a layer of that
    name, and the frame's parts, under the names that they had. All views of a frame go into one
    EXR, under the names that they had in its source.

    Other files hold code values within the display window; 8 bits are dithered. They are tagged
    with the display that they are for, see `postfx.io.encoder`. Linear frames are clipped to 0..1
    there and encoded as sRGB, so tone-map them first: a RuntimeWarning tells of scene-linear ones.

    The file appears under its name only when it is complete; folders are made.

    Args:
        relax: called repeatedly while the file is written.
        dither: moving, static or none.
        provenance: attributes for an EXR header that tell how the frame came about.
        keep: write everything else that the frame's source holds into an EXR, see
            `postfx.io.exr.passthrough`; None: only beside a picture that has the source's size.
        bits: EXR 16 (half floats, default) or 32 (floats, default beside parts that are distances
            or places); PNG and TIFF 8 or 16 (default: PNG 8, but 16 for HDR displays; TIFF 16);
            JPEG 8.
        compression: of EXR files: none, rle, zips, zip, piz, pxr24, b44, b44a, dwaa, dwab,
            htj2k256, htj2k32, lj2k or zstd; dwaa and dwab also with a level as in 'dwaa:45'. ZIP is
            the fastest that shrinks, pxr24 (floats), b44, dwa and lj2k lose something.

    Raises FrameError when the frame has no colour, WriteError when the file cannot be written or
    its format cannot hold such a picture, ReadError when what is kept cannot be read.
    """
    if not isinstance(frame, Frame):
        raise FrameError("write_frame takes a path and a postfx.Frame, not "
                         f"{type(frame).__name__}: give Frame({{'colour': array}})")
    if not isinstance(path, str | PathLike):
        raise WriteError(f"{path!r} is no file name: give a text or a path")
    path = Path(path)
    if not isinstance(compression, str) or not isinstance(bits, int | None):
        raise WriteError(f"{path}: compression {compression!r} and bits {bits!r}: give a text and "
                         "a whole number")
    if re.search(r"##|%0\dd", path.name):
        raise WriteError(f"{path}: is a pattern, and write_frame writes one file: name it by "
                         "frame.number, as in f'clean.{frame.number:04d}.exr'")
    kind = (path.suffix, bits, compression, frame.encoding)
    shown = _HOLDS_CODES.find(kind)
    if shown is None:  # the first file of its kind
        shown = is_display_format(path)
        check_storage(path, bits, compression, frame.encoding)
        _HOLDS_CODES.keep(kind, shown)
    if shown and frame.views:
        raise WriteError(f"{path}: {path.suffix[1:].upper()} holds one view: write EXR, or choose "
                         "one with --view NAME")
    if shown:
        if frame.encoding == "scene-linear":
            warnings.warn(NO_LOOK, RuntimeWarning, stacklevel=3)  # past the decorator
        _write_codes(path, frame, Dither(dither), bits, relax)
        return path
    exact = any(source.exact for name, source in frame.part_sources.items() if name in frame.parts)
    half = not exact if bits is None else bits == 16
    with output_file(path) as temporary:
        found = [(view, *find_light_plan(view, half, compression,
                                         {**(provenance or {}), **_tell_jitter(view)}))
                 for view in (frame, *frame.views.values())]
        keep = not found[0][1].is_enlarged if keep is None else keep
        notes = _write_light(temporary, found, keep, relax)
    for note, *facts in notes:
        TOLD.warning(note, path, *facts)
    return path


def _tell_jitter(frame: Frame) -> dict[str, Any]:
    """The attribute of a frame's jitter, where its samples still lie off the pixels' centres."""
    return {} if frame.jitter == (0.0, 0.0) else {JITTER_ATTRIBUTE: tuple(map(float, frame.jitter))}


def _write_light(path: Path, found: list[tuple[Frame, LightPlan, Header]], keep: bool,
                 relax: Callable[[], None] | None) -> list[tuple[Any, ...]]:
    """Write an EXR of one view or several. Where a lossy compression makes light infinite, write it
    again, cut at a limit. Returns what the user should know of it: notes on the file with their
    facts."""
    plans = [plan for _, plan, _ in found]
    altered = {name for plan in plans
               for name, is_altered in zip(plan.names, plan.altered, strict=True) if is_altered}
    altered |= {f"{view}.{name}" for view in found[0][0].views for name in altered}
    losses = _Losses()
    for limit in _LIMITS if altered else _LIMITS[:1]:
        pictures = []
        for frame, plan, header in found:
            rows = _light_rows(frame, plan, limit, losses, relax)
            pictures.append(Picture(Header(dict(header.attributes)), rows, frame))
        write_exr(path, pictures, keep, plans[0].key)
        if not altered or _is_finite(path, altered):
            break
    notes: list[tuple[Any, ...]] = []
    compression = plans[0].compression
    if losses.has_nan:
        notes.append(("%s: pixels that are NaN become black by %s compression", compression))
    if limit is not None:
        notes.append(("%s: light above %d is cut there, as %s compression would make it infinite",
                      limit, compression))
    elif losses.beyond:
        notes.append(("%s: %s above %d is cut there, as half floats hold no more: give 32 bits "
                      "(--bits 32) to keep it", " and ".join(sorted(losses.beyond)), LARGEST_HALF))
    return notes


@dataclass
class _Losses:
    """What a file does not hold of a picture, noted while it is written.

    Attributes:
        beyond: kinds of channels that are larger than half floats.
        has_nan: whether a pixel is NaN that a compression would spread.
    """

    beyond: set[str] = field(default_factory=set)
    has_nan: bool = False


def _write_codes(path: Path, frame: Frame, dither: Dither, bits: int | None,
                 relax: Callable[[], None] | None) -> None:
    """Write a picture for a display in the format of a suffix. Raises OSError unless all bytes are
    in the file, which encoders do not tell."""
    suffix, display, windows = path.suffix.lower(), display_of(frame), output_windows(frame)
    opaque = (Role.ALPHA not in frame or suffix in JPEG_SUFFIXES
              or bool(frame[Role.ALPHA].min() >= 1))
    depth = bits or (16 if suffix in _DEEP or (display and display.hdr) else 8)
    spec = _codes_spec(suffix, windows.display, 3 if opaque else 4, depth, display or SRGB_DISPLAY)
    straight = suffix == ".png" and not opaque
    convert = crop(_code_pixels(frame, display, opaque, straight, depth, dither), windows.area,
                   windows.display)
    with output_file(path) as temporary:
        if suffix in JPEG_SUFFIXES:
            write_jpeg(temporary, spec.image_bytes(),
                       lambda to: encode_all(to, suffix, spec, convert, relax))
        elif suffix == ".png" and spec.nchannels == OWN_CHANNELS:
            write_png(temporary, encode_pixel(suffix, spec), (spec.width, spec.height),
                      cut_pieces(spec, convert, relax))
        else:
            encode_all(temporary, suffix, spec, convert, relax)
        if not has_end(temporary, suffix):
            raise OSError(errno.ENOSPC, "the file has no end")


@lru_cache(16)
def _codes_spec(suffix: str, window: Window, channels: int, depth: int,
                display: Display) -> oiio.ImageSpec:
    """What OpenImageIO is told of a picture for a display. It is the same in all frames."""
    spec = oiio.ImageSpec(window.width, window.height, channels, f"uint{depth}")
    spec.channelnames = ("R", "G", "B", "A")[:channels]
    tag_codes(spec, display, suffix)
    if suffix == ".png":
        spec.attribute("oiio:UnassociatedAlpha", 1)
    if suffix in JPEG_SUFFIXES:  # TIFF would take it for a level of deflate
        spec.attribute("CompressionQuality", 95)
    spec.attribute("png:compressionLevel", _PNG_LEVEL)
    spec.attribute("png:filter", _PNG_PAETH)
    return spec


def write_channels(
    path: str | PathLike[str],
    channels: Mapping[str, np.ndarray],
    attributes: Mapping[str, str | int | float] | None = None,
    at: tuple[int, int] = (0, 0),
    full: tuple[int, int] | None = None,
) -> Path:
    """Write planes (height, width) under the names of their channels into an EXR of 32-bit floats;
    returns the path.

    at, full: column and row of the planes in a larger picture, and its width and height, as for a
    region of a render.
    """
    path, planes = Path(path), [np.asarray(plane, np.float32) for plane in channels.values()]
    height, width = planes[0].shape
    spec = oiio.ImageSpec(width, height, len(planes), "float")
    spec.channelnames = tuple(channels)
    spec.x, spec.y = at
    spec.full_width, spec.full_height = full or (width, height)
    spec.attribute("compression", "zip")
    set_attributes(spec, attributes or {})
    header = PictureHeader(spec, attributes or {})
    stored = [planes[place] for place in header.places]

    def read(first: int, last: int) -> list[np.ndarray]:
        return [plane[first:last] for plane in stored]

    with output_file(path) as temporary:
        write_exr(temporary, [Picture(header.first, read)])
    return path


_LIMITS = (None, 60000, 52000, 40000, 24000)
"""Light at which pictures are cut, one after the other, until lossy compression, which errs by some
percent of what is around a pixel, leaves all within half floats."""


def _limit(pixels: np.ndarray, altered: np.ndarray, limit: float | None,
           losses: _Losses) -> np.ndarray:
    """Pixels whose altered channels are cut at a limit and are 0 in place of NaN."""
    if (is_nan := altered & np.isnan(pixels)).any():
        losses.has_nan = True
        pixels = np.where(is_nan, pixels.dtype.type(0), pixels)
    if limit is None:
        return pixels
    return np.where(altered & (np.abs(pixels) > limit),
                    np.copysign(pixels.dtype.type(limit), pixels), pixels)


def _is_finite(path: Path, names: set[str]) -> bool:
    """Whether channels of these names are finite in an EXR file."""
    image = oiio.ImageInput.open(str(path))
    if image is None:
        raise OSError(reason_of(oiio.geterror))
    found, part = True, 0
    while found and image.seek_subimage(part, 0):
        known = [name in names for name in image.spec().channelnames]
        first, last = ((known.index(True), len(known) - known[::-1].index(True)) if any(known)
                       else (0, 0))
        pixels = (image.read_image(part, 0, first, last, oiio.HALF)
                  if last and not image.spec().deep else None)
        found = (pixels is None
                 or bool(np.isfinite(pixels.reshape(-1, last - first)[:, known[first:last]]).all()))
        part += 1
    image.close()
    return found


def is_complete(path: str | PathLike[str], width: int, height: int) -> bool:
    """Whether a file holds a readable image whose display window is of this size: every pixel of it
    is decoded, and all else that an OpenEXR file holds is there."""
    image = oiio.ImageInput.open(str(path)) if os.path.isfile(path) else None
    if image is None:
        reason_of(oiio.geterror)
        return False
    spec = image.spec()
    same = (spec.full_width, spec.full_height) == (width, height)
    readable = same and image.read_image(oiio.UINT8) is not None
    reason_of(image.geterror)
    image.close()
    return readable and has_end(Path(path), Path(path).suffix)


def _light_rows(frame: Frame, plan: LightPlan, limit: float | None, losses: _Losses,
                relax: Callable[[], None] | None) -> Rows:
    """Channels of light as they are written. Those that a compression alters are cut at a limit."""
    colour, (before, behind) = frame[Role.COLOUR], plan.planes
    area, data = plan.windows.area, plan.windows.data
    top, columns = data.y0 - area.y0, slice(data.x0 - area.x0, data.x1 + 1 - area.x0)
    is_altered = plan.altered.any()

    def read(first: int, last: int) -> list[np.ndarray]:
        some = slice(first + top, last + top), columns
        light = light_of(colour[some], plan.display) if plan.display else colour[some]
        planes = [light, *[frame[role][some] for role in before]]
        planes += [_divide_part(frame, name, some) for name in plan.parts]
        planes += [frame[role][some] for role in behind]
        pixels = np.concatenate(planes, axis=2) if len(planes) > 1 else light
        if plan.half:
            if largest_bits_of(pixels) >= BEYOND_HALF_BITS:
                beyond = (np.abs(pixels) >= BEYOND_HALF).any((0, 1))
                losses.beyond.update(kind for kind, is_beyond
                                     in zip(plan.kinds, beyond, strict=True) if is_beyond)
            pixels = to_halves(pixels)
        if is_altered:
            pixels = _limit(pixels, plan.altered, limit, losses)
        if relax is not None:
            relax()
        return [pixels[:, :, place] for place in plan.header.places]

    return read


def _code_pixels(frame: Frame, display: Display | None, opaque: bool, straight: bool, depth: int,
                 dither: Dither) -> Pixels:
    """Rows of code values as they are written, with alpha unless the picture is opaque, which PNG
    wants straight."""
    colour = frame[Role.COLOUR]

    def convert(rows: slice) -> np.ndarray:
        codes = colour[rows] if display else SRGB.encode(colour[rows])
        if straight:
            codes = _divide_by_alpha(codes, frame[Role.ALPHA][rows], display or SRGB_DISPLAY, depth)
        if not opaque:
            codes = np.concatenate([codes, frame[Role.ALPHA][rows]], axis=2)
        return quantise(codes, depth, dither, frame.number, rows.start)

    return convert


def _divide_by_alpha(codes: np.ndarray, alpha: np.ndarray, display: Display,
                     depth: int) -> np.ndarray:
    """Codes (h, w, 3) of light without alpha (h, w, 1) in it, as PNG wants them (PNG specification,
    6.2). Where alpha is less than half a step of its `depth` in bits, and written as 0, they stay:
    there it divides noise, which programs that ignore alpha would show."""
    partly = (alpha[..., 0] >= 0.5 / (2**depth - 1)) & (alpha[..., 0] < 1)
    found = np.array(codes)
    found[partly] = display.encode(light_of(codes[partly], display) / alpha[partly])
    return found


def _divide_part(frame: Frame, name: str, some: tuple[slice, slice]) -> np.ndarray:
    """A part as its file stores it: divided by its factor, 0 where that is 0; a factor is at least
    LEAST_FACTOR where there is light, which would be lost."""
    divided = [other for other, source in frame.part_sources.items()
               if source.factor == name and other in frame.parts]
    if divided:
        factor, light = frame.parts[name][some], [frame.parts[other][some] > 0 for other in divided]
        return np.where(np.any(light, axis=0), np.maximum(factor, LEAST_FACTOR), factor)
    part, source = frame.parts[name][some], frame.part_sources.get(name)
    if source is None or source.factor is None or source.factor not in frame.parts:
        return part
    stored, factor = np.zeros_like(part), _divide_part(frame, source.factor, some)
    np.divide(part, factor, out=stored, where=factor > 0)
    return stored


class ExistingFiles(StrEnum):
    """What to do with output files that are already there."""

    REFUSE = "refuse"
    OVERWRITE = "overwrite"
    SKIP = "skip"


class OutputFiles:
    """Output files of a sequence.

    `target` is a pattern with a frame number, a folder (input names are kept, as EXR), or one file
    for one frame; with {view} each view has a file of its own. Raises WriteError when the format is
    unknown, when several frames would share a file, when views that were read from files of their
    own would, or when an output would be an input; OutputExistsError from `check`.

    `can_skip`: whether the command that writes them has --skip-existing.

    Attributes:
        display: whether they are pictures for a display.
        has_views: whether every view has a file of its own.
    """

    def __init__(self, target: str, sequence: Sequence,
                 existing: ExistingFiles = ExistingFiles.REFUSE, can_skip: bool = True) -> None:
        self.existing, self._sequence = existing, sequence
        self._can_skip = can_skip
        target = with_slashes(os.path.expanduser(target))
        if target == "-":
            raise WriteError("-: frames are written to files, not to standard output: write it "
                             "like out/clean.####.exr")
        self._pattern = _output_pattern(target, sequence.pattern)
        wild = next((letter for letter in "*?" if letter in self._pattern.prefix), "")
        if wild and not self._pattern.is_numbered:
            raise WriteError(f"{target}: '{wild}' finds files, it names none: write # for each "
                             "digit of the frame's number, as in clean.####.exr")
        self.display = is_display_format(str(self._pattern))
        self.has_views = self._pattern.has_views
        if len(sequence) > 1 and not self._pattern.is_numbered:
            stem, suffix = Path(target).stem, Path(target).suffix
            raise WriteError(f"{target}: one file for {len(sequence)} frames, "
                             f"{format_frames(sequence.numbers)}: write it like "
                             f"{stem}.####{suffix}")
        if VIEW_FIELD in os.path.dirname(self._pattern.prefix):
            folder = os.path.dirname(str(self._pattern))
            raise WriteError(f"{self._pattern}: all views go into one folder: put {VIEW_FIELD} "
                             f"into the file's name, or make the folder '{folder}' first if it is "
                             "called so")
        if sequence.pattern.has_views and sequence.views and not self.has_views:
            raise WriteError(f"{target}: one file for {len(sequence.views) + 1} views, which have "
                             f"files of their own: put {VIEW_FIELD} into the name, or choose one "
                             "with --view NAME")
        self._refuse_inputs(sequence)

    @property
    def pattern(self) -> str:
        """How the files are named, with # for digits."""
        return Path(str(self._pattern)).name

    def path(self, number: int) -> Path:
        """Output file of a frame, or of its first view."""
        return self.paths(number)[0]

    def paths(self, number: int) -> list[Path]:
        """Output files of a frame, of the first view first."""
        if not self.has_views:
            return [self._pattern.path(number)]
        return [self._pattern.of_view(view).path(number) for view in self._views()]

    def split(self, frame: Frame) -> list[tuple[Path, Frame]]:
        """A frame's output files, each with what goes into it."""
        pictures = [frame]
        if self.has_views:
            pictures = [replace(one, views={}) for one in (frame, *frame.views.values())]
        return list(zip(self.paths(frame.number), pictures, strict=True))

    def check(self, numbers: tuple[int, ...]) -> None:
        """OutputExistsError when a file is already there and is to be neither overwritten nor
        skipped."""
        if self.existing is ExistingFiles.REFUSE:
            for path in self._guess_paths(numbers):
                if os.path.lexists(path):
                    ways = "--overwrite or --skip-existing" if self._can_skip else "--overwrite"
                    raise OutputExistsError(f"{path}: is already there: give {ways}")

    def check_storage(self, encoding: str, bits: int | None = None,
                      compression: str = "zip") -> None:
        """WriteError where the format cannot have these bits or this compression, or too few for an
        encoding."""
        check_storage(Path(str(self._pattern)), bits, compression, encoding)

    def _refuse_inputs(self, sequence: Sequence) -> None:
        """No input may be replaced, whatever links, `..` or letter case lead there, and no output
        may become a frame of the input: the next run would read it."""
        inputs = {_place(path) for path in sequence.all_files()}
        outputs = self._guess_paths(sequence.numbers)
        there = any(map(os.path.lexists, outputs))
        linked = {_identity(path) for path in sequence.all_files()} - {None} if there else set()
        for path in outputs:
            if _place(path) in inputs or _identity(path) in linked:
                raise WriteError(f"{path}: is an input: write to another folder or name")
            if sequence.pattern.includes(path):
                raise WriteError(f"{path}: would be a frame of the input: write to another folder "
                                 "or name")

    def _views(self) -> list[str]:
        """Views that have files of their own; '' for the first one while its name is not known."""
        return [view or "" for view in (self._sequence.view, *self._sequence.views)]

    def _guess_paths(self, numbers: Iterable[int]) -> list[Path]:
        """Files of frames, of whatever views are on the disk where no frame was opened yet that
        tells them."""
        if not self.has_views:
            return [self._pattern.path(number) for number in numbers]
        views = list(filter(None, self._views())) or ["view", *self._pattern.by_view()]
        return [self._pattern.of_view(view).path(number) for number in numbers for view in views]


def _place(path: Path) -> str:
    """Where a file is, without links and regardless of letter case."""
    return os.path.realpath(path).casefold()


def _identity(path: Path) -> tuple[int, int] | None:
    """A key that all names of one file share; None if there is no file."""
    try:
        found = os.stat(path)
    except OSError:
        return None
    return found.st_dev, found.st_ino


def check_folder(folder: Path, option: str) -> None:
    """Make a folder and raise WriteError where it cannot be written, so that a run fails before its
    first frame."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise WriteError(
            f"{option} folder '{folder}' cannot be written ({error.strerror}): give --{option} "
            "another folder"
        ) from error


def _output_pattern(target: str, source: Pattern) -> Pattern:
    if not is_utf8(target):
        raise WriteError(f"{make_printable(target)}: is not UTF-8: choose another name")
    if not (target.endswith("/") or os.path.isdir(target)):
        ending, name = Path(target).suffix, Path(target).name
        if ending and not parse_pattern(ending).is_numbered:
            _refuse_planes(target)
            return parse_pattern(target)
        if parse_pattern(name).is_numbered:
            raise WriteError(f"{target}: its name has no ending: write it like {target}.exr, or "
                             f"{target}/ for a folder that is called so")
    start, end = source.prefix.rpartition("/")[2].replace(PLANE_FIELD, "frame"), source.suffix
    if source.is_numbered:
        end = os.path.splitext(f"n{end}")[0][1:]
    else:
        start = os.path.splitext(start)[0]
    if source.has_views and VIEW_FIELD not in start + end:
        start = f"{VIEW_FIELD}.{start}"
    return Pattern(start, f"{end}.exr", source.digits, f"{target.rstrip('/')}/")


def _refuse_planes(target: str) -> None:
    """WriteError for a file's name with {plane} outside of a folder that is there."""
    place, rest = split_folder(target)
    folder = rest.rpartition("/")[0]
    if PLANE_FIELD in rest:
        also = (f", or make the folder '{place}{folder}' first if it is called so"
                if PLANE_FIELD in folder else "")
        raise WriteError(f"{target}: {PLANE_FIELD} is for input: leave it out, the AOVs of a frame "
                         f"go into one file{also}")
