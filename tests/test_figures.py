"""Every figure of README, documents and model cards has a source: what a script printed, with
commit and date.

A document says where its figures come from, from a comment to the next one, the next heading or the
end:

    <!-- measured: NAME, NAME -->   figures are in docs/measured/runs/NAME.txt, made by
                                    `python -m training.measure.record`
    <!-- given -->                  figures are settings, limits in the code, or what others have
                                    published
    <!-- from: lab/NAME.md -->      figures are those of that page below docs/, which says where
                                    they come from

A figure is a number with a unit, one with a negative exponent, and any number with a decimal point
in a table. Code blocks do not count: other tests run them.
"""

from __future__ import annotations

import hashlib
import json
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from postfx.cli.run import EXAMPLES
from training.measure.record import NUMBER, RUNS, Run, agrees, is_same, load, run

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
MARK = re.compile(r"<!-- (?:measured: ([\w, ]+)|(given)|from: ([\w/.]+)) -->")
UNITS = (
    r"dB|EV|ms|s|%|MiB|GiB|MB|GB|KB|KiB|seconds|minutes|min|hours|samples|times|x(?![\dx])|frames "
    r"a second"
)
FIGURE = re.compile(rf"({NUMBER.pattern}) ?(?:{UNITS})(?![\w-])")
SMALL = re.compile(r"(?<![\w.])[+-]?\d+(?:\.\d+)?e-\d+(?![\w.])")
CELL = re.compile(r"(?<![\w.])[+-]?\d+\.\d+(?:e[+-]?\d+)?(?![\w.])")


LOGGED_FACTS = ("steps", "minutes", "clips", "batch", "gpus", "validation_psnr",
                "validation_flicker")
"""Of a training, in the card of its network and in the log of runs."""
LOG_ROUNDING = 5e-3
"""The log rounds facts by at most this share."""


class Part(NamedTuple):
    """A part of a page with one source: `sources` are names of runs, None where nothing is said;
    `copied` is the page whose figures it repeats."""

    section: str
    sources: tuple[str, ...] | None
    is_given: bool
    text: str
    copied: str = ""

    def figures(self) -> list[str]:
        found = [match[1] for match in FIGURE.finditer(self.text)]
        rows = [line for line in self.text.splitlines() if line.startswith("|")]
        prose = "\n".join(line for line in self.text.splitlines() if not line.startswith("|"))
        return (found + SMALL.findall(prose)
                + [number for row in rows for number in CELL.findall(row)])


def parts_of(text: str) -> Iterator[Part]:
    """A page's parts, in order, without code and links' targets."""
    text = re.sub(r"(?ms)^```.*?^```$|^(?: {4}[^\n]*\n?)+|`[^`\n]*`", "", text)
    text = re.sub(r"\]\([^)]*\)", "]", text)
    for block in filter(None, re.split(r"(?m)^(?=#)", text)):
        title = block.partition("\n")[0].lstrip("# ") if block.startswith("#") else ""
        sources: tuple[str, ...] | None = None
        # headings claim nothing
        is_given, copied, start = (False, "", len(block.partition("\n")[0]) if title else 0)
        for mark in MARK.finditer(block):
            yield Part(title, sources, is_given, block[start:mark.start()], copied)
            sources, is_given = tuple(re.split(", *", mark[1])) if mark[1] else None, bool(mark[2])
            copied, start = mark[3] or "", mark.end()
        yield Part(title, sources, is_given, block[start:], copied)


def sections_without_source() -> dict[str, list[str]]:
    """Page -> sections that have figures and name no source."""
    found: dict[str, list[str]] = {}
    for page in PAGES:
        for part in parts_of(page.read_text(encoding="utf-8")):
            name = page.relative_to(ROOT).as_posix()
            if part.sources is None and not (part.is_given or part.copied) and part.figures() and \
                    part.section not in found.get(name, []):
                found.setdefault(name, []).append(part.section)
    return found


def test_a_part_s_figures_are_found() -> None:
    page = ("# One\n1.5 dB of `2 dB`\n<!-- measured: a, b -->\n| 3 | 4.25 |\n\n    5 dB\n\n6 % and "
            "7x8\n<!-- given -->\n8 EV\n## Two\n9x, 1.5 of it\n")
    found = [(*part[:3], part.figures(), part.copied)
             for part in parts_of(page + "<!-- from: lab/a.md -->\n7 %\n")]
    assert found == [("One", None, False, ["1.5"], ""),
                     ("One", ("a", "b"), False, ["6", "4.25"], ""),
                     ("One", None, True, ["8"], ""), ("Two", None, False, ["9"], ""),
                     ("Two", None, False, ["7"], "lab/a.md")]


def test_figures_are_rounded_numbers_of_a_run() -> None:
    made = Run({"tolerance": "0.1"}, "worth 124.26 samples, 1,234 of them, 3.0e-05, -0.8")
    assert all(made.has(figure)
               for figure in ("124.3", "124", "1234", "1,234", "3e-5", "0.8", "-0.8"))
    assert not any(made.has(figure) for figure in ("125", "124.2", "0.9", "26"))
    assert is_same("12.34", "12.3") and not is_same("12.36", "12.3")
    assert (agrees("10.0", "10.1", 0) and not agrees("10.0", "10.3", 0.02)
            and agrees("10.0", "11.0", 0.1))


