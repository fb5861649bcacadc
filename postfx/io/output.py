"""Which file each processed frame goes to, and what happens when it is already there."""

from __future__ import annotations

import os
import tempfile
from enum import StrEnum
from pathlib import Path

from postfx.errors import OutputExistsError, WriteError
from postfx.files import is_utf8, make_printable
from postfx.io.pattern import PLANE, Pattern, parse_pattern
from postfx.io.sequence import Sequence
from postfx.io.writer import is_display_format, refuse_few_bits


class Existing(StrEnum):
    """What to do with output files that are already there."""

    REFUSE = "refuse"
    OVERWRITE = "overwrite"
    SKIP = "skip"


class OutputFiles:
    """Output files of a sequence.

    `target` is a pattern with a frame number, a folder (input names are kept, as EXR), or one file for one frame.
    Raises WriteError when the format is unknown, when several frames would share a file, or when an output would be
    an input; OutputExistsError from `check`.
    """

    def __init__(self, target: str, sequence: Sequence, existing: Existing = Existing.REFUSE) -> None:
        self.existing, self._sequence = existing, sequence
        self._pattern = _output_pattern(target, sequence.pattern)
        self.display = is_display_format(str(self._pattern))
        if len(sequence) > 1 and not self._pattern.numbered:
            stem, suffix = Path(target).stem, Path(target).suffix
            raise WriteError(f"{target}: one file for {len(sequence)} frames: write it like {stem}.####{suffix}")
        self._refuse_inputs(sequence)

    @property
    def pattern(self) -> str:
        """How the files are named, with # for digits."""
        return Path(str(self._pattern)).name

    def path(self, number: int) -> Path:
        """Output file of a frame."""
        return self._pattern.path(number)

    def check(self, numbers: tuple[int, ...]) -> None:
        """OutputExistsError when a file is already there and is to be neither overwritten nor skipped."""
        if self.existing is Existing.REFUSE:
            for path in map(self.path, numbers):
                if os.path.lexists(path):
                    raise OutputExistsError(f"{path}: is already there: give --overwrite or --skip-existing")

    def refuse_few_bits(self, encoding: str) -> None:
        """WriteError where the format has too few bits for code values of an encoding."""
        refuse_few_bits(Path(str(self._pattern)), encoding)

    def _refuse_inputs(self, sequence: Sequence) -> None:
        """No input may be replaced, whatever links, `..` or letter case lead there, and no output may become a frame of
        the input: the next run would read it."""
        inputs = {_place(path) for path in sequence.all_files()}
        outputs = list(map(self.path, sequence.numbers))
        there = any(map(os.path.lexists, outputs))
        linked = {_identity(path) for path in sequence.all_files()} - {None} if there else set()
        for path in outputs:
            if _place(path) in inputs or _identity(path) in linked:
                raise WriteError(f"{path}: is an input: write to another folder or name")
            if sequence.pattern.takes(path):
                raise WriteError(f"{path}: would be a frame of the input: write to another folder or name")


def _place(path: Path) -> str:
    """Where a file is, without links and regardless of letter case."""
    return os.path.realpath(path).casefold()


def _identity(path: Path) -> tuple[int, int] | None:
    """What names of one file have in common; None where there is no file."""
    try:
        found = os.stat(path)
    except OSError:
        return None
    return found.st_dev, found.st_ino


def check_folder(folder: Path, option: str) -> None:
    """Make a folder and raise WriteError where it cannot be written: that must not be found out at the end of a run."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise WriteError(
            f"{option} folder '{folder}' cannot be written ({error.strerror}): give --{option} another folder"
        ) from error


def _output_pattern(target: str, source: Pattern) -> Pattern:
    if not is_utf8(target):
        raise WriteError(f"{make_printable(target)}: is not UTF-8: choose another name")
    if PLANE in target:
        raise WriteError(f"{target}: {PLANE} is for input: leave it out, the planes of a frame go into one file")
    if not (target.endswith("/") or Path(target).is_dir() or not Path(target).suffix):
        return parse_pattern(target)
    name = Path(str(source)).name.replace(PLANE, "frame")
    return parse_pattern(f"{target.rstrip('/')}/{Path(name).stem}.exr")
