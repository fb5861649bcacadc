"""What measures parts and alpha: frames that add up, grades, and truths that noisy samples go
towards."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")

from postfx.frame import Role  # noqa: E402
from training.measure import alpha, parts  # noqa: E402


def test_groups_add_up_and_are_graded(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    names = {"key": 3, "fill": 3, "albedo": 3, "normal": 3, "depth": 1, "motion": 2}
    arrays = {f"{name}{i}": random.random((8, 8, count)) for name, count in names.items()
              for i in range(2)}
    np.savez(tmp_path / "a.npz", **arrays,
             **{f"ref16_{name}1": random.random((16, 16, 3)) for name in ("key", "fill")})
    frames, references = parts.load(tmp_path / "a.npz")
    assert (len(frames) == 2 and references.keys() == {"key", "fill"}
            and references["key"][16].shape == (16, 16, 3))
    key, fill = (frames[1].parts[name] for name in ("key", "fill"))
    np.testing.assert_allclose(frames[1][Role.COLOUR], key + fill, rtol=1e-6)
    np.testing.assert_allclose(parts.graded(frames[1])[Role.COLOUR], 2 * key + 0.5 * fill,
                               rtol=1e-6)
    assert parts.shown_psnr(key, key) > 100 > parts.shown_psnr(key, fill)


def test_more_samples_come_nearer_to_the_truth() -> None:
    hairs = alpha.Hairs.grown()
    few, more, true = (alpha.draw(hairs, seed, count, 1, False, np.zeros(2))[Role.ALPHA]
                       for seed, count in ((1, 1), (2, 4), (3, 12)))
    assert np.abs(more - true).mean() < 0.8 * np.abs(few - true).mean()
    assert set(np.unique(few)) == {0, 1} and true.shape == (alpha.SIDE, alpha.SIDE, 1)


@pytest.mark.parametrize(("scale", "way", "most"), [
    (1, "still", 1.4), pytest.param(2, "moving", 1.5, marks=pytest.mark.soak)])
@pytest.mark.soak
def test_composites_with_denoised_alpha_are_near_those_with_true_alpha(scale: int, way: str,
                                                                       most: float) -> None:
    """With 256 samples of the truth, 1x is within 1 dB: fewer count against denoised alpha only."""
    for resampled, denoised, true in alpha.measure("m", scale, way, truth=64).values():
        assert denoised >= true - most and denoised >= resampled
