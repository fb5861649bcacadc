"""A picture of what becomes of noise that a pixel filter spreads over several pixels.

    python -m training.measure.pixel_filter_picture docs/images/pixel_filter.png

Mitsuba's Cornell box at 16 samples a pixel, with Mitsuba's default filter, twice as large:
the noisy frame, Open Image Denoise with prefiltered planes, `xl` as it runs by default, and a
reference.
"""

from __future__ import annotations

import argparse

import numpy as np
import OpenImageIO as oiio

from postfx import DenoiseUpscale, Device, Pipeline
from postfx.colour.views import to_codes
from postfx.frame import Role
from postfx.tools.bench.baselines import Oidn
from training.measure.pixel_filter import mitsuba_cases

PART = slice(12, 156), slice(76, 220)
"""Rows and columns of the box that are shown."""
ZOOM = 2
"""Pixels of the picture for each of the frame."""
GAP_PX = 6
"""White columns between the parts."""


def comparison(threads: int) -> np.ndarray:
    """The picture, (height, width, 3) of code values from 0 to 1."""
    *_, case = mitsuba_cases()
    (frame,), (reference,) = case.filtered, case.references
    pipeline = Pipeline([DenoiseUpscale(scale=1.0, model="xl")], Device("cpu", threads))
    denoised = pipeline(frame)[Role.COLOUR]
    exposure = pipeline.exposure_factor or 1.0
    others = Oidn("high", "cpu", threads, "prefiltered")(frame)
    parts = []
    for light in (frame[Role.COLOUR], others, denoised, reference):
        codes = to_codes(light[PART], exposure).repeat(ZOOM, 0).repeat(ZOOM, 1)
        parts += [codes, np.ones((len(codes), GAP_PX, 3), np.float32)]
    return np.concatenate(parts[:-1], axis=1)


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("picture", metavar="FILE.png")
    parser.add_argument("--threads", type=int, default=2)
    given = parser.parse_args(argv)
    found = np.ascontiguousarray(comparison(given.threads), np.float32)
    image = oiio.ImageBuf(found)
    image.set_write_format(oiio.UINT8)
    if not image.write(given.picture):
        parser.error(f"{given.picture}: {image.geterror()}")


if __name__ == "__main__":
    main()
