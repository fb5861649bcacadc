"""Names of frame files: patterns with a frame number, the files that match them, and the sources
that users name."""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TypeAlias

from fileseq.exceptions import MaxSizeException, ParseException
from fileseq.frameset import FrameSet

from postfx.errors import SequenceError
from postfx.files import with_slashes
from postfx.io.channels import COLOUR_FILES, is_plane_word
from postfx.io.image_file import READABLE, STILLS

PLANE_FIELD = "{plane}"
VIEW_FIELD = "{view}"
_NUKES_VIEW = re.compile(r"%[vV](?![A-Za-z])")
"""How Nuke writes the place of a view's name, or of its first letter."""
_NUMBER = re.compile(
    r"%(?:0(?P<printf>\d+))?d|(?P<hash>#+)|(?P<at>@+)|\$F(?P<houdini>\d*)|<F(?P<angle>\d*)>",
    re.ASCII
)
_DIGITS = re.compile(r"((?<=[._])-|^-)?\d+(?=\.[^.]*$)", re.ASCII)
"""The number that ends a name, with a minus that stands where a number begins."""
_FRAME_RANGE = re.compile(
    r"\s*(?P<first>-?\d{1,9})(?:-(?P<last>-?\d{1,9})(?P<step>[xy:]\d{1,9})?)?\s*", re.ASCII
)
_WILD = re.compile(r"[*?[]")
Source: TypeAlias = "str | os.PathLike[str] | Sequence[str | os.PathLike[str]]"
"""A pattern, a folder, a file, wildcards, or files one by one."""
MOST_DIGITS = 32
"""Digits that a frame number may be padded to."""
MOST_RANGE_FRAMES = 1_000_000
"""Frames from the first to the last of each range that is asked for."""
MOST_FOLDERS = 4096
"""Folders that wildcards may fit on each level, so that a search ends soon."""


@dataclass(frozen=True)
class Pattern:
    """File name before and after the frame number, and the least count of digits; `digits` None: no
    number at all.

    `folder` is a path that stands before `prefix` and is taken as it is written, whatever signs are
    in it.
    """

    prefix: str
    suffix: str = ""
    digits: int | None = None
    folder: str = ""

    @property
    def is_numbered(self) -> bool:
        return self.digits is not None

    @cached_property
    def has_views(self) -> bool:
        """Whether every view has files of its own."""
        return VIEW_FIELD in self.prefix + self.suffix

    def of_view(self, view: str) -> Pattern:
        """Pattern of one view's files."""
        return replace(self, prefix=self.prefix.replace(VIEW_FIELD, view),
                       suffix=self.suffix.replace(VIEW_FIELD, view))

    def by_view(self) -> dict[str, Pattern]:
        """View -> pattern of its files, of all views on the disk; '' -> this one where views share
        their files."""
        if not self.has_views:
            return {"": self}
        regex = self._regex()
        found = {match["view"]
                 for name in _glob(self._make_wildcards()) if (match := regex.fullmatch(name))}
        return {view: self.of_view(view) for view in sorted(found)}

    def path(self, number: int, plane: str = "") -> Path:
        """File of a frame (and of a plane, where every plane has its own); of one view."""
        name = self.prefix + self.suffix
        if self.digits is not None:
            sign = "-" if number < 0 else ""
            name = f"{self.prefix}{sign}{abs(number):0{self.digits}d}{self.suffix}"
        return Path(self.folder + name.replace(PLANE_FIELD, plane))

    def plane_of(self, other: Pattern) -> str | None:
        """Word that stands in another pattern where this one has {plane}; None when they differ
        elsewhere."""
        name = re.escape(self.prefix).replace(re.escape(PLANE_FIELD), r"(?P<plane>[^./]+)", 1)
        match = re.fullmatch(re.escape(self.folder) + name, other.folder + other.prefix)
        same = self.suffix == other.suffix and self.is_numbered == other.is_numbered
        return match["plane"] if match and same else None

    def find_frames(self) -> dict[int, dict[str, Path]]:
        """Frames of one view on the disk: number -> plane word ('' where one file holds all
        planes) -> file."""
        return self._look()[0]

    def find_overlooked(self) -> list[Path]:
        """Files that would be frames of it if their numbers had more digits."""
        return self._look()[1]

    def _look(self) -> tuple[dict[int, dict[str, Path]], list[Path]]:
        """Both of these. Numbers of fewer digits count where no number begins with a zero: nothing
        pads them there."""
        regex, least = self._regex(least=1), self.digits or 0
        found = [match for name in sorted(_glob(self._make_wildcards()))
                 if (match := regex.fullmatch(name))]
        numbers = [match.groupdict().get("number") or "1" for match in found]
        are_padded = any(number.lstrip("-").startswith("0")
                         for number in numbers if len(number) >= least)
        frames: dict[int, dict[str, Path]] = {}
        overlooked: list[Path] = []
        for number, match in zip(numbers, found, strict=True):
            path = Path(match.group())
            if are_padded and len(number) < least:
                overlooked.append(path)
                continue
            planes, word = frames.setdefault(int(number), {}), match.groupdict().get("plane") or ""
            if word in planes:
                raise SequenceError(f"{planes[word]} and {path.name}: both are frame {number}: "
                                    "remove one of them")
            planes[word] = path
        return dict(sorted(frames.items())), overlooked

    def includes(self, path: Path) -> bool:
        """Whether a file, there or not, would be found as a frame."""
        inner, name = os.path.split(self.prefix)
        if PLANE_FIELD in inner or VIEW_FIELD in inner:
            inner, name = "", self.prefix
        resolved = replace(self, prefix=name,
                           folder=_join(os.path.realpath(self.folder + inner), ""))
        return (resolved._regex()
                .fullmatch(_join(os.path.realpath(path.parent), path.name)) is not None)

    def _make_wildcards(self) -> str:
        """Wildcards that fit its files, and others."""
        number = "*" if self.is_numbered else ""
        name = glob.escape(self.prefix) + number + glob.escape(self.suffix)
        return glob.escape(self.folder) + name.replace(PLANE_FIELD, "*").replace(VIEW_FIELD, "*")

    def _regex(self, least: int | None = None) -> re.Pattern[str]:
        """What fits its files, or those whose numbers have at least so many digits."""
        # programs that count the minus among the digits write frame -3 of #### as -003
        number = ""
        if self.digits is not None:
            count = least or self.digits
            number = rf"(?P<number>\d{{{count},}}|-\d{{{max(1, count - 1)},}})"
        name = re.escape(self.prefix) + number + re.escape(self.suffix)
        for word in (PLANE_FIELD, VIEW_FIELD):
            group = word.strip("{}")
            name = name.replace(re.escape(word), rf"(?P<{group}>[^./]+)",
                                1).replace(re.escape(word), f"(?P={group})")
        return re.compile(re.escape(self.folder) + name, re.ASCII)

    def __str__(self) -> str:
        return self.folder + self.prefix + "#" * (self.digits or 0) + self.suffix


