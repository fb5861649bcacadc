"""A Python for Windows with what postfx needs, from packages of the index; wine runs it.

The interpreter's library comes with Panda3D, which brings it for the programs that it packs, its
modules in Python from the Python that runs this, and packages from their wheels for Windows. Wine
lacks some of what they ask for: `_make_missing_libraries` says what.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Sequence
from pathlib import Path

from postfx.compiled import build, library
from tests.kernels import foreign
from tests.made_once import copy_made_once

REPOSITORY = Path(__file__).resolve().parent.parent
VERSION = (3, 11)
"""Of Python; the one that runs this must be the same, as its modules are taken."""
INTERPRETER = ("panda3d==1.10.16", "msvc-runtime")
NOT_TAKEN = ("site-packages", "lib-dynload", "test", "idlelib", "tkinter", "ensurepip",
             "__pycache__", "config-*")
PROGRAM = """
#include <wchar.h>
__declspec(dllimport) int Py_Main(int count, wchar_t **words);
int wmain(int count, wchar_t **words) { return Py_Main(count, words); }
"""
COMPLEX_PARTS = """
struct Complex { double real, imaginary; };
struct ComplexFloat { float real, imaginary; };
double creal_of(struct Complex x) { return x.real; }
double cimag_of(struct Complex x) { return x.imaginary; }
float crealf_of(struct ComplexFloat x) { return x.real; }
float cimagf_of(struct ComplexFloat x) { return x.imaginary; }
"""
"""What NumPy calls when it is imported, and wine 8 has not."""
MATHS = b"api-ms-win-crt-math-l1-1-0.dll"
OUR_MATHS = b"own-ms-win-crt-math-l1-1-0.dll"
"""A name that wine does not know, of the same length."""


def make(folder: Path) -> None:
    """Fill a folder with Python, postfx and its kernels, of which packages and the interpreter are
    kept between runs. Raises CalledProcessError where packages cannot be had."""
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text("utf-8"))["project"]
    packages: list[str] = project["dependencies"]
    copy_made_once("windows-python", [Path(__file__)], f"{packages} {sys.version}",
                   lambda kept: _make_python(kept, packages), folder)
    for name, source in (("postfx", "postfx"), ("models", "models")):
        shutil.copytree(REPOSITORY / source, folder / "app" / name,
                        ignore=shutil.ignore_patterns("_native", "__pycache__"))
    native = folder / "app/postfx/_native/windows-x86_64"
    native.mkdir(parents=True)
    for path in foreign.windows_libraries(folder, library.levels()[-1])[0]:
        shutil.copy(path, native)


def run(folder: Path, *words: str | Path) -> subprocess.CompletedProcess[str]:
    """Python for Windows with these words; a path of this system begins with Z: there."""
    settings = foreign.wine_settings(folder) | {"PYTHONHOME": foreign.windows_path(folder),
                                                "PYTHONPATH": foreign.windows_path(folder / "app")}
    written = [foreign.windows_path(word) if isinstance(word, Path) else word for word in words]
    return subprocess.run([foreign.WINE or "", folder / "python.exe", *written], cwd=folder,
                          env=os.environ | settings, stdin=subprocess.DEVNULL, capture_output=True,
                          text=True, timeout=600)


def _make_python(folder: Path, packages: Sequence[str]) -> None:
    chosen = ["--platform", "win_amd64", "--python-version", ".".join(map(str, VERSION)),
              "--only-binary=:all:", "--quiet", "--disable-pip-version-check"]
    pip = [sys.executable, "-m", "pip"]
    wheels, taken = folder / "wheels", folder / "Lib/site-packages"
    subprocess.run([*pip, "download", *chosen, "--no-deps", "-d", wheels, *INTERPRETER], check=True)
    shutil.copytree(os.__file__.removesuffix("os.py"), folder / "Lib",
                    ignore=shutil.ignore_patterns(*NOT_TAKEN))
    subprocess.run([*pip, "install", *chosen, "--target", taken, *packages], check=True)
    for wheel in wheels.glob("*.whl"):
        with zipfile.ZipFile(wheel) as held:
            for name in held.namelist():
                place = Path(name)
                if place.parent.name in ("deploy_libs", "Scripts") and place.suffix in (".dll",
                                                                                        ".pyd"):
                    into = folder if place.suffix == ".dll" else folder / "DLLs"
                    into.mkdir(exist_ok=True)
                    (into / place.name).write_bytes(held.read(name))
    shutil.rmtree(wheels)
    _make_missing_libraries(folder)
    (folder / "python.c").write_text(PROGRAM)
    _compile(folder, "-municode", "-o", "python.exe", "python.c", "python311.dll")


def _make_missing_libraries(folder: Path) -> None:
    """The library by which modules of any Python 3 find this one, and one of complex numbers for
    NumPy, which is told its name."""
    maths = folder / MATHS.decode()
    own = {f"{name}{kind}" for name in ("creal", "cimag") for kind in ("", "f")}
    (folder / "maths.c").write_text(COMPLEX_PARTS)
    (folder / "empty.c").write_text("")
    for name, source, exported in (
            (OUR_MATHS.decode(), "maths.c",
             {name: f"{name}_of" if name in own else f"ucrtbase.{name}"
              for name in _names_exported(maths)}),
            ("python3.dll", "empty.c",
             {name: f"python311.{name}" for name in _names_exported(folder / "python311.dll")})):
        lines = [f"LIBRARY {name.removesuffix('.dll')}", "EXPORTS",
                 *(f"  {key}={value}" for key, value in exported.items())]
        (folder / "names.def").write_text("\n".join(lines) + "\n")
        _compile(folder, "-shared", "-o", name, source, "names.def")
    for module in (folder / "Lib/site-packages/numpy").rglob("*.pyd"):
        module.write_bytes(module.read_bytes().replace(MATHS, OUR_MATHS))


def _compile(folder: Path, *words: str) -> None:
    command = [*build.find_compiler()[:1], "cc", "-O1", "-target", "x86_64-windows-gnu", *words]
    subprocess.run(command, cwd=folder, check=True)


def _names_exported(path: Path) -> list[str]:
    """Names that a library for 64-bit Windows exports, by the format of its file."""
    data = path.read_bytes()

    def number(at: int, size: int = 4) -> int:
        return int.from_bytes(data[at:at + size], "little")

    header = number(0x3C)
    optional, sections = header + 24, number(header + 6, 2)
    table = optional + number(header + 20, 2)
    held = [[number(table + 40 * i + at) for at in (8, 12, 16, 20)] for i in range(sections)]

    def place(address: int) -> int:
        return next(address - begin + at for size, begin, length, at in held
                    if begin <= address < begin + max(size, length))

    exports = place(number(optional + 112))
    count, names = number(exports + 24), place(number(exports + 32))
    begins = [place(number(names + 4 * i)) for i in range(count)]
    return [data[begin:data.index(b"\0", begin)].decode() for begin in begins]
