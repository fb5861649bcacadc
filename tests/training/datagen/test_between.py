"""The sequences by which frames between frames are judged."""


import numpy as np

from tests.training.llvm import require_mitsuba

mi = require_mitsuba()

from postfx.frame import Role  # noqa: E402
from postfx.sampling import bilinear  # noqa: E402
from training.datagen.between import HEIGHT, WIDTH, mirror, planes_of, wires  # noqa: E402


def test_motion_leads_to_the_same_point_in_the_frame_before() -> None:
    """A camera that moves sideways: nothing comes nearer, but bars hide a part of the wall."""
    before, after = (planes_of(wires(t), wires(t - 1)) for t in (4.0, 5.0))
    y, x = np.indices((HEIGHT, WIDTH), np.float32)
    u, v = x + after[Role.MOTION][..., 0], y + after[Role.MOTION][..., 1]
    inside = (u > 0) & (u < WIDTH - 1) & (v > 0) & (v < HEIGHT - 1)
    there = bilinear(before[Role.DEPTH], u[inside], v[inside])[:, 0]
    here = after[Role.DEPTH][inside][:, 0]
    assert (np.median(np.abs(there / here - 1)) < 1e-5
            and (np.abs(there / here - 1) < 0.01).mean() > 0.75)
    assert np.abs(after[Role.MOTION]).mean() > 2


def test_mirrors_tell_how_far_what_they_show_is() -> None:
    """The wall behind the camera is at least eight metres from the mirror, all else nearer."""
    length = planes_of(mirror(2.0), mirror(1.0))[Role.SPECULAR_HIT_DISTANCE]
    seen = length[(length > 0) & (length < 1e10)]
    assert seen.size > 0.1 * length.size and 8 < seen.max() < 20 and seen.min() > 0
