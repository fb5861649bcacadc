"""Running the command line within the test's process, on small files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest

from postfx.cli.main import main
from tests.files.exr_files import write_mixed


class Outcome(NamedTuple):
    """Exit code and outputs of a command."""

    code: int
    out: str
    err: str

    @property
    def error(self) -> str:
        """The one line that says what is wrong."""
        (line,) = (line for line in self.err.splitlines() if line.startswith("error: "))
        return line


BOOKS = ("postfx.manifest.json", ".postfx")
"""What a run keeps beside its frames."""


@pytest.fixture
def postfx(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
           capfd: pytest.CaptureFixture) -> Callable[..., Outcome]:
    """Runs `postfx run ARGUMENTS --no-denoise --exposure 0` in the test's folder."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str) -> Outcome:
        capfd.readouterr()
        code = main(["run", *arguments, "--no-denoise", "--exposure", "0", "--device", "cpu"])
        return Outcome(code, *capfd.readouterr())

    return run


@pytest.fixture
def shot(tmp_path: Path) -> Callable[..., Path]:
    """Writes in/shot.####.exr, a picture with ids and a Cryptomatte; gives the folder."""

    def write(*numbers: int) -> Path:
        (tmp_path / "in").mkdir(exist_ok=True)
        for number in numbers:
            write_mixed(tmp_path / f"in/shot.{number:04d}.exr")
        return tmp_path / "in"

    return write


def names(folder: Path) -> list[str]:
    """What is in a folder, hidden files as well, but for the books of runs."""
    return sorted(path.name for path in folder.iterdir() if path.name not in BOOKS)
