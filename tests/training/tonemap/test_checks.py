"""What looks must never do: charts catch what they should, and the shipped looks pass them."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("PyOpenColorIO")
pytest.importorskip("flip_evaluator", reason="needs the extra 'bench'")

from postfx.colour.displays import srgb_encode  # noqa: E402
from postfx.frame import Frame, Role  # noqa: E402
from training.tonemap.checks import greys, halo, hue_flips, sweep  # noqa: E402
from training.tonemap.evaluate import Mapper  # noqa: E402
from training.tonemap.looks import LOOKS, exact_target  # noqa: E402
from training.tonemap.pictures import hue_chart, ramp  # noqa: E402


def plain(rgb: np.ndarray) -> np.ndarray:
    """x / (1 + x) through the sRGB curve."""
    return srgb_encode(rgb / (1 + rgb))


def test_charts_hold_what_they_say() -> None:
    stops = np.log2(ramp()[0, :, 0] / 0.18)
    assert (stops[0] == pytest.approx(-8) and stops[-1] == pytest.approx(6)
            and (np.diff(stops) > 0).all())
    chart = hue_chart()
    peak = chart.max(-1)
    assert np.log2(peak.max() / peak.min()) == pytest.approx(23, abs=0.1)


def test_a_tint_a_fall_and_a_band_are_found() -> None:
    clean = greys(plain, plain)
    assert clean["chroma"] < 0.01 and clean["fall"] == 0 and clean["rough"] == 0
    assert greys(lambda x: plain(x) * [1.0, 1.0, 0.97], plain)["chroma"] > 2
    assert greys(lambda x: np.sin(2.5 * plain(x)), plain)["fall"] > 0.05
    assert greys(lambda x: np.floor(plain(x) * 32) / 32, plain)["rough"] > 5


def test_a_flipped_hue_and_a_broken_value_are_found() -> None:
    chart = plain(hue_chart())
    assert hue_flips(chart, chart) == 0
    assert hue_flips(chart[..., ::-1], chart) > 0.1
    grey = np.full((16, 16, 3), 0.18, np.float32)
    assert sweep(plain, plain, grey) == {"in_range": True, "hue_flips": 0}
    assert not sweep(lambda x: np.where(x > 9, np.nan, plain(x)), plain, grey)["in_range"]


def test_a_halo_is_found() -> None:
    def glowing(rgb: np.ndarray) -> np.ndarray:
        out = plain(rgb)
        return out + 0.1 * (out - (np.roll(out, 8, 1) + np.roll(out, -8, 1)) / 2)

    assert halo(plain, plain) == 0
    assert halo(glowing, plain) > 5


@pytest.mark.parametrize("tag", ["aces2", "local", "auto"])
def test_shipped_looks_pass(tag: str) -> None:
    look, mapper = LOOKS[tag], Mapper(tag)

    def reference(rgb: np.ndarray) -> np.ndarray:
        return exact_target(rgb, look)

    found = greys(mapper, reference)
    assert found["chroma"] < 0.5 and found["fall"] < 1 and found["rough"] < 1
    random = np.random.default_rng(1)
    patches = (np.exp2(random.normal(-2, 2, (6, 8, 3))).repeat(24, 0).repeat(24, 1)
               .astype(np.float32))
    assert sweep(mapper, reference, patches) == {"in_range": True, "hue_flips": 0}
    assert halo(mapper, reference) < 1  # of 255 steps


@pytest.mark.parametrize("tag", ["local", "auto"])
def test_what_was_kept_of_a_sequence_stays_as_it_was(tag: str) -> None:
    """Two frames later, too: the pass writes into the memory of the first one's."""
    mapper, light = Mapper(tag), ramp(64)
    kept = [mapper.smooth_state(Frame({Role.COLOUR: light * gain}, number))
            for number, gain in enumerate((1, 4, 16))]
    first = Mapper(tag).smooth_state(Frame({Role.COLOUR: light}, 0))
    np.testing.assert_array_equal(kept[0], first)
    assert np.abs(kept[2] - first).max() > 1e-3
