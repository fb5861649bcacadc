"""Sections whose figures are older than the sources of figures; see tests/test_figures.py. The list
only shrinks."""

from __future__ import annotations

PENDING: dict[str, tuple[str, ...]] = {
    "docs/lab/interpolation.md": (
        "Time",
    ),
    "docs/lab/denoiser.md": (
        "Doubt in planes",
        "At 1x",
        "Clean input",
    ),
    "docs/lab/gpu.md": (
        "Estimate",
        "Half precision around the network",
        "Networks as our own kernels",
        "Kernels around the networks",
    ),
    "docs/lab/neural.md": (
        "Kernels on a GPU",
    ),
    "docs/measured/speed.md": (
        "On a GPU",
    ),
    "docs/lab/runtime.md": (
        "CUDA",
        "Arrays of other libraries",
        "How time grows",
    ),
}
