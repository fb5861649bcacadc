"""Runs kernels that are compiled for another machine: all of them in one program, which an emulator
runs.

The program reads a kernel's number, its rows and its arrays, and writes the arrays as the kernel
left them.
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
ALONE = ("-nostdlib", "-static", "-fno-stack-protector", "-fno-threadsafe-statics", "-fno-builtin")
"""No library of C is linked: to compile one takes a minute of a core, and kernels call five
functions of it."""
PROGRAM = """
typedef long long Word;
typedef unsigned long Size;
@DECLARED@
static int (*const kernels[])(const Word*, void*) = {@NAMES@};

enum { READ = 63, WRITE = 64, EXIT = 93 };
static char heap[1 << 29];
static Size used;

static Word ask(Word number, Word first, Word second, Word third) {
    register Word x8 asm("x8") = number, x0 asm("x0") = first;
    register Word x1 asm("x1") = second, x2 asm("x2") = third;
    asm volatile("svc 0" : "+r"(x0) : "r"(x8), "r"(x1), "r"(x2) : "memory");
    return x0;
}

[[noreturn]] static void leave(Word status) {
    for (;;) ask(EXIT, status, 0, 0);
}

static void move(Word number, Word file, char* at, Size count) {
    while (count) {
        const Word moved = ask(number, file, (Word)at, (Word)count);
        if (moved <= 0) leave(2);
        at += moved;
        count -= (Size)moved;
    }
}

static Word number() {
    Word word = 0;
    move(READ, 0, (char*)&word, sizeof word);
    return word;
}

extern "C" {
void* malloc(Size size) {
    used = (used + 63) & ~63ul;
    if (size > sizeof heap - used) leave(3);
    void* const found = heap + used;
    used += size;
    return found;
}

void free(void*) {}

void* memcpy(void* to, const void* from, Size count) {
    for (Size i = 0; i < count; i++) ((char*)to)[i] = ((const char*)from)[i];
    return to;
}

void* memset(void* to, int value, Size count) {
    for (Size i = 0; i < count; i++) ((char*)to)[i] = (char)value;
    return to;
}

[[noreturn]] void _start() {
    const Word kernel = number(), arrays = number();
    Word words[200];
    char* memory[20];
    Word bytes[20];
    int count = 0;
    words[count++] = number();
    words[count++] = number();
    for (Word i = 0; i < arrays; i++) {
        const Word axes = number();
        bytes[i] = number();
        memory[i] = (char*)malloc((Size)bytes[i] + 1);
        words[count++] = (Word)memory[i];
        for (Word axis = 0; axis < axes; axis++) words[count++] = number();
        move(READ, 0, memory[i], (Size)bytes[i]);
    }
    const int status = kernels[kernel](words, nullptr);
    for (Word i = 0; i < arrays; i++) move(WRITE, 1, memory[i], (Size)bytes[i]);
    leave(status);
}
}
"""


def make_program(names: Sequence[str], folder: Path) -> Path:
    """A program of these kernels, compiled once for all runs from the same sources."""
    parts = build.our_parts()
    units = sorted({parts[name].unit for name in names})
    sources = [*units, *build.KERNELS.rglob("*.h"), Path(__file__)]
    make = partial(_make, names, units)
    copy_made_once("foreign", sources, f"{names} {version('ziglang')}", make, folder)
    return folder / "program"


def _make(names: Sequence[str], units: Sequence[Path], folder: Path) -> None:
    declared = "".join(f'extern "C" int {name}(const Word*, void*);\n' for name in names)
    (folder / "program.cpp").write_text(PROGRAM.replace("@DECLARED@", declared)
                                        .replace("@NAMES@", ", ".join(names)))
    compiler = [sys.executable, "-m", "ziglang", "c++", *build.FLAGS, "-target", TARGET]
    begin = [*compiler, *ALONE, "-c", "-o", folder / "program.o", folder / "program.cpp"]
    subprocess.run(begin, check=True)
    end = [*compiler, *ALONE[:2], "-nostdlib++", "-o", folder / "program", folder / "program.o",
           *units]
    subprocess.run(end, check=True)


def run(program: Path, kernel: int, rows: int, arrays: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The arrays as a kernel of the program left them."""
    given = struct.pack("<4q", kernel, len(arrays), 0, rows)
    for array in arrays:
        given += (struct.pack(f"<{2 + array.ndim}q", array.ndim, array.nbytes, *array.shape)
                  + array.tobytes())
    done = subprocess.run([EMULATOR, program], input=given, stdout=subprocess.PIPE,
                          check=True).stdout
    found, at = [], 0
    for array in arrays:
        found.append(np.frombuffer(done[at:at + array.nbytes], array.dtype).reshape(array.shape))
        at += array.nbytes
    return found
