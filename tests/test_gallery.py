"""The gallery's sliders: six scenes by renderer, whose pictures are there, of one size a scene."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from PIL import Image

from training.measure.pictures import pictures

DOCS = Path(__file__).parent.parent / "docs"
PAGE = (DOCS / "gallery.md").read_text("utf-8")
BOXES = re.findall(r'<div class="compare" data-names="([^"]+)" data-sources="([^"]+)">', PAGE)


def test_there_are_six_scenes_by_renderer():
    assert len(BOXES) == 6
    assert re.findall(r"(?m)^### (\w+)$", PAGE)[:2] == ["Blender", "Mitsuba"]


@pytest.mark.parametrize(("names", "sources"), BOXES)
def test_pictures_lie_on_each_other(names, sources):
    left, right = (side.split(",") for side in sources.split("|"))
    assert (names.split(",") == ["As rendered", "Open Image Denoise"] and len(left) == 2
            and len(right) == 1)
    sizes = {Image.open(DOCS / path).size for path in (*left, *right)}
    assert len(sizes) == 1
    assert len({(DOCS / path).read_bytes() for path in (*left, *right)}) == 3


def test_one_program_makes_all_pictures_of_the_default_network():
    made = {shown for _, shown in pictures()}
    assert all((DOCS / "images" / shown).is_file() for shown in made)
    assert {path.relative_to(DOCS / "images").as_posix()
            for path in (DOCS / "images/gallery").iterdir()} < made


def test_the_site_loads_the_slider():
    text = (DOCS.parent / "mkdocs.yml").read_text("utf-8")
    assert "extra_css: [compare.css]" in text and "extra_javascript: [compare.js]" in text


def test_the_slider_is_javascript_that_parses():
    node = shutil.which("node") or pytest.skip("needs node")
    subprocess.run([node, "--check", str(DOCS / "compare.js")], check=True)
