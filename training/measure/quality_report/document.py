"""The document: text written by hand and blocks between markers."""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from training.measure.quality_report.errors import ReportError

OPEN = re.compile(r"<!-- table: (.*?) -->\s*")
CLOSE = re.compile(r"<!-- end -->\s*")


@dataclass(frozen=True)
class Block:
    """What stands between two markers: its name and arguments, the first marker's line and the lines between them."""

    name: str
    arguments: tuple[str, ...]
    line: int
    text: str

    @property
    def title(self) -> str:
        """As the marker has it."""
        return " ".join((self.name, *self.arguments))


def parse(text: str, path: Path, known: Collection[str]) -> list[str | Block]:
    """Lines and blocks in order. Raises ReportError for unknown names and for markers that do not pair."""
    parts: list[str | Block] = []
    start: tuple[int, list[str]] | None = None
    inside: list[str] = []
    for number, line in enumerate(text.splitlines(keepends=True), 1):
        opened, closed = OPEN.fullmatch(line), CLOSE.fullmatch(line)
        if opened and start or closed and not start:
            what = f"block of line {start[0]} has no end" if start else "an end without a beginning"
            raise ReportError(f"{path}:{number}: {what}: markers come in pairs")
        if opened:
            words = opened[1].split()
            if not words or words[0] not in known:
                raise ReportError(f"{path}:{number}: there is no table '{opened[1]}': choose among "
                                  f"{', '.join(sorted(known))}")
            start, inside = (number, words), []
        elif closed:
            parts.append(Block(start[1][0], tuple(start[1][1:]), start[0], "".join(inside)))
            start = None
        elif start:
            inside.append(line)
        else:
            parts.append(line)
    if start:
        raise ReportError(f"{path}:{start[0]}: block has no end: write <!-- end --> after it")
    return parts


def compose(parts: list[str | Block], made: dict[int, str]) -> str:
    """The whole text, blocks replaced that were made, by the lines of their markers."""
    return "".join(_text(part, made) if isinstance(part, Block) else part for part in parts)


def _text(block: Block, made: dict[int, str]) -> str:
    return f"<!-- table: {block.title} -->\n{made.get(block.line, block.text)}<!-- end -->\n"
