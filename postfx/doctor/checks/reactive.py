"""What the reactive mask is made of: whether it leaves any history."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from postfx.doctor.findings import Finding, warning
from postfx.doctor.material import Material
from postfx.doctor.statistics import percent
from postfx.frame import Role

MOST = 90.0  # percent of pixels that ignore more than half of their history
DIFFERENT, ALIKE = 25.0, 65.0  # percent: of pixels, and of neighbours that are both brighter or both darker


def reactive_everywhere(material: Material) -> Iterator[Finding]:
    """A mask that makes nearly every pixel a first frame's."""
    frame = material.middle
    if Role.REACTIVE in frame and (share := percent(frame[Role.REACTIVE] > 0.5)) > MOST:
        evidence = f"{share:.3g} % of the pixels ignore more than half of their history"
        yield warning(Role.REACTIVE, "reactive-everywhere", evidence, "stored the other way round, 1 where the history "
                      "is used", "store 0 where it is used and 1 where it is ignored")


def opaque_samples(material: Material) -> Iterator[Finding]:
    """Colour before transparency whose noise is another than that of the colour: it is brighter here and darker next
    to it, where something in front makes neighbours alike."""
    frame = material.middle
    if Role.COLOUR not in frame or Role.OPAQUE_COLOUR not in frame:
        return
    before = frame[Role.OPAQUE_COLOUR].sum(axis=2)
    change = frame[Role.COLOUR].sum(axis=2) - before
    sign = np.where(np.abs(change) > 0.1 * np.abs(before), np.sign(change), 0)
    both = (sign[:, 1:] != 0) & (sign[:, :-1] != 0)
    share, alike = percent(sign != 0), percent((sign[:, 1:] == sign[:, :-1])[both]) if both.any() else 100.0
    if share > DIFFERENT and alike < ALIKE:
        evidence = (f"{share:.3g} % of the pixels differ from the colour by more than a tenth, and {alike:.3g} % of "
                    "neighbours in the same direction")
        yield warning(Role.OPAQUE_COLOUR, "opaque-samples", evidence, "rendered with other samples than the colour, so "
                      "that the reactive mask is made of noise", "write both colours of the same samples, or a plane "
                      "'reactive'; --reactive none leaves it out")
