"""Sources of the CUDA kernels: a family a file, behind the constants of Python and what all families share."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import numpy as np

from postfx.kernels.denoise import layout

SOURCES = Path(__file__).parent
_KERNEL = re.compile(r'extern "C" __global__ void (?:__launch_bounds__\(\w+\) )?(\w+)\(')
_LAYOUT = (
    "HIDDEN", "KERNEL", "TAP_WEIGHTS", "BLEND", "SHARPEN", "MIX", "DISTRUST", "IMPORTANCE", "MEMORY", "FINE",
    "PLANE_TRUST",
    "EXPOSURE", "JITTER_X", "JITTER_Y", "GAIN",
    "TOP", "LEFT", "HEIGHT", "WIDTH", "OUT_TOP", "OUT_LEFT", "OUT_HEIGHT", "OUT_WIDTH",
    "TRUST_CELL", "DOUBT", "FAINT", "MAX_COLOUR", "TINY", "MAX_COUNT", "MAX_DEPTH", "MAX_FLOAT",
    "MOST_LOG", "MOST_STATE",
)
CONSTANTS: dict[str, int | float | np.float32] = {
    name: getattr(layout, name) for name in _LAYOUT}
"""Numbers that CUDA kernels take from Python, by name."""


def has_source(name: str) -> bool:
    """Whether a kernel is written for CUDA."""
    return name in _families()


def family_of(name: str) -> Path:
    """The file that holds a kernel."""
    return _families()[name]


def read_source(family: Path) -> str:
    """All that is compiled for a family of kernels: the constants, what all families share, and its file."""
    return print_constants() + (SOURCES / "common.cuh").read_text() + family.read_text()


def print_constants() -> str:
    """The constants in CUDA: whole numbers as an enum, others as float."""
    whole = [f"{name} = {value}" for name, value in CONSTANTS.items() if isinstance(value, int)]
    floats = [f"{name} = {float(value)!r}f" for name, value in CONSTANTS.items() if not isinstance(value, int)]
    return f"enum {{ {', '.join(whole)} }};\n[[maybe_unused]] const float {', '.join(floats)};\n"


@cache
def _families() -> dict[str, Path]:
    """Every kernel's file by the kernel's name."""
    return {name: path for path in SOURCES.rglob("*.cu") for name in _KERNEL.findall(path.read_text())}
