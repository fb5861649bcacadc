"""What loops and tuned networks are measured by: samples for the same error, and clean tiles."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("flip_evaluator")

from postfx.frame import Role  # noqa: E402
from postfx.io.sequence import read_sequence  # noqa: E402
from training.measure import render_more, tune_shot  # noqa: E402


def figures(samples: float, error: float) -> render_more.Figures:
    return render_more.Figures(samples, -10 * np.log10(error), error**0.5, 2 * error**0.5,
                               np.full(4, error**0.5))


def test_samples_are_a_share_of_the_uniform_ones_with_the_same_figures():
    curve = [figures(count, 1 / count) for count in (4, 8, 16, 32)]
    assert render_more.shares(curve, figures(8, 1 / 16)) == pytest.approx([0.5, 0.5, 0.5])
    assert np.isnan(render_more.shares(curve, figures(8, 1 / 64))).all()
    assert render_more.equivalent([4, 8, 16], [0.4, 0.2, 0.3], 0.25) == pytest.approx(6.4, rel=0.02)
    assert render_more.within(np.array([1.0, 1.3, 0.7, 3.0]), 2.0) == 0.75


def test_the_best_spread_saves_nothing_where_all_tiles_are_alike_and_most_where_one_errs():
    counts = [4.0, 8.0, 16.0, 32.0, 64.0]
    falls = np.array(counts)[:, None] ** -0.5
    alike = render_more.best_spread(falls * np.ones(16), counts, 16)
    assert alike == pytest.approx(1, abs=0.02)
    uneven = render_more.best_spread(falls * np.array([1.0, *[1e-3] * 15]), counts, 16)
    assert uneven < 0.6


def test_clean_tiles_are_as_many_as_asked_for(tmp_path: Path):
    references = {number: np.full((64, 96, 3), number, np.float64) for number in (1, 2)}
    pattern = tune_shot.write_tiles(references, 5, tmp_path)
    frames = list(read_sequence(pattern))
    counts = [frame[Role.SAMPLE_COUNT][:, :, 0] > 0 for frame in frames]
    assert sum(count.sum() for count in counts) == 5 * tune_shot.TILE**2
    for frame, count in zip(frames, counts, strict=True):
        assert ((frame[Role.COLOUR][count] == frame.number).all()
                and (frame[Role.COLOUR][~count] == 0).all())


def test_references_of_twice_the_size_are_averaged(tmp_path: Path):
    from postfx.io.writer import write_channels

    light = np.arange(16.0).reshape(4, 4)
    write_channels(tmp_path / "ref.0001.exr", {name: light for name in "RGB"})
    mean = tune_shot.reference_of(read_sequence(f"{tmp_path}/ref.####.exr"), 1, 2)
    np.testing.assert_allclose(mean[:, :, 0], [[2.5, 4.5], [10.5, 12.5]])
