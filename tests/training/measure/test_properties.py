"""Cases by formula: frames and truth belong together, and what gets worse with more samples is
found."""

import numpy as np
import pytest

from postfx.frame import Role
from training.measure import properties
from training.measure.properties import CASES, SIDE, measure, rises, table


@pytest.mark.parametrize("name", CASES)
def test_frames_and_truth_of_a_case_belong_together(name: str) -> None:
    make, scales = CASES[name]
    for scale in scales:
        for case in make(scale):
            assert case.truth.shape == (round(SIDE * scale), round(SIDE * scale), 3)
            assert all(np.isfinite(plane).all() for one in case.frames
                       for plane in one.planes.values())
            assert [one.reset for one in case.frames] == [True, *[False] * (len(case.frames) - 1)]
            mean = np.mean([one[Role.COLOUR].mean() for one in case.frames])
            assert mean == pytest.approx(case.truth.mean(),
                                         rel=0.2), "noise neither adds nor takes light"
            assert measure(case,
                           case.truth)["psnr"] > 100 and measure(case, case.truth)["light"] == 1


def test_cases_without_noise_are_their_truth() -> None:
    for name in ("text", "speckle"):
        first = next(properties.CASES[name][0](1))
        np.testing.assert_array_equal(first.frames[0][Role.COLOUR], first.truth)


def test_noise_that_rises_with_samples_is_found() -> None:
    rows = [{"case": "wall", "scale": 2, "spp": spp, "method": "m", "psnr": psnr, "noise": noise,
             "light": 1.0}
            for spp, psnr, noise in ((1, 40.0, 0.01), (2, 43.0, 0.007), (4, 41.0, 0.009))]
    assert rises(rows, "m") == ["wall 2x, 2 to 4 samples: 43.00 dB, then 41.00"]
    assert "| wall | 2x | spp 4 | 41.00 |" in table(rows)
