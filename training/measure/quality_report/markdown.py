"""Tables, numbers and names as the document shows them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from postfx.bench.methods import OTHERS, PRECISIONS

FORMS = {"psnr": ".2f", "ssim": ".4f", "flip": ".4f", "relmse": ".4f", "flicker": ".2f"}
NAMES = {"psnr": "PSNR", "ssim": "SSIM", "flip": "FLIP", "relmse": "relMSE", "flicker": "flicker"}


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of GitHub's markdown."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "".join(f"|{''.join(f' {cell} |' if cell else ' |' for cell in line)}\n" for line in lines)


def number(value: float | None, form: str, unit: str = "") -> str:
    """A number, or a dash where it is not known; never '-0.00'."""
    if value is None:
        return "-"
    sign = "+" if form.startswith("+") else ""
    zero = "z" if form.endswith("f") else ""
    return format(value, sign + zero + form.removeprefix("+")) + unit


def bold(text: str, wanted: bool) -> str:
    """Text, bold where wanted."""
    return f"**{text}**" if wanted else text


def place(sequence: str) -> str:
    """A folder's name for readers."""
    return sequence.replace("_", " ")


def titled(name: str) -> str:
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
