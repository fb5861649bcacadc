"""Kernels that enlarge the filtered radiance by predicted weights, sharpen it, and blend it with
the last output."""

from __future__ import annotations

from dataclasses import replace

from postfx.kernels.denoise import BOTH, GUIDE_REFLECTANCE, in_half, kernel

TAPS = 9
"""Filtered pixels around an output pixel that it is made of."""

WRITES = ("output", "next_history")
BETWEEN = ("moved", "past", "warped")
LAST = ("params", "window", "keep")
HELD = ("radiance", "fine", *BETWEEN)
CODED = ("radiance", "codes", "factors", "scaling", *BETWEEN)
GUIDES_READ = (*GUIDE_REFLECTANCE, "trust")
UPSAMPLE = replace(kernel("upsample", (*HELD, *LAST), WRITES, None, ("output", 0)), pixels=(2, 2))
UPSAMPLE_GUIDED = replace(kernel("upsample_guided", (*HELD, *GUIDES_READ, *LAST), WRITES, None,
                                 ("output", 0), radiance=BOTH), pixels=(2, 2))
UPSAMPLE_UNSCALED = kernel("upsample_unscaled", (*HELD, "factor", *LAST), WRITES, None,
                           ("output", 0), radiance=BOTH)
CODES_PLAIN = kernel("upsample_codes", (*CODED, *LAST), WRITES, None, ("output", 0))
CODES_GUIDED = kernel("upsample_guided_codes", (*CODED, *GUIDES_READ, *LAST), WRITES, None,
                      ("output", 0), radiance=BOTH)
CODES_UNSCALED = kernel("upsample_unscaled_codes", (*CODED, "factor", *LAST), WRITES, None,
                        ("output", 0), radiance=BOTH)
BLEND_PICTURE = kernel("blend_picture", ("picture", "controls", *BETWEEN, *LAST), WRITES, None,
                       ("output", 0))
"""A picture that a network gives itself, blended with the last output: its first control is its
share."""
for one in (UPSAMPLE, UPSAMPLE_GUIDED, UPSAMPLE_UNSCALED):
    in_half(one, "fine")
