"""The document: hand-written text and blocks between markers; the format of tables, numbers and
names; and its results: figures from files, and small copies of pictures."""

from __future__ import annotations

import io
import json
import os
import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import Image

from postfx.tools.bench.methods import OTHERS, PRECISIONS

# Errors -------------------------------------------------------------------------------------------

class ReportError(Exception):
    """The document or a file of results is invalid; the message is one line that names it."""


class Missing(Exception):
    """Data of a block is missing; names the file."""


# Blocks -------------------------------------------------------------------------------------------

OPEN = re.compile(r"<!-- table: (.*?) -->\s*")
CLOSE = re.compile(r"<!-- end -->\s*")


@dataclass(frozen=True)
class Block:
    """A block between two markers: name and arguments, the first marker's line and the lines
    between."""

    name: str
    arguments: tuple[str, ...]
    line: int
    text: str

    @property
    def title(self) -> str:
        """The text of the first marker."""
        return " ".join((self.name, *self.arguments))


def parse(text: str, path: Path, known: Collection[str]) -> list[str | Block]:
    """Lines and blocks in order. Raises ReportError for unknown names and for markers that do not
    pair."""
    parts: list[str | Block] = []
    start: tuple[int, list[str]] | None = None
    inside: list[str] = []
    for number, line in enumerate(text.splitlines(keepends=True), 1):
        opened, closed = OPEN.fullmatch(line), CLOSE.fullmatch(line)
        if (opened and start) or (closed and not start):
            what = f"block of line {start[0]} has no end" if start else "an end without a beginning"
            raise ReportError(f"{path}:{number}: {what}: markers come in pairs")
        if opened:
            words = opened[1].split()
            if not words or words[0] not in known:
                raise ReportError(f"{path}:{number}: there is no table '{opened[1]}': choose among "
                                  f"{', '.join(sorted(known))}")
            start, inside = (number, words), []
        elif closed and start:
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
    """The complete text with new blocks, by the line of their markers."""
    return "".join(_text(part, made) if isinstance(part, Block) else part for part in parts)


def _text(block: Block, made: dict[int, str]) -> str:
    return f"<!-- table: {block.title} -->\n{made.get(block.line, block.text)}<!-- end -->\n"


# Words and numbers --------------------------------------------------------------------------------

FORMS = {"psnr": ".2f", "ssim": ".4f", "flip": ".4f", "relmse": ".4f", "flicker": ".2f"}
NAMES = {"psnr": "PSNR", "ssim": "SSIM", "flip": "FLIP", "relmse": "relMSE", "flicker": "flicker"}


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of GitHub's markdown."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "".join(f"|{''.join(f' {cell} |' if cell else ' |' for cell in line)}\n"
                   for line in lines)


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
    """A method's name for readers: 'm-int8-guides-alone' is 'postfx m int8 with guides, no
    history'."""
    known = {method.name: method.title for method in OTHERS}
    if name in known:
        return known[name]
    tag, *words = name.split("-")
    text = " ".join(["postfx", tag, *(word for word in words if word in PRECISIONS)])
    said = {"guides": " with guides", "alone": ", no history", "run": ", run-up",
            "both": ", both ways"}
    return text + "".join(more for word, more in said.items() if word in words)


def is_network(row: dict[str, Any], name: str = "name") -> bool:
    """Whether a row is one of our networks in normal use: full precision, history, all planes;
    frames in order, or with a run-up."""
    return row["family"] == "ours" and set(row[name].split("-")[1:]) <= {"guides", "run", "up"}


# Results ------------------------------------------------------------------------------------------

# Figures ------------------------------------------------------------------------------------------

Facts = dict[str, Any]


