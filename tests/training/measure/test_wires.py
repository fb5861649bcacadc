"""Frames between those of thin wires."""

import numpy as np
import pytest

from training.measure.wires import DRAWN, draw_wire, gains

SEED = 2
"""Wires by which the rule was chosen."""
LARGEST_LOSS_DB = 0.3


@pytest.mark.parametrize("drawn, is_right, lost", [
    (36, False, 7.0), (24, False, 3.4), (1, False, 2.9), (12, False, 2.1), (37, False, 1.8),
    (19, True, 9.3), (18, True, 6.1), (37, True, 2.9),
])
def test_a_wire_is_as_good_as_by_estimated_motion(drawn, is_right, lost):
    """Wires of 0.7 to 2 pixels whose vectors fit no better than estimated motion: wrong ones, and
    right ones along a wire, whose cells took the wall with them. They were `lost` dB below."""
    random = np.random.default_rng(SEED)
    wires = [draw_wire(random, is_right) for _ in range(DRAWN)]
    assert min(gains(wires[drawn])) > -LARGEST_LOSS_DB > -lost
