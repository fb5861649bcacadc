"""The distribution is postfx-render: the name postfx on the package index is another project's."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import postfx
from postfx import version
from postfx.cli import find_namesake
from postfx.version import DISTRIBUTION, pip_install

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = Path(postfx.__file__).parent
TEXTS = ([path for folder in ("docs", "hosts", "postfx", "samples", "training")
          for path in (ROOT / folder).rglob("*") if path.suffix in (".md", ".py", ".toml", ".txt")]
         + [*ROOT.glob("*.md"), ROOT / "Makefile"])


def test_the_project_says_the_name_that_messages_say():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["name"] == DISTRIBUTION
    assert {"cuda", "capture", "ray", "bench"} <= set(project["optional-dependencies"])


def test_people_are_told_what_works_now(monkeypatch):
    """A checkout or a wheel, until the package index has the package: one constant says so."""
    monkeypatch.setattr(version, "IS_PUBLISHED", True)
    assert (pip_install("cuda") == "pip install 'postfx-render[cuda]'" and pip_install() == "pip "
            "install 'postfx-render'")
    monkeypatch.undo()
    assert (version.IS_PUBLISHED
            or pip_install("cuda").startswith("pip install '.[cuda]' in a checkout of postfx"))
    lines = [f"{path}: {line}" for path in TEXTS for line in path.read_text(encoding="utf-8")
             .splitlines() if re.search(rf"pip install( -\S+)* ['\"]?{DISTRIBUTION}", line)]
    assert version.IS_PUBLISHED or lines == []


def test_no_text_has_people_install_the_other_package():
    """Neither the other package, nor an extra that this one does not have."""
    extras = tomllib.loads((ROOT / "pyproject.toml")
                           .read_text())["project"]["optional-dependencies"]
    assert len(TEXTS) > 200
    for path in TEXTS:
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"(pip install|pipx|uvx|uv add)( -\S+)* ['\"]?postfx(?![-\w./])",
                             text), path
        assert not re.search(r"(?<![-\w])postfx\[[a-z]", text), path
        used = (set(re.findall(r"postfx-render\[(\w+)", text))
                | set(re.findall(r"pip_install\(['\"](\w+)", text)))
        assert used <= set(extras), path


@pytest.fixture
def site(tmp_path) -> Path:
    """Our files in a folder of packages of their own."""
    (tmp_path / "postfx").mkdir()
    for entry in PACKAGE.iterdir():
        if entry.name != "cli" and entry.suffix != ".pyc":
            (tmp_path / "postfx" / entry.name).symlink_to(entry)
    (tmp_path / "postfx" / "cli").mkdir()
    for entry in (PACKAGE / "cli").glob("*.py"):
        (tmp_path / "postfx" / "cli" / entry.name).write_text(entry.read_text())
    return tmp_path


def add_namesake(site: Path, is_last: bool) -> None:
    """What installing postfx 1.1.0 leaves: files that only it has, and its __init__ where it came
    last."""
    (site / "postfx-1.1.0.dist-info").mkdir()
    record = ("postfx/__init__.py,sha256=a,1823\npostfx/cli.py,sha256=b,5861\n"
              "postfx/imgio.py,sha256=c,3811\n")
    (site / "postfx-1.1.0.dist-info" / "RECORD").write_text(record)
    (site / "postfx" / "cli.py").write_text("def main(): print('the other one')\n")
    if is_last:
        (site / "postfx" / "__init__.py").unlink()
        (site / "postfx" / "__init__.py").write_text("from .imgio import load\n")
        (site / "postfx" / "imgio.py").write_text("def load(): pass\n")


@pytest.mark.parametrize("is_last", [False, True], ids=["ours came last", "the other came last"])
@pytest.mark.parametrize("script", ["from postfx.cli.main import main; main(['--version'])",
                                    "from postfx.cli import main; main()"],
                         ids=["our script", "its script"])
def test_the_other_package_beside_this_one_is_told_in_one_line(site, is_last, script):
    add_namesake(site, is_last)
    environment = {**os.environ, "PYTHONPATH": str(site)}
    done = subprocess.run([sys.executable, "-c", script], env=environment, cwd=site,
                          capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert done.stderr.startswith("error: postfx 1.1.0, another package of that name, shares the "
                                  "folder ")
    assert done.stderr.endswith(f"pip uninstall postfx postfx-render, then {pip_install()}\n")


def test_this_package_is_not_taken_for_the_other(tmp_path):
    """Neither by its name of today nor by its former one, which was never published."""
    for name in ("postfx_render-0.2.0", "postfx-0.1.0"):
        (tmp_path / f"{name}.dist-info").mkdir()
        (tmp_path / f"{name}.dist-info" / "RECORD").write_text("postfx/__init__.py,,\n"
                                                               "postfx/cli/main.py,,\n")
    assert find_namesake(str(tmp_path)) is None


def test_the_version_is_the_same_everywhere():
    citation = (ROOT / "CITATION.cff").read_text()
    assert f"\nversion: {postfx.__version__}\n" in citation
    assert re.search(r"^## (\S+),", (ROOT / "CHANGELOG.md").read_text(),
                     re.MULTILINE)[1] == postfx.__version__
    page = (ROOT / "CONTRIBUTING.md").read_text()
    assert all((ROOT / name).is_file()
               for name in re.findall(r"`([\w/]+\.(?:py|toml|cff|md))`", page))
