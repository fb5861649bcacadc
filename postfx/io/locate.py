"""What a user's words for a sequence mean: a pattern, a folder or one file."""

from __future__ import annotations

import os
from pathlib import Path

from postfx.errors import SequenceError
from postfx.io.image_file import READABLE
from postfx.io.layout import COLOUR_FILES, is_plane_word
from postfx.io.pattern import PLANE, Pattern, number_in_name, parse_pattern, pattern_of, patterns_in


def locate(source: str) -> tuple[Pattern, list[int] | None]:
    """Pattern of a source, and the frame numbers where the source itself names one file.

    Raises SequenceError for a folder without OpenEXR files or with several sequences.
    """
    path = Path(source)
    if os.path.isdir(source):
        return _folder_pattern(path), None
    pattern = parse_pattern(source)
    if pattern.numbered or pattern.has_planes:
        return pattern, None
    number = number_in_name(path)
    return pattern_of(path), None if number is None else [number]


def _folder_pattern(folder: Path) -> Pattern:
    patterns = patterns_in(folder, READABLE)
    if len(patterns) == 1:
        return patterns[0]
    if not patterns:
        raise SequenceError(f"{folder}: holds no OpenEXR file")
    together = _one_file_a_plane(patterns)
    if together is None:
        names = ", ".join(Path(str(pattern)).name for pattern in patterns[:4])
        raise SequenceError(f"{folder}: holds {len(patterns)} sequences ({names}): name one of them")
    return together


def _one_file_a_plane(patterns: list[Pattern]) -> Pattern | None:
    """Pattern with {plane} that fits all sequences of a folder, one of them the colour; None when there is none."""
    for pattern in patterns:
        folder, _, name = pattern.prefix.rpartition("/")
        for word in COLOUR_FILES:
            prefix = f"{folder}/{name.replace(word, PLANE)}"
            together = Pattern(prefix, pattern.suffix, pattern.digits)
            if word in name and all(is_plane_word(together.plane_of(other) or "") for other in patterns):
                return together
    return None
