"""A Python for arm64 with what postfx needs, from Debian's packages and the index; an emulator runs
it.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path

from postfx.compiled import build
from postfx.system import private_folder
from tests.kernels import foreign
from tests.made_once import copy_made_once

REPOSITORY = Path(__file__).resolve().parent.parent
VERSION = (3, 11)
"""Of Debian 12's Python, and of the wheels."""
DEBIAN = ("python3.11-minimal", "libpython3.11-minimal", "libpython3.11-stdlib", "libc6",
          "libstdc++6", "libgcc-s1", "zlib1g", "libexpat1", "libffi8", "libssl3", "libbz2-1.0",
          "liblzma5", "libuuid1", "libsqlite3-0", "libcrypt1")
RUNTIME = "onnxruntime==1.23.2"
"""The newest of those tried that qemu 7.2 runs: 1.32.0 crashes when it is imported."""
TARGET = "linux-aarch64"


def make(folder: Path) -> None:
    """Fill a folder with Python, postfx and its kernels, of which packages are kept between runs.
    Raises CalledProcessError where packages cannot be had."""
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text("utf-8"))["project"]
    packages = [RUNTIME, *(package for package in project["dependencies"]
                           if not package.startswith("onnxruntime"))]
    copy_made_once("arm64-python", [Path(__file__)], str(packages),
                   lambda kept: _make_python(kept, packages), folder)
    for name in ("postfx", "models"):
        shutil.copytree(REPOSITORY / name, folder / "app" / name,
                        ignore=shutil.ignore_patterns("_native", "__pycache__"))
    native = folder / "app/postfx/_native" / TARGET
    native.mkdir(parents=True)
    home = private_folder("tests") or folder
    for path in build.build_all(TARGET, home / TARGET):
        shutil.copy(path, native)


def run(folder: Path, *words: str | Path) -> subprocess.CompletedProcess[str]:
    """Python for arm64 with these words."""
    root = folder / "root"
    libraries = [root / "usr/lib/aarch64-linux-gnu", root / "lib/aarch64-linux-gnu"]
    settings = {"QEMU_LD_PREFIX": root, "PYTHONHOME": root / "usr",
                "QEMU_SET_ENV": "LD_LIBRARY_PATH=" + ":".join(map(str, libraries)),
                "PYTHONPATH": f"{folder / 'app'}:{folder / 'packages'}",
                "XDG_CACHE_HOME": folder / "cache"}
    return subprocess.run([foreign.QEMU or "", root / "usr/bin/python3.11", *words], cwd=folder,
                          env=os.environ | {name: str(value) for name, value in settings.items()},
                          stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=900)


def _make_python(folder: Path, packages: Sequence[str]) -> None:
    state, debs, root = folder / "apt", folder / "debs", folder / "root"
    for made in (state / "lists/partial", state / "cache/archives/partial", debs, root):
        made.mkdir(parents=True)
    (state / "status").touch()
    apt = ["apt-get", "-qq", "-o", "APT::Architecture=arm64", "-o", "APT::Architectures=arm64",
           "-o", f"Dir::State::Lists={state / 'lists'}", "-o", f"Dir::Cache={state / 'cache'}",
           "-o", f"Dir::State::status={state / 'status'}"]
    subprocess.run([*apt, "update"], check=True)
    subprocess.run([*apt, "download", *DEBIAN], cwd=debs, check=True)
    for package in debs.glob("*.deb"):
        subprocess.run(["dpkg", "-x", package, root], check=True)
    kinds = [word for kind in ("2_17", "2_27", "2_28")
             for word in ("--platform", f"manylinux_{kind}_aarch64")]
    subprocess.run([sys.executable, "-m", "pip", "install", "--quiet", *kinds, "--python-version",
                    ".".join(map(str, VERSION)), "--only-binary=:all:", "--target",
                    folder / "packages", *packages], check=True)
    for folder_of_no_use in (state, debs, root / "usr/share"):
        shutil.rmtree(folder_of_no_use)
