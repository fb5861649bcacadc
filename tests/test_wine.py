"""postfx by a Python for Windows, which wine runs."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

from tests import windows_python
from tests.kernels import foreign

ROOM = windows_python.REPOSITORY / "samples/room/noisy.####.exr"


@pytest.mark.soak
@pytest.mark.skipif(foreign.WINE is None, reason="needs wine64")
@pytest.mark.skipif(importlib.util.find_spec("ziglang") is None, reason="needs ziglang")
@pytest.mark.skipif(sys.version_info[:2] != windows_python.VERSION, reason="needs Python 3.11")
@pytest.mark.parametrize("model", ["s", "m", "xl"])
def test_the_command_on_windows_writes_the_same_files(windows: Path, tmp_path: Path,
                                                      model: str) -> None:
    """Denoised with history, by networks of 8 bits, and tone-mapped: the same bytes as here."""
    for ending in ("exr", "png"):
        words = ("-m", "postfx", "run", ROOM, "--frames", "1-3", "--run-up", "0", "--model", model)
        here, there = tmp_path / f"here/a.####.{ending}", tmp_path / f"there/a.####.{ending}"
        subprocess.run([sys.executable, *words, "-o", here], check=True, capture_output=True)
        done = windows_python.run(windows, *words, "-o", there)
        assert done.returncode == 0, done.stderr
        for number in (1, 2, 3):
            name = f"a.{number:04}.{ending}"
            assert (there.parent / name).read_bytes() == (here.parent / name).read_bytes(), name
    done = windows_python.run(windows, "-m", "postfx", "verify", tmp_path / "there")
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def windows(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A Python for Windows with postfx."""
    folder = tmp_path_factory.mktemp("windows")
    windows_python.make(folder)
    return folder
