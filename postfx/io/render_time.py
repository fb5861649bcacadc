"""How long a frame took to render, as renderers write it into headers: '01:02.50', '1:02:03.45',
'0h 1m 2.5s'."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

SUMMED = re.compile(r"cycles\..+\.(render|total)_time|RenderTime|vrayInfo/rendertime")
"""Attributes with a time that two renders of a frame take together."""
AVERAGED = re.compile(r"cycles\..+\.synchronization_time")
"""Those that Cycles' own merging takes the mean of."""


def render_seconds(attributes: Mapping[str, Any]) -> float | None:
    """Seconds that a frame took, by its header; None where that does not say it."""
    times = [parse_time(str(value)) for name, value in attributes.items() if SUMMED.fullmatch(name)]
    return max(times, default=0.0) or None


def parse_time(text: str) -> float:
    """Seconds of a time; 0 for anything else."""
    try:
        seconds = 0.0
        for word in re.split(r":|[hm]\s*", text.strip().rstrip("s")):
            seconds = 60 * seconds + float(word)
        return seconds
    except ValueError:
        return 0.0


def format_time(seconds: float, model: str) -> str:
    """Seconds in the way that another time is written."""
    minutes, rest = divmod(seconds, 60)
    hours, minutes = divmod(int(minutes), 60)
    if "h" in model:
        return f"{hours}h {minutes:2d}m {rest:4.1f}s"
    return (f"{hours:02d}:" if hours else "") + f"{minutes:02d}:{rest:05.2f}"
