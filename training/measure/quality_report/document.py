"""The document: text written by hand, blocks between markers, and the form of tables, numbers and names."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from postfx.bench.methods import OTHERS, PRECISIONS

# Errors ---------------------------------------------------------------------------------------------------------------

class ReportError(Exception):
    """The document or a file of results is invalid; the message is one line that names it."""


class Missing(Exception):
    """Data of a block is missing; names the file."""


# Blocks ---------------------------------------------------------------------------------------------------------------

OPEN = re.compile(r"<!-- table: (.*?) -->\s*")
CLOSE = re.compile(r"<!-- end -->\s*")


@dataclass(frozen=True)
class Block:
    """A block between two markers: name and arguments, the first marker's line and the lines between."""

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
    """The whole text with new blocks put in, by the line of their markers."""
    return "".join(_text(part, made) if isinstance(part, Block) else part for part in parts)


def _text(block: Block, made: dict[int, str]) -> str:
    return f"<!-- table: {block.title} -->\n{made.get(block.line, block.text)}<!-- end -->\n"


# Words and numbers ----------------------------------------------------------------------------------------------------

FORMS = {"psnr": ".2f", "ssim": ".4f", "flip": ".4f", "relmse": ".4f", "flicker": ".2f"}
NAMES = {"psnr": "PSNR", "ssim": "SSIM", "flip": "FLIP", "relmse": "relMSE", "flicker": "flicker"}


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of GitHub's markdown."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "".join(f"|{''.join(f' {cell} |' if cell else ' |' for cell in line)}\n" for line in lines)


def number(value: float | None, form: str, unit: str = "") -> str:
    """A number, or a dash for None; never '-0.00'."""
    if value is None:
        return "-"
    sign = "+" if form.startswith("+") else ""
    zero = "z" if form.endswith("f") else ""
    return format(value, sign + zero + form.removeprefix("+")) + unit


def bold(text: str, wanted: bool) -> str:
    """Text, bold on request."""
    return f"**{text}**" if wanted else text


def place(sequence: str) -> str:
    """A folder's name for readers."""
    return sequence.replace("_", " ")


def method_title(name: str) -> str:
    """A method's name for readers: 'm-int8-guides-alone' is 'postfx m int8 with guides, no history'."""
    known = {method.name: method.title for method in OTHERS}
    if name in known:
        return known[name]
    tag, *words = name.split("-")
    text = " ".join(["postfx", tag, *(word for word in words if word in PRECISIONS)])
    said = {"guides": " with guides", "alone": ", no history", "run": ", run-up", "both": ", both ways"}
    return text + "".join(more for word, more in said.items() if word in words)


def is_network(row: dict[str, Any], name: str = "name") -> bool:
    """Whether a row tells of one of our networks as it is meant to run: full precision, history, all planes; of frames
    in order or with a run-up."""
    return row["family"] == "ours" and set(row[name].split("-")[1:]) <= {"guides", "run", "up"}
