"""Types are right: mypy in strict mode over postfx and training, beside the other tests.

It is asked once, about a file of wrong calls, too: what it finds in that it would say to a user.
"""

from __future__ import annotations

import fcntl
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from postfx.system import private_folder

pytest.importorskip("mypy", reason="needs the extra 'dev'")

REPOSITORY = Path(__file__).resolve().parent.parent
IMPORTS = "import postfx; from postfx.passes.display import Display"
CASES = {
    'postfx.DenoiseUpscale(scale=1.5, size=None, model="s", strength=1, budget=40)': None,
    'postfx.DenoiseUpscale(reactive="none")': None,
    "postfx.DenoiseUpscale(size=(640, 360))": None,
    'postfx.ToneMap(look="aces2", keep=0.5)': None,
    'postfx.ToneMap("agx")': None,
    'Display("pq")': None,
    'postfx.DenoiseUpscale(scale="two")': "scale",
    "postfx.DenoiseUpscale(scle=2.0)": "scle",
    'postfx.DenoiseUpscale(scle="two")': "scle",
    "postfx.ToneMap(look=1)": "look",
    "Display(peak=1000)": "peak",
    "postfx.Overlay(over=True)": "over",
}
"""Calls -> the option that they get wrong."""


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Errors in the files that the project names, and in one that calls passes. What is known of
    files as they are is kept for other runs."""
    calls = tmp_path_factory.mktemp("calls") / "calls.py"
    calls.write_text("\n".join((IMPORTS, *CASES, "")))
    settings = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))
    kept = private_folder("tests") or tmp_path_factory.getbasetemp()
    command = [sys.executable, "-m", "mypy", f"--cache-dir={kept / 'mypy'}",
               *settings["tool"]["mypy"]["files"], str(calls)]
    with (kept / "mypy.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stdout + done.stderr
    return [line for line in done.stdout.splitlines() if " error: " in line]


def test_mypy_finds_nothing(report: list[str]) -> None:
    assert [line for line in report if "calls.py:" not in line] == []


def test_it_finds_wrong_options_of_passes_before_anything_runs(report: list[str]) -> None:
    for number, (call, wrong) in enumerate(CASES.items(), 2):
        here = [line for line in report if f"calls.py:{number}: error" in line]
        assert bool(here) == bool(wrong), (call, report)
        assert wrong is None or f'"{wrong}"' in here[0]
