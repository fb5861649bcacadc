"""Runs kernels that are compiled for another machine: all of them in one program, which an emulator runs.

The program reads a kernel's number, its rows and its arrays, and writes the arrays as the kernel left them.
"""

from __future__ import annotations

import shutil
import struct
import subprocess
import sys
from collections.abc import Sequence
from functools import partial
from importlib.metadata import version
from pathlib import Path

import numpy as np

from postfx.compiled import build
from tests.made_once import copy_made_once

EMULATOR = shutil.which("qemu-aarch64-static") or shutil.which("qemu-aarch64")
TARGET = "aarch64-linux-musl"
PROGRAM = """
#include <stdio.h>
#include <stdlib.h>

typedef long long Word;
@DECLARED@
static int (*const kernels[])(const Word*, void*) = {@NAMES@};

static Word number() {
    Word word = 0;
    if (fread(&word, sizeof word, 1, stdin) != 1) exit(2);
    return word;
}

int main() {
    const Word kernel = number(), arrays = number();
    Word words[200];
    void* memory[20];
    Word bytes[20];
    int count = 0;
    words[count++] = number();
    words[count++] = number();
    for (Word i = 0; i < arrays; i++) {
        const Word axes = number();
        bytes[i] = number();
        memory[i] = malloc(bytes[i] + 1);
        words[count++] = (Word)memory[i];
        for (Word axis = 0; axis < axes; axis++) words[count++] = number();
        if (fread(memory[i], 1, bytes[i], stdin) != (size_t)bytes[i]) exit(2);
    }
    const int status = kernels[kernel](words, nullptr);
    for (Word i = 0; i < arrays; i++) fwrite(memory[i], 1, bytes[i], stdout);
    return status;
}
"""


def make_program(names: Sequence[str], folder: Path) -> Path:
    """A program of these kernels, compiled once for all runs from the same sources."""
    sources = [*build.our_units(), *build.KERNELS.rglob("*.h"), Path(__file__)]
    copy_made_once("foreign", sources, f"{names} {version('ziglang')}", partial(_make, names), folder)
    return folder / "program"


def _make(names: Sequence[str], folder: Path) -> None:
    declared = "".join(f'extern "C" int {name}(const Word*, void*);\n' for name in names)
    (folder / "program.cpp").write_text(PROGRAM.replace("@DECLARED@", declared).replace("@NAMES@", ", ".join(names)))
    flags = [*build.FLAGS, "-nostdlib++", "-static", "-target", TARGET]
    subprocess.run([sys.executable, "-m", "ziglang", "c++", *flags, "-o",
                    folder / "program", folder / "program.cpp", *build.our_units()], check=True)


def run(program: Path, kernel: int, rows: int, arrays: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The arrays as a kernel of the program left them."""
    given = struct.pack("<4q", kernel, len(arrays), 0, rows)
    for array in arrays:
        given += struct.pack(f"<{2 + array.ndim}q", array.ndim, array.nbytes, *array.shape) + array.tobytes()
    done = subprocess.run([EMULATOR, program], input=given, stdout=subprocess.PIPE, check=True).stdout
    found, at = [], 0
    for array in arrays:
        found.append(np.frombuffer(done[at:at + array.nbytes], array.dtype).reshape(array.shape))
        at += array.nbytes
    return found
