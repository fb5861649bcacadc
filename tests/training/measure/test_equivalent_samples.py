"""Equivalent sample counts: the curve, the find_crossing, and the noise of the reference."""

import argparse
import json

import numpy as np
import OpenImageIO as oiio
import pytest

for module in ("flip_evaluator", "skimage", "matplotlib"):
    pytest.importorskip(module, reason="needs the extra 'bench'")
from training.measure.equivalent_samples import Errors, find_crossing, measure, prefix_counts  # noqa: E402


def test_counts_rise_to_the_most():
    counts = prefix_counts(100)
    assert counts[:5] == [1, 2, 3, 4, 5] and counts[-1] == 100 and counts == sorted(set(counts))
    assert prefix_counts(2) == [1, 2] and prefix_counts(1) == [1]


def test_the_find_crossing_is_interpolated_in_logarithms():
    counts = np.array([1, 4, 16, 64])
    assert find_crossing(counts, 8.0 / counts, 1.0) == pytest.approx(8)
    assert find_crossing(counts, 8.0 / counts**0.5, 2.0) == pytest.approx(16)
    assert (find_crossing(counts, 8.0 / counts, 100.0) == 1
            and find_crossing(counts, 8.0 / counts, 0.01) is None)


def images(rng, count, size=(64, 96)):
    """A picture, and `count` noisy ones of it whose noise is a tenth of its light."""
    picture = (0.5 + 0.3 * np.sin(np.arange(size[1]) / 9))[None, :, None] * np.ones((*size, 3))
    return picture, picture * (1 + 0.1 * rng.standard_normal((count, *size, 3)))


def test_the_reference_s_noise_is_taken_out():
    rng = np.random.default_rng(1)
    picture, noisy = images(rng, 8)
    exact = Errors(picture, picture, 1.0)
    measured = Errors(noisy[:2].mean(0), noisy[2:4].mean(0), 1.0)
    assert exact.noise == {"seen": 0, "relmse": 0}
    for key, value in exact(noisy[7]).items():
        assert measured(noisy[7])[key] == pytest.approx(value, rel=0.02), key
        # what it would be with the noise
        assert measured(noisy[7])[key] + measured.noise[key] > 1.2 * value


@pytest.fixture
def view(tmp_path):
    """A view whose noise is mild, so that a mean of n images has 1/n of the error of one."""
    rng = np.random.default_rng(2)
    picture, noisy = images(rng, 64)
    counts = prefix_counts(64)
    means = np.stack([noisy[:n].mean(0) for n in counts]).astype(np.float32)
    ones = np.ones((2, *picture.shape[:2], 1), np.float32)
    planes = {"diffuse_albedo": np.tile(0.5 * ones, 3), "specular_albedo": np.tile(0 * ones, 3),
              "normal": np.tile(ones, 3) * np.float32([0, 0, 1]), "roughness": ones,
              "depth": 3 * ones, "motion": np.tile(0 * ones, 2)}
    np.savez(tmp_path / "view.npz", colour=noisy[:2].astype(np.float32), reference_a=picture,
             reference_b=picture, counts=counts, means=means,
             facts=json.dumps({"scene": "made up", "seed": 9000}), **planes)
    return tmp_path / "view.npz"


def test_a_network_s_equivalent_samples(view, tmp_path, capsys):
    measure(argparse.Namespace(view=view, results=tmp_path / "out", model="m", no_oidn=True,
                               device="cpu"))
    facts = json.loads((tmp_path / "out/equivalent_samples.json").read_text())
    curve, counts = np.array(facts["curve"]["relmse"]), np.array(facts["counts"])
    assert np.allclose(curve * counts, curve[0], rtol=0.1)
    row = facts["results"]["m"]
    assert row["images"] == 2 and row["error"]["relmse"] < curve[0]
    assert row["equivalent_samples"]["relmse"] == pytest.approx(curve[0] / row["error"]["relmse"],
                                                                rel=0.15)
    assert "m: one sample a pixel is worth seen" in capsys.readouterr().out
    assert np.ptp(oiio.ImageBuf(str(tmp_path / "out/equivalent_samples.png"))
                  .get_pixels(oiio.UINT8)) == 255