def _join(folder: str, name: str) -> str:
    return with_slashes(os.path.join(folder, name))


def _glob(wild: str) -> list[str]:
    """Names of files that wildcards fit, as patterns have them; SequenceError when a level has more
    than MOST_FOLDERS folders that fit."""
    levels: list[tuple[str, str]] = []  # glob.glob would call itself for each
    folder, name = os.path.split(wild)
    while glob.has_magic(folder) and folder != wild:
        levels.append((wild := folder, name))
        folder, name = os.path.split(wild)
    found = _glob_level(wild)
    for folder, name in reversed(levels):
        folders = [glob.escape(path) for path in found if os.path.isdir(path)]
        if len(folders) > MOST_FOLDERS:
            raise SequenceError(f"{folder}: the wildcards fit {len(folders)} folders: name more of "
                                "the folders")
        found = [path for folder in folders for path in _glob_level(_join(folder, name))]
    return found


def _glob_level(wild: str) -> list[str]:
    """Windows puts backslashes between folders; patterns have none."""
    return list(map(with_slashes, glob.glob(wild)))


def parse_pattern(text: str) -> Pattern:
    """Pattern of a file name that holds %04d, ####, @@@@, $F4 or <F4> once in its last part; else a
    single file.

    Nuke's %V and %v stand for {view}. The signs in the name of a folder that is there are part of
    its name. SequenceError when another folder's name holds a frame number, or a name holds two.
    """
    place, text = split_folder(with_slashes(text))
    text = _NUKES_VIEW.sub(VIEW_FIELD, text)
    folder, _, name = text.rpartition("/")
    found = list(_NUMBER.finditer(name))
    if folder and _NUMBER.search(folder):
        raise SequenceError(f"{place}{text}: give the frame number once, in the file name, or make "
                            f"the folder '{place}{folder}' first if it is called so")
    if len(found) > 1:
        raise SequenceError(f"{place}{text}: give the frame number once, in the file name")
    if not found:
        return Pattern(text, folder=place)
    if _digits(found[0]) > MOST_DIGITS:
        raise SequenceError(f"{place}{text}: a frame number has at most {MOST_DIGITS} digits")
    start = len(text) - len(name)
    prefix, suffix = text[: start + found[0].start()], text[start + found[0].end() :]
    return Pattern(prefix, suffix, _digits(found[0]), place)


def split_folder(text: str) -> tuple[str, str]:
    """A path's deepest folder that is there as it is written, with its slash, and what follows."""
    end = text.rfind("/") + 1
    while end and not os.path.isdir(text[:end]):
        end = text.rfind("/", 0, end - 1) + 1
    return text[:end], text[end:]


