"""What publishes postfx: workflows, the container and conda-forge's recipe name what is there."""

from __future__ import annotations

import hashlib
import json
import re
import runpy
import shutil
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import pytest

from postfx.version import PUBLISHER, __version__

ROOT = Path(__file__).resolve().parents[1]
WORKFLOWS = sorted((ROOT / ".github/workflows").glob("*.yml"))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
SYSTEMS = {"ubuntu": "Linux", "windows": "Windows", "macos": "macOS"}


def read_yaml(text: str) -> dict[Any, Any]:
    return pytest.importorskip("yaml").safe_load(text)


def jobs(name: str) -> dict[str, Any]:
    return read_yaml((ROOT / ".github/workflows" / name).read_text("utf-8"))["jobs"]


def lines_of(job: dict[str, Any]) -> str:
    return "\n".join(step.get("run", "") for step in job["steps"])


def needed(extra: str) -> set[str]:
    """Packages that an extra installs, with those of extras that it names."""
    found = set()
    for one in PROJECT["optional-dependencies"][extra]:
        inner = re.fullmatch(r"postfx-render\[(.+)\]", one)
        found |= (set().union(*map(needed, inner[1].split(","))) if inner
                  else {re.split(r"[\[<>=;]", one)[0]})
    return found


def test_workflows_pass_actionlint() -> None:
    actionlint = shutil.which("actionlint")
    if actionlint is None:
        pytest.skip("needs actionlint")
    done = subprocess.run([actionlint, "-no-color", *WORKFLOWS], capture_output=True, text=True)
    assert done.stdout + done.stderr == ""


def test_tests_run_on_every_system_that_has_wheels() -> None:
    rows = jobs("tests.yml")["systems"]["strategy"]["matrix"]["include"]
    tried = {row["system"] for row in rows}
    assert {SYSTEMS[system.split("-")[0]] for system in tried} == set(SYSTEMS.values())
    assert {"ubuntu-24.04-arm", "macos-15", "macos-15-intel"} <= tried
    assert tried == {row["system"]
                     for row in jobs("release.yml")["install"]["strategy"]["matrix"]["include"]}


def test_trials_are_the_systems_that_are_not_supported_yet() -> None:
    """A system that the page of platforms calls good must not fail in silence."""
    page = (ROOT / "docs/reference/platforms.md").read_text("utf-8")
    unsupported = set(re.findall(r"^\| (\w+)[^|]*\| not supported yet", page, re.M))
    for name, job in (("tests.yml", "systems"), ("release.yml", "install")):
        for row in jobs(name)[job]["strategy"]["matrix"]["include"]:
            is_tried = (row["system"].endswith("-arm")
                        or SYSTEMS[row["system"].split("-")[0]] in unsupported)
            assert row.get("trial", False) == is_tried, f"{name}: {row}"


def test_sessions_and_pythons_are_those_of_nox() -> None:
    nox = (ROOT / "noxfile.py").read_text("utf-8")
    pythons = re.findall(r'"(3\.\d+)"', nox.split("PYTHONS = ")[1].splitlines()[0])
    rows = jobs("tests.yml")["systems"]["strategy"]["matrix"]["include"]
    for row in rows:
        assert row["session"] in ("lowest", f"tests-{row['python']}"), row
    assert {row["python"] for row in rows} == set(pythons)
    release = lines_of(jobs("release.yml")["build"])
    assert all(f"python{python}" in release for python in pythons)


def test_a_release_is_built_by_make_and_needs_no_pytorch() -> None:
    assert "make release " in lines_of(jobs("release.yml")["build"])
    rule = (ROOT / "Makefile").read_text("utf-8").split("\nrelease:")[1].split("\n\n")[0]
    assert rule.splitlines()[0].strip() == "$(VENV)/installed-release"
    assert needed("release") == {"hatchling", "ziglang"}
    modules = re.findall(r"-m ([\w.]+)", rule)
    assert modules and set(modules) == {"hatchling"}