class Results:
    """A folder of results and one of models; every method raises Missing if its file is not
    there."""

    def __init__(self, folder: Path, models: Path) -> None:
        self._folder, self._models = folder, models

    def bench(self, sequence: str) -> Facts:
        """Results of `postfx bench` for a sequence."""
        return self._load(f"{sequence}/bench.json")

    def ablations(self, sequence: str) -> list[Facts]:
        """Comparisons of networks without some planes, from the sequence's folder or the one beside
        it."""
        try:
            found = self.bench(sequence)["ablations"]
        except Missing:
            found = []
        return found or self.bench(f"{sequence}-ablations")["ablations"]

    def validation(self) -> Facts:
        """Results of `training.measure.validation compare`."""
        return self._load("validation/comparison.json")

    def equivalent(self, name: str) -> Facts:
        """Results of `training.measure.equivalent_samples`."""
        return self._load(f"{name}/equivalent_samples.json")

    def convergence(self, name: str) -> Facts:
        """Results of `training.measure.convergence`."""
        return self._load(f"{name}/convergence.json")

    def cards(self) -> list[Facts]:
        """Cards of the denoisers in full precision, by number of parameters."""
        cards = [_read(path) for path in sorted(self._models.glob("denoise_upscale.*.json"))]
        found = [card for card in cards if "precision" not in card]
        if not found:
            raise Missing(f"{self._models} holds no denoise_upscale.*.json")
        return sorted(found, key=lambda card: (card["parameters"], card["name"]))

    def picture(self, name: str) -> Path:
        """A picture's file."""
        path = self._folder / name
        if not path.is_file():
            raise Missing(f"there is no {path}")
        return path

    def _load(self, name: str) -> Facts:
        path = self._folder / name
        if not path.is_file():
            raise Missing(f"there is no {path}")
        return _read(path)


def _read(path: Path) -> Facts:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ReportError(f"{path}: is not JSON: {error}") from error


# Pictures -----------------------------------------------------------------------------------------

WIDTH, LIMIT = 1100, 2_500_000
"""Greatest width in pixels, and bytes of all pictures together."""
PHOTOGRAPHS = "crops"
"""Part of the names of pictures that are kept as JPEG; others are drawings: PNG of 256 colours."""


class Album:
    """Pictures of a document, collected before they are written."""

    def __init__(self, folder: Path, beside: Path) -> None:
        self._folder, self._beside = folder, beside
        self._made: dict[str, bytes] = {}

    def add(self, results: Results, file: str, *words: str) -> str:
        """Take RESULTS/file; returns the line that shows it. Raises Missing."""
        source = results.picture(file)
        kind = "jpg" if PHOTOGRAPHS in source.stem else "png"
        target = f"{'.'.join(Path(file).with_suffix('').parts)}.{kind}"
        self._made[target] = shrink_picture(source, kind)
        address = Path(os.path.relpath(self._folder / target, self._beside)).as_posix()
        return f"![{' '.join(words)}]({address})\n"

    def check_size(self) -> None:
        """Raises ReportError when all pictures together are too large."""
        total = sum(map(len, self._made.values()))
        if total > LIMIT:
            raise ReportError(f"pictures take {total / 1e6:.1f} MB, more than {LIMIT / 1e6:g}: "
                              "show fewer of them")

    def stale(self) -> list[str]:
        """Pictures whose file differs or is not there."""
        paths = {self._folder / name: made for name, made in self._made.items()}
        return [str(path)
                for path, made in paths.items() if not path.is_file() or path.read_bytes() != made]

    def write(self) -> None:
        """Write all pictures; others in the folder stay."""
        if self._made:
            self._folder.mkdir(parents=True, exist_ok=True)
        for name, made in self._made.items():
            (self._folder / name).write_bytes(made)


def shrink_picture(path: Path, kind: str) -> bytes:
    """A picture at most WIDTH wide, as the bytes of a JPEG ('jpg') or of a PNG with a palette."""
    with Image.open(path) as opened:
        picture = opened.convert("RGB")
    if picture.width > WIDTH:
        picture = picture.resize((WIDTH, round(picture.height * WIDTH / picture.width)),
                                 Image.Resampling.LANCZOS)
    buffer = io.BytesIO()
    if kind == "jpg":
        picture.save(buffer, "JPEG", quality=84, optimize=True)
    else:
        few = picture.quantize(256, method=Image.Quantize.MAXCOVERAGE, kmeans=3,
                               dither=Image.Dither.NONE)
        few.save(buffer, "PNG", optimize=True)
    return buffer.getvalue()
