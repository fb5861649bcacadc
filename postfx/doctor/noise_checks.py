"""Checks of the noise itself."""

from __future__ import annotations

from collections.abc import Iterator

from postfx.doctor import Finding, info
from postfx.doctor.material import Material
from postfx.frame import Role
from postfx.pixel_filter import find_stddev

NOISE_SPREAD_CODE = "noise-spread"
"""Code of the finding that a pixel filter spread the noise."""


def check_pixel_filter(material: Material) -> Iterator[Finding]:
    """Noise that the renderer's pixel filter spreads over several pixels."""
    first = material.first
    stddev = find_stddev(first[Role.COLOUR], first.planes) if Role.COLOUR in first else None
    if stddev is None:
        return
    evidence = ("noise of pixels beside each other is alike, as a gaussian pixel filter with a "
                f"standard deviation of {stddev:.2f} pixels makes it")
    yield info(Role.COLOUR, NOISE_SPREAD_CODE, evidence,
               "the renderer adds each sample to several pixels",
               "none needed with xl, l and oidn: they see frames without that filter, and it is "
               "applied to their picture (--pixel-filter none leaves it); for s and m render with "
               "a box filter")
