"""Recipes and workflows name what the project has: versions, dependencies, commands and paths."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

import postfx

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
CONDA = {"isal": "python-isal", "OpenImageIO": "py-openimageio"}
"""Packages that conda-forge names otherwise."""


def test_the_conda_recipe_has_the_version_and_every_dependency():
    recipe = (ROOT / "packaging/conda/meta.yaml").read_text("utf-8")
    assert f'{{% set version = "{postfx.__version__}" %}}' in recipe
    run = recipe[recipe.index("  run:"):recipe.index("test:")]
    wanted = {f"python {PROJECT['requires-python']}"}
    for needed in PROJECT["dependencies"]:
        name, bound = re.fullmatch(r"([\w.-]+)(>=.+)", needed).groups()
        wanted.add(f"{CONDA.get(name, name)} {bound}")
    assert set(re.findall(r"^    - (.+)$", run, re.MULTILINE)) == wanted


def test_comfyui_s_registry_file_is_of_this_version():
    facts = tomllib.loads((ROOT / "hosts/comfyui_postfx/pyproject.toml").read_text("utf-8"))
    assert facts["project"]["version"] == postfx.__version__
    assert facts["project"]["dependencies"] == [f"{PROJECT['name']}>={postfx.__version__.rpartition('.')[0]}"]
    assert set(facts["tool"]["comfy"]) >= {"PublisherId", "DisplayName"}


def test_the_container_installs_extras_that_there_are():
    text = (ROOT / "Containerfile").read_text("utf-8")
    (extras,) = re.findall(r"^ARG EXTRAS=(\S+)$", text, re.MULTILINE)
    shown = re.search(r"--build-arg EXTRAS=(\S+)", text)[1]
    assert {*extras.split(","), *shown.split(",")} <= set(PROJECT["optional-dependencies"])
    assert 'ENTRYPOINT ["postfx"]' in text and "postfx" in PROJECT["scripts"]


@pytest.mark.parametrize("name", ["test.yml", "release.yml"])
def test_workflows_run_what_there_is(name):
    text = (ROOT / ".github/workflows" / name).read_text("utf-8")
    targets = re.findall(r"\bmake (\w+)", text)
    assert targets and all(re.search(rf"^{target}:", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE)
                           for target in targets)
    paths = re.findall(r"\b(?:tests|samples)/[\w/]+(?=\s|$)", text)
    assert paths and all((ROOT / path).exists() for path in paths)
    assert {"runs-on", "timeout-minutes"} <= set(re.findall(r"^    ([\w-]+):", text, re.MULTILINE))
    assert text.count("runs-on") == text.count("timeout-minutes")  # nothing hangs for six hours


def test_workflows_try_every_system():
    for name in ("test.yml", "release.yml"):
        text = (ROOT / ".github/workflows" / name).read_text("utf-8")
        assert all(system in text for system in ("ubuntu-24.04-arm", "windows-", "macos-14", "macos-15-intel"))
