"""Checks of the noise itself."""

from __future__ import annotations

from collections.abc import Iterator

from postfx.doctor import Finding, warning
from postfx.doctor.material import Material
from postfx.frame import Role
from postfx.pixel_filter import find_stddev


def check_pixel_filter(material: Material) -> Iterator[Finding]:
    """Noise that the renderer's pixel filter spreads over several pixels."""
    first = material.first
    stddev = find_stddev(first[Role.COLOUR], first.samples) if Role.COLOUR in first else None
    if stddev is None:
        return
    evidence = ("noise of pixels beside each other is alike, as a gaussian pixel filter with a "
                f"standard deviation of {stddev:.2f} pixels makes it")
    yield warning(Role.COLOUR, "noise-spread", evidence,
                  "the renderer adds each sample to several pixels",
                  "none needed with 'xl' and 'l': the filter is undone before them and applied to "
                  "their picture (--pixel-filter none switches that off); other denoisers leave "
                  "such noise: render with a box filter of one pixel for them")
