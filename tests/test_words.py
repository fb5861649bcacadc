"""What people read: sentences of README, pages and help texts are short, and there is not too much
of it."""

from __future__ import annotations

import argparse
import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from postfx.cli.main import make_parser

ROOT = Path(__file__).resolve().parent.parent
MOST = 35
"""Words of a sentence."""
MOST_AT_FIRST = 30
"""Words of a sentence on the README and on the pages for beginners, which are in `FIRST`."""
FIRST = ("README.md", "docs/index.md", "docs/start/", "docs/howto/")
MOST_OF_ALL = 45_000
"""Words of all that people read: without the laboratory, and without pages that are made from the
code."""
PAGES = ("README.md", "CONTRIBUTING.md", "SECURITY.md", "CHANGELOG.md",
         *(path.relative_to(ROOT).as_posix() for path in sorted((ROOT / "docs").rglob("*.md"))))
OF_ARTISTS = ("howto/index.md", "howto/tasks.md", "howto/troubleshooting.md", "howto/faq.md",
              "howto/video.md", "howto/oidn.md", "howto/hosts.md", "howto/doctor.md",
              "howto/masks.md", "howto/parts.md",
              "howto/report.md", "howto/render_more.md", "howto/interpolation.md", "gallery.md")
"""Pages that artists read beside those of `FIRST`, in which an AOV is an AOV."""
_END = re.compile(r"(?<=[.!?])[)\"'*]*\s+(?=[A-Z0-9'`*(\[{]|--)|(?<=:\*\*)\s+")
"""Where a sentence ends: after its full stop, or after the bold label of a list item."""
_ABBREVIATIONS = re.compile(r"\b(e\.g|i\.e|etc|vs|cf)\.")


def paragraphs(text: str) -> Iterator[str]:
    """Running text of Markdown, or of a description: without code, tables, headings and pictures;
    list items apart."""
    text = re.sub(r"```.*?```", "\n", text, flags=re.DOTALL)
    lines: list[str] = []
    for line in [*text.splitlines(), ""]:
        is_item = re.match(r"\s{0,3}([-*]|\d+\.) ", line)
        if not line.strip() or is_item or line.startswith(("#", "|", "!", "    ", "  postfx")):
            if lines:
                yield " ".join(lines)
            lines = []
        if is_item or (line.strip() and not line.startswith(("#", "|", "!", "    ", "  postfx"))):
            lines.append(re.sub(r"^\s{0,3}([-*]|\d+\.) ", "", line).strip())


def sentences(paragraph: str) -> Iterator[str]:
    """Sentences of a paragraph; what stands in backticks is one word, and so is a link's
    address."""
    plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", paragraph)
    plain = re.sub(r"`[^`]*`", "CODE", plain)
    yield from _END.split(_ABBREVIATIONS.sub(r"\1", plain))


def too_long(text: str, most: int = MOST) -> list[str]:
    """Sentences of more than so many words, with their count."""
    found = [(len(re.findall(r"[\w'/.*%+-]*\w[\w'/.*%+-]*", sentence)), sentence)
             for paragraph in paragraphs(text) for sentence in sentences(paragraph)]
    return [f"{count} words: {sentence}" for count, sentence in found if count > most]


def help_texts() -> dict[str, str]:
    """Verb, and verb with option -> what its help says."""
    parser = make_parser()
    (verbs,) = (action.choices
                for action in parser._actions if isinstance(action, argparse._SubParsersAction))
    texts = {}
    for name, verb in verbs.items():
        texts[name] = "\n\n".join(filter(None, (verb.description, verb.more[0], verb.epilog,
                                                verb.more[1])))
        texts |= {f"{name} {action.dest}": action.help or "" for action in verb._actions}
    return texts


@pytest.mark.parametrize("page", PAGES)
def test_pages_have_short_sentences(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    assert [*paragraphs(text)]
    assert too_long(text, MOST_AT_FIRST if page.startswith(FIRST) else MOST) == []


@pytest.mark.parametrize("page", [page for page in PAGES
                                  if page.startswith(("README", "docs/index", "docs/start/"))
                                  or page.endswith(OF_ARTISTS)])
def test_pages_of_artists_have_the_field_s_words(page):
    text = re.sub(r"\]\([^)]*\)", "]",
                  "\n".join(paragraphs((ROOT / page).read_text(encoding="utf-8"))))
    assert re.findall(r"(?i)\b(planes?|doubts?|both ways)\b", re.sub("`[^`]*`", "", text)) == []


@pytest.mark.parametrize("module", sorted(
    path.relative_to(ROOT).as_posix() for folder in ("doctor", "masks", "cli")
    for path in (ROOT / "postfx" / folder).glob("*.py")))
def test_what_a_run_says_has_the_field_s_words(module):
    """Findings, warnings, summaries and refusals; not what comes in code, such as '{plane}' of a
    file's name."""
    tree = ast.parse((ROOT / module).read_text(encoding="utf-8"))
    unsaid = {id(value) for node in ast.walk(tree) if isinstance(node, ast.Expr)
              for value in ast.walk(node)
              if value is node.value and isinstance(value, ast.Constant)}
    said = [node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and id(node)
            not in unsaid and isinstance(node.value, str) and " " in node.value.strip()]
    texts = [re.sub(r"(far|near) plane|\{plane\}|--planes|'plane'", "", text) for text in said]
    assert [text for text in texts if re.search(r"(?i)\b(planes?|doubts?|both ways)\b", text)] == []


def test_there_is_not_too_much_to_read():
    pages = [ROOT / page for page in PAGES if not page.startswith("docs/lab/")]
    assert sum(len(page.read_text(encoding="utf-8").split()) for page in pages) <= MOST_OF_ALL


def test_the_readme_is_short_and_begins_with_a_picture():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    prose = [line for line in re.sub("```.*?```", "", text, flags=re.DOTALL).splitlines()
             if line[:4] != "    "]
    words = re.sub(r"\]\([^)]*\)", "]", "\n".join(prose)).split()
    assert 400 < len(words) <= 600
    assert text.split("\n\n")[1].startswith("![")


def test_help_texts_have_short_sentences():
    texts = help_texts()
    assert len(texts) > 100
    assert {name: found for name, text in texts.items() if (found := too_long(text))} == {}


def test_long_sentences_are_found():
    long = " ".join(["word"] * 36)
    assert too_long(f"Short.\n\n- {long}.\n") == [f"36 words: {long}."]
    assert too_long(f"# {long}\n\n| {long} |\n\n    {long}\n\n```\n{long}\n```\n") == []
    assert too_long(" ".join(["word"] * 35) + ". And more.") == []
    assert len(too_long(f"One (e.g. {long}) and `code of {long}` here.")) == 1
