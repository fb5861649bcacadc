"""Kernels that enlarge the filtered radiance by predicted weights, sharpen it, and blend it with
the last output."""

from __future__ import annotations

from dataclasses import replace

from postfx.kernels.denoise import BOTH, GUIDE_REFLECTANCE, in_half, kernel

SIGMA = 0.5
TAPS = 9

WRITES = ("output", "next_history")
BETWEEN, LAST = ("moved", "past", "warped"), ("params", "window", "keep")
HELD, CODED = ("radiance", "fine", *BETWEEN), ("radiance", "codes", "factors", "scaling", *BETWEEN)
GUIDES_READ = (*GUIDE_REFLECTANCE, "trust")
UPSAMPLE = kernel("upsample", (*HELD, *LAST), WRITES, None, ("output", 0))
UPSAMPLE_GUIDED = kernel("upsample_guided", (*HELD, *GUIDES_READ, *LAST), WRITES, None,
                         ("output", 0), radiance=BOTH)
UPSAMPLE_UNSCALED = kernel("upsample_unscaled", (*HELD, "factor", *LAST), WRITES, None,
                           ("output", 0), radiance=BOTH)
CODES_PLAIN = kernel("upsample_codes", (*CODED, *LAST), WRITES, None, ("output", 0))
CODES_GUIDED = kernel("upsample_guided_codes", (*CODED, *GUIDES_READ, *LAST), WRITES, None,
                      ("output", 0), radiance=BOTH)
CODES_UNSCALED = kernel("upsample_unscaled_codes", (*CODED, "factor", *LAST), WRITES, None,
                        ("output", 0), radiance=BOTH)
UPSAMPLE, UPSAMPLE_GUIDED = (replace(one, pixels=(2, 2)) for one in (UPSAMPLE, UPSAMPLE_GUIDED))
BLEND_PICTURE = kernel("blend_picture", ("picture", "controls", *BETWEEN, *LAST), WRITES, None,
                       ("output", 0))
"""A picture that a network gives itself, blended with the last output: its first control is its
share."""
for one in (UPSAMPLE, UPSAMPLE_GUIDED, UPSAMPLE_UNSCALED):
    in_half(one, "fine")