def test_every_section_s_figures_have_a_source() -> None:
    assert not sections_without_source(), "say where these figures come from (see this module)"


@pytest.mark.parametrize("page", [page for page in PAGES
                                  if "<!-- measured:" in page.read_text(encoding="utf-8")],
                         ids=lambda page: page.stem)
def test_figures_are_those_of_their_sources(page: Path) -> None:
    for part in parts_of(page.read_text(encoding="utf-8")):
        if part.sources is not None:
            runs = [load(name) for name in part.sources]
            lost = [figure
                    for figure in part.figures() if not any(made.has(figure) for made in runs)]
            assert not lost, f"{page.name}, {part.section}: not in {', '.join(part.sources)}"


@pytest.mark.parametrize("page", [page for page in PAGES
                                  if "<!-- from:" in page.read_text(encoding="utf-8")],
                         ids=lambda page: page.stem)
def test_figures_that_are_repeated_are_those_of_their_page(page: Path) -> None:
    for part in parts_of(page.read_text(encoding="utf-8")):
        if part.copied:
            made = Run({}, (ROOT / "docs" / part.copied).read_text(encoding="utf-8"))
            lost = [figure for figure in part.figures() if not made.has(figure)]
            assert not lost, f"{page.name}, {part.section}: not in {part.copied}"


def test_the_figures_of_the_help_are_measured() -> None:
    runs = [load("kinds_2x"), load("kinds_1x"), load("kinds_xl")]
    figures = [figure for line in EXAMPLES.splitlines() if line.startswith("  postfx run")
               for figure in CELL.findall(line)]
    assert len(figures) == 11
    assert all(any(made.has(figure) for made in runs) for figure in figures)


def test_every_source_says_where_it_is_from_and_is_used() -> None:
    parts = (part for page in PAGES for part in parts_of(page.read_text(encoding="utf-8")))
    used = {name for part in parts for name in part.sources or ()}
    assert {path.stem for path in RUNS.glob("*.txt")} == used
    for name in used:
        facts = load(name).facts
        assert (re.fullmatch(r"[0-9a-f]{7,40}", facts["commit"])
                and re.fullmatch(r"\d{4}-\d\d-\d\d", facts["date"]))
        assert facts["command"].startswith("python ") and facts["machine"]


@pytest.mark.parametrize("name", [path.stem for path in sorted(RUNS.glob("*.txt"))
                                  if load(path.stem).is_repeatable])
def test_scripts_still_print_what_was_recorded(name: str) -> None:
    """Those that are short enough."""
    recorded = load(name)
    now = Run(recorded.facts, run(shlex.split(recorded.facts["command"])))
    assert len(now.numbers()) == len(recorded.numbers())
    off = [(one, other) for one, other in zip(recorded.numbers(), now.numbers(), strict=True)
           if not agrees(one, other, recorded.tolerance)]
    assert not off


def test_the_figures_of_model_cards_name_their_script() -> None:
    """Scripts that are there: of the training, and of every step of the recipe."""
    for path in sorted((ROOT / "models").glob("*.json")):
        card = json.loads(path.read_text(encoding="utf-8"))
        scripts = [card["training"]["script"]] if "script" in card.get("training", {}) else []
        steps = (step.get("run", "") for step in (card.get("recipe") or {}).get("steps", ()))
        modules = [step.split()[0] for step in steps if step.startswith("training.")]
        scripts += [f"{module.replace('.', '/')}.py" for module in modules]
        for script in scripts:
            there = ((ROOT / script).is_file()
                     or (ROOT / script.removesuffix(".py") / "__main__.py").is_file())
            assert there, f"{path.name}: {script}"
        assert scripts or not card.get("quality"), f"{path.name}: figures without a script"


def test_model_cards_are_of_their_files_and_of_a_run_in_the_log() -> None:
    """The hash of the network, of the one that it was made from, and what training measured."""
    log = [json.loads(line)
           for line in (ROOT / "training/runs.jsonl").read_text(encoding="utf-8").splitlines()]
    cards = {path.stem: json.loads(path.read_text(encoding="utf-8"))
             for path in sorted((ROOT / "models").glob("*.json"))}
    for name, card in cards.items():
        network = (ROOT / "models" / f"{name}.onnx").read_bytes()
        assert hashlib.sha256(network).hexdigest() == card["sha256"], name
        origin = card.get("made_from")
        assert origin is None or cards[origin["name"]]["sha256"] == origin["sha256"], name
        if name.startswith("denoise_upscale."):
            told = {fact: card["training"][fact] for fact in LOGGED_FACTS}
            assert any(all(run.get(fact) == pytest.approx(value, rel=LOG_ROUNDING)
                           for fact, value in told.items()) for run in log), f"{name}: {told}"
