"""Checks of the noise itself."""

from __future__ import annotations

from collections.abc import Iterator

from postfx.doctor import Finding, warning
from postfx.doctor.material import Material
from postfx.frame import Role
from postfx.pixel_filter import spread_ratio


def check_pixel_filter(material: Material) -> Iterator[Finding]:
    """Noise that the renderer's pixel filter spreads over several pixels."""
    first = material.first
    ratio = spread_ratio(first[Role.COLOUR], first.samples) if Role.COLOUR in first else None
    if ratio is None:
        return
    evidence = (f"noise of pixels beside each other is alike ({ratio:.2f} where independent noise "
                "has 1): 'xl' and OIDN take it for detail and leave most of it")
    yield warning(Role.COLOUR, "noise-spread", evidence,
                  "a pixel filter that adds each sample to several pixels, as a gaussian does",
                  "render with a box filter of one pixel, or denoise by --model m")
