"""What `--cuts` says."""

from __future__ import annotations

from postfx.errors import CutError, SequenceError
from postfx.io.pattern import parse_frames


def known_cuts(text: str) -> tuple[int, ...] | None:
    """Frames at which shots begin, of what `--cuts` says: 'auto' gives None, 'none' none, else '1,48' or '1-100x10'.

    Raises CutError for anything else.
    """
    if text in ("auto", "none"):
        return None if text == "auto" else ()
    try:
        return tuple(parse_frames(text))
    except SequenceError:
        raise CutError(f"cuts '{text}': use auto, none, or the frames at which shots begin, e.g. 1,48,90") from None
