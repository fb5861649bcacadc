"""Sections whose figures are older than the sources of figures; see tests/test_figures.py. The list
only shrinks."""

from __future__ import annotations

PENDING: dict[str, tuple[str, ...]] = {
    "docs/lab/denoiser.md": (
        "Doubt in planes",
        "At 1x",
        "Clean input",
    ),
    "docs/lab/runtime.md": (
        "How time grows",
    ),
}
