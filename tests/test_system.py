"""Threads are as many as cores that can be used, by affinity and the quota of control groups;
memory likewise."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from postfx import system
from postfx.cli.main import main
from tests.conftest import REPOSITORY


def within(own: str | None, files: dict[str, str], folder: Path, monkeypatch) -> None:
    """As if this process were in such control groups."""
    for name, text in files.items():
        path = folder / "groups" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    if own is not None:
        (folder / "own").write_text(own)
    monkeypatch.setattr(system, "_GROUPS", folder / "groups")
    monkeypatch.setattr(system, "_OWN", folder / "own")


@pytest.mark.parametrize(("own", "files", "expected"), [
    ("0::/\n", {"cpu.max": "250000 100000\n"}, 3),
    ("0::/\n", {"cpu.max": "max 100000\n"}, 64),
    ("0::/\n", {"cpu.max": "10000 100000\n"}, 1),
    ("0::/farm/job\n", {"farm/cpu.max": "200000 100000\n", "farm/job/cpu.max": "800000 100000\n"},
     2),
    ("0::/of/the/host\n", {"cpu.max": "400000 100000\n"}, 4),
    ("4:memory:/a\n3:cpu,cpuacct:/a\n0::/\n",
     {"cpu/a/cpu.cfs_quota_us": "150000\n", "cpu/a/cpu.cfs_period_us": "50000\n"}, 3),
    ("3:cpu,cpuacct:/\n", {"cpu/cpu.cfs_quota_us": "-1\n", "cpu/cpu.cfs_period_us": "100000\n"},
     64),
    ("3:cpuset:/\n", {"cpu/cpu.cfs_quota_us": "100000\n", "cpu/cpu.cfs_period_us": "100000\n"}, 64),
    ("0::/\n", {"cpu.max": "nonsense\n"}, 64),
    (None, {}, 64),
])
def test_quotas_of_containers_bound_the_cores(own: str | None, files: dict[str, str],
                                              expected: int, tmp_path: Path, monkeypatch) -> None:
    within(own, files, tmp_path, monkeypatch)
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: set(range(64)))
    assert system.usable_cores() == expected


@pytest.mark.parametrize(("own", "files", "expected"), [
    ("0::/\n", {"memory.max": "2000000000\n"}, 2_000_000_000),
    ("0::/\n", {"memory.max": "max\n"}, 0),
    ("0::/farm/job\n", {"farm/memory.max": "max\n", "farm/job/memory.max": "1000000000\n"},
     1_000_000_000),
    ("4:memory:/a\n0::/\n", {"memory/a/memory.limit_in_bytes": "3000000000\n"}, 3_000_000_000),
    ("4:memory:/\n", {"memory/memory.limit_in_bytes": "9223372036854771712\n"}, 0),
    (None, {}, 0),
])
def test_limits_of_containers_bound_the_memory(own: str | None, files: dict[str, str],
                                               expected: int, tmp_path: Path, monkeypatch) -> None:
    within(own, files, tmp_path, monkeypatch)
    machine = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    assert system.usable_memory() == (expected or machine)


def test_no_more_than_by_affinity() -> None:
    assert 1 <= system.usable_cores() <= len(os.sched_getaffinity(0))


def test_files_are_read_and_written_by_as_many_threads(tmp_path: Path) -> None:
    wanted = ("run", "samples/room/noisy.0001.exr", "-o", str(tmp_path / "a.exr"), "--no-denoise",
              "--threads")
    assert main([*wanted, "3"]) == 0 and oiio.get_int_attribute("threads") == 3
    assert main(["models"]) == 0 and oiio.get_int_attribute("threads") == system.usable_cores()


@pytest.fixture
def base(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a home and one for temporary files."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(system.tempfile, "gettempdir", lambda: str(tmp_path / "tmp"))
    return tmp_path


def test_a_folder_of_our_own(base: Path) -> None:
    found = system.private_folder("native")
    assert found == base / "cache/postfx/native" and found.stat().st_mode & 0o077 == 0
    assert system.private_folder("native") == found


def test_a_folder_that_everyone_may_write_to_is_not_used(base: Path) -> None:
    system.private_folder("native").chmod(0o777)
    temporary = base / f"tmp/postfx-{os.getuid()}"
    assert system.private_folder("native") == temporary / "native"
    temporary.chmod(0o777)
    assert system.private_folder("native") is None


def test_a_folder_of_someone_else_is_not_used(base: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    system.private_folder("native")
    monkeypatch.setattr(system.os, "getuid", lambda: 54321)
    assert system.private_folder("native") is None


def test_without_a_home_it_lies_with_the_temporary_files(base: Path) -> None:
    (base / "cache").write_text("a file where the folder should be")
    assert system.private_folder("native").parent == base / f"tmp/postfx-{os.getuid()}"


WATCHED = """
import sys
def note(event, given):
    if event in ("open", "os.mkdir") and str(given[0]).startswith(sys.argv[1]):
        print(event, given[0])
sys.addaudithook(note)
from postfx.cli.main import main
sys.exit(main(sys.argv[2:]))
"""
"""Prints what a command makes in a folder."""


def test_a_run_with_a_cache_leaves_the_temporary_folder_alone(tmp_path, write_exr):
    """Python writes a file to find that folder, which stays where a process is killed just then."""
    write_exr("in/shot.0001.exr", {name: np.ones((16, 16)) for name in "RGB"})
    (tmp_path / "temporary").mkdir()
    words = ["run", f"{tmp_path}/in/", "-o", f"{tmp_path}/out/", "--model", "s"]
    command = [sys.executable, "-c", WATCHED, f"{tmp_path}/temporary", *words]
    for _ in range(2):  # the first run may compile
        done = subprocess.run([*command, "--overwrite"], capture_output=True, text=True, check=True,
                              env={**os.environ, "TMPDIR": f"{tmp_path}/temporary",
                                   "PYTHONPATH": str(REPOSITORY)})
    assert done.stdout == "" and not list((tmp_path / "temporary").iterdir())