def parse_frames(text: str) -> list[int]:
    """Frame numbers of '1-100x2', '1,5,7-9' and the like, in order of time; SequenceError when
    malformed.

    Farms write '100-1' for frames to render last first. A history only goes forwards.

    Steps that fileseq writes with ':' or 'y' are refused: they deal frames out to several machines,
    out of order.
    """
    try:
        parts = [_FRAME_RANGE.fullmatch(part) for part in text.split(",") if part.strip()]
        if None in parts:
            raise ValueError("not whole numbers of up to nine digits")
        for part in filter(None, parts):
            if abs(int(part["last"] or part["first"]) - int(part["first"])) >= MOST_RANGE_FRAMES:
                raise SequenceError(f"--frames {text}: holds more than {MOST_RANGE_FRAMES} frames")
            _refuse_other_steps(text, part)
        numbers = list(FrameSet(text))
    except (ParseException, MaxSizeException, ValueError) as error:
        raise SequenceError(f"--frames {text}: not a frame range: write it like 1-100, 1-100x2 or "
                            "1,5,8-12") from error
    if not numbers:
        raise SequenceError(f"--frames {text}: holds no frame")
    return sorted({int(number) for number in numbers})


def _refuse_other_steps(text: str, part: re.Match[str]) -> None:
    """SequenceError for a step that other programs read otherwise."""
    first, last, step = part["first"], part["last"], part["step"] or "x"
    if step[0] == ":":
        raise SequenceError(f"--frames {text}: a step is written with x: give "
                            f"{first}-{last}x{step[1:]}")
    if step[0] == "y":
        raise SequenceError(f"--frames {text}: a step is written with x, and y is not a step: give "
                            f"{first}-{last}x2 for every second frame, or list the frames, like "
                            "2-4,6-8")


def format_frames(numbers: Iterable[int]) -> str:
    """Frame numbers as `parse_frames` reads them, sorted: '1-8', '1-9x2', '4,7-9'."""
    return FrameSet.framesToFrameRange(numbers, sort=True) if (numbers := list(numbers)) else ""


def number_in_name(path: Path) -> int | None:
    """Frame number that ends a file's stem ('shot.0012.exr' -> 12), or None."""
    match = _DIGITS.search(path.name)
    return int(match.group()) if match else None


def pattern_of(path: Path) -> Pattern:
    """Pattern of the sequence that a file belongs to by its name; without a number when the name
    ends in none."""
    match = _DIGITS.search(path.name)
    folder, name = split_folder(with_slashes(str(path)))
    if not match:
        return Pattern(name, folder=folder)
    before = len(name) - len(path.name)
    digits = len(match.group().lstrip("-"))
    return Pattern(name[: before + match.start()], name[before + match.end() :], digits, folder)


def patterns_in(folder: Path, suffixes: Iterable[str]) -> list[Pattern]:
    """Sequences and single files of a folder that have one of the suffixes; hidden files are none.

    SequenceError when the folder cannot be read.
    """
    return _group(path for path in _list_folder(folder) if path.suffix.lower() in suffixes
                  and path.name[0] != "." and os.path.isfile(path))


def describe_absence(pattern: Pattern) -> str:
    """Why a pattern fits no file: its folder, or what that holds instead."""
    folder = Path(str(pattern)).parent
    if not os.path.isdir(folder):  # False for a name that is too long
        return f"no such file: there is no folder '{folder}'"
    held = ", ".join(Path(str(other)).name for other in patterns_in(folder, READABLE)[:4])
    return ("no such file: "
            + (f"its folder holds {held}" if held else "check the folder and the frame pattern"))


def _group(paths: Iterable[Path]) -> list[Pattern]:
    """Patterns of files, each once."""
    found: dict[tuple[str, str, str], Pattern] = {}
    for path in sorted(paths, key=lambda path: (number_in_name(path) or 0) < 0):
        pattern, number = pattern_of(path), number_in_name(path)
        key = pattern.folder, pattern.prefix, pattern.suffix
        known = found.setdefault(key, pattern)
        fewer = (pattern.digits is not None and known.digits is not None
                 and pattern.digits < known.digits)
        if fewer and number is not None and number >= 0:
            found[key] = pattern
    return list(found.values())


def _list_folder(folder: Path) -> list[Path]:
    try:
        return sorted(folder.iterdir())
    except OSError as error:
        raise SequenceError(f"{folder}: cannot be read: {error.strerror or error}; check its "
                            "rights") from error


def _digits(match: re.Match[str]) -> int:
    if match["hash"] or match["at"]:
        return len(match.group())
    return max(1, int(match["printf"] or match["houdini"] or match["angle"] or 1))


