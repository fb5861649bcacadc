"""The difference of a window to the whole frame falls with the halo, and is found where it is."""

from pathlib import Path

import pytest

from postfx.passes.denoise.models import halo_of
from training.measure import halo

ROOM = Path(__file__).resolve().parents[3] / "samples/room/noisy.####.exr"


def test_windows_end_a_halo_below_what_is_denoised() -> None:
    for side in (24, 56, 72):
        found = halo.rows_for(side, 180)
        assert found and all((rows + side + halo.STRENGTH_REACH_PX) % halo.SIDE_MULTIPLE == 0
                             for rows in found)
        assert max(found) + side < 180
    assert not halo.rows_for(170, 180)


def test_a_smaller_halo_differs_more_and_that_in_use_by_less_than_a_thousandth(
    capsys: pytest.CaptureFixture[str]
) -> None:
    used = halo_of(["denoise_upscale.s.int8"])
    halo.main([str(ROOM), "--model", "s", "--halos", "24", str(used)])
    words = capsys.readouterr().out.replace(",", "").split()
    narrow, wide = float(words[words.index("24:") + 1]), float(words[words.index(f"{used}:") + 1])
    assert wide < 1e-3 < narrow
