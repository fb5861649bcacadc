"""What `--keep` does, in words."""

from __future__ import annotations

import argparse
from pathlib import Path

from postfx.frame import Role
from postfx.io.sequence import Sequence
from postfx.io.writer import is_display_format


def keeps(arguments: argparse.Namespace, sequence: Sequence) -> list[str]:
    """A line on what the first frame's file holds beside the picture, which goes into the output; none for nothing."""
    picture = arguments.output and Path(arguments.output).suffix and is_display_format(arguments.output)
    if arguments.keep == "none" or picture:
        return []
    with sequence.open(sequence.numbers[0]) as files:
        planes = [files.layout.planes[role] for role in (Role.COLOUR, Role.ALPHA) if role in files.layout.planes]
        touched = {(channel.part.index, channel.name) for match in planes for channel in match.channels}
        file = files.match(Role.COLOUR).channels[0].file
        others = [(part.index, name) for part in file.parts for name in part.channels]
    count = len([one for one in others if one not in touched])
    return [f"keeps   {count} other channels bit for bit (--keep none leaves them out)"] if count else []
