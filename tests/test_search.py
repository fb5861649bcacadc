"""What people type into the site's search leads to the page that answers, among the first three.

The search is the site's own: its worker and its index, run by Node. Needs mkdocs with its theme,
which the extra docs has, and node.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
SHOWN = 3
QUESTIONS = {
    "ghosting": "howto/troubleshooting",
    "blurry": "howto/troubleshooting",
    "flicker": "howto/troubleshooting",
    "too dark": "howto/troubleshooting",
    "violet leaves": "howto/troubleshooting",
    "blotches": "howto/troubleshooting",
    "too slow": "howto/troubleshooting",
    "out of memory": "howto/troubleshooting",
    "wrong colours": "howto/troubleshooting",
    "fireflies": "howto/troubleshooting",
    "hair": "howto/troubleshooting",
    "license": "howto/faq",
    "commercial": "howto/faq",
    "when should I use OIDN instead": "howto/faq",
    "compare OIDN": "measured/quality",
    "how many samples": "howto/faq",
    "seed": "howto/faq",
    "mac": "reference/platforms",
    "windows": "reference/platforms",
    "video": "howto/video",
    "ffmpeg": "howto/video",
    "blender": "start/blender",
    "light groups": "howto/parts",
    "motion vectors": "howto/troubleshooting",
    "resume": "reference/runs",
    "exit codes": "reference/runs",
    "nuke": "howto/hosts",
    "cryptomatte": "howto/masks",
    "glossary": "reference/glossary",
    "farm": "howto/farm",
    "install": "start/index",
}
"""What is typed -> the page that answers it."""


@pytest.fixture(scope="module")
def hits(tmp_path_factory) -> dict[str, list[str]]:
    """Query -> pages in the order of the search."""
    pytest.importorskip("mkdocs")
    pytest.importorskip("material")
    if shutil.which("node") is None:
        pytest.skip("there is no node")
    site = tmp_path_factory.mktemp("site")
    subprocess.run([sys.executable, "-m", "mkdocs", "build", "--quiet", "-d", str(site)], cwd=ROOT,
                   check=True, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"})
    (worker,) = (site / "assets/javascripts/workers").glob("search.*.min.js")
    done = subprocess.run(["node", str(Path(__file__).with_name("site_search.mjs")), str(worker),
                           str(site / "search/search_index.json")],
                          input=json.dumps([*QUESTIONS]), text=True,
                          capture_output=True, check=True)
    return json.loads(done.stdout)


@pytest.mark.parametrize(("typed", "page"), QUESTIONS.items())
def test_a_question_finds_its_page(hits, typed, page):
    assert f"{page}.html" in hits[typed][:SHOWN]


def test_the_laboratory_comes_last(hits):
    """Pages for people come first, wherever any of them has the words."""
    for typed, pages in hits.items():
        in_lab = [page.startswith("lab/") for page in pages]
        assert in_lab == sorted(in_lab), typed
    assert any(page.startswith("lab/") for pages in hits.values() for page in pages)


def test_there_are_enough_questions():
    assert len(QUESTIONS) >= 25 and len({*QUESTIONS.values()}) >= 10
