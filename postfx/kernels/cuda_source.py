"""Sources of the CUDA kernels: a family a file, behind the constants of Python and what all families share.

A plug-in's kernels come from files in its own folder, and share nothing with ours but what an argument is.
"""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import numpy as np

from postfx.kernels.denoise import layout
from postfx.kernels.kernel import Kernel

SOURCES = Path(__file__).resolve().parent
_KERNEL = re.compile(r'extern "C" __global__ void (?:__launch_bounds__\(\w+\) )?(\w+)\(')
_LAYOUT = (
    "HIDDEN", "KERNEL", "TAP_WEIGHTS", "BLEND", "SHARPEN", "MIX", "DISTRUST", "IMPORTANCE", "MEMORY", "FINE",
    "PLANE_TRUST",
    "EXPOSURE", "JITTER_X", "JITTER_Y", "GAIN",
    "TOP", "LEFT", "HEIGHT", "WIDTH", "OUT_TOP", "OUT_LEFT", "OUT_HEIGHT", "OUT_WIDTH",
    "TRUST_CELL", "DOUBT", "FAINT", "MAX_COLOUR", "MAX_LIGHT", "TINY", "MAX_COUNT", "MAX_DEPTH", "MAX_FLOAT",
    "MOST_LOG", "MOST_STATE",
)
CONSTANTS: dict[str, int | float | np.float32] = {
    name: getattr(layout, name) for name in _LAYOUT}
"""Numbers that CUDA kernels take from Python, by name."""


def find_source(kernel: Kernel) -> Path | None:
    """The file that holds a kernel; None where it is not written for CUDA."""
    return _families(kernel.home or SOURCES).get(kernel.name)


def read_source(family: Path) -> str:
    """All that is compiled for a file of kernels: what a kernel's arguments are, for ours also the constants and what
    all families share, and the file."""
    is_own = family.is_relative_to(SOURCES)
    shared = print_constants() + (SOURCES / "common.cuh").read_text() if is_own else ""
    return (SOURCES / "view.cuh").read_text() + shared + family.read_text()


def print_constants() -> str:
    """The constants in CUDA: whole numbers as an enum, others as float."""
    whole = [f"{name} = {value}" for name, value in CONSTANTS.items() if isinstance(value, int)]
    floats = [f"{name} = {float(value)!r}f" for name, value in CONSTANTS.items() if not isinstance(value, int)]
    return f"enum {{ {', '.join(whole)} }};\n[[maybe_unused]] const float {', '.join(floats)};\n"


@cache
def _families(folder: Path) -> dict[str, Path]:
    """Every kernel's file by the kernel's name: below our folder, or in a plug-in's."""
    sources = sorted(folder.rglob("*.cu") if folder == SOURCES else folder.glob("*.cu"))
    return {name: path for path in sources for name in _KERNEL.findall(path.read_text())}
