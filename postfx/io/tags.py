"""What files say about the colours of display pictures: chunks, profiles and attributes, by kind of file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from postfx.colour.displays import Display
from postfx.colour.icc import profile
from postfx.colour.primaries import Chromaticities

JPEG = (".jpg", ".jpeg")


def tag_codes(spec: oiio.ImageSpec, display: Display, path: Path) -> None:
    """Say in a PNG, TIFF or JPEG for which display its code values are.

    PNG: chunk sRGB, or for other displays iCCP, an ICC profile, and before it cICP (ITU-T H.273) where that can say it.
    TIFF and JPEG: an ICC profile.
    """
    if path.suffix.lower() == ".png" and display.name == "srgb":
        spec.attribute("oiio:ColorSpace", "sRGB")
        return
    icc = np.frombuffer(profile(display), np.uint8)
    spec.attribute("oiio:ColorSpace", "unknown")  # else OpenImageIO adds that it is sRGB
    spec.attribute("ICCProfile", oiio.TypeDesc(f"uint8[{len(icc)}]"), icc)
    if display.kind.cicp:
        spec.attribute("CICP", oiio.TypeDesc("int[4]"), display.kind.cicp)


def tag_light(spec: oiio.ImageSpec, primaries: Chromaticities, white: float | None = None) -> None:
    """Say in an EXR of which primaries its light is, and how bright 1 is in cd/m2, if that is known."""
    spec.attribute("chromaticities", oiio.TypeDesc("float[8]"), primaries)
    if white is not None:
        spec.attribute("whiteLuminance", float(white))