def test_only_a_release_that_was_installed_is_published() -> None:
    there = jobs("release.yml")
    assert there["publish"]["needs"] == "install" and there["install"]["needs"] == "build"
    assert there["publish"]["permissions"] == {"id-token": "write"}
    uploaded = {step["with"]["name"]: step["with"]["path"] for job in there.values()
                for step in job["steps"] if "upload-artifact" in step.get("uses", "")}
    assert uploaded == {"dist": "dist/postfx_render-*", "conda-recipe": "build/recipe.yaml"}


def test_the_tag_is_compared_with_the_version() -> None:
    steps = {step.get("name"): step for step in jobs("release.yml")["build"]["steps"]}
    line = steps["the tag is the version"]["run"].replace("python3.11", "python3")
    for tag, code in ((f"v{__version__}", 0), (f"v{__version__}1", 1), (__version__, 1)):
        run = subprocess.run(["sh", "-c", line], cwd=ROOT,
                             env={"PATH": "/usr/bin:/bin", "GITHUB_REF_NAME": tag})
        assert run.returncode == code, tag


def test_who_publishes_is_named_in_one_place() -> None:
    """What holds the name itself, as it cannot read it, is compared."""
    nodes = tomllib.loads((ROOT / "hosts/comfyui_postfx/pyproject.toml").read_text("utf-8"))
    assert nodes["tool"]["comfy"]["PublisherId"] == PUBLISHER
    made = runpy.run_path(str(ROOT / "packaging/conda_recipe.py"))
    assert read_yaml(made["recipe"](b"sdist"))["extra"]["recipe-maintainers"] == [PUBLISHER]


def test_the_recipe_of_conda_forge_has_what_the_package_needs() -> None:
    made = runpy.run_path(str(ROOT / "packaging/conda_recipe.py"))
    recipe = read_yaml(made["recipe"](b"sdist"))
    assert recipe["context"]["version"] == __version__
    assert recipe["source"]["sha256"] == hashlib.sha256(b"sdist").hexdigest()
    run = recipe["requirements"]["run"]
    assert run[0] == "python" and len(run) == 1 + len(PROJECT["dependencies"])
    oldest = PROJECT["requires-python"].removeprefix(">=")
    assert recipe["build"]["skip"] == [f'match(python, "<{oldest}")']
    assert recipe["about"]["homepage"] and recipe["about"]["license"] == PROJECT["license"]
    assert {"numpy >=2.0", "py-openimageio >=3.1", "python-isal >=1.7"} <= set(run)
    assert set(run[1:]) <= set(recipe["requirements"]["host"])
    assert recipe["build"]["python"]["entry_points"] == ["postfx = postfx.cli.main:main"]
    with pytest.raises(ValueError, match=r"'a; b' has no form for conda"):
        made["conda_name"]("a; b")


def test_the_notice_names_networks_that_began_with_weights_of_others():
    """Those that give the picture have the layers of Open Image Denoise, and began with its
    weights."""
    notice = " ".join((ROOT / "NOTICE").read_text("utf-8").split())
    (said,) = [text for text in re.split(r"(?<=added\.) ", notice) if "rt_hdr_alb_nrm" in text]
    names = [card.stem for card in sorted((ROOT / "models").glob("*.json"))
             if "picture" in json.loads(card.read_text("utf-8")).get("outputs", {})]
    assert names == re.findall(r"models/([\w.]+)\.onnx", said) and len(names) > 1


def test_the_container_has_what_a_wheel_is_built_of() -> None:
    """What is ignored is not what a build reads."""
    ignored = (ROOT / ".dockerignore").read_text("utf-8").split()
    assert {".git", ".venv", "dist"} <= set(ignored)
    for name in ("pyproject.toml", "hatch_build.py", "README.md", "models", "postfx", "LICENSE",
                 "NOTICE"):
        assert (ROOT / name).exists() and name not in ignored
    said = (ROOT / "Containerfile").read_text("utf-8")
    wheel = PROJECT["name"].replace("-", "_")
    assert f"/{wheel}-*.whl" in said
    assert f'ENTRYPOINT ["{next(iter(PROJECT["scripts"]))}"]' in said