def locate(source: Source) -> tuple[Pattern, list[int] | None]:
    """Pattern of a source, and the frame numbers where the source names some of its files.

    A leading ~ is the home folder. Wildcards (* ? [..]) count where no file has exactly that name.

    Raises SequenceError for a folder without OpenEXR files, and where files belong to several
    sequences.
    """
    if not isinstance(source, str | os.PathLike):
        names = list(source) if isinstance(source, Iterable) else [source]
        if not names or not all(isinstance(name, str | os.PathLike) for name in names):
            raise SequenceError(f"input {source!r}: give a file name, or a list of them")
        return _locate_files(names)
    name = with_slashes(os.path.expanduser(source))
    if os.path.isdir(name):
        return _folder_pattern(Path(name)), None
    pattern = parse_pattern(name)
    if _WILD.search(name) and not any(own.find_frames() for own in pattern.by_view().values()):
        return _matches(pattern, str(source))
    if pattern.is_numbered:
        return pattern, None
    path = Path(str(pattern))
    number = number_in_name(path)
    return pattern_of(path), None if number is None else [number]


def _locate_files(names: list[str | os.PathLike[str]]) -> tuple[Pattern, list[int] | None]:
    """Pattern of files that are named one by one, as a shell does with wildcards."""
    if len(names) == 1:
        return locate(names[0])
    paths = [Path(with_slashes(os.path.expanduser(name))) for name in names]
    absent = [path for path in paths if not os.path.isfile(path)]
    if any(parse_pattern(with_slashes(str(path))).is_numbered for path in absent):
        raise SequenceError(f"{absent[-1]}: is one of {len(names)} inputs: give one pattern, or "
                            "files alone (postfx run takes the output behind -o)")
    if absent or not paths:
        raise SequenceError(f"{absent[0] if absent else 'INPUT'}: no such file: check the folder "
                            "(postfx run takes the output behind -o)")
    return _gather_files(paths, f"INPUT of {len(paths)} files")


def _matches(pattern: Pattern, source: str) -> tuple[Pattern, list[int] | None]:
    """Pattern of the files, or of the one folder, that wildcards fit."""
    name = pattern.prefix + ("*" if pattern.is_numbered else "") + pattern.suffix
    name = name.replace(PLANE_FIELD, "*").replace(VIEW_FIELD, "*")
    found = sorted(map(Path, _glob(glob.escape(pattern.folder) + name)))
    folders = [path for path in found if os.path.isdir(path)]  # False without the right to look
    files = [path for path in found if os.path.isfile(path)]
    paths = ([path for path in files if path.suffix.lower() in READABLE]
             or [path for path in files if path.suffix.lower() in STILLS])
    if not paths and len(folders) == 1:
        return _folder_pattern(folders[0]), None
    if not paths:
        raise SequenceError(f"{source}: no such file: check the folder and the wildcards")
    return _gather_files(paths, source)


def _gather_files(paths: list[Path], source: str) -> tuple[Pattern, list[int] | None]:
    """The one sequence that files belong to, and their numbers unless these are all that is on the
    disk."""
    pattern = _one_sequence(_group(paths), source)
    numbers = sorted({number for path in paths if (number := number_in_name(path)) is not None})
    return (pattern,
            None if not pattern.is_numbered or numbers == list(pattern.find_frames()) else numbers)


def _folder_pattern(folder: Path) -> Pattern:
    patterns = patterns_in(folder, READABLE) or patterns_in(folder, STILLS)
    if not patterns:
        raise SequenceError(f"{folder}: holds no OpenEXR file")
    return _one_sequence(patterns, str(folder))


def _one_sequence(patterns: list[Pattern], source: str) -> Pattern:
    """The one pattern, or the one that fits them all, each of another plane; else SequenceError."""
    together = patterns[0] if len(patterns) == 1 else _one_file_a_plane(patterns)
    if together is None:
        folders = {Path(str(pattern)).parent for pattern in patterns}
        names = [Path(str(pattern)).name if len(folders) == 1 else str(pattern)
                 for pattern in patterns]
        views = sorted({name.replace("right", VIEW_FIELD) for name in names if "right" in name}
                       & {name.replace("left", VIEW_FIELD) for name in names if "left" in name})
        also = f", or all views by {views[0]}" if views else ""
        raise SequenceError(f"{source}: holds {len(names)} sequences ({', '.join(names[:4])}): "
                            f"name one of them{also}")
    return together


def _one_file_a_plane(patterns: list[Pattern]) -> Pattern | None:
    """Pattern with {plane} that fits all sequences of a folder, one of them the colour; None when
    there is none."""
    for pattern in patterns:
        name = pattern.prefix
        for word in COLOUR_FILES:
            together = replace(pattern, prefix=name.replace(word, PLANE_FIELD))
            if word in name and all(is_plane_word(together.plane_of(other) or "")
                                    for other in patterns):
                return together
    return None
