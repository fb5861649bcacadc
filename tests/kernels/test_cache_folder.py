"""Where compiled kernels are kept: Numba unpickles them, so nobody else may put anything there."""

import os
from pathlib import Path

import pytest

from postfx import system
from postfx.kernels import numeric


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Finds the folder anew, with a home and a folder for temporary files of the test's own."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(system.tempfile, "gettempdir", lambda: str(tmp_path / "tmp"))
    return lambda: numeric.cache_folder.__wrapped__()


def test_a_folder_of_our_own(folder, tmp_path):
    found = Path(folder())
    assert found.parent == tmp_path / "cache/postfx" and found.stat().st_mode & 0o077 == 0
    assert folder() == str(found)


def test_a_folder_that_everyone_may_write_to_is_not_used(folder, tmp_path):
    Path(folder()).chmod(0o777)
    assert Path(folder()).parent == tmp_path / f"tmp/postfx-{os.getuid()}"
    (tmp_path / f"tmp/postfx-{os.getuid()}").chmod(0o777)
    assert folder() == ""


def test_a_folder_of_someone_else_is_not_used(folder, monkeypatch):
    folder()
    monkeypatch.setattr(system.os, "getuid", lambda: 54321)
    assert folder() == ""


def test_without_a_home_it_lies_with_the_temporary_files(folder, tmp_path):
    (tmp_path / "cache").write_text("a file where the folder should be")
    assert Path(folder()).parent == tmp_path / f"tmp/postfx-{os.getuid()}"
