"""Exposure: whether the header's suits the picture."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from postfx.doctor.findings import Finding, error, info, warning
from postfx.doctor.material import Material
from postfx.exposure import measure
from postfx.frame import Role

MISMATCH_EV = 2.0
UNUSUAL_EV = 8.0


def exposure_mismatch(material: Material) -> Iterator[Finding]:
    """Exposure header against what metering brings to mid grey, which the tone mapper expects."""
    frames = [frame for frame in material.frames if Role.COLOUR in frame]
    metered = {frame.number: ev for frame in frames if (ev := measure(frame[Role.COLOUR])) is not None}
    if frames and not metered:
        yield warning(Role.COLOUR, "colour-black", "every frame looked at is black", "lights off, or another layer's "
                      "colour", "check that the colour plane is the beauty pass")
    headers = {frame.number: frame.exposure for frame in frames if frame.exposure is not None}
    if any(not 0 < value < math.inf for value in headers.values()):
        yield error("sequence", "exposure-invalid", f"exposure in the header: {next(iter(headers.values()))}",
                    "an EV was written instead of a multiplier", "write a positive multiplier: 2 ** EV")
        return
    offs = [math.log2(headers[number]) - metered[number] for number in metered if number in headers]
    if offs and abs(off := float(np.median(offs))) > MISMATCH_EV:
        number = next(number for number in metered if number in headers)
        evidence = (f"the header's exposure is {headers[number]:.3g} ({math.log2(headers[number]):+.2f} EV), metering "
                    f"wants {2 ** metered[number]:.3g} ({metered[number]:+.2f} EV): {off:+.2f} EV")
        result = "bright" if off > 0 else "dark"
        yield warning("sequence", "exposure-mismatch", evidence, f"pictures would be too {result}: colour was scaled "
                      "after the exposure was set, or it is that of another camera", "write the multiplier that brings "
                      "mid grey to 0.18, or use --exposure auto")
    elif not headers and metered and abs(ev := float(np.median(list(metered.values())))) > UNUSUAL_EV:
        yield info("sequence", "exposure-unusual", f"metering wants {ev:+.2f} EV", "physical light units without a "
                   "camera's exposure", "nothing to do with --exposure auto; else write postfx:exposure")
