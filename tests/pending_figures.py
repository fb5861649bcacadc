"""Sections whose figures are older than the sources of figures; see tests/test_figures.py. The list
only shrinks."""

from __future__ import annotations

PENDING: dict[str, tuple[str, ...]] = {
    "docs/lab/partner.md": (
        "What it gains",
        "How it is mixed",
    ),
    "docs/lab/tonemap.md": (
        "Measured",
        "Flicker",
        "local",
        "auto",
    ),
    "docs/lab/interpolation.md": (
        "Measured",
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
    "docs/lab/parts.md": (
        "Light groups in a room",
        "Alpha",
        "Light groups and passes of Cycles",
    ),
    "docs/measured/speed.md": (
        "On a GPU",
    ),
    "docs/lab/networks.md": (
        "Ambient occlusion",
    ),
    "docs/lab/quality.md": (
        "Against the best of the others",
        "Living room",
        "Staircase",
        "Garage",
        "Kinds of content",
        "Run time against error",
        "Planes that are missing",
        "Other scales",
        "As many light paths, spent both ways",
        "How many samples one is worth",
        "As samples rise",
        "The networks",
        "Unusual content",
        "Failure cases",
    ),
    "docs/lab/runtime.md": (
        "CUDA",
        "Arrays of other libraries",
        "Other execution providers",
        "Inside a network",
        "A memory budget",
        "Threads",
        "Measured",
        "Where the time of a frame goes",
        "How time grows",
    ),
}
